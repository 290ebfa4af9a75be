"""Photons: how they leave lights, scatter and are counted, and shards of them."""

import dataclasses
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from boxes import make_solver
from floors import chi_square_sigmas, sigma_limit
from leaflight.core.bake.photon_shards import PhotonShard, trace_photons
from leaflight.core.lights.lights import EmittedPhotons
from leaflight.core.parallel import shared_arrays
from leaflight.core.radiosity.quadtree import TreeView
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.rays import RayScene
from leaflight.core.scene.scene import Light, Material, SceneObject, SceneSnapshot, TextureImage
from leaflight.core.transport import photon_log, photons, traced_scene
from leaflight.core.transport.emission import Photons, light_every_surface, soften
from leaflight.core.util import geometry, sampling
from leaflight.core.util.settings import Settings
from scenes import Mesh, box_mesh, make_scene, moved, quad_mesh

N = 40_000
GREY = Material("Grey", (0.5, 0.5, 0.5))


@dataclass(frozen=True)
class Lamp:
    """A point that shines everywhere, or along one direction."""

    power_rgb: np.ndarray
    place_unit: tuple[float, float, float] = (0.0, 0.0, 0.0)
    along: tuple[float, float, float] | None = None
    soft: tuple[float, float] = (0.0, 0.0)
    casts_shadow: bool = True
    name: str = "Lamp"

    def emit(self, u):
        n = len(u)
        direction = sampling.square_to_uniform_cone(u[:, :2], math.pi) if self.along is None else np.tile(np.float32(self.along), (n, 1))
        radius, offset = np.repeat(np.float32(self.soft)[:, None], n, axis=1)
        return EmittedPhotons(np.tile(np.float32(self.place_unit), (n, 1)), direction, np.ones((n, 1), np.float32), radius, offset)


def _cube(outwards: bool = False) -> np.ndarray:
    """(12, 3, 3) m: side 1, two triangles per face in the order -x +x -y +y -z +z, seen from inside unless told otherwise."""
    box = box_mesh()
    faces = [box.polygons[face][:: 1 if outwards else -1] for face in (4, 5, 2, 3, 0, 1)]
    return make_scene([dataclasses.replace(box, polygons=faces)]).tri_position


def _snapshot(corners, surfaces=(GREY,), tri_material=None, **changes) -> SceneSnapshot:
    n = len(corners)
    scene = make_scene([Mesh("Room", corners.reshape(-1, 3), np.arange(3 * n).reshape(n, 3).tolist())])
    material = scene.tri_material if tri_material is None else np.array(tri_material, np.int32)
    uv = np.tile(np.float32([[0, 0], [1, 0], [0, 1]]), (n, 1, 1))
    return dataclasses.replace(scene, materials=surfaces, tri_material=material, tri_albedo_uv=uv, **changes)


def _white_lamp(watts: float = 12.0, **options) -> Lamp:
    return Lamp(np.full(3, watts), **options)


def _build(snapshot, *lamps) -> photons.TraceScene:
    box = geometry.UnitBox.from_points(snapshot.vertex_position)
    return photons.build_trace_scene(snapshot, box, SurfaceMaterials(snapshot), lamps)


def _trace_whole(*arguments, **options) -> photon_log.ShardHits:
    (hits,) = photons.trace_shard(*arguments, **options)
    return hits


def _trace(scene, n=N, shard=0, max_depth=1000, skip_first=False, share=1.0) -> photon_log.ShardHits:
    return _trace_whole(scene, n, share, sampling.shard_rng(7, 0, shard), max_depth, skip_first)


def _assert_closes(audit: photon_log.EnergyAudit) -> None:
    out = audit.absorbed + audit.escaped + audit.remainder
    np.testing.assert_allclose(out, audit.emitted, rtol=1e-12, atol=1e-12 * audit.emitted.max())


def _count_rays(scene):
    """The scene, and the lengths of the arrays of rays that are traced in it."""
    lengths = []

    class Counting:
        def closest(self, origin, direction):
            lengths.append(len(origin))
            return scene.rays.closest(origin, direction)

    return dataclasses.replace(scene, rays=Counting()), lengths


