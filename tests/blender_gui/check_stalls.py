"""Checks in a Blender with a window that pressing Bake does not make it stand still, and that undo, saving and Esc change nothing.

    blender --enable-event-simulate --factory-startup --addons bl_ext.user_default.leaflight --python tests/blender_gui/check_stalls.py

The extension must be installed. Bakes a grid of 500,000 triangles, and 2,000 cubes of which a part is hidden in the viewport; prints the
longest time in which Blender did nothing else, of the clock and of the processor, and the longest that Leaflight itself took of the
latter: where others are at work, and drawing has no graphics card, only that says much.
ONLY=meanwhile leaves the measurements out, ONLY=gaps the rest; WHOLE=1 measures whole bakes, others over them, and Remove: minutes.
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from gui_script import check, check_all, has_bake, in_view, press, start, state, wait, window

MOST_S = 0.35
MOST_UNWRAP_S = 20.0
ONLY, WHOLE = os.environ.get("ONLY", ""), "WHOLE" in os.environ
TICK_SECONDS = 0.005
CUBES, SIDE = 2000, 501


class Gaps:
    """The longest time between two of Blender's rounds, by the clock and of its own thread's processor; made by a timer."""

    def __init__(self) -> None:
        self.last = self.read()
        self.longest = [0.0, 0.0]
        self.ours_s = 0.0
        preparation = next(module for name, module in sys.modules.items() if name.endswith("leaflight.addon.app.preparation")).Preparation
        advance = preparation.advance

        def advance_timed(*arguments):
            began = time.thread_time()
            try:
                return advance(*arguments)
            finally:
                self.ours_s = max(self.ours_s, time.thread_time() - began)

        preparation.advance = advance_timed
        bpy.app.timers.register(self.tick, persistent=True)

    @staticmethod
    def read() -> tuple[float, float]:
        return time.monotonic(), time.thread_time()

    def tick(self) -> float:
        now = self.read()
        gaps = [a - b for a, b in zip(now, self.last, strict=True)]
        self.longest, self.last = [max(pair) for pair in zip(self.longest, gaps, strict=True)], now
        return TICK_SECONDS

    def end(self) -> None:
        if bpy.app.timers.is_registered(self.tick):  # no file was opened since
            bpy.app.timers.unregister(self.tick)

    def take(self, name: str) -> float:
        """Print the longest since they were taken last; gives what of it is ours."""
        self.tick()
        (clock_s, cpu_s), ours_s = self.longest, self.ours_s
        self.longest, self.ours_s = [0.0, 0.0], 0.0
        print(f"GAP   {clock_s:.3f} s, {cpu_s:.3f} s of processor, {ours_s:.3f} s of it Leaflight's: {name}", flush=True)
        return ours_s


def press_bake(size: int = 512) -> None:
    chosen = bpy.context.scene.leaflight
    chosen.size, chosen.error, chosen.output = size, 0.2, tempfile.mkdtemp(prefix="leaflight_images_")
    press("bake", "INVOKE_DEFAULT")


def is_reading() -> bool:
    return state().running and state().stage.startswith("Reading the scene")


def is_lit() -> bool:
    return any("leaflight_live" in image for image in bpy.data.images)


def empty_file() -> Iterator[float]:
    bpy.ops.wm.read_homefile(use_empty=False)
    yield 1.0
    bpy.data.batch_remove([obj for obj in bpy.data.objects if obj.type == "MESH"])


def make_grid() -> None:
    """A smooth field of 500,000 triangles."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=SIDE - 1, y_subdivisions=SIDE - 1, size=10.0)
    bpy.ops.object.shade_smooth()


