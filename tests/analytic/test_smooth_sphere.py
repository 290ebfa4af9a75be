"""A smooth-shaded sphere under a sun: E0 max(0, n.l) with the interpolated normal n.

By photons the faces of the polyhedron that look away from the sun are dark, however their normals are bent; shadow rays start on the smooth
surface, so that they are lit as far as the sphere is. The statistical tests of this
file share floors.ALPHA.
"""

from dataclasses import replace

import numpy as np
import pytest
from boxes import solve_scene
from known_light import BLACK, SUB_POINTS, bake_known
from leaflight.core.integrate import texel_light
from leaflight.core.scene.scene import Light
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import DIRECT_MODES, Settings
from scenes import Mesh, make_scene, sphere_mesh
from stats import Estimates, hold_bias_is_seen, hold_unbiased

E0 = 4.0
SUN = np.array([2.0, -1.0, 2.0]) / 3  # from the sphere
GRAZING = 0.15  # the cosine to the face below which the sun only skims it


def sphere_scene():
    z = SUN
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    sun = Light("SUN", "Sun", rotation=tuple(map(tuple, np.array([x, np.cross(z, x), z]))), power_rgb=(E0,) * 3)
    scene = make_scene([sphere_mesh(rings=12, segments=24)], [sun], [BLACK])
    return replace(scene, tri_normal=scene.tri_position.astype(np.float32))  # of a unit sphere


def irradiance(position, normal):
    return E0 * np.maximum(normal @ SUN, 0)


@pytest.fixture(scope="module", params=DIRECT_MODES)
def known(request, tmp_path_factory):
    return bake_known(tmp_path_factory.mktemp("sphere"), sphere_scene(), irradiance, request.param, size=128, max_photons=800_000)


def leaf_faces(known):
    """(m, 2) least and greatest cosine between the sun and the faces of each leaf."""
    scene, texels = sphere_scene(), known.texels
    edge = np.diff(scene.tri_position, axis=1)
    face = np.cross(edge[:, 0], edge[:, 1])
    cosine = (face / np.linalg.norm(face, axis=1, keepdims=True)) @ SUN
    tri = texels.sub_points(np.arange(len(known.truth)), SUB_POINTS, side=1.0)[0]
    start = np.sort(known.light.tree.start[known.light.leaves])
    ends = cosine[tri].min(0), cosine[tri].max(0)
    return np.stack([np.minimum.reduceat(ends[0], start), np.maximum.reduceat(ends[1], start)], axis=1)


def keep(found, rows):
    return Estimates(*(getattr(found, name)[rows] for name in ("value", "truth", "noise", "doubt", "weight")))


def lit_leaves(known):
    """Without slivers at the charts' edges, which few photons reach."""
    leaves = known.on_leaves()
    return keep(leaves, (leaf_faces(known)[:, 0] > GRAZING) & (leaves.weight > 0.2 * np.median(leaves.weight)))


def test_most_of_the_lit_half_is_judged(known):
    assert 0.2 < len(lit_leaves(known).value) / len(known.light.leaves) < 0.5


def test_every_lit_leaf_is_within_its_stated_error(known, hold):
    hold_unbiased(hold, "smooth-shaded sphere", lit_leaves(known), len(DIRECT_MODES), 0.3)


def test_a_planted_bias_is_rejected(known, hold):
    hold_bias_is_seen(hold, "smooth-shaded sphere", lit_leaves(known), len(DIRECT_MODES))


def test_faces_that_look_away_are_as_bright_as_the_sphere_there(known, request):
    faces = leaf_faces(known)
    beyond = keep(known.on_leaves(), (faces[:, 1] < -1e-3) & (faces[:, 0] > -0.1))
    assert (beyond.truth > 0).sum() > 3
    if request.node.callspec.params["known"] == "photons":
        assert beyond.value.max() == 0.0
    else:
        assert beyond.mean == pytest.approx((beyond.truth @ beyond.weight) / beyond.weight.sum(), rel=0.05)
        assert keep(known.on_leaves(), faces[:, 1] < -0.2).value.max() == 0.0


def test_a_smooth_solid_that_glows_does_not_light_itself(tmp_path):
    """Ends of shadow rays on its own faces lie in front of normals between the corners', but not in front of the faces."""
    glowing = replace(BLACK, emission_rgb=(1.0, 1.0, 1.0))
    scene = make_scene([sphere_mesh(rings=6, segments=12)], [], [glowing])
    scene = replace(scene, tri_normal=scene.tri_position.astype(np.float32))
    settings = Settings(size=64, max_photons=10_000, error=0.05, workers=1, seed=1)
    field = solve_scene(tmp_path, scene, settings)
    found = texel_light.light_at_texels(field, traced_scene.open_tracing(str(tmp_path)).texels)
    assert found.direct.max() == 0.0


def test_faces_that_the_sun_skims_are_no_brighter_than_their_normals(known):
    faces = leaf_faces(known)
    skimmed = keep(known.on_leaves(), (faces[:, 0] > 1e-3) & (faces[:, 0] < GRAZING))
    assert skimmed.mean == pytest.approx((skimmed.truth @ skimmed.weight) / skimmed.weight.sum(), rel=0.1)


@pytest.mark.parametrize("direct", DIRECT_MODES)
def test_a_leaf_is_lit_from_behind_as_its_normals_say(tmp_path, direct):
    """A square in the plane of x and y whose normals lean to a sun below it, as leaves have that are shaded like a ball; Cycles agrees."""
    lean, sun = np.array([0.8, 0.0, -0.6]), np.array([0.6, 0.0, -0.8])
    x = np.array([0.0, 1.0, 0.0])
    light = Light("SUN", "Sun", rotation=tuple(map(tuple, np.array([x, np.cross(sun, x), sun]))), power_rgb=(E0,) * 3)
    leaf = Mesh("Leaf", np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float), [[0, 1, 2, 3]], None, True)
    scene = make_scene([leaf], [light], [BLACK])
    scene = replace(scene, tri_normal=np.broadcast_to(lean, scene.tri_normal.shape).astype(np.float32))
    for cover, expected in ((scene, E0 * lean @ sun), (_cover(scene, light), 0.0)):
        settings = Settings(direct=direct, size=32, max_photons=100_000, error=0.005, workers=1, seed=3)
        field = solve_scene(tmp_path / str(expected), cover, settings)
        texels = traced_scene.open_tracing(str(tmp_path / str(expected))).texels
        found = texel_light.light_at_texels(field, texels)
        assert (found.direct + found.indirect).mean() == pytest.approx(expected, rel=0.02, abs=1e-6)


def _cover(scene, light):
    """The same with a square below it that hides the sun, and has no lightmap."""
    below = Mesh("Cover", np.array([[-8, -8, -1], [8, -8, -1], [8, 8, -1], [-8, 8, -1]], float), [[0, 1, 2, 3]], None, False)
    both = make_scene([Mesh("Leaf", scene.vertex_position, [[0, 1, 2, 3]], None, True), below], [light], [BLACK])
    return replace(both, tri_normal=np.concatenate([scene.tri_normal, both.tri_normal[2:]]))
