"""Bakes the open file in a Blender with a window, as an artist would, and takes pictures before, at the first light, meanwhile and after.

    blender sample_blends/furnished_room.blend --python tests/blender_gui/take_pictures.py

The extension must be installed. PICTURES names the folder for the pictures (default: a temporary one), QUALITY, SIZE,
PASS and OUTPUT are the panel's, SHADING the viewport's. Prints the seconds from Bake to the first light on the objects, and the
longest gap in which Blender's main loop did not run; before that, the gaps of Blender alone, without a bake: when the view is drawn
anew, and when one object changes its material. The first light is drawn, which is not yet seen: Blender shows white objects until
it has compiled the new materials' shaders; first_light.png tells. PICTURES=none takes no pictures, which would slow the bake.
"""

import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
import gui_script
from gui_script import check_all, has_bake, in_view, make_pictures_folder, open_tab, press, settle, start, state, view, window

PICTURES = make_pictures_folder() if os.environ.get("PICTURES") != "none" else None
QUALITY = os.environ.get("QUALITY", "PREVIEW")
SIZE = int(os.environ.get("SIZE", "512"))
PASS = os.environ.get("PASS", "combined")
OUTPUT = os.environ.get("OUTPUT") or tempfile.mkdtemp(prefix="leaflight_images_")
SHADING = os.environ.get("SHADING", "MATERIAL")
MID_BAKE_FRACTION = 0.4
GIVE_UP_SECONDS = 240.0
TICK_SECONDS = 0.02
ALONE_TICKS = 150


def take_picture(name: str) -> Iterator[float]:
    """The whole window."""
    if PICTURES:
        yield from gui_script.take_picture(PICTURES / f"{name}.png", f"{window().width}x{window().height}+0+0")


def look_through_camera() -> None:
    space = view().spaces.active
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_overlays = False
    space.show_gizmo = False
    space.shading.type = SHADING
    if SHADING == "SOLID":
        space.shading.light, space.shading.color_type = "FLAT", "TEXTURE"


def steps() -> Iterator[float]:
    """What happens, one after the other; each value is the seconds until the next step."""
    look_through_camera()
    yield from open_tab()
    settings = bpy.context.scene.leaflight
    settings.quality, settings.size, settings.main_pass, settings.output = QUALITY, SIZE, PASS, OUTPUT
    with in_view():
        bpy.ops.view3d.view_center_camera()
    yield from settle(8.0)  # the first material preview compiles shaders
    yield from measure_blender_alone()
    yield from take_picture("before")
    gaps, last = [], time.perf_counter()
    press("bake", "INVOKE_DEFAULT")
    start_gap = time.perf_counter() - last
    began, pictured = last, set()
    drawn: list[float] = []  # when the view was drawn with light on the objects
    handler = bpy.types.SpaceView3D.draw_handler_add(
        lambda: has_bake() and drawn.append(time.perf_counter() - began), (), "WINDOW", "POST_PIXEL"
    )
    while state().running and time.perf_counter() - began < GIVE_UP_SECONDS:
        for name, due in (("first_light", drawn), ("baking", state().fraction >= MID_BAKE_FRACTION)):
            if due and name not in pictured:
                pictured.add(name)
                yield from take_picture(name)
        last, worked = time.perf_counter(), time.thread_time()
        yield TICK_SECONDS
        gaps.append((time.perf_counter() - last, time.thread_time() - worked, time.perf_counter() - began))
    bpy.types.SpaceView3D.draw_handler_remove(handler, "WINDOW")
    print(f"FIRST LIGHT drawn after {drawn[0] if drawn else math.nan:.2f} s; the view was drawn {len(drawn)} times")
    print(f"SECONDS {time.perf_counter() - began:.1f}  error {state().error!r}  result {state().summarize()}  warnings {state().warnings}")
    for gap, worked, at in sorted(gaps, reverse=True)[:6]:  # on a machine that has other work, a gap is longer than what fills it
        print(f"  gap {gap:.3f} s at {at:.1f} s, in which the main thread worked {worked:.3f} s")
    longest = max(gaps[:-1])[0]
    print(f"GAP press of Bake {start_gap:.3f} s, longest while it ran {longest:.3f} s, at the end {gaps[-1][0]:.3f} s", flush=True)
    yield from settle(10.0)  # shaders compile and panels slide into place meanwhile
    yield from take_picture("done")
    if state().result:
        print("UNDO " + ("bake still there" if leaves_bake_after_undo() else "one step took the bake off"), flush=True)


def find_gap(change: Callable[[], None]) -> Iterator[float]:
    """The longest gap after a change, in LONGEST: Blender goes on drawing while samples add up."""
    LONGEST.append(0.0)
    yield 2.0  # what came before comes to rest
    change()
    for _ in range(ALONE_TICKS):
        last = time.perf_counter()
        yield TICK_SECONDS
        LONGEST[-1] = max(LONGEST[-1], time.perf_counter() - last)


LONGEST: list[float] = []


def measure_blender_alone() -> Iterator[float]:
    """Prints what gaps Blender makes here without Leaflight."""
    obj = next(one for one in bpy.context.scene.objects if one.type == "MESH" and one.material_slots)
    slot, own, other = obj.material_slots[0], obj.material_slots[0].material, bpy.data.materials.new("Other")
    yield from find_gap(view().tag_redraw)
    yield from find_gap(lambda: setattr(slot, "material", other))
    yield from find_gap(lambda: setattr(slot, "material", own))
    bpy.data.materials.remove(other)
    yield 8.0  # what this has set going in Blender comes to rest
    redraw, *changes = LONGEST
    print(f"ALONE the view drawn anew {redraw:.3f} s, one object's material changed {max(changes):.3f} s", flush=True)


def leaves_bake_after_undo() -> bool:
    with in_view():
        bpy.ops.ed.undo()
    return has_bake()


start(check_all(steps(), "the pictures"), has_checks=False)
