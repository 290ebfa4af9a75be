"""Checks what only a Blender with a window can show of a bake: live light, stopping, Edit Mode, undo, another scene or file, the end.

    blender --enable-event-simulate sample_blends/cornell_box.blend --python tests/blender_gui/check_bake.py

The extension must be installed. Prints a line for each check, and at last how many failed; then quits in the middle of a bake.
"""

import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from gui_script import FAILED, check, check_all, has_bake, in_view, press, start, state, wait, window

SCENE_FILE = bpy.data.filepath


def press_bake(error: float = 0.2) -> None:
    chosen = bpy.context.scene.leaflight
    chosen.size, chosen.error, chosen.output = 128, error, tempfile.mkdtemp(prefix="leaflight_images_")
    press("bake", "INVOKE_DEFAULT")


def is_alive(process_id: int) -> bool:
    try:
        os.killpg(process_id, 0)
    except ProcessLookupError:
        return False
    return True


def running_id() -> int:
    return state()._process._process.pid


def worn_lines() -> tuple[str, ...]:
    return state().describe_worn(bpy.context.scene.session_uid)


def worn_warnings() -> list[tuple[str, str]]:
    return state().list_warnings(bpy.context.scene.session_uid, has_bake())


def live_images() -> list[str]:
    return [image.name for image in bpy.data.images if "leaflight_live" in image]


def is_live() -> bool:
    return state().running and has_bake() and bool(live_images())


def stop() -> Iterator[float]:
    bpy.ops.leaflight.stop()
    yield from wait(lambda: not state().running)


def mean_light() -> float:
    pixels = bpy.data.images[live_images()[0]].pixels[:]
    return sum(pixels) / len(pixels)


def check_live() -> Iterator[float]:
    press_bake(error=1e-4)
    yield from wait(lambda: is_live() or not state().running)
    check("the first light is on the objects before there is any progress", is_live() and state().progress is None)
    first = mean_light() if is_live() else 0.0
    yield from wait(lambda: state().progress or not state().running)
    yield from wait(lambda: not state().running or mean_light() != first)
    check("and changes while it bakes", is_live() and 0.0 < mean_light() != first > 0.0)
    path = Path(tempfile.mkdtemp()) / "meanwhile.blend"
    with in_view():
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    with bpy.data.libraries.load(str(path)) as (found, _):
        check("a file saved meanwhile holds none of it", not any("live" in name for name in found.images))
        check("nor our materials", not any("Leaflight" in name for name in found.materials))
    yield from wait(lambda: is_live() or not state().running)
    check("and it comes on again", is_live())
    yield from stop()
    check("the best so far takes its place", has_bake() and state().result and not live_images())


def check_refine() -> Iterator[float]:
    before = state().result
    check("a stopped bake can be refined", bpy.ops.leaflight.refine.poll())
    bpy.context.scene.leaflight.error = 0.9 * before["estimated_error"]
    press("refine", "INVOKE_DEFAULT")
    yield from wait(lambda: not state().running)
    after = state().result  # gathering may come to the smaller error without more photons
    goes_on = after and after["photons"] >= before["photons"] and after["estimated_error"] < before["estimated_error"]
    check("and goes on from there", goes_on and "direct" not in after["seconds"])
    shown, lines = {image.name for image in bpy.data.images if image.users}, worn_lines()
    check("its numbers are told", lines and list(lines) == state().summarize())
    press_bake(error=1e-4)
    yield from wait(lambda: is_live() or not state().running)
    check("a new bake of the same layout is shown over it", is_live())
    bpy.ops.leaflight.stop()
    bpy.ops.leaflight.discard()
    yield from wait(lambda: not state().running)
    check("thrown away, the earlier comes back", has_bake() and shown == {i.name for i in bpy.data.images if i.users})
    check("with its numbers", worn_lines() == lines)
    press("remove")


def check_removed_state() -> Iterator[float]:
    """Remove deletes the state for good; an undo of it brings only the bake back."""
    bpy.data.objects["Tall block"].visible_shadow = False  # which is warned of
    press_bake()
    yield from wait(lambda: not state().running)
    lines = worn_lines()
    check("a bake can be refined, and its warning is told", bpy.ops.leaflight.refine.poll() and worn_warnings())
    press("remove")
    check("removed, its warning is told no more", not worn_warnings())
    with in_view():
        bpy.ops.ed.undo_push(message="Remove")  # Blender makes no steps of what scripts press
        bpy.ops.ed.undo()
    check("an undo brings it back with its numbers, not its state", has_bake() and worn_lines() == lines)
    check("so it cannot be refined", worn_warnings() and not bpy.ops.leaflight.refine.poll())
    press("bake", "INVOKE_DEFAULT")
    yield from wait(lambda: not state().running)
    check("until it is baked again", state().summarize()[0].startswith("Baked in") and bpy.ops.leaflight.refine.poll())
    press("remove")
    bpy.data.objects["Tall block"].visible_shadow = True


