"""Shards of photons: pure functions, whoever runs them, and sums of what they bring."""

from dataclasses import replace

import numpy as np
from boxes import make_solver
from leaflight.core.bake.photon_shards import PhotonShard, trace_photons
from leaflight.core.parallel import shared_arrays
from leaflight.core.radiosity.quadtree import TreeView
from leaflight.core.scene.scene import Light, Material
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import Settings
from scenes import Mesh, make_scene, moved, quad_mesh

SETTINGS = Settings(size=32, padding=1)


def make_shard(folder, scene):
    """A shard of 5000 photons, and its tree."""
    solver = make_solver(folder, scene, replace(SETTINGS, direct="photons"))
    tree, view = solver.tree, folder / "view"
    shared_arrays.save_struct(view, TreeView.of_tree(tree, len(solver.tracing.texels)))
    return PhotonShard(str(folder), str(view), 1, 0, 0, photons=5000, max_depth=100, degree=1, skip_first=False), tree


def test_light_on_a_face_without_texels_is_no_other_texel_s(tmp_path):
    """Half of a sheet is folded to a line in its layer; what has the last texels lies in the dark."""
    vertex = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]], float)
    square, line = np.array([[0, 0], [0.9, 0], [0.9, 0.9], [0, 0.9]]), np.array([[0.1, 0.1], [0.2, 0.2], [0.3, 0.3], [0.4, 0.4]])
    sheet = Mesh("Sheet", vertex, [[0, 1, 2, 3], [1, 4, 5, 2]], [square, line])
    ceiling = replace(moved(quad_mesh("Ceiling", 2.0, 1.0), (0, 0, 1.0)), polygons=[[3, 2, 1, 0]], receives=False)
    screen = replace(moved(quad_mesh("Screen", 9.0, 9.0), (-4.0, -4.0, -1.0)), receives=False)
    scene = make_scene(
        [sheet, ceiling, screen, moved(quad_mesh("Dark"), (0, 0, -2.0))],
        [Light("POINT", "Lamp", (1.0, 0.5, 0.5), power_rgb=(1.0,) * 3)],
        [Material("White", (0.9,) * 3)],
    )
    shard, tree = make_shard(tmp_path, scene)
    result = trace_photons(shard)
    texels = traced_scene.open_tracing(str(tmp_path)).texels
    assert set(scene.tri_object[texels.texel_tri[tree.start[result.tally.node]]]) == {0}
    assert 100 < result.tally.count.sum() < 0.8 * result.counters.deposits  # the others fell on the folded half
