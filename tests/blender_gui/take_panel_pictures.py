"""Takes a picture of each state of the panel in a Blender with a window, as an artist meets them; they are docs/panel.

    blender sample_blends/furnished_room.blend --python tests/blender_gui/take_panel_pictures.py

The extension must be installed, and ImageMagick there. PICTURES names the folder for the pictures (default: a temporary one).
Those of errors are check_errors.py's. PARTS names some of the parts below, default all.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
import gui_script
from gui_script import area_of, bake, check_all, choose_parts, has_bake, in_view, press, region_of, settle, start, state, view, wait, window

PICTURES = gui_script.make_pictures_folder()
MID_BAKE_FRACTION = 0.3
LIT_ERROR = 0.3  # no error is stated before some rounds of photons
STRICT_ERROR = 0.01  # such a bake does not end before it is stopped
SIZE = 512
GROUPS = ("quality", "lightmap", "output", "advanced", "research")
WIDTH, COLORS = 700, 256  # of a picture: small files; with fewer colours, or undithered, light that fades shows bands


def chosen():
    return bpy.context.scene.leaflight


def take_picture(name: str, part, height: int | None = None, wide: int = WIDTH) -> Iterator[float]:
    """The upper part of an area or a region, small enough for a page of documentation."""
    yield from gui_script.take_picture(PICTURES / f"{name}.png", gui_script.crop_of(part, height), wide, COLORS, "FloydSteinberg")


def picture_of_view(name: str, height: int = 560) -> Iterator[float]:
    yield from take_picture(name, view(), height)


def picture_of_panel(name: str, height: int = 420) -> Iterator[float]:
    yield from take_picture(name, region_of(view(), "UI"), height)


def open_tab() -> Iterator[float]:
    space = view().spaces.active
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_overlays = space.show_gizmo = False
    space.shading.type = "MATERIAL"
    yield from gui_script.open_tab()
    with in_view():
        bpy.ops.view3d.view_center_camera()


def measured() -> Iterator[float]:
    """Until the panel's estimate is up to date and drawn."""
    yield from settle()
    yield from wait(lambda: not bpy.context.window_manager.leaflight_meter.stale)
    yield from settle()


def picture_plan() -> Iterator[float]:
    yield from settle(20.0)  # the first material preview compiles shaders
    yield from measured()
    yield from picture_of_view("plan")
    chosen().resolution, chosen().density = "DENSITY", 80.0
    yield from measured()
    yield from picture_of_panel("pages")
    chosen().resolution = "PAGE"


def picture_checker() -> Iterator[float]:
    view().spaces.active.shading.type = "SOLID"
    bpy.data.objects["Rug"].leaflight.density_factor = 2.0
    press("checker")
    yield from measured()
    yield from settle()
    yield from picture_of_view("checker")
    press("checker")
    bpy.data.objects["Rug"].leaflight.density_factor = 1.0
    view().spaces.active.shading.type = "MATERIAL"


def picture_bake() -> Iterator[float]:
    obj = bpy.data.objects["Rug"].copy()  # an offender, for the warnings
    obj.name, obj.data = "Nothing", bpy.data.meshes.new("Nothing")
    bpy.context.scene.collection.objects.link(obj)
    shading = view().spaces.active.shading
    shading.type, shading.color_type = "SOLID", "TEXTURE"  # by software alone Material Preview takes as long as half a bake
    press("bake", "INVOKE_DEFAULT")
    yield from wait(lambda: has_bake() or not state().running)
    yield from settle(0.3)
    yield from picture_of_view("first_light")
    yield from wait(lambda: state().fraction >= MID_BAKE_FRACTION or not state().running)
    yield from settle(0.3)
    yield from picture_of_view("baking")
    shading.type = "MATERIAL"
    yield from wait(lambda: not state().running)
    print(f"BAKED {state().summarize()} {state().error!r} {state().warnings}", flush=True)
    yield from measured()
    yield from picture_of_view("done")
    bpy.ops.leaflight.select(names="Nothing")
    print(f"SELECTED {[obj.name for obj in bpy.context.selected_objects]}", flush=True)
    bpy.data.objects.remove(obj)
    press("toggle_preview")
    yield from measured()
    yield from picture_of_view("preview_off")
    press("toggle_preview")


def draw_little() -> None:
    """For pictures of the panel alone: a small page, and a view that leaves the processor to the bake."""
    shading = view().spaces.active.shading
    shading.type, shading.color_type, chosen().size = "SOLID", "TEXTURE", 128


def picture_refine() -> Iterator[float]:
    draw_little()
    chosen().quality, chosen().error = "CUSTOM", STRICT_ERROR
    chosen().force = True  # the scene has not changed
    press("bake", "INVOKE_DEFAULT")
    chosen().force = False
    # Before that there is nothing that Refine could go on from.
    yield from wait(lambda: (state().progress and state().progress.estimated_error < LIT_ERROR) or not state().running)
    press("stop")
    yield from settle(0.2)
    yield from picture_of_panel("stopping", 360)
    yield from wait(lambda: not state().running)
    yield from measured()
    yield from picture_of_panel("stopped")
    press("refine", "INVOKE_DEFAULT")
    yield from settle(1.0)
    yield from wait(lambda: state().fraction >= MID_BAKE_FRACTION or not state().running)
    yield from settle(0.3)
    yield from picture_of_panel("refining", 450)
    press("discard")
    yield from wait(lambda: not state().running)


