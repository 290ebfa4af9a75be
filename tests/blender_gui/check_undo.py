"""Checks with a window that the light shown is always that of the objects' UVs, and that a changed scene says so.

    blender --enable-event-simulate sample_blends/cornell_box.blend --python tests/blender_gui/check_undo.py

The extension must be installed, and ImageMagick there. PICTURES names the folder for the pictures (default: a temporary one).
Prints a line for each check, and at last how many failed.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
import gui_script
from gui_script import (
    check,
    check_all,
    crop_of,
    in_view,
    make_pictures_folder,
    open_tab,
    region_of,
    settle,
    start,
    state,
    type_key,
    view,
    wait,
)

PICTURES = make_pictures_folder()
FILE = Path(tempfile.mkdtemp(prefix="leaflight_undo_file_")) / "room.blend"
SAME, OTHER = 0.015, 0.025  # difference (RMSE, of 1) of two pictures of one thing, less or more smooth yet, and of two things


def changes() -> list[str]:
    watch = bpy.context.window_manager.leaflight_changes
    return watch.names if not watch.stale else ["not looked at yet"]


def take_picture(name: str) -> Iterator[float]:
    """The 3D View with its sidebar."""
    yield from settle()
    yield from gui_script.take_picture(PICTURES / f"{name}.png", crop_of(view()))


def compare(first: str, second: str) -> float:
    """Difference of the parts of two pictures that show the room: no header, no panels."""
    area, side = view(), region_of(view(), "UI").width
    crop = f"{area.width - side - 160}x{area.height - 260}+80+130"
    parts = [PICTURES / f"part_{k}.png" for k in range(2)]
    for name, part in zip((first, second), parts, strict=True):
        subprocess.run(["convert", str(PICTURES / f"{name}.png"), "-crop", crop, "+repage", str(part)], check=True)
    found = subprocess.run(["compare", "-metric", "RMSE", *map(str, parts), "null:"], capture_output=True, text=True)
    for part in parts:
        part.unlink()
    difference = float(found.stderr.partition("(")[2].partition(")")[0])
    print(f"DIFFERENCE {first} {second} {difference:.4f}", flush=True)
    return difference


def bake(size: int) -> Iterator[float]:
    bpy.context.scene.leaflight.size = size
    yield from gui_script.bake()
    check(f"a bake of {size} texels ends without an error", not state().error)
    yield from settle()


def walk() -> Iterator[float]:
    bpy.context.scene.leaflight.error = 0.5
    bpy.ops.wm.save_as_mainfile(filepath=str(FILE))
    yield from open_tab()
    shading = view().spaces.active.shading
    shading.type, shading.color_type, shading.light = "SOLID", "TEXTURE", "FLAT"
    view().spaces.active.region_3d.view_perspective = "CAMERA"
    view().spaces.active.overlay.show_overlays = False
    yield from bake(256)
    yield from take_picture("1_first")
    yield from bake(32)
    yield from take_picture("2_second")
    check("a coarser bake looks different", compare("1_first", "2_second") > OTHER)
    yield from type_key("Z", ctrl=True)
    yield from take_picture("3_undone")
    check("Ctrl Z after two bakes shows the first one's light", compare("1_first", "3_undone") < SAME)
    with in_view():
        check("what is kept of the second bake is not offered to go on from", not bpy.ops.leaflight.refine.poll())
    yield from type_key("Z", ctrl=True, shift=True)
    yield from take_picture("4_redone")
    check("Ctrl Shift Z shows the second one's", compare("2_second", "4_redone") < SAME)
    yield from type_key("Z", ctrl=True)
    bpy.ops.wm.save_mainfile()
    yield from bake(32)
    bpy.ops.wm.revert_mainfile()
    yield 2.0
    yield from open_tab()
    yield from take_picture("5_reverted")
    check("Revert shows the light that was saved", compare("1_first", "5_reverted") < SAME)
    yield from wait(lambda: not changes(), 20.0)
    check("an opened file knows that nothing has changed", changes() == [])
    yield from change_a_lamp()
    yield from lose_the_images()


def change_a_lamp() -> Iterator[float]:
    lamp = next(obj for obj in bpy.context.scene.objects if obj.type == "LIGHT")
    name, began = lamp.name, time.monotonic()
    lamp.data.energy *= 2.0
    with in_view():
        bpy.ops.ed.undo_push(message="Change Lamp")
    yield from wait(lambda: changes() == [name], 20.0)
    print(f"SECONDS until the change is said {time.monotonic() - began:.1f}", flush=True)
    check("a changed lamp is named", changes() == [name])
    yield from take_picture("6_changed")
    yield from type_key("Z", ctrl=True)
    yield from wait(lambda: changes() == [], 20.0)
    check("and no longer when the change is undone", changes() == [])


def lose_the_images() -> Iterator[float]:
    shutil.rmtree(FILE.parent / "lightmaps")
    bpy.ops.wm.open_mainfile(filepath=str(FILE))
    yield 2.0
    yield from open_tab()
    yield from take_picture("7_missing")
    worn = [slot.material for obj in bpy.context.scene.objects for slot in obj.material_slots if slot.material]
    check("without images no object wears the bake", not any("leaflight_made" in material for material in worn))
    check("and the panel says why", "leaflight_missing" in bpy.context.scene)


start(check_all(walk(), "the checks came to their end"))
