"""Makes every mistake an artist makes in a Blender with a window, and checks that it is a sentence in the status bar and in the panel.

    blender --enable-event-simulate sample_blends/cornell_box.blend --python tests/blender_gui/check_errors.py

The extension must be installed. Bake is pressed as an artist does it, by a key (F6, for the time of the script). PICTURES names a folder
for pictures of each, of the panel above the status bar (needs ImageMagick; they are docs/panel/error_*.png). PARTS names some of the
mistakes below, default all. Prints a line for each check, and at last how many failed.
"""

import os
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
import gui_script
from gui_script import (
    choose_parts,
    has_bake,
    in_view,
    make_pictures_folder,
    open_tab,
    press,
    region_of,
    settle,
    start,
    state,
    take_picture,
    type_key,
    view,
    wait,
    window,
)

SCENE_FILE = bpy.data.filepath
PICTURES = make_pictures_folder() if "PICTURES" in os.environ else None
WIDTH, BAR_HEIGHT, COLORS = 700, 24, 96


def check(name: str, holds: object) -> None:
    gui_script.check(name, holds)
    if not holds:
        print(f"      told {told()}", flush=True)


def chosen():
    return bpy.context.scene.leaflight


def addon_module(name: str):
    package = next(module for module in sys.modules if module.endswith(".leaflight.addon"))
    return sys.modules[f"{package}.{name}"]


def told(forget: bool = False) -> list[str]:
    """What the status bar was given: Blender's list of reports, which the Info editor shows too."""
    area = next(area for area in window().screen.areas if area.type == "DOPESHEET_EDITOR")
    kind, area.type = area.type, "INFO"
    with bpy.context.temp_override(window=window(), area=area, region=region_of(area)):
        bpy.ops.info.select_all(action="SELECT")
        bpy.ops.info.report_copy()
        if forget:
            bpy.ops.info.report_delete()
    area.type = kind
    return bpy.context.window_manager.clipboard.splitlines()


def press_bake() -> Iterator[float]:
    """The key, low in the view, where Blender's pop-up with the sentence hides nothing of the panel."""
    yield from type_key("F6", 0.1)


def picture(name: str, height: int = 310) -> Iterator[float]:
    """The panel, and the status bar below it."""
    yield from settle()
    if PICTURES is None:
        return
    region, whole = region_of(view(), "UI"), PICTURES / "whole.png"
    panel = f"{WIDTH}x{min(height, region.height)}+{region.x + region.width - WIDTH}+{window().height - region.y - region.height}"
    bar = f"{WIDTH}x{BAR_HEIGHT}+{(window().width - WIDTH) // 2}+{window().height - BAR_HEIGHT}"  # its text is in the middle
    yield from take_picture(whole, f"{window().width}x{window().height}+0+0")
    parts = [word for crop in (panel, bar) for word in ("(", str(whole), "-crop", crop, "+repage", ")")]
    small = ["-append", "+dither", "-colors", str(COLORS), f"PNG8:{PICTURES / f'error_{name}.png'}"]
    subprocess.run(["convert", *parts, *small], check=True)
    whole.unlink()


def open_room() -> Iterator[float]:
    """The file as it is, with the tab open, and small, quick settings."""
    bpy.ops.wm.open_mainfile(filepath=SCENE_FILE)
    yield 1.0
    view().spaces.active.region_3d.view_perspective = "CAMERA"
    yield from open_tab()
    told(forget=True)
    chosen().size, chosen().error, chosen().output = 64, 0.3, tempfile.mkdtemp(prefix="leaflight_images_")
    yield from settle(0.5)
    check("nothing is told yet", not told())


def check_error(name: str, sentence: str, shown: str | None = None, height: int = 310) -> Iterator[float]:
    """Presses Bake; the sentence must come into the status bar and be drawn by the panel."""
    yield from press_bake()
    yield from wait(lambda: not state().running)
    yield from settle(0.5)
    check(f"{name}: in the status bar", any(sentence in line for line in told()))
    check(f"{name}: in the panel", sentence in (state().error if shown is None else shown))
    check(f"{name}: nothing runs, nothing was put on the scene", not state().running and not has_bake())
    yield from picture(name, height)