def picture_other_ends() -> Iterator[float]:
    draw_little()
    press("remove")  # an earlier bake would stand between the bar and what is told
    chosen().quality = "DRAFT"
    press("bake", "INVOKE_DEFAULT")
    with in_view():
        bpy.context.view_layer.objects.active = bpy.data.objects["Rug"]
        bpy.ops.object.mode_set(mode="EDIT")
    yield from wait(lambda: state().notice or not state().running)
    yield from settle(0.5)
    yield from picture_of_panel("edit_mode_waits", 220)
    with in_view():
        bpy.ops.object.mode_set(mode="OBJECT")
    yield from wait(lambda: not state().running)
    yield from bake()
    yield from measured()
    yield from picture_of_panel("unchanged")
    view().spaces.active.shading.type, chosen().size = "MATERIAL", SIZE


def picture_groups() -> Iterator[float]:
    """Output, Advanced and Research without the others, so that they are seen whole."""
    chosen().min_level = 1  # no longer as in a new file: Research is shown
    groups = [getattr(bpy.types, f"LEAFLIGHT_PT_{name}") for name in GROUPS]
    output, chosen().output = chosen().output, "//lightmaps/{blend_name}"
    for name, group in zip(GROUPS[2:], groups[2:], strict=True):
        for panel in groups:
            bpy.utils.unregister_class(panel)
        bpy.utils.register_class(group)
        yield from settle()
        yield from picture_of_panel(name, 640)
        bpy.utils.unregister_class(group)
        for panel in groups:
            bpy.utils.register_class(panel)
    chosen().output, chosen().min_level = output, 0


def open_groups() -> None:
    """All groups as after a click on them; before Blender draws them first, for it remembers which are closed."""
    groups = [getattr(bpy.types, f"LEAFLIGHT_PT_{name}") for name in GROUPS]
    for panel in groups:
        bpy.utils.unregister_class(panel)
    for panel in groups:
        panel.bl_options = set()
        bpy.utils.register_class(panel)


def picture_object() -> Iterator[float]:
    bpy.context.view_layer.objects.active = bpy.data.objects["Rug"]
    panel = bpy.types.LEAFLIGHT_PT_object
    bpy.utils.unregister_class(panel)
    # Open, as after a click; under another name, for Blender remembers of this one that it is closed.
    opened = type("LEAFLIGHT_PT_opened", (panel,), {"bl_idname": "LEAFLIGHT_PT_opened", "bl_options": set()})
    bpy.utils.register_class(opened)
    yield from settle(1.0)
    area = area_of("PROPERTIES")
    area.spaces.active.context = "OBJECT"
    yield 0.5
    with bpy.context.temp_override(window=window(), area=area, region=region_of(area)):
        bpy.ops.screen.screen_full_area()
    yield 1.0
    area = next(area for area in window().screen.areas if area.type == "PROPERTIES")
    yield from take_picture("object", area)
    with bpy.context.temp_override(window=window(), area=area):
        bpy.ops.screen.back_to_previous()
    bpy.utils.unregister_class(opened)
    bpy.utils.register_class(panel)
    yield 1.0


def picture_debug_passes() -> Iterator[float]:
    area = view()
    area.spaces.active.show_region_ui = False
    chosen().quality, chosen().formats = "DRAFT", {"exr", "png"}
    for name in ("leaf_edges", "level", "photons", "charts", "stderr"):
        chosen().main_pass = name
        yield from bake()
        yield from settle(20.0 if name == "leaf_edges" else 6.0)  # the first of them compiles a shader
        yield from take_picture(f"pass_{name}", area, wide=WIDTH // 2)
    chosen().formats = {"exr"}


def picture_gltf() -> Iterator[float]:
    """The exported file, imported again into an empty one."""
    file = str(Path(tempfile.mkdtemp(prefix="leaflight_gltf_")) / "room.glb")
    camera = bpy.context.scene.camera.matrix_world.copy(), bpy.context.scene.camera.data.angle
    chosen().main_pass = "combined"
    yield from bake()
    press("export_gltf", filepath=file)
    bpy.ops.wm.read_homefile(use_empty=True)
    yield 1.0
    with in_view():
        bpy.ops.import_scene.gltf(filepath=file)
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.matrix_world, scene.camera.data.angle = camera
    scene.view_settings.view_transform = "Standard"  # what a viewer shows
    yield from open_tab()
    area = view()
    area.spaces.active.show_region_ui = False
    yield from settle(8.0)
    yield from take_picture("gltf", area, wide=WIDTH // 2)


PARTS = (
    picture_plan,
    picture_checker,
    picture_groups,
    picture_bake,
    picture_refine,
    picture_other_ends,
    picture_object,
    picture_debug_passes,
    picture_gltf,
)


CHOSEN = choose_parts(PARTS, "picture_")


def steps() -> Iterator[float]:
    open_groups()
    yield from open_tab()
    chosen().output, chosen().size, chosen().main_pass = tempfile.mkdtemp(prefix="leaflight_images_"), SIZE, "lighting"
    for part in CHOSEN:
        yield from check_all(part(), part.__name__)


start(steps())