def test_scattered_light_is_cosine_distributed():
    # from the middle of the floor to the ceiling of a cube; view factor of an element to a parallel rectangle at its corner, four times
    a = 0.5 / math.sqrt(1.25)
    factor = 4 * (2 * a * math.atan(a)) / (2 * math.pi)
    scene = _build(_snapshot(_cube(), (Material("White", (0.999,) * 3),)), _white_lamp(along=(0, 0, -1)))
    hits = _trace(scene, max_depth=2)
    second = np.bincount(hits.tri[~hits.is_first] // 2, minlength=6) / (~hits.is_first).sum()
    band = 4 * math.sqrt(factor * (1 - factor) / N)
    assert abs(second[5] - factor) < band
    assert second[4] == 0
    np.testing.assert_allclose(second[:4], (1 - factor) / 4, atol=band)


def test_back_sides_scatter_but_get_nothing():
    scene = _build(_snapshot(_cube(outwards=True)), _white_lamp())
    hits = _trace(scene)
    assert hits.counters.deposits == 0
    assert hits.counters.rays == pytest.approx(2 * N, rel=0.03)  # 1 / (1 - 0.5)
    assert not hits.audit.escaped.any()
    both = _build(_snapshot(_cube(outwards=True), objects=(SceneObject("Leaf", two_sided=True),)), _white_lamp())
    assert _trace(both).counters.deposits == hits.counters.rays


def test_objects_without_shadow_let_light_through():
    pane = np.array([[[-0.5, -0.5, 0.2], [0.5, -0.5, 0.2], [0.0, 0.5, 0.2]]])
    objects = SceneObject("Room"), SceneObject("Pane", receives=False, casts_shadow=False, seen_by=(False,) * 3)
    with_pane = _snapshot(np.concatenate([pane, _cube()]), tri_object=np.int32([1] + [0] * 12), objects=objects)
    hits, bare = _trace(_build(with_pane, _white_lamp())), _trace(_build(_snapshot(_cube()), _white_lamp()))
    assert hits.counters == bare.counters
    np.testing.assert_array_equal(hits.tri, bare.tri + 1)


def test_a_lamp_without_shadow_lights_what_lies_behind_too_and_that_scatters():
    """A pane that faces down halves the cube, the lamp in the upper half: the floor is lit as without it, the pane on its back only."""
    pane = np.array([[[-0.5, -0.5, -0.2], [0.5, 0.5, -0.2], [0.5, -0.5, -0.2]], [[-0.5, -0.5, -0.2], [-0.5, 0.5, -0.2], [0.5, 0.5, -0.2]]])
    two = np.concatenate([_cube(), pane])
    lamp = _white_lamp(casts_shadow=False)
    bare, hits = _trace(_build(_snapshot(_cube()), _white_lamp()), max_depth=1), _trace(_build(_snapshot(two), lamp))
    first = hits.is_first
    np.testing.assert_array_equal(np.bincount(hits.tri[first], minlength=14)[:12], np.bincount(bare.tri, minlength=12))
    assert hits.counters.photons == N
    below = np.bincount(hits.tri[~first], hits.flux_rgb[0, ~first], 14)
    shadowed = _trace(_build(_snapshot(two), _white_lamp()))
    assert not np.bincount(shadowed.tri, minlength=14)[[8, 9, 12, 13]].any()
    assert (below[[12, 13]] > 0.01 * 12).all()  # from the floor
    _assert_closes(hits.audit)
    assert hits.audit.emitted[0] > 12 * 1.1


def test_photons_whose_first_hit_is_skipped_go_there_together_and_part():
    """The light that surfaces send each other is the same as of photons that go alone, by fewer rays."""
    scene = _build(_snapshot(_cube(), (Material("Red", (0.8, 0.5, 0.1)),)), Lamp(np.array([10.0, 20.0, 5.0])))
    counting, lengths = _count_rays(scene)
    alone, together = _trace(scene), _trace(counting, skip_first=True)
    assert together.counters.photons == N
    assert lengths[0] == N // photons.SPLIT
    assert not together.is_first.any()
    assert not _trace(scene, skip_first=True, max_depth=1).counters.deposits
    _assert_closes(together.audit)
    np.testing.assert_array_equal(together.audit.emitted, alone.audit.emitted)
    later = ~alone.is_first
    assert together.counters.deposits == pytest.approx(later.sum(), rel=0.02)
    sent = [hits.flux_rgb[:, kept].sum(axis=1) for hits, kept in ((alone, later), (together, slice(None)))]
    np.testing.assert_allclose(sent[1], sent[0], rtol=0.03)
    on_tri = [np.bincount(hits.tri[kept], minlength=12) for hits, kept in ((alone, later), (together, slice(None)))]
    np.testing.assert_allclose(on_tri[1], on_tri[0], rtol=0.08)


def test_audit_closes_with_escape_depth_limit_colours_and_softness():
    surfaces = (Material("A", (0.9, 0.3, 0.0)), Material("B", (0.2, 0.8, 0.999)))
    open_box = _snapshot(_cube()[:10], surfaces, [0, 1] * 5)
    lamps = Lamp(np.array([3.0, 0.0, 900.0]), soft=(0.2, 0.19)), _white_lamp(1e-6), Lamp(np.array([0, 5.0, 0]), (0.2, 0.2, 0.45))
    audit = _trace(_build(open_box, *lamps), max_depth=3).audit
    _assert_closes(audit)
    for part in (audit.emitted, audit.absorbed, audit.escaped, audit.remainder):
        assert (part > 0).all()
    assert audit.emitted[2] < 900  # after the falloff


def test_photons_choose_emitters_by_their_watts(hold):
    watts = np.array([1.0, 2.0, 0.5, 4.0, 0.25, 3.0])
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    face_of = [1, 3, 5, 0, 2, 4]  # _cube's faces are -x +x -y +y -z +z
    scene = _build(_snapshot(_cube()), *[_white_lamp(w, along=tuple(axis)) for w, axis in zip(watts, faces, strict=True)])
    counts = sum(np.bincount(_trace(scene, 501, shard, max_depth=1).tri // 2, minlength=6) for shard in range(300))[face_of]
    expected, off = watts / watts.sum() * counts.sum(), watts * [1, 1, 1, 1.03, 1, 1]
    limit = sigma_limit(2)
    hold("light choice of photons: chi-square against the watts", chi_square_sigmas(counts, expected), high=limit, unit="sigmas")
    seen = chi_square_sigmas(counts, off / off.sum() * counts.sum())
    hold("light choice of photons: chi-square with one lamp 3 % off", seen, low=limit, unit="sigmas")


@pytest.mark.parametrize("lamps", [(), (_white_lamp(0.0),)])
def test_darkness_gives_nothing(lamps):
    hits = _trace(_build(_snapshot(_cube()), *lamps))
    assert hits.counters == photon_log.Counters(0, 0, 0)
    assert hits.flux_rgb.shape == (3, 0)
    assert not hits.audit.emitted.any()


@pytest.mark.parametrize("power", [-1.0, math.nan, math.inf, 1e31])
def test_a_power_that_cannot_be_traced_is_refused(power):
    with pytest.raises(ValueError, match="Sun: its power is"):
        _build(_snapshot(_cube()), _white_lamp(power, name="Sun"))


@pytest.mark.parametrize(("radius", "offset"), [(0.8, 0.0), (0.8, 0.3), (0.2, 0.19)])
def test_soft_falloff_weighs_the_first_hit(radius, offset):
    scene = _build(_snapshot(_cube(), (Material("White", (0.9,) * 3),)), _white_lamp(along=(0, 0, -1), soft=(radius, offset)))
    hits = _trace(scene, 1000)
    seen = offset / 0.5 <= radius / np.hypot(0.5, offset)  # as a part of the disk that turns to the face
    expected = 12 / 1000 if seen else 0.0
    np.testing.assert_allclose(hits.flux_rgb, expected, rtol=1e-4)  # roulette keeps it at later hits
    np.testing.assert_allclose(hits.audit.emitted, 1000 * expected, rtol=1e-5)


def test_bent_shading_normals_interpolate():
    flat = _snapshot(_cube())
    normal = flat.tri_normal.copy()
    up_and_aside = np.float32([[0.6, 0, 0.8], [0, 0, 1], [-0.6, 0, 0.8]])
    normal[8:10] = up_and_aside
    hits = _trace(_build(dataclasses.replace(flat, tri_normal=normal), _white_lamp()), 2000, max_depth=1)
    _assert_closes(hits.audit)  # the correction is of what is recorded, not of what goes on
    floor = np.isin(hits.tri, [8, 9])
    weights = np.stack([1 - hits.u - hits.v, hits.u, hits.v], axis=1)[floor]
    shading = weights @ up_and_aside
    shading /= np.linalg.norm(shading, axis=1, keepdims=True)
    position = np.einsum("nk,nkj->nj", weights, _cube()[hits.tri[floor]])
    toward_lamp = -position / np.linalg.norm(position, axis=1, keepdims=True)
    expected = 12 / 2000 * np.maximum((shading * toward_lamp).sum(axis=1), 0) / toward_lamp[:, 2]
    np.testing.assert_allclose(hits.flux_rgb[1, floor], expected, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(hits.flux_rgb[1, ~floor], 12 / 2000, rtol=1e-5)


def test_broken_input_gives_finite_records():
    rng = np.random.default_rng(3)
    corners = rng.uniform(-1, 1, (60, 3, 3))
    corners[:10, 2] = corners[:10, 1]  # no area
    corners[10:20, 2] = corners[10:20, 0] + 1e-9 * rng.normal(size=(10, 3))  # needles
    corners[20:25] = corners[25:30]  # doubled
    odd = Material("Odd", (np.nan, 1e30, -1), 0), Material("White", (0.9, 0.5, 0))
    image = TextureImage("Odd", np.full((2, 2, 3), np.inf, np.float32))
    scene = _snapshot(corners, odd, [0, 1, 1] * 20, images=(image,))
    normal = scene.tri_normal.copy()
    normal[30:40] = 0
    normal[40:45] = np.nan
    hits = _trace(_build(dataclasses.replace(scene, tri_normal=normal), _white_lamp(soft=(1e-30, 0))), 5000)
    assert hits.counters.deposits > 2000
    for array in (hits.u, hits.v, hits.flux_rgb):
        assert np.isfinite(array).all()
    _assert_closes(hits.audit)


# Photons as they leave the lights.
def sheets(*heights):
    """Rays, normals and frames of sheets across the way down; every other one faces down."""
    corner = np.float32([[[-0.5, -0.5, z], [0.5, -0.5, z], [0.0, 0.5, z]] for z in heights])
    corner[1::2] = corner[1::2, ::-1]
    edge = corner[:, 1:] - corner[:, :1]
    normal = np.cross(edge[:, 0], edge[:, 1])
    frame = np.stack([corner[:, 0], edge[:, 0], edge[:, 1]]).transpose(0, 2, 1)
    return RayScene(corner), (normal / np.linalg.norm(normal, axis=1, keepdims=True)).T, frame


def way_down(n, soft=None):
    origin, direction = np.tile(np.float32([[0], [0], [0.4]]), n), np.tile(np.float32([[0], [0], [-1]]), n)
    return Photons(origin, direction, np.ones((3, n), np.float32), soft)


def test_one_photon_more_for_each_further_surface():
    photons = replace(way_down(3), link=np.int16([5, 6, 7]))
    heights = (0.3, 0.1, -0.2)
    traced = light_every_surface(photons, np.array([True, False, True]), *sheets(*heights))
    assert photons.flux.shape[1] == 3 + 2 * 2
    assert photons.link.tolist() == [5, 6, 7, 5, 7, 5, 7]
    assert traced == 2 * 4
    found = sheets(*heights)[0].closest(photons.origin.T, photons.direction.T)
    assert found.tri.tolist() == [0, 0, 0, 1, 1, 2, 2]


def test_soft_falloff_counts_the_whole_way():
    soft = np.float32([[0.2] * 2, [0.15] * 2, [0.0] * 2, [0.0] * 2])
    photons = way_down(2, soft)
    rays, normal, frame = sheets(0.3, -0.2)
    light_every_surface(photons, np.ones(2, bool), rays, normal, frame)
    flux = soften(photons, rays.closest(photons.origin.T, photons.direction.T).distance)
    np.testing.assert_array_equal(flux[0], [0, 0, 1, 1])  # seen from 0.1 away they come from beside the disk, from 0.6 they do not


def test_the_way_ends_after_a_thousand_surfaces():
    photons = way_down(1)
    light_every_surface(photons, np.ones(1, bool), *sheets(*np.linspace(0.3, -0.3, 1500)))
    assert photons.flux.shape[1] == 1000


# Shards of photons: pure functions, whoever runs them, and sums of what they bring.
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
