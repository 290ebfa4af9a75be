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
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d, region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
import gui_script
from gui_script import check, check_all, has_bake, in_view, press, region_of, settle, start, state, view, wait, window

PICTURES = gui_script.make_pictures_folder()
FILE = Path(tempfile.mkdtemp(prefix="leaflight_walk_file_")) / "My Room.blend"
WIDTH, COLORS = 640, 96
ALIKE = 0.03  # of white
LEAST_SPREAD, LEAST_PLACES = 0.2, 50  # of the floor: from its shadows to its brightest; and where it is looked at


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


def visible_places() -> Iterator[tuple[float, float, int, int]]:
    """Places of the floor that the view shows: x and y in metres, and the pixel, from the lower left of the window."""
    area, floor = view(), bpy.data.objects["Floor"]
    region, looking = region_of(area), area.spaces.active.region_3d
    right, top = region.width - region_of(area, "UI").width - 20, region.height - 120
    for x in np.arange(-3.75, 4.0, 0.5):
        for y in np.arange(-3.75, 4.0, 0.5):
            pixel = location_3d_to_region_2d(region, looking, floor.matrix_world @ Vector((x, y, 0.0)))
            if pixel is None or not (100 < pixel.x < right and 40 < pixel.y < top):
                continue
            begin, along = (find(region, looking, pixel) for find in (region_2d_to_origin_3d, region_2d_to_vector_3d))
            if bpy.context.scene.ray_cast(bpy.context.evaluated_depsgraph_get(), begin, along)[4] == floor:
                yield x, y, region.x + int(pixel.x), region.y + int(pixel.y)


def read_screen() -> np.ndarray:
    """The window, (height, width) float, 0 to 1, row 0 at the bottom."""
    size = window().width, window().height
    found = subprocess.run(
        ["import", "-window", "root", "-crop", f"{size[0]}x{size[1]}+0+0", "-depth", "8", "rgb:-"], check=True, capture_output=True
    )
    return np.frombuffer(found.stdout, np.uint8).reshape(size[1], size[0], 3)[::-1].mean(axis=2) / 255.0


def read_page(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """What the lightmap that the scene wears has at these places of the floor, as a screen shows it; of the nearest texels."""
    (image,) = bpy.context.scene["leaflight_layout"]["images"].values()
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    page = values.reshape(image.size[1], image.size[0], -1)[..., :3]
    mesh = bpy.data.objects["Floor"].data
    layer, corner = mesh.uv_layers["Leaflight"].uv, {}
    for loop in mesh.loops:
        corner[tuple(np.sign(mesh.vertices[loop.vertex_index].co[:2]))] = np.array(layer[loop.index].vector)
    first = corner[-1.0, -1.0]
    uv = first + np.outer((x + 4.0) / 8.0, corner[1.0, -1.0] - first) + np.outer((y + 4.0) / 8.0, corner[-1.0, 1.0] - first)
    light = np.clip(page[tuple((uv[:, ::-1] * (image.size[1], image.size[0])).astype(int).T)], 0.0, 1.0)
    return np.where(light < 0.0031308, light * 12.92, 1.055 * light ** (1.0 / 2.4) - 0.055).mean(axis=1)


def check_shown(name: str, is_shown: bool = True) -> None:
    """Whether the floor in the view is as bright, place by place, as the lightmap has it."""
    places = np.array(list(visible_places()))
    told, shown = read_page(places[:, 0], places[:, 1]), read_places(places)
    differ, spread = np.abs(shown - told).mean(), np.ptp(told)
    print(f"FLOOR {len(places)} places, {told.min():.2f} to {told.max():.2f} in the lightmap, off by {differ:.3f} in the view", flush=True)
    check(f"{name}: there is light and shadow on the floor", len(places) > LEAST_PLACES and spread > LEAST_SPREAD)
    check(f"{name}: the view {'shows' if is_shown else 'does not show'} it as the lightmap has it", (differ < ALIKE) == is_shown)


def read_places(places: np.ndarray) -> np.ndarray:
    """Brightness of the screen at places; medians, for lines of the grid cross some."""
    screen = read_screen()
    return np.array([np.median(screen[y - 3 : y + 4, x - 3 : x + 4]) for x, y in places[:, 2:].astype(int)])


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
    yield from bake()
    check("the first bake ends without an error", has_bake() and not state().error)
    check_shown("Blender's default view", is_shown=False)
    yield from take_picture("3_baked")
    press("show_it")
    yield from settle()
    check_shown("Show It")
    yield from take_picture("4_shown")
    lamp = bpy.data.objects["Light"]
    lamp.location.x, lamp.data.color = -3.0, (1.0, 0.55, 0.2)
    with in_view():
        bpy.ops.ed.undo_push(message="Move Light")
    yield from settle(3.0)
    yield from take_picture("5_lamp_moved")
    yield from bake()
    check_shown("Baked again")
    yield from take_picture("6_again")
    with in_view():
        bpy.ops.ed.undo()
    yield from settle(3.0)
    check("after an undo objects still wear a bake", has_bake())
    check_shown("Undone")
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
    check_shown("Reopened")
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