def check_warning(name: str, subject: str, sentence: str) -> Iterator[float]:
    yield from press_bake()
    yield from wait(lambda: not state().running)
    yield from settle(0.5)
    found = [text for about, text in state().warnings if about == subject]
    check(f"{name}: a warning in the panel", any(sentence in text for text in found))
    check(f"{name}: told in the status bar", any("in the panel" in line for line in told()))
    check(f"{name}: the rest is baked", has_bake() and not state().error)
    press("show_it")
    yield from settle()
    yield from picture(name, 640)


def meshes() -> list:
    return [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]


def unsaved_file() -> Iterator[float]:
    bpy.ops.wm.read_homefile(use_empty=False)
    yield 1.0
    yield from open_tab()
    told(forget=True)
    yield from settle(1.0)
    with in_view():
        check("unsaved: the button is grey", not bpy.ops.leaflight.bake.poll())
        try:
            bpy.ops.leaflight.bake("INVOKE_DEFAULT")
        except RuntimeError as reason:  # Blender puts into it what its tooltip of a grey button says
            check("unsaved: its tooltip says why", "Save the file first" in str(reason))
    yield from picture("unsaved")


def read_only_folder() -> Iterator[float]:
    folder = Path(tempfile.mkdtemp(prefix="leaflight_fixed_"))
    folder.chmod(0o555)
    chosen().output = str(folder) if os.geteuid() else "/sys/lightmaps"  # nothing else is read-only to the administrator
    yield from check_error("read_only", "is no folder that can be written")


def no_uv_possible() -> Iterator[float]:
    mesh = meshes()[0].data
    while len(mesh.uv_layers) < 8:
        mesh.uv_layers.new()
    yield from check_warning("no_uv", meshes()[0].name, "has 8 UV layers, as many as Blender allows")


def no_uv_at_all() -> Iterator[float]:
    for obj in meshes():
        while len(obj.data.uv_layers) < 8:
            obj.data.uv_layers.new()
    yield from check_error("no_uv_at_all", "and 4 more: each has 8 UV layers, as many as Blender allows; remove one")


def linked_mesh() -> Iterator[float]:
    name = meshes()[0].name
    library = str(Path(tempfile.mkdtemp()) / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=library, copy=True)
    mesh_name = bpy.data.objects[name].data.name
    with bpy.data.libraries.load(library, link=True) as (_, to):
        to.meshes = [mesh_name]
    bpy.data.objects[name].data = to.meshes[0]
    yield from check_warning("linked_mesh", name, "its mesh is linked from another file; a copy")


def linked_object() -> Iterator[float]:
    name = meshes()[0].name
    library = str(Path(tempfile.mkdtemp()) / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=library, copy=True)
    bpy.data.objects.remove(bpy.data.objects[name])
    with bpy.data.libraries.load(library, link=True) as (_, to):
        to.objects = [name]
    bpy.context.scene.collection.objects.link(to.objects[0])
    yield from check_warning("linked_object", name, "is linked from another file and cannot be hidden behind a baked copy")


def edit_mode() -> Iterator[float]:
    obj = meshes()[0]
    with in_view():
        bpy.context.view_layer.objects.active = obj
        bpy.ops.object.mode_set(mode="EDIT")
    yield from settle(0.5)
    sentence = f"{obj.name}: is in Edit Mode; leave it (Tab) to bake."
    yield from check_error("edit_mode", sentence, addon_module("app.request").find_mode_error(bpy.context))
    with in_view():
        bpy.ops.object.mode_set(mode="OBJECT")


