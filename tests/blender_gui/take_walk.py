"""Walks through the extension as a new user does, in Blender's default scene and default view, with a picture of each step.

    blender --python tests/blender_gui/take_walk.py

The extension must be installed, and ImageMagick there. PICTURES names the folder for the pictures (default: a temporary one).
Prints a line for each thing that a user counts on, and at last how many failed. The pictures are those of docs/first-bake.md.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
import gui_script
from gui_script import check, check_all, has_bake, in_view, press, region_of, settle, start, state, view, wait, window

PICTURES = gui_script.make_pictures_folder()
FILE = Path(tempfile.mkdtemp(prefix="leaflight_walk_file_")) / "My Room.blend"
WIDTH, COLORS = 640, 96


def take_picture(name: str, crop: str = "") -> Iterator[float]:
    """The 3D View, or another part of the screen."""
    yield from gui_script.take_picture(PICTURES / f"{name}.png", crop or gui_script.crop_of(view()), WIDTH, COLORS)


def open_tab() -> Iterator[float]:
    yield from gui_script.open_tab()
    for cls in ("quality", "lightmap"):  # closed by hand: only the panel Bake is walked through
        panel = getattr(bpy.types, f"LEAFLIGHT_PT_{cls}", None)
        if panel is not None and "DEFAULT_CLOSED" not in getattr(panel, "bl_options", ()):
            bpy.utils.unregister_class(panel)
            panel.bl_options = {"DEFAULT_CLOSED"}
            bpy.utils.register_class(panel)
    yield from settle()


def bake() -> Iterator[float]:
    yield from gui_script.bake()
    yield from settle(2.5)


def count_bright() -> int:
    """Colours of the view: the light of a bake has more of them than a flat grey."""
    area, path = view(), Path(tempfile.mkdtemp(prefix="leaflight_colors_")) / "view.png"
    side = region_of(view(), "UI").width
    crop = f"{area.width - side - 100}x{area.height - 200}+{area.x + 50}+{window().height - area.y - area.height + 100}"
    subprocess.run(["import", "-window", "root", "-crop", crop, "+repage", str(path)], check=True)
    found = subprocess.run(["identify", "-format", "%k", str(path)], check=True, capture_output=True, text=True)
    return int(found.stdout)


def walk() -> Iterator[float]:
    with in_view():
        bpy.ops.mesh.primitive_plane_add(size=8.0, location=(0.0, 0.0, -1.0))
        bpy.context.object.name = "Floor"
        bpy.ops.object.select_all(action="DESELECT")
    yield from open_tab()
    yield from settle()
    yield from take_picture("1_unsaved")
    with in_view():
        check("an unsaved file cannot be baked", not bpy.ops.leaflight.bake.poll())
    bpy.ops.wm.save_as_mainfile(filepath=str(FILE))
    yield from wait(lambda: not bpy.context.window_manager.leaflight_meter.stale)
    yield from settle()
    yield from take_picture("2_plan")
    shading = view().spaces.active.shading
    print(f"VIEW {shading.type} {shading.color_type} {shading.light}", flush=True)
    before = count_bright()
    yield from bake()
    check("the first bake ends without an error", has_bake() and not state().error)
    yield from take_picture("3_baked")
    press("show_it")
    yield from settle()
    after = count_bright()
    print(f"COLOURS {before} before, {after} with the light shown", flush=True)
    check("Show It shows the light", view().spaces.active.shading.color_type == "TEXTURE" and after != before)
    yield from take_picture("4_shown")
    lamp = bpy.data.objects["Light"]
    lamp.location.x, lamp.data.color = -3.0, (1.0, 0.55, 0.2)
    with in_view():
        bpy.ops.ed.undo_push(message="Move Light")
    yield from settle(3.0)
    yield from take_picture("5_lamp_moved")
    yield from bake()
    yield from take_picture("6_again")
    with in_view():
        bpy.ops.ed.undo()
    yield from settle(3.0)
    check("after an undo objects still wear a bake", has_bake())
    yield from take_picture("7_undone")
    with in_view():
        bpy.ops.ed.redo()
    yield from settle()
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(FILE))
    yield 2.0
    yield from open_tab()
    yield from settle(3.0)
    check("the reopened file wears its bake", has_bake())
    yield from take_picture("8_reopened")
    press("export_gltf", filepath=str(FILE.with_suffix(".glb")))
    yield from settle()
    check("a .glb was exported", FILE.with_suffix(".glb").is_file())
    press("remove")
    yield from settle(3.0)
    shading = view().spaces.active.shading
    check("Remove takes the bake off and switches the view back", not has_bake() and shading.color_type == "MATERIAL")
    yield from take_picture("9_removed")
    yield from picture_preferences()


def picture_preferences() -> Iterator[float]:
    """The extension in the preferences, with its choices."""
    from bl_ext.user_default import leaflight

    with in_view():
        bpy.ops.screen.userpref_show("INVOKE_DEFAULT", section="ADDONS")
    yield 2.0
    bpy.context.window_manager.addon_search = "Leaflight"
    module = leaflight.__name__
    opened = window() if len(bpy.context.window_manager.windows) == 1 else bpy.context.window_manager.windows[-1]
    with bpy.context.temp_override(window=opened):
        bpy.ops.preferences.addon_expand(module=module)
    yield from settle()
    for area in opened.screen.areas:
        area.tag_redraw()
    yield 1.0
    yield from take_picture("0_preferences", f"{opened.width}x130+{opened.x}+80")  # without a window manager it stands at the top


start(check_all(walk(), "the walk came to its end"))
