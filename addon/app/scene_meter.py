"""Keeps the areas of what would be baked, so that the panel can tell of the bake before it; never computed while drawing.

What changes in the scene makes the numbers stale at once, and the panel says so; a timer brings them up to date a moment later,
a little at a time, and measures again only the objects that changed.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.util.threads import count_usable
from ..read.object_settings import read_choice
from ..read.render_levels import find_hidden_instances
from ..show.bake_text import Worn
from ..show.images import check_shown
from ..show.layout import worn_result
from ..show.redraw import redraw
from .chart_guess import guess_charts
from .estimate import Estimate, Measured, estimate_bake
from .properties import make_settings
from .request import can_be_baked, list_objects

_CALM_S = 0.3  # without a change, before measuring
_STEP_S = 0.03  # of measuring at a time: Blender must stay smooth
_PAUSE_S = 0.05


class SceneMeter:
    """The estimate for the panel, of the scene that is shown.

    estimate   the last one, None where nothing is to be baked or nothing was measured yet
    problem    why there is none, as a sentence
    stale      the scene or the settings changed since
    version    grows with every change of what would be baked
    updates    grows with every change of geometry, place or shading
    """

    def __init__(self) -> None:
        self.version = self.updates = 0
        self.clear()

    def clear(self) -> None:
        """Forget everything: another file."""
        self.estimate: Estimate | None = None
        self.problem = ""
        self.stale = True
        self._size: dict[int, tuple[float, float, int, float]] = {}  # of measure_object, by the object's session_uid
        self._key: tuple[Any, ...] = ()
        self._rows: list[Measured] = []
        self._measured = False
        self._changed = 0.0
        self.version += 1

    def note(self, changed: set[int]) -> None:
        """Something in the scene changed; objects of these session_uid are to be measured again."""
        for uid in changed:
            self._size.pop(uid, None)
        self.stale, self._changed = True, time.monotonic()

    def watch(self, context: bpy.types.Context) -> None:
        """The panel is being drawn: notice other settings, and see to it that what is stale is brought up to date."""
        if not self.stale and self._key != _read_key(context):
            self.note(set())
        if self.stale and not bpy.app.timers.is_registered(_tick):
            bpy.app.timers.register(_tick, first_interval=_CALM_S)

    def is_calm(self) -> bool:
        """Whether the last change is long enough ago."""
        return time.monotonic() - self._changed >= _CALM_S

    def measure(self, context: bpy.types.Context, seconds: float = float("inf")) -> bool:
        """Measure what is to be baked, for so long at most; gives whether it is done and `estimate` up to date."""
        until = time.monotonic() + seconds
        key, objects = _read_key(context), list_objects(context)
        depsgraph = context.evaluated_depsgraph_get()
        for obj in objects:
            if obj.session_uid not in self._size:
                if time.monotonic() > until:
                    return False
                self._size[obj.session_uid] = measure_object(obj, depsgraph)
                self._measured = True
        rows = [_make_row(obj, *self._size[obj.session_uid]) for obj in objects]
        self.version += self._measured or key != self._key or rows != self._rows
        self.stale, self._measured, self._key, self._rows = False, False, key, rows
        self.estimate, self.problem = None, ""
        try:
            settings = make_settings(context.scene.leaflight)
            check_shown(settings)
        except ValueError as reason:
            self.problem = str(reason)
            return True
        layer = context.scene.leaflight.uv_layer
        own_layers = sum(obj.type == "MESH" and layer in obj.data.uv_layers for obj in objects) if layer else 0
        self.estimate = estimate_bake(rows, settings, own_layers, count_usable(), find_worn(context).pace)
        return True


def find_worn(context: bpy.types.Context) -> Worn:
    """What is known of the scene's bake: from the .blend, which undo changes too, or from this Blender."""
    state = context.window_manager.leaflight_state
    return worn_result(context.scene) or state.worn.get(context.scene.session_uid, Worn())


def measure_object(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[float, float, int, float]:
    """Of the triangles that an object shows, or the collection that it is an instance of: area in m2, longest edge in m, about how many
    charts they will be, and the sum of the roots of the charts' areas in m.
    """
    area_m2, longest_m, charts, side_m = 0.0, 0.0, 0, 0.0
    for mesh, matrix in walk_meshes(obj, depsgraph):
        corner = read_corners(mesh, matrix)
        area, edge = _measure_corners(corner)
        area_m2 += area
        longest_m = max(longest_m, edge)
        guessed, side = guess_charts(corner, np.zeros(len(corner), np.int64), 1)
        charts, side_m = charts + int(guessed[0]), side_m + float(side[0])
    return area_m2, longest_m, charts, side_m


def _make_row(obj: bpy.types.Object, area_m2: float, longest_m: float, charts: int, side_m: float) -> Measured:
    return Measured(obj.name, area_m2, read_choice(obj).density_factor, longest_m, charts, side_m)


def walk_meshes(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Mesh, NDArray[np.float64]]]:
    """The evaluated meshes behind an object, with their (4, 4) matrices to the world; each is gone when the next is asked for."""
    if obj.type == "MESH":
        parts = [(obj, obj.matrix_world)]
    else:
        parts = list(_walk_instance(obj, obj.matrix_world, find_hidden_instances(obj.instance_collection)))
    for part, matrix in parts:
        evaluated = part.evaluated_get(depsgraph)
        edited = evaluated.data.is_editmode  # its mesh has no faces then: they are in Edit Mode's own mesh
        yield evaluated.to_mesh() if edited else evaluated.data, np.array(matrix, np.float64)
        if edited:
            evaluated.to_mesh_clear()