def make_cubes() -> None:
    """Cubes with meshes of their own; each twentieth is hidden in the viewport, but rendered."""
    materials = [bpy.data.materials.new(f"Paint {number}") for number in range(20)]
    bpy.ops.mesh.primitive_cube_add(size=0.5)
    first = bpy.context.object
    for number in range(CUBES):
        mesh = first.data.copy()
        mesh.materials.append(materials[number % 20])
        obj = bpy.data.objects.new(f"Cube {number}", mesh)
        obj.location = (number % 50, number // 50, 0.0)
        bpy.context.scene.collection.objects.link(obj)
        if number % 20 == 0:
            obj.hide_set(True)
    bpy.data.objects.remove(first)


def note_scene() -> list[tuple]:
    layer = bpy.context.view_layer
    return [
        (
            o.name,
            o.hide_viewport,
            o.hide_render,
            o.hide_get(view_layer=layer),
            o.select_get(view_layer=layer),
            [m and m.name for m in o.data.materials],
        )
        for o in layer.objects
        if o.type == "MESH"
    ]


def check_gaps(name: str, make: Callable[[], None]) -> Iterator[float]:
    yield from empty_file()
    make()
    bpy.context.view_layer.update()
    yield 3.0
    before = note_scene()
    gaps = Gaps()
    press_bake()
    began = time.monotonic()
    yield from wait(lambda: not is_reading())
    longest = gaps.take(f"{name} are read, in {time.monotonic() - began:.2f} s")
    check(f"{name}: Blender never stands still while the scene is read", longest <= MOST_S)
    check(f"{name}: and it is as it was", note_scene() == before and state().running)
    if WHOLE:
        yield from wait(lambda: is_lit() or not state().running)
        gaps.take(f"up to the first light, after {time.monotonic() - began:.2f} s")
        yield from wait(lambda: not state().running)
        yield 0.5
        gaps.take(f"up to the end, after {time.monotonic() - began:.2f} s")
        unwrap_s = (state().result or {"seconds": {}})["seconds"].get("charts", float("inf"))
        check(f"{name}: are unwrapped within {MOST_UNWRAP_S:.0f} s ({unwrap_s:.1f} s)", unwrap_s <= MOST_UNWRAP_S)
        check(f"{name}: are baked", state().result and has_bake())
        shown = note_scene()
        bpy.context.scene.leaflight.error = 0.1
        press("bake", "INVOKE_DEFAULT")
        yield from wait(lambda: not is_reading())
        gaps.take(f"{name} are read again, which show their bake")
        check(f"{name}: they show it again", note_scene() == shown)
        yield from wait(lambda: not state().running)
        gaps.take("")
        press_bake(size=1024)
        yield from wait(lambda: not is_reading())
        gaps.take(f"{name} are read once more")
        yield from wait(lambda: not state().running)
        yield 0.5
        longest = gaps.take("up to the end of a bake of another layout")
        check(f"{name}: Blender never stands still while a bake takes another's place", longest <= MOST_S)
        press("remove", "INVOKE_DEFAULT")
        yield from wait(lambda: not has_bake())
        yield 2.0
        check(f"{name}: nor while it is removed", gaps.take("Remove") <= MOST_S)
        check(f"{name}: which leaves the scene as it was", note_scene() == before)
    if state().running:
        bpy.ops.leaflight.discard()
    yield from wait(lambda: not state().running)
    gaps.end()


def check_meanwhile() -> Iterator[float]:
    """What may happen to a scene that is being read."""
    yield from empty_file()
    make_cubes()
    with in_view():
        bpy.ops.ed.undo_push(message="Cubes")
        bpy.context.view_layer.objects.active = bpy.data.objects["Cube 1"]
        bpy.data.objects["Cube 1"].location.z = 1.0
        bpy.ops.ed.undo_push(message="Move")
    yield 2.0
    before = note_scene()
    middle = {"x": window().width // 3, "y": window().height // 2}
    press_bake()
    check("2,000 objects take more than one step", is_reading())
    check("and the panel says meanwhile what was planned", len(state().plan) >= 3)
    window().event_simulate(type="ESC", value="PRESS", **middle)
    window().event_simulate(type="ESC", value="RELEASE", **middle)
    yield from wait(lambda: not state().running)
    check("Esc leaves all as it was", note_scene() == before and not state().error and not state().result)
    press_bake()
    yield 0.15
    window().event_simulate(type="X", value="PRESS", **middle)
    window().event_simulate(type="X", value="RELEASE", **middle)
    path = Path(tempfile.mkdtemp()) / "meanwhile.blend"
    check("it is read yet when the file is saved", is_reading())
    with in_view():
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    check("a file saved meanwhile is as the scene was", note_scene() == before)
    yield from wait(lambda: not is_reading())
    check("and then it is baked", state().running and note_scene() == before)
    bpy.ops.leaflight.discard()
    yield from wait(lambda: not state().running)
    press_bake()
    yield 0.15
    check("it is read yet at the undo", is_reading())
    with in_view():
        bpy.ops.ed.undo()
    yield from wait(lambda: not is_reading())
    check("an undo leaves nothing of it", note_scene() == before and bpy.data.objects["Cube 1"].location.z == 0.0 and state().running)
    bpy.ops.leaflight.discard()
    yield from wait(lambda: not state().running)
    press_bake()
    yield 0.15
    check("it is read yet when a script deletes an object", is_reading())
    bpy.data.objects.remove(bpy.data.objects["Cube 1999"])
    yield from wait(lambda: not is_reading())
    check("what a script deletes is not baked", state().running and note_scene() == [row for row in before if row[0] != "Cube 1999"])
    bpy.ops.leaflight.discard()
    yield from wait(lambda: not state().running)
    press_bake()
    yield 0.15
    check("it is read yet when another file is opened", is_reading())
    bpy.ops.wm.open_mainfile(filepath=str(path))
    yield 1.0
    check("a file that is opened ends it", not state().running and note_scene() == before)


def list_checks() -> list[Callable[[], Iterator[float]]]:
    measured = [partial(check_gaps, "2,000 objects", make_cubes), partial(check_gaps, "500,000 triangles", make_grid)]
    return (measured if ONLY != "meanwhile" else []) + ([check_meanwhile] if ONLY != "gaps" else [])


def steps() -> Iterator[float]:
    for checks in list_checks():
        yield from check_all(checks(), "a fault of the script")


start(steps())
