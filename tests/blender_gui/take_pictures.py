"""Bakes the open file in a Blender with a window, as an artist would, and takes a picture while it bakes and one after.

    blender sample_blends/furnished_room.blend --python tests/blender_gui/take_pictures.py

The extension must be installed. PICTURES names the folder for the pictures (default: a temporary one), QUALITY, SIZE,
PASS and OUTPUT are the panel's, SHADING the viewport's. Prints the longest gap in which Blender's main loop did not run.
"""

import os
import shutil
import subprocess
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import bpy

PICTURES = Path(os.environ.get("PICTURES") or tempfile.mkdtemp(prefix="leaflight_pictures_"))
QUALITY = os.environ.get("QUALITY", "PRODUCTION")
SIZE = int(os.environ.get("SIZE", "512"))
PASS = os.environ.get("PASS", "combined")
OUTPUT = os.environ.get("OUTPUT") or tempfile.mkdtemp(prefix="leaflight_images_")
SHADING = os.environ.get("SHADING", "MATERIAL")
MID_BAKE_FRACTION = 0.4
GIVE_UP_SECONDS = 240.0
TICK_SECONDS = 0.02
CALM_TICKS = 50


def take_picture(name: str) -> Iterator[float]:
    """The whole window; with ImageMagick where it is there, for Blender's own picture is black on software OpenGL."""
    path = str(PICTURES / f"{name}.png")
    if shutil.which("import"):
        process = subprocess.Popen(["import", "-window", "root", path])
        while process.poll() is None:
            yield TICK_SECONDS
    else:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            bpy.ops.screen.screenshot(filepath=path)
    print(f"PICTURE {path}", flush=True)


def find_view():
    window = bpy.context.window_manager.windows[0]
    return window, next(area for area in window.screen.areas if area.type == "VIEW_3D")


def find_region(area, kind):
    return next(region for region in area.regions if region.type == kind)


def look_through_camera(area) -> None:
    space = area.spaces.active
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_overlays = False
    space.show_gizmo = False
    space.shading.type = SHADING
    if SHADING == "SOLID":
        space.shading.light, space.shading.color_type = "FLAT", "TEXTURE"


def steps() -> Iterator[float]:
    """What happens, one after the other; each value is the seconds until the next step."""
    state = bpy.context.window_manager.leaflight_state
    window, area = find_view()
    area.spaces.active.show_region_ui = True
    look_through_camera(area)
    yield 1.0  # the sidebar must be drawn once before its tab can be chosen
    find_region(area, "UI").active_panel_category = "Leaflight"
    settings = bpy.context.scene.leaflight
    settings.quality, settings.size, settings.main_pass = QUALITY, SIZE, PASS
    settings.output = OUTPUT
    area.tag_redraw()
    yield 1.0
    with bpy.context.temp_override(window=window, area=area, region=find_region(area, "WINDOW")):
        bpy.ops.view3d.view_center_camera()
    yield 8.0  # the first material preview compiles shaders
    yield from take_picture("before")
    gaps, last = [], time.perf_counter()
    with bpy.context.temp_override(window=window, area=area, region=find_region(area, "WINDOW")):
        bpy.ops.leaflight.bake("INVOKE_DEFAULT")
    start_gap = time.perf_counter() - last
    pictured, began = False, last
    while state.running and time.perf_counter() - began < GIVE_UP_SECONDS:
        if not pictured and state.fraction >= MID_BAKE_FRACTION:
            yield from take_picture("baking")
            pictured = True
        last = time.perf_counter()
        yield TICK_SECONDS
        gaps.append(time.perf_counter() - last)
    print(f"SECONDS {time.perf_counter() - began:.1f}  error {state.error!r}  result {state.summarize()}  warnings {state.warnings}")
    print(f"GAP press of Bake {start_gap:.3f} s, longest while it ran {max(gaps[:-1]):.3f} s, at the end {gaps[-1]:.3f} s", flush=True)
    for _ in range(CALM_TICKS):  # shaders compile and panels slide into place meanwhile
        area.tag_redraw()
        yield 0.2
    yield from take_picture("done")
    if state.result:
        print("UNDO " + ("bake still there" if leaves_bake_after_undo(window, area) else "one step took the bake off"), flush=True)


def leaves_bake_after_undo(window, area) -> bool:
    with bpy.context.temp_override(window=window, area=area):
        bpy.ops.ed.undo()
    return any("leaflight_bake" in obj for obj in bpy.context.scene.objects)


def run(script=None) -> float | None:
    """Blender's timer: the next step, and Blender's end after the last one."""
    try:
        return next(script)
    except StopIteration:
        bpy.ops.wm.quit_blender()
    except Exception:
        traceback.print_exc()
        bpy.ops.wm.quit_blender()
    return None


PICTURES.mkdir(parents=True, exist_ok=True)
bpy.context.preferences.view.show_splash = False
SCRIPT = steps()
bpy.app.timers.register(lambda: run(SCRIPT), first_interval=2.0)