def check_escape() -> Iterator[float]:
    press_bake(error=1e-4)
    yield from wait(lambda: state().progress or not state().running)
    check("a second bake cannot start", not bpy.ops.leaflight.bake.poll())
    middle = {"x": window().width // 3, "y": window().height // 2}
    window().event_simulate(type="ESC", value="PRESS", **middle)
    window().event_simulate(type="ESC", value="RELEASE", **middle)
    yield from wait(lambda: state().stopping or not state().running)
    check("Esc asks for the best so far", state().stopping)
    yield from wait(lambda: not state().running)
    check("the best so far is shown", state().result and state().result["stopped_by"] == "interrupted" and has_bake())
    press("remove")


def check_discard() -> Iterator[float]:
    materials = {material.name for material in bpy.data.materials}
    press_bake(error=1e-4)
    yield from wait(lambda: (is_live() and state().progress) or not state().running)
    group = running_id()
    bpy.ops.leaflight.stop()
    bpy.ops.leaflight.discard()
    yield from wait(lambda: not state().running)
    check("stop twice throws the bake away", not state().result and not state().error and not has_bake())
    check("with its materials and images", not live_images() and materials == {material.name for material in bpy.data.materials})
    yield from wait(lambda: not is_alive(group))
    check("and leaves no process", not is_alive(group))


def check_edit_mode() -> Iterator[float]:
    press_bake()
    with in_view():
        bpy.context.view_layer.objects.active = next(obj for obj in bpy.context.scene.objects if obj.type == "MESH")
        bpy.ops.object.mode_set(mode="EDIT")
    yield from wait(lambda: state().notice or not state().running)
    check("a finished bake waits for Edit Mode's end", state().running and "Leave Edit Mode" in state().notice)
    with in_view():
        bpy.ops.object.mode_set(mode="OBJECT")
    yield from wait(lambda: not state().running)
    check("and is then shown", has_bake() and not state().warnings)
    press("remove")


def check_gltf() -> Iterator[float]:
    press_bake()
    yield from wait(lambda: not state().running)
    scene, file = bpy.context.scene, os.path.join(tempfile.mkdtemp(prefix="leaflight_gltf_"), "room.glb")
    with in_view():
        bpy.ops.leaflight.export_gltf(filepath=file)
    yield 0.5  # a redraw with the scene that came back
    check("the baked scene is exported", os.path.getsize(file) > 1000)
    check("and the window shows the user's scene again", window().scene == scene and len(bpy.data.scenes) == 1 and has_bake(scene))
    press("remove")


def check_undo_meanwhile() -> Iterator[float]:
    with in_view():
        bpy.ops.object.select_all(action="SELECT")
        bpy.ops.ed.undo_push(message="Select")
        bpy.ops.object.select_all(action="DESELECT")
        bpy.ops.ed.undo_push(message="Deselect")
    press_bake(error=1e-4)
    yield from wait(lambda: is_live() or not state().running)
    with in_view():
        bpy.ops.ed.undo()
    check("an undo takes the light off", not has_bake() and state().running)
    yield from wait(lambda: is_live() or not state().running)
    check("and it comes on again", is_live())
    with in_view():
        bpy.ops.object.select_all(action="SELECT")
        bpy.ops.ed.undo_push(message="Select")
    yield from stop()
    check("a bake outlives an undo", state().result and has_bake() and not live_images())
    with in_view():
        bpy.ops.ed.undo()
    check("a step back into the middle of the bake shows nothing half done", not live_images() and not has_bake())
    with in_view():
        bpy.ops.ed.redo()
    check("and forward again the whole bake", has_bake() and not live_images())
    press("remove")


def check_other_scene() -> Iterator[float]:
    baked = bpy.context.scene.name
    press_bake()
    window().scene = bpy.data.scenes.new("Other")
    yield from wait(lambda: not state().running)
    check("the scene that was baked gets the bake", has_bake(bpy.data.scenes[baked]) and not state().error)
    window().scene = bpy.data.scenes[baked]
    press("remove")
    press_bake()
    scene = bpy.data.scenes[baked]
    window().scene = bpy.data.scenes["Other"]
    bpy.data.scenes.remove(scene)
    yield from wait(lambda: not state().running)
    check("a deleted scene is told", "scene was deleted" in state().error)


def check_closed_window() -> Iterator[float]:
    bpy.ops.wm.open_mainfile(filepath=SCENE_FILE)
    yield 1.0
    bpy.ops.wm.window_new()
    yield 1.0
    second = bpy.context.window_manager.windows[1]
    area = second.screen.areas[0]
    area.type = "VIEW_3D"
    yield 0.5
    chosen = bpy.context.scene.leaflight
    chosen.size, chosen.error, chosen.output = 128, 1e-4, tempfile.mkdtemp(prefix="leaflight_images_")
    with bpy.context.temp_override(window=second, area=area, region=next(r for r in area.regions if r.type == "WINDOW")):
        bpy.ops.leaflight.bake("INVOKE_DEFAULT")
    yield from wait(lambda: is_live() or not state().running)
    group = running_id()
    with bpy.context.temp_override(window=second):
        bpy.ops.wm.window_close()
    yield from wait(lambda: not is_alive(group) and not live_images())
    check("closing the window that a bake was started in ends it", not is_alive(group) and not state().running)
    check("and takes its light off", not live_images() and not has_bake())


def check_other_file() -> Iterator[float]:
    bpy.ops.wm.open_mainfile(filepath=SCENE_FILE)
    yield 1.0
    press_bake(error=1e-4)
    yield from wait(lambda: state().progress or not state().running)
    group = running_id()
    bpy.ops.wm.open_mainfile(filepath=SCENE_FILE)
    yield from wait(lambda: not is_alive(group))
    check("opening a file ends the bake", not is_alive(group) and not state().running)
    check("the sidebar bakes again", bpy.ops.leaflight.bake.poll())


def check_end() -> Iterator[float]:
    press_bake(error=1e-4)
    yield from wait(lambda: state().progress or not state().running)
    print(f"QUITTING with process group {running_id()} at work; {len(FAILED)} FAILED", flush=True)


CHECKS = (
    check_live,
    check_refine,
    check_removed_state,
    check_escape,
    check_discard,
    check_edit_mode,
    check_gltf,
    check_undo_meanwhile,
    check_other_scene,
    check_closed_window,
    check_other_file,
    check_end,
)


def steps() -> Iterator[float]:
    for checks in CHECKS:
        yield from check_all(checks(), checks.__name__)


start(steps())