def _walk_instance(obj: bpy.types.Object, matrix: Matrix, hidden: set[bpy.types.Object]) -> Iterator[tuple[bpy.types.Object, Matrix]]:
    """The mesh objects that an instance of a collection at `matrix` shows, of instances within it too, where they are shown."""
    place = matrix @ Matrix.Translation(-obj.instance_collection.instance_offset)
    for part in obj.instance_collection.all_objects:
        if part in hidden:
            continue
        if part.type == "MESH":
            yield part, place @ part.matrix_world
        elif can_be_baked(part):
            yield from _walk_instance(part, place @ part.matrix_world, hidden)


def read_corners(mesh: bpy.types.Mesh, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n_tri, 3, 3) float64, m: corners of a mesh's triangles in the world."""
    mesh.calc_loop_triangles()
    position, vertex = np.empty((len(mesh.vertices), 3), np.float32), np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.vertices.foreach_get("co", position.reshape(-1))
    mesh.loop_triangles.foreach_get("vertices", vertex.reshape(-1))
    with np.errstate(invalid="ignore", over="ignore"):
        world: NDArray[np.float64] = position @ matrix[:3, :3].T + matrix[:3, 3]
    return world[vertex]


def _measure_corners(corner: NDArray[np.float64]) -> tuple[float, float]:
    """Area and longest edge; a triangle without area, or of no numbers, has none that counts."""
    with np.errstate(invalid="ignore", over="ignore"):
        edge = np.roll(corner, -1, axis=1) - corner
        area = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1) / 2.0
        length2 = (edge**2).sum(axis=2).max(axis=1, initial=0.0)
    return float(area[np.isfinite(area)].sum()), float(np.sqrt(length2[np.isfinite(area) & (area > 0.0)].max(initial=0.0)))


def _read_key(context: bpy.types.Context) -> tuple[Any, ...]:
    """What the estimate depends on besides the objects."""
    chosen = context.scene.leaflight
    names = ("objects", "uv_layer", "size", "density", "atlas", "padding", "error", "max_photons", "time_limit", "workers")
    told = ("main_pass", "formats", "view_transform", "name_pattern")  # what may be wrong
    values = (getattr(chosen, name) for name in (*names, *told))
    return (context.scene.session_uid, context.view_layer.name, find_worn(context).pace, *values)


def _tick() -> float | None:
    """The timer: measures once the scene is calm; ends when all is up to date."""
    context = bpy.context
    meter: SceneMeter = context.window_manager.leaflight_meter
    if context.window_manager.leaflight_state.running:
        return _CALM_S
    if not meter.is_calm():
        return _CALM_S
    if not meter.measure(context, _STEP_S):
        return _PAUSE_S
    redraw(context, "UI")
    return None


@bpy.app.handlers.persistent
def note_changes(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Handler of every change that Blender evaluates."""
    meter = getattr(bpy.context.window_manager, "leaflight_meter", None)
    if meter is None:
        return
    changed = [update.id for update in depsgraph.updates if update.is_updated_geometry or update.is_updated_transform]
    # What is selected or shown in the viewport changes the scene as well, but none of what is read.
    meter.updates += any(one.is_updated_geometry or one.is_updated_transform or one.is_updated_shading for one in depsgraph.updates)
    meter.note({block.original.session_uid for block in changed if isinstance(block, bpy.types.Object)})


@bpy.app.handlers.persistent
def forget_measures(*_: Any) -> None:
    """Another file was opened."""
    bpy.context.window_manager.leaflight_meter.clear()


_HANDLERS = (
    ("depsgraph_update_post", note_changes),  # undo and redo come here too
    ("frame_change_post", note_changes),
    ("load_post", forget_measures),
)


def register() -> None:
    """Listen to changes from now on."""
    bpy.types.WindowManager.leaflight_meter = SceneMeter()  # of this Blender, like the state of the bake
    for name, handler in _HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Take back what `register` did."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    for name, handler in reversed(_HANDLERS):
        getattr(bpy.app.handlers, name).remove(handler)
    del bpy.types.WindowManager.leaflight_meter