def hidden_collection() -> Iterator[float]:
    hidden = bpy.data.collections.new("Hidden")
    bpy.context.scene.collection.children.link(hidden)
    for obj in meshes():
        for collection in obj.users_collection:
            collection.objects.unlink(obj)
        hidden.objects.link(obj)
    hidden.hide_render = True
    yield from check_error("hidden", "nothing to bake: no mesh object with faces is shown in render")


def no_light() -> Iterator[float]:
    for obj in [obj for obj in bpy.data.objects if obj.type == "LIGHT"]:
        bpy.data.objects.remove(obj)
    for node in (node for material in bpy.data.materials for node in material.node_tree.nodes):
        if node.type in ("EMISSION", "BSDF_PRINCIPLED"):
            node.inputs["Strength" if node.type == "EMISSION" else "Emission Strength"].default_value = 0.0
    bpy.context.scene.world = None
    yield from check_error("no_light", "the scene has no light: add a light, an emitting material or a world colour")


def out_of_memory() -> Iterator[float]:
    """The child gets a gigabyte; what an artist does is choose a page of 8192."""
    import resource

    subprocess_of_job = addon_module("app.job").subprocess
    start = subprocess_of_job.Popen

    def start_limited(*arguments, **options):
        limit = 1_000_000_000
        return start(*arguments, **options, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)))

    chosen().size = 8192
    subprocess_of_job.Popen = start_limited
    yield from press_bake()
    subprocess_of_job.Popen = start
    yield from wait(lambda: not state().running)
    sentence = "The bake ran out of memory: choose a smaller page size or density, or fewer processes."
    yield from settle(0.5)
    check("out_of_memory: in the status bar", any(sentence in line for line in told()))
    check("out_of_memory: in the panel", sentence == state().error and not has_bake())
    yield from picture("out_of_memory")


def child_killed() -> Iterator[float]:
    yield from kill("child", find_child)


def worker_killed() -> Iterator[float]:
    yield from kill("worker", find_worker)


def kill(which: str, find: Callable[[], int]) -> Iterator[float]:
    """As the system does it to a process that takes too much memory."""
    chosen().error, chosen().size, chosen().workers = 1e-4, 128, 2
    yield from press_bake()
    yield from wait(lambda: state().progress or not state().running)
    os.kill(find(), signal.SIGKILL)
    yield from wait(lambda: not state().running)
    yield from settle(0.5)
    sentence = "was killed, most likely for lack of memory: choose a smaller page size or fewer processes."
    check(f"killed {which}: in the status bar", any(sentence in line for line in told()))
    check(f"killed {which}: in the panel", sentence in state().error and not has_bake())
    yield from picture(f"killed_{which}")


def find_child() -> int:
    return state()._process._process.pid


def find_worker() -> int:
    """A process of the child's that traces, a copy of it: it has others for unwrapping and for Python's own needs."""
    leader = find_child()
    words = Path(f"/proc/{leader}/cmdline").read_text()
    for status in Path("/proc").glob("[0-9]*/stat"):
        parent = int(status.read_text().rpartition(")")[2].split()[1])
        if parent == leader and (status.parent / "cmdline").read_text() == words:
            return int(status.parent.name)
    raise LookupError(f"process {leader} has no workers")


PARTS = (
    unsaved_file,
    read_only_folder,
    no_uv_possible,
    no_uv_at_all,
    linked_mesh,
    linked_object,
    edit_mode,
    hidden_collection,
    no_light,
    out_of_memory,
    child_killed,
    worker_killed,
)
CHOSEN = choose_parts(PARTS)


def steps() -> Iterator[float]:
    keys = bpy.context.window_manager.keyconfigs.addon.keymaps.new("3D View", space_type="VIEW_3D")
    key = keys.keymap_items.new("leaflight.bake", "F6", "PRESS")
    for part in CHOSEN:
        try:
            yield from open_room()
            yield from part()
        except Exception:
            traceback.print_exc()
            check(part.__name__, False)
    keys.keymap_items.remove(key)


start(steps())
