"""The atlas of a scene: the charts of its objects, how dense they are, and their places on pages."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from leaflight.addon.app.chart_guess import guess_charts
from leaflight.core.atlas import chart_cache, chart_search
from leaflight.core.atlas.chart_search import find_charts
from leaflight.core.atlas.charts import PACKING, make_charts
from leaflight.core.atlas.density_search import find_greatest_density
from leaflight.core.atlas.even_out import USABLE, acts, even_out, find_factors
from leaflight.core.atlas.layer_check import signed_areas
from leaflight.core.atlas.packing import Page, place_charts, shape_charts
from leaflight.core.atlas.page_plan import ChartDemand
from leaflight.core.atlas.unfolding import UnfolderDied
from leaflight.core.util.geometry import triangle_normals_areas
from leaflight.core.util.settings import Settings
from plain_charts import rectangles, triangles
from scenes import Mesh, box_mesh, grid_mesh, make_scene, moved, quad_mesh, shared_mesh, sphere_mesh, split_faces
from texel_gaps import check_gaps

FULL_PAGE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])


def mixed_meshes():
    return [
        box_mesh("Box", (0.4, 0.8, 0.2)),
        Mesh("Shade", quad_mesh().vertex, quad_mesh().polygons, receives=False),
        moved(sphere_mesh("Ball", rings=8, segments=12), (1e3, 0, 0), 0.3),
        grid_mesh("Cloth", cells=6, noise=0.6, edge_m=0.2),
        Mesh("Nothing", np.zeros((0, 3)), []),
        quad_mesh("Painted", uv=FULL_PAGE),
    ]


def check_atlas(scene, atlas, padding):
    """What an atlas promises of any scene."""
    count = len(atlas.chart_page)
    used = atlas.tri_chart >= 0
    area = triangle_normals_areas(scene.tri_position)[1]
    receives = np.array([one.receives for one in scene.objects], bool)
    np.testing.assert_array_equal(used, (area > 0) & receives[scene.tri_object])
    assert not atlas.tri_uv[~used].any()
    assert set(atlas.tri_chart[used]) == set(range(count))
    np.testing.assert_array_equal(atlas.chart_object[atlas.tri_chart[used]], scene.tri_object[used])
    np.testing.assert_array_equal(atlas.chart_page, atlas.object_page[atlas.chart_object])
    assert set(atlas.object_page[atlas.object_page >= 0]) == set(range(atlas.page_count))
    for one in range(len(scene.objects)):
        rows = used & (scene.tri_object == one)
        corners = scene.tri_corner[rows].ravel()
        points = atlas.tri_uv[rows].reshape(-1, 2)
        assert len(np.unique(np.column_stack([corners, points]), axis=0)) == len(np.unique(corners)), "a corner has two UVs"
    for page in range(atlas.page_count):
        rows = np.flatnonzero(used)[atlas.chart_page[atlas.tri_chart[used]] == page]
        if not any(scene.objects[k].has_layer for k in scene.tri_object[rows]):
            check_gaps(atlas.tri_uv[rows], atlas.tri_chart[rows], atlas.page_size, padding)


def densities(scene, atlas):
    """Texels per metre of each object, nan without charts."""
    used, count = atlas.tri_chart >= 0, len(scene.objects)
    area = np.bincount(scene.tri_object[used], triangle_normals_areas(scene.tri_position[used])[1], count)
    texels = np.bincount(scene.tri_object[used], np.abs(signed_areas(atlas.tri_uv[used])), count)
    return np.sqrt(np.divide(texels, area, out=np.full(count, np.nan), where=area > 0))


@pytest.mark.parametrize("options", [{}, {"density": 60.0}, {"atlas": False}, {"atlas": False, "density": 40.0}, {"padding": 1}])
def test_atlas_keeps_its_promises(options):
    scene = make_scene(mixed_meshes())
    settings = Settings(size=128, **options)
    atlas = make_charts(scene, settings)
    check_atlas(scene, atlas, settings.padding)
    assert atlas.object_page[[1, 4]].tolist() == [-1, -1]
    assert [subject for subject, _ in atlas.warnings if subject == "Nothing"] == ["Nothing"]


def test_density_is_exact_and_fills_pages_with_whole_objects():
    rng = np.random.default_rng(4)
    scene = make_scene([box_mesh(f"Box {k}", rng.uniform(0.1, 1.0, 3)) for k in range(30)])
    atlas = make_charts(scene, Settings(size=256, density=60.0))
    check_atlas(scene, atlas, 4)
    np.testing.assert_allclose(densities(scene, atlas), 60.0, rtol=1e-9)
    covered = np.abs(signed_areas(atlas.tri_uv)).sum()
    assert 1 < atlas.page_count < covered / (0.5 * 256**2) + 1
    assert atlas.object_page[np.bincount(scene.tri_object, triangle_normals_areas(scene.tri_position)[1]).argmax()] == 0
    assert not atlas.warnings


@pytest.mark.parametrize("atlas_mode", [True, False])
def test_object_too_large_for_its_density_is_named_and_baked_less_dense(atlas_mode):
    scene = make_scene([box_mesh("Hall", (9, 9, 9)), box_mesh("Cup", (0.1, 0.1, 0.1))])
    atlas = make_charts(scene, Settings(size=128, density=50.0, atlas=atlas_mode))
    check_atlas(scene, atlas, 4)
    hall, cup = densities(scene, atlas)
    assert hall < 10
    assert cup == pytest.approx(50.0)
    ((subject, sentence),) = atlas.warnings
    assert subject == "Hall"
    assert sentence.startswith("Hall: does not fit a page of 128 texels at 50 texels per metre and is baked at ")


@pytest.mark.parametrize("options", [{}, {"density": 20.0}, {"atlas": False, "density": 20.0}])
def test_density_factor_is_relative_to_the_others(options):
    scene = make_scene([box_mesh("Plain"), box_mesh("Fine")])
    objects = (scene.objects[0], dataclasses.replace(scene.objects[1], density_factor=2.0))
    scene = dataclasses.replace(scene, objects=objects)
    atlas = make_charts(scene, Settings(size=256, **options))
    check_atlas(scene, atlas, 4)
    plain, fine = densities(scene, atlas)
    assert fine == pytest.approx(2.0 * plain)
    if options:
        assert plain == pytest.approx(20.0)


@pytest.mark.parametrize("options", [{"density": 20.0}, {"atlas": False}])
def test_objects_are_told_as_they_are_packed(options):
    told = []
    scene = make_scene([moved(box_mesh(), (3.0 * i, 0.0, 0.0), scale=i + 1.0, name=f"Box {i}") for i in range(4)])
    make_charts(scene, Settings(size=256, **options), lambda *words: told.append(words))
    packed = [(share, about) for said, share, about in told if said is PACKING]
    assert [share for share, _ in packed] == [0.0, 0.25, 0.5, 0.75]
    assert {about for _, about in packed} == {f"Box {i}" for i in range(4)}
    assert [said for said, _, _ in told].index(PACKING) > 0, "they are unwrapped before"


def test_per_object_pages_are_filled():
    scene = make_scene([quad_mesh("Small", 0.1, 0.1), quad_mesh("Large", 50, 50)])
    atlas = make_charts(scene, Settings(size=64, atlas=False))
    assert atlas.object_page.tolist() == [0, 1]
    np.testing.assert_allclose(densities(scene, atlas), [560.0, 1.12])


def test_existing_layer_is_kept_as_it_is():
    uv = np.array([[0.25, 0.25], [0.75, 0.25], [0.75, 0.5], [0.25, 0.5]])
    scene = make_scene([box_mesh(), quad_mesh("Painted", uv=uv)])
    atlas = make_charts(scene, Settings(size=64))
    assert atlas.object_page.tolist() == [0, 1]
    np.testing.assert_array_equal(atlas.tri_uv[-2:], uv[[[0, 1, 2], [0, 2, 3]]] * 64)
    assert atlas.tri_chart[-2] == atlas.tri_chart[-1] >= 0
    assert not atlas.warnings


def test_faulty_layer_is_told_and_baked_where_it_can_be():
    grid = grid_mesh("Table", cells=4)
    uv = [grid.vertex[polygon][:, :2] / 4 for polygon in grid.polygons]
    uv[3] = uv[3] + 2.0
    uv[5] = uv[6]
    scene = make_scene([Mesh("Table", grid.vertex, grid.polygons, uv)])
    atlas = make_charts(scene, Settings(size=64))
    assert np.flatnonzero(atlas.tri_chart < 0).tolist() == [6, 7]
    assert [subject for subject, _ in atlas.warnings] == ["Table", "Table"]
    assert [sentence.split(" the ")[0] for _, sentence in atlas.warnings] == [
        "Table: 1 face outside",
        "Table: 2 faces overlapping others in",
    ]


@pytest.mark.parametrize("meshes", [[], [Mesh("Shade", quad_mesh().vertex, quad_mesh().polygons, receives=False)]])
def test_nothing_that_receives_makes_an_empty_atlas(meshes):
    atlas = make_charts(make_scene(meshes), Settings())
    assert (atlas.page_count, len(atlas.chart_page), len(atlas.warnings)) == (0, 0, 0)


def loose_mesh(count=100, name="Loose"):
    corners = np.random.default_rng(1).normal(size=(3 * count, 3))
    return Mesh(name, corners, np.arange(3 * count).reshape(-1, 3).tolist())


def test_as_many_pages_as_needed_are_made_by_themselves():
    """A hundred boxes have 600 charts, of which a page of 64 holds a hundred."""
    rng = np.random.default_rng(7)
    scene = make_scene([moved(box_mesh(), scale=rng.uniform(0.5, 2.0), name=f"Box {k}") for k in range(100)])
    atlas = make_charts(scene, Settings(size=64, even_out=False))
    check_atlas(scene, atlas, 4)
    assert 10 < atlas.page_count < 30
    found = densities(scene, atlas)
    np.testing.assert_allclose(found, found[0], rtol=1e-6)
    assert np.abs(signed_areas(atlas.tri_uv)).sum() / len(atlas.chart_page) > 4.0**2, "charts are as wide as their gaps, in the mean"
    assert not atlas.warnings


def test_more_pages_than_may_be_are_refused():
    scene = make_scene([moved(box_mesh(), scale=1.0 + 0.01 * k, name=f"Box {k}") for k in range(30)])
    needed = make_charts(scene, Settings(size=64)).page_count
    fewer = make_charts(scene, Settings(size=64, max_pages=needed - 2))
    assert fewer.page_count == needed - 2, "coarser, but as many as there may be"
    with pytest.raises(ValueError, match=r"The 180 charts of 30 objects do not fit a page of 64 texels: .* or allow more pages"):
        make_charts(scene, Settings(size=64, max_pages=1))
    with pytest.raises(
        ValueError, match=r"The bake needs \d+ pages of 64 texels, and the most that it may make is 2: allow more pages, or"
    ):
        make_charts(scene, Settings(size=64, max_pages=2, density=9.0))


@pytest.mark.parametrize("others", [[], [box_mesh(), quad_mesh("Painted", uv=FULL_PAGE)]])
def test_pages_are_larger_where_one_object_does_not_fit(others):
    scene = make_scene([loose_mesh(), *others])
    atlas = make_charts(scene, Settings(size=16))
    check_atlas(scene, atlas, 4)
    assert atlas.page_size == 128
    ((subject, sentence),) = [warning for warning in atlas.warnings if "do not fit" in warning[1]]
    assert subject == "Loose"
    assert sentence.startswith("Loose: its 100 charts do not fit a page of 16 texels, so pages of 128 are made; choose that page size")


def test_page_too_small_for_the_charts():
    sentence = r"The 100 charts of Loose do not fit a page of 16 texels: choose a greater page size or less padding"
    with pytest.raises(ValueError, match=sentence):
        make_charts(make_scene([loose_mesh()]), Settings(size=16, padding=8))
    with pytest.raises(ValueError, match=sentence):
        make_charts(make_scene([loose_mesh()]), Settings(size=16, atlas=False))


def test_charts_below_a_texel_are_told():
    atlas = make_charts(make_scene([moved(sphere_mesh("Grit"), scale=1e-3), quad_mesh("Floor", 10, 10)]), Settings(size=64))
    assert [subject for subject, _ in atlas.warnings] == ["Grit"]


def check_blocks(scene, atlas):
    """Objects of one block have one UV at each corner, within a unit square; gives their names by block."""
    names = {}
    for block in range(atlas.object_block.max() + 1):
        of_corner = {}
        members = np.flatnonzero(atlas.object_block == block)
        for i in members:
            rows = (scene.tri_object == i) & (atlas.tri_chart >= 0)
            place = atlas.object_place[i]
            assert place[0] == place[1]
            uv = (atlas.tri_uv[rows] / atlas.page_size - place[2:]) / place[:2]
            np.testing.assert_allclose([uv.min(), uv.max()], [0, 1], atol=1e-9)
            for corner, point in zip(scene.tri_corner[rows].ravel().tolist(), uv.reshape(-1, 2), strict=True):
                np.testing.assert_allclose(point, of_corner.setdefault(corner, point), atol=1e-9)
        names[block] = [scene.objects[i].name for i in members]
    free = atlas.object_block < 0
    assert (atlas.object_place[free] == [1, 1, 0, 0]).all()
    return names


def linked_meshes():
    cloth, crate = grid_mesh("Cloth", cells=4, noise=0.9, edge_m=0.2), box_mesh("Crate", (0.5, 0.3, 0.2))
    crates = [shared_mesh(f"Crate {k}", crate, (1 + 0.3 * k,) * 3, (k, 0, 0)) for k in range(5)]
    crates.append(shared_mesh("Crate mirrored", crate, (-1, 1, 1)))
    cloths = [dataclasses.replace(shared_mesh(f"Cloth {k}", cloth, (1, 1 + 0.2 * k, 1)), shares=1) for k in range(3)]
    return [*crates, shared_mesh("Plank", crate, (9, 1, 0.1)), quad_mesh("Floor", 3, 3), *cloths, quad_mesh("Painted", uv=FULL_PAGE)]


@pytest.mark.parametrize("options", [{}, {"density": 400.0}, {"atlas": False}, {"atlas": False, "density": 50.0}])
def test_linked_duplicates_wear_one_block_each_in_its_own_place(options):
    scene = make_scene(linked_meshes())
    settings = Settings(size=192, even_out=False, **options)
    atlas = make_charts(scene, settings)
    check_atlas(scene, atlas, settings.padding)
    names = check_blocks(scene, atlas)
    assert sorted(map(sorted, names.values())) == [
        ["Cloth 0", "Cloth 1", "Cloth 2"],
        ["Crate 0", "Crate 1", "Crate 2", "Crate 3", "Crate 4", "Crate mirrored"],
    ]
    found = densities(scene, atlas)
    worn = atlas.object_block >= 0
    if not options.get("atlas", True) and "density" not in options:
        for block in names:
            texels = np.bincount(scene.tri_object, np.abs(signed_areas(atlas.tri_uv)))[atlas.object_block == block]
            np.testing.assert_allclose(texels, texels[0])
    elif options.get("density") == 400.0:
        assert {f"Crate {k}" for k in range(5)} <= {subject for subject, _ in atlas.warnings}
        assert (found[worn] < 400.0).all()
    else:
        np.testing.assert_allclose(found[worn], options.get("density", found[worn][0]), rtol=1e-9)


# The charts of all objects before they have a place.
CLOTH = grid_mesh("Cloth", cells=4, noise=0.8)


def test_charts_of_an_object_follow_each_other_upright_and_at_zero():
    scene = make_scene([box_mesh("Box"), quad_mesh("Painted", uv=[[0, 0], [1, 0], [1, 1], [0, 1]]), CLOTH])
    found = find_charts(scene, True)
    for i in range(3):
        chart = found.chart[scene.tri_object == i]
        assert (chart.min(), chart.max() + 1) == (found.first_chart[i], found.first_chart[i + 1])
    for c in range(int(found.first_chart[-1])):
        assert found.uv[found.chart == c].min(axis=(0, 1)).tolist() == [0.0, 0.0]
    assert (found.layered, found.blocks, found.findings) == ((1,), (), ())
    assert found.outlines.extent[found.first_chart[1]].tolist() == [0.0, 0.0]


def test_an_objects_charts_lie_the_same_way_whatever_is_unwrapped_with_it():
    """Though xatlas packs them together, and turns them as they fit if it may."""
    meshes = [sphere_mesh(), box_mesh(), grid_mesh(noise=0.6), sphere_mesh(rings=5, segments=7), grid_mesh(cells=3, noise=0.3)]
    together = find_charts(make_scene(meshes), False)
    begin = 0
    for k, mesh in enumerate(meshes):
        alone = find_charts(make_scene([mesh]), False)
        own = slice(begin, begin := begin + len(alone.chart))
        np.testing.assert_array_equal(together.chart[own], alone.chart + together.first_chart[k])
        np.testing.assert_allclose(together.uv[own], alone.uv, atol=1e-4 * np.abs(alone.uv).max())


def test_copies_are_unwrapped_once_and_have_the_charts_that_they_would_have(monkeypatch):
    bent = grid_mesh("Bent", cells=6, noise=0.6)
    linked = [shared_mesh("A", bent, (2.0, 2.0, 2.0), (9.0, 0.0, 0.0)), shared_mesh("B", bent, (-2.0, 2.0, 2.0))]
    scene = make_scene([grid_mesh("Other"), bent, *linked, replace(moved(bent, (5.0, 0.0, 0.0), 3.0), name="Copy")])
    scene = replace(scene, objects=(*scene.objects[:4], replace(scene.objects[4], density_factor=2.0)))
    calls = []
    real = chart_cache.Unwrapping
    monkeypatch.setattr(chart_cache, "Unwrapping", lambda *arrays: calls.append(len(arrays[0])) or real(*arrays))
    found = find_charts(scene, True)
    assert sum(calls) == np.isin(scene.tri_object, [0, 1]).sum()
    own = [found.uv[scene.tri_object == i] for i in range(5)]
    np.testing.assert_allclose(own[2], 2.0 * own[1], rtol=1e-9)
    np.testing.assert_allclose(own[4], 6.0 * own[1], rtol=1e-9)
    monkeypatch.setattr(chart_search, "find_copies", lambda *_: {})
    apart = find_charts(scene, True)
    np.testing.assert_array_equal(found.first_chart, apart.first_chart)
    np.testing.assert_array_equal(found.chart, apart.chart)
    np.testing.assert_allclose(found.uv, apart.uv, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.outlines.area, apart.outlines.area, rtol=1e-4)


@pytest.mark.parametrize("layer", [False, True])
def test_charts_go_on_where_a_file_holds_vertices_for_each_face(layer):
    cloth = replace(CLOTH, uv=[(CLOTH.vertex[polygon, :2]) / 4.0 for polygon in CLOTH.polygons]) if layer else grid_mesh("Cloth", 4, 0.1)
    whole, split = (find_charts(make_scene([mesh]), True) for mesh in (cloth, split_faces(cloth)))
    assert whole.first_chart[1] == split.first_chart[1] == 1
    assert not split.findings


@pytest.mark.parametrize(("height", "advice"), [(1.0, "mend the layer"), (0.0, "give it faces with an area")])
def test_what_is_to_be_mended_is_the_layer_or_the_faces(height, advice):
    outside = quad_mesh("Over", uv=[[1.5, 0], [2.5, 0], [2.5, 1], [1.5, 1]])
    found = find_charts(make_scene([replace(outside, vertex=outside.vertex * [1.0, height, height])]), True)
    sentences = [sentence for _, sentence in found.findings]
    assert sentences[0].startswith("1 face outside the page") == (height > 0)
    assert sentences[-1].startswith("no face can be baked")
    assert advice in sentences[-1]
    assert len(found.findings) == (2 if height > 0 else 1)


def test_crash_of_xatlas_names_the_object(monkeypatch):
    class Crashing:
        def __init__(self, *arrays):
            self.first = int(arrays[-1][0])

        def finish(self, watch):
            raise UnfolderDied(-11, self.first)

        def cancel(self):
            pass

    monkeypatch.setattr(chart_cache, "Unwrapping", Crashing)
    with pytest.raises(ValueError, match=r"^Grid: the unwrapper xatlas ended unexpectedly on it \(code -11\); give"):
        find_charts(make_scene([grid_mesh("Grid", cells=2)]), True)


def guess(meshes):
    scene = make_scene(meshes)
    return guess_charts(scene.tri_position, scene.tri_object, len(meshes))[0].tolist()


def test_what_is_no_number_is_no_chart():
    broken = np.full((4, 3, 3), np.nan)
    charts, side = guess_charts(broken, np.zeros(4, int), 1)
    assert (charts.tolist(), side.tolist()) == ([0], [0.0])


def test_small_charts_leave_their_object_finer():
    """Beside a large square a hundred small ones take little of a page; of one size, as their number alone says, they would take most."""
    squares = [quad_mesh("Floor", 10.0, 10.0), *(moved(quad_mesh("Tile", 0.1, 0.1), (k, 0.0, 1.0)) for k in range(100))]
    corner = make_scene(squares).tri_position
    charts, side = guess_charts(corner, np.zeros(len(corner), int), 1)
    assert (charts[0], side[0]) == (101, pytest.approx(10.0 + 100 * 0.1, rel=1e-3))
    known, unknown = (ChartDemand.of_squares(charts, [101.0], told).find_density(1.0, Page(256, 4)) for told in (side, 0.0))
    assert known > 1.1 * unknown


@pytest.mark.parametrize("mesh", [sphere_mesh("Ball", rings=16, segments=24), grid_mesh("Cloth", cells=12, noise=0.1), box_mesh()])
def test_xatlas_makes_about_as_many(mesh):
    made = len(make_charts(make_scene([mesh]), Settings()).chart_page)
    assert made / 3 <= guess([mesh])[0] <= 3 * made


# Small things keep usable texels: by one rule, at a bounded cost for large ones, and never against what the user set.
PAGE = 170_000.0


def share_texels(area, is_set=None, texels=PAGE):
    """Texels of each object, on a page of so many."""
    area = np.array(area, float)
    weight = area * find_factors(area, np.zeros(len(area), bool) if is_set is None else np.array(is_set), texels) ** 2
    return texels * weight / weight.sum()


def level_meshes(count=60):
    rng = np.random.default_rng(3)
    props = [moved(box_mesh(), (*rng.uniform(-20, 20, 2), 0.5), scale=rng.uniform(1, 3), name=f"Prop {k}") for k in range(count)]
    return [quad_mesh("Ground", 200.0, 200.0), *props]


def texels_of(scene, atlas):
    return np.bincount(scene.tri_object, np.abs(signed_areas(atlas.tri_uv)), len(scene.objects))


def test_small_things_share_by_the_root_of_their_area():
    """Density ~ area^-1/4, where half of the page is not enough for all to be usable; a screw among them stays small."""
    area = np.array([1e6, *np.full(200, 4.0), 16.0, 1e-4])
    after = share_texels(area)
    assert after[-2] / after[1] == pytest.approx(2.0)
    assert after[-1] / after[1] == pytest.approx(5e-3)
    assert after[1:].sum() == pytest.approx(0.5 * PAGE), "and large things keep the other half"
    density = np.sqrt(after / area)
    assert density[-2] / density[1] == pytest.approx((16.0 / 4.0) ** -0.25)


@pytest.mark.parametrize("seed", range(6))
def test_no_object_loses_more_than_half_and_none_is_lifted_beyond_use(seed):
    rng = np.random.default_rng(seed)
    area = np.exp(rng.normal(0.0, rng.uniform(0.5, 4.0), rng.integers(2, 300)))
    before, after = PAGE * area / area.sum(), share_texels(area)
    assert (after >= 0.5 * before - 1e-6).all()
    assert (after <= np.maximum(before, USABLE) + 1e-6).all()
    assert after.sum() == pytest.approx(PAGE)


def test_nothing_changes_where_all_is_usable_or_all_is_small():
    assert (find_factors(np.array([10.0, 5.0, 1.0]), np.zeros(3, bool), PAGE) == 1.0).all()
    assert (find_factors(np.full(2000, 6.0), np.zeros(2000, bool), PAGE) == 1.0).all(), "there is nobody to take texels from"
    assert (find_factors(np.zeros(2), np.zeros(2, bool), PAGE) == 1.0).all()
    assert find_factors(np.array([1e5, 1.0, 0.0]), np.zeros(3, bool), PAGE)[2] == 1.0


def test_what_the_user_set_stays_relative_to_the_others():
    factor = find_factors(np.array([40_000.0, 6.0, 6.0]), np.array([False, True, False]), PAGE)
    assert factor[:2].tolist() == [1.0, 1.0]
    assert factor[2] > 5.0


@pytest.mark.parametrize(
    ("options", "expected"), [({}, True), ({"even_out": False}, False), ({"density": 20.0}, False), ({"atlas": False}, False)]
)
def test_it_acts_only_where_nobody_chose_a_density(options, expected):
    scene = make_scene(level_meshes())
    settings = Settings(**options)
    assert acts(settings) is expected
    assert (even_out(scene, settings) is not scene) is expected


def test_a_level_bakes_its_props_finer():
    scene = make_scene(level_meshes())
    plain, even = (texels_of(scene, make_charts(scene, Settings(even_out=on))) for on in (False, True))
    assert np.median(plain[1:]) < 200
    assert np.median(even[1:]) > 900
    assert even[0] > 0.5 * plain[0]


def test_layers_and_densities_of_the_users_own_are_left_alone():
    scene = make_scene([*level_meshes(), quad_mesh("Painted", uv=FULL_PAGE)])
    objects = list(scene.objects)
    objects[1] = dataclasses.replace(objects[1], density_factor=2.0)
    scene = dataclasses.replace(scene, objects=tuple(objects))
    changed = even_out(scene, Settings())
    assert [changed.objects[k].density_factor for k in (0, 1, -1)] == [1.0, 2.0, 1.0]
    assert changed.objects[2].density_factor > 1.0
    plain, even = (make_charts(scene, Settings(even_out=on)) for on in (False, True))
    painted = scene.tri_object == len(objects) - 1
    np.testing.assert_array_equal(plain.tri_uv[painted], even.tri_uv[painted])
    area = np.bincount(scene.tri_object, triangle_normals_areas(scene.tri_position)[1])
    ground, chosen = np.sqrt(texels_of(scene, even) / area)[:2]
    assert chosen / ground == pytest.approx(2.0, rel=1e-6)


def test_one_square_fills_the_page_exactly():
    _, _, outlines = rectangles([(2.0, 2.0)])
    layout = find_greatest_density(outlines, Page(64, 4))
    assert layout.density == 28.0
    assert layout.offset.tolist() == [[4, 4]]


@pytest.mark.parametrize(("count", "size", "least_share"), [(100, 1024, 0.75), (1000, 1024, 0.55), (100, 256, 0.35)])
def test_rectangles_fill_most_of_the_page(count, size, least_share):
    sizes = np.random.default_rng(2).uniform(0.05, 1.0, (count, 2))
    _, _, outlines = rectangles(sizes)
    density = find_greatest_density(outlines, Page(size, 4)).density
    assert sizes.prod(axis=1).sum() * density**2 / size**2 > least_share


@pytest.mark.parametrize("sizes", [[(1.0, 1.0)] * 6, [(5.0, 0.01)] * 3, [(1.0, 1.0), (1e-4, 1e-4)], [(3.0, 2.0)]])
def test_density_is_the_greatest_to_a_few_percent(sizes):
    page = Page(128, 3)
    _, _, outlines = rectangles(sizes)
    density = find_greatest_density(outlines, page).density
    for factor in (1.05, 1.1, 1.2, 1.5):
        shapes = shape_charts(outlines, density * factor, page)
        assert shapes is None or place_charts(shapes, page.empty_horizon()) is None


@pytest.mark.parametrize(("size", "padding", "count"), [(16, 4, 100), (8, 4, 1), (4, 64, 1)])
def test_too_many_charts_for_a_page(size, padding, count):
    assert find_greatest_density(triangles(count)[2], Page(size, padding)) is None
