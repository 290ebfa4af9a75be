"""The scene of a bake, loaded from the files in its folder and prepared for rays."""

import contextlib
from dataclasses import dataclass
from pathlib import Path

from ..lights.emitters import EmittingMeshes, build_emitters
from ..parallel import shared_arrays
from ..parallel.folders import TEXELS_FOLDER, keep_scene_open
from ..scene.materials import SurfaceMaterials
from ..scene.pruning import prune_scene
from ..scene.scene import SceneSnapshot
from ..scene.snapshot import load_snapshot
from ..scene.surface_cells import SurfaceCells
from ..texels.texel_map import TexelMap
from ..util.geometry import UnitBox, triangle_normals_areas
from ..util.job import SNAPSHOT_FILE
from ..util.malloc_tuning import keep_freed_memory
from . import photons


@dataclass(frozen=True)
class TracedScene:
    """A scene prepared for rays."""

    snapshot: SceneSnapshot
    unit_box: UnitBox
    scene: photons.TraceScene
    meshes: EmittingMeshes
    warnings: tuple[tuple[str, str], ...]  # subject, sentence
    cells: SurfaceCells  # of sides without a lightmap


@dataclass(frozen=True)
class Tracing(TracedScene):
    """A scene and the texel map on which hits are deposited."""

    texels: TexelMap


@keep_scene_open
def open_scene(folder: str) -> TracedScene:
    """Open the scene that was written to `folder`; a process keeps the last one open.

    Raises ValueError with a sentence when the scene has no light.
    """
    keep_freed_memory()
    snapshot, _ = prune_scene(load_snapshot(Path(folder) / SNAPSHOT_FILE))
    unit_box = UnitBox.from_points(snapshot.vertex_position)
    surfaces = SurfaceMaterials(snapshot)
    meshes = EmittingMeshes.of(snapshot, surfaces)
    emitters, warnings = build_emitters(snapshot, unit_box, surfaces, meshes)
    scene = photons.build_trace_scene(snapshot, unit_box, surfaces, emitters)
    cells = SurfaceCells.of(triangle_normals_areas(snapshot.tri_position)[1], scene.tri_lit_below == 0)
    return TracedScene(snapshot, unit_box, scene, meshes, tuple(warnings), cells)


@keep_scene_open
def open_tracing(folder: str) -> Tracing:
    """As open_scene, with the texel map that was written there too."""
    opened = open_scene(folder)
    texels = shared_arrays.load_struct(Path(folder) / TEXELS_FOLDER, TexelMap)
    return Tracing(opened.snapshot, opened.unit_box, opened.scene, opened.meshes, opened.warnings, opened.cells, texels)


def open_ahead(folder: str) -> None:
    """Open the scene in `folder` ahead of the work; the first task raises its errors."""
    with contextlib.suppress(ValueError, OSError):
        open_scene(folder)
