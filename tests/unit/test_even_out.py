"""Small things keep usable texels: by one rule, at a bounded cost for large ones, and never against what the user set."""

import dataclasses

import numpy as np
import pytest
from leaflight.core.atlas.charts import make_charts
from leaflight.core.atlas.even_out import USABLE, acts, even_out, find_factors
from leaflight.core.atlas.layer_check import signed_areas
from leaflight.core.util.geometry import triangle_normals_areas
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, moved, quad_mesh

PAGE = 170_000.0
FULL_PAGE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])


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
