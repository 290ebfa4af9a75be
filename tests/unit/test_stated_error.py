"""The error that a bake states: whose it is, that it is the real one, and where more rays go because of it."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.filter import error_estimate
from leaflight.core.filter.error_estimate import PhotonLight
from leaflight.core.filter.filtered_field import FilteredField
from leaflight.core.integrate.adaptive_sampling import DIRECT_SHARE, choose_texels
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.gathered import GatheredField
from leaflight.core.radiosity import quadtree, refine
from leaflight.core.radiosity.leaf_light import evaluate_nodes
from leaflight.core.radiosity.radiosity_solution import RadiositySolution
from leaflight.core.texels import error_metric
from leaflight.core.texels.error_metric import DARK_FLOOR, ErrorMetric, Parts
from trees import SIDE, SquareBake, even, even_truth, hill, hill_truth, make_map, throw

# Whose error is asked for: the whole's, or that of each object beside its own brightness.
STRIPS_SIDE = 64  # texels


def strips_map(*columns, side=STRIPS_SIDE, rows=None):
    """A page of upright strips, each a chart and an object of so many columns, and rows or `side`; and the object of each triangle."""
    strips = list(zip(pairwise(np.cumsum([0, *columns])), rows or [side] * len(columns), strict=True))
    uv = [[[a, 0], [b, 0], [b, high]] for (a, b), high in strips] + [[[a, 0], [b, high], [a, high]] for (a, b), high in strips]
    thing = np.tile(np.arange(len(columns)), 2)
    return make_map(uv, chart=thing, size=side), thing


def test_the_whole_is_asked_all_over_and_its_objects_are_told_apart():
    texels, tri_object = strips_map(48, 16)
    whole = ErrorMetric.of("bake", texels, tri_object)
    assert whole.entry.tolist() == error_metric.choose_sample(texels).tolist()
    assert [rows.tolist() for rows in whole.groups] == [list(range(len(whole.entry)))]
    assert {thing: len(rows) for thing, rows in whole.objects.items()} == {0: 48 * STRIPS_SIDE, 1: 16 * STRIPS_SIDE}
    for thing, rows in whole.objects.items():
        assert (tri_object[texels.texel_tri[whole.entry[rows]]] == thing).all()


def test_each_object_is_asked_as_much_as_another():
    texels, tri_object = strips_map(100, 20, side=128)
    each = ErrorMetric.of("objects", texels, tri_object)
    small, large = (len(rows) for rows in each.groups)
    assert small == large < 20 * 128
    assert (np.diff(each.entry) > 0).all()
    for thing, rows in each.objects.items():
        assert rows.tolist() == each.groups[thing].tolist()
        assert (each.entry_group[each.entry[rows]] == thing).all()


@pytest.mark.parametrize(("rows", "groups"), [(32, [0, 1, 2]), (31, [0, 1, 1]), (15, [0, -1, -1])])
def test_objects_with_few_texels_are_judged_together_or_not_at_all(rows, groups):
    texels, tri_object = strips_map(62, 1, 1, rows=[STRIPS_SIDE, rows, rows])
    each = ErrorMetric.of("objects", texels, tri_object)
    thing = tri_object[texels.texel_tri]
    assert [sorted(set(each.entry_group[thing == one])) for one in range(3)] == [[group] for group in groups]
    assert len(each.groups) == max(groups) + 1
    assert sorted(each.objects) == [one for one, group in enumerate(groups) if groups.count(group) == 1]


def test_where_no_object_has_enough_texels_it_is_the_whole():
    texels, tri_object = strips_map(1, 1, rows=[15, 15])
    each = ErrorMetric.of("objects", texels, tri_object)
    assert each.entry_group is None
    assert len(each.groups[0]) == 30
    assert each.objects == {}


def test_each_object_is_judged_beside_its_own_brightness():
    """But not next to black: below a tenth of what is dark on the whole."""
    texels, tri_object = strips_map(32, 16, 16)
    each = ErrorMetric.of("objects", texels, tri_object)
    level = np.array([10.0, 0.5, 1e-6], np.float32)
    light = np.repeat(level[tri_object[texels.texel_tri[each.entry]]][:, None], 3, axis=1)
    parts = each.part(light, dark=0.2)
    assert parts.dark2 == pytest.approx((DARK_FLOOR * np.array([10.0, 0.5, 0.2])) ** 2, rel=1e-5)
    entries = np.array([np.flatnonzero(tri_object[texels.texel_tri] == one)[0] for one in range(3)])
    assert parts.find_dark2(entries)[:, 0] == pytest.approx(parts.dark2)
    whole = ErrorMetric.of("bake", texels, tri_object).part(light, dark=0.2)
    assert whole.find_dark2(entries) == pytest.approx([0.2**2])


# The stated error against the real one, on a square whose light is known.
def read(bake, shrink=False):
    return RadiositySolution.of(bake.tree, bake.tally, refine.Rule("significance", 0.0, 16, 2), shrink)


def leaves_of(bake, reading):
    return quadtree.node_of_texel(bake.tree, reading.leaves, bake.n_texel)


def state(bake, direct_variance=0.0, shrink=False):
    """What is stated of leaves, and of direct light beside them that has some variance."""
    reading, dark = read(bake, shrink), np.zeros((bake.n_texel, 3), np.float32)
    leaf = leaves_of(bake, reading)
    total = float(reading.mean[leaf].sum())
    photons = PhotonLight(lambda entry: reading.mean[leaf[entry]], total, lambda entry: reading.error2[leaf[entry]])
    direct = FilteredField.plain(dark, dark + np.float32(direct_variance))
    return error_estimate.state_error(error_metric.ErrorMetric.whole(bake.texels), direct, photons)


def real_error(bake, truth, shrink=False):
    """Of leaves at texels' middles, relative to local brightness, over the best of them."""
    s, t = (bake.texels.texel_xy.T + 0.5) / SIDE
    reading, places = read(bake, shrink), bake.texels.own_points(0, bake.n_texel)
    shown = evaluate_nodes(bake.tree, reading.solution.coefficient, leaves_of(bake, reading), *places).sum(0)[0]
    squares = (shown - truth(s, t)) ** 2 / (truth(s, t) ** 2 + error_metric.DARK_FLOOR**2)
    return np.sqrt(np.sort(squares)[: int(error_metric.BEST_TEXELS * len(squares))].mean())


def ratio_of_errors(make, truth, n_bake, shrink=False):
    """Root mean squares of stated over real error, over bakes."""
    bakes = [make(seed) for seed in range(n_bake)]
    stated, real = [state(one, shrink=shrink).relative for one in bakes], [real_error(one, truth, shrink) for one in bakes]
    return np.sqrt(np.mean(np.square(stated)) / np.mean(np.square(real)))


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_noise_alone_is_stated_within_a_quarter(degree):
    """On the safe side: what is left of a bias by chance is added where it is positive."""
    ratio = ratio_of_errors(lambda seed: throw(even, 50_000, seed, degree=degree, level=3, preview_depth=0), even_truth, n_bake=6)
    assert 0.95 < ratio < 1.25


@pytest.mark.parametrize("degree", [1, 2])
def test_noise_is_stated_as_shrinking_leaves_it(degree):
    """Even light: with all noise of the functions that are shrunk it would be stated half too large."""
    ratio = ratio_of_errors(lambda seed: throw(even, 50_000, seed, degree=degree, level=2, preview_depth=0), even_truth, 12, shrink=True)
    assert 0.8 < ratio < 1.25


@pytest.mark.parametrize(("degree", "level"), [(0, 3), (1, 2), (2, 2)])
def test_light_that_coarse_leaves_cannot_hold_is_stated_within_a_quarter(degree, level):
    ratio = ratio_of_errors(lambda seed: throw(hill, 700_000, seed, degree=degree, level=level), hill_truth, 2)
    assert 0.75 < ratio < 1.25


def test_the_stated_error_takes_the_correction():
    """Four photons at each place err as a quarter as many, as few leaves state without seeing it."""
    clumped, single = [], []
    for seed in range(4):
        for stated, copies in ((clumped, 4), (single, 1)):
            bake = throw(
                lambda rng, n, k=copies: np.repeat(rng.random((2, n // k)), k, axis=1), 80_000, seed, degree=0, level=4, preview_depth=0
            )
            stated.append(state(bake).relative)
    assert np.mean(clumped) == pytest.approx(2 * np.mean(single), rel=0.2)


def test_no_light_has_no_error():
    direct = FilteredField.plain(*np.zeros((2, 64, 3), np.float32))
    metric = error_metric.ErrorMetric.whole(SquareBake(side=8).texels)
    assert error_estimate.state_error(metric, direct, PhotonLight.none()).relative == 0.0


def test_noise_of_direct_light_counts_and_is_told_apart():
    bake = throw(even, 50_000, 1, degree=0, level=3, preview_depth=0)
    without, with_it = state(bake), state(bake, direct_variance=0.2**2)
    expected = 0.2**2 / (1 + error_metric.DARK_FLOOR**2)
    assert with_it.relative**2 - without.relative**2 == pytest.approx(expected, rel=0.1)
    assert with_it.direct**2 == pytest.approx(expected, rel=0.02)
    assert with_it.texel_direct2() == pytest.approx(np.full(SIDE * SIDE, expected), rel=0.2)
    assert without.direct == 0
    assert not without.texel_direct2().any()


# More rays go from texels where one of them takes more off the squared error than a photon's ray does.
ERROR = 0.1  # that is asked for
LEAST = (DIRECT_SHARE * ERROR) ** 2  # below which rays are left as they are
TEXEL2 = np.array([0.0, 0.9, 1.1, 50.0, 50.0]) * LEAST


def field_of(kind, rays):
    field = kind.none(len(TEXEL2))
    field.counters["rays"] = rays
    field.passes[:] = 1
    return field


def stated(relative, direct, gathered=0.0):
    told = SimpleNamespace(relative=relative, chosen=relative, direct=direct, gathered=gathered, parts=Parts.whole(5, 1.0))
    told.texel_direct2 = lambda: TEXEL2.astype(np.float32)
    told.texel_gathered2 = (lambda: TEXEL2[::-1].astype(np.float32)) if gathered else None
    return told


def test_texels_that_err_too_much_are_chosen_where_shadow_rays_are_few():
    direct = field_of(DirectField, 100)
    rays, texels, _ = choose_texels(ERROR, stated(0.15, 0.1), 1000, direct, None)
    assert rays is direct
    assert texels.tolist() == [2, 3, 4]


def test_not_where_a_photon_helps_as_much():
    by_direct = 0.1**2 / 100
    for photons, chosen in ((0.9 * by_direct * 1000, True), (1.1 * by_direct * 1000, False)):
        found = choose_texels(ERROR, stated(np.sqrt(photons + 0.1**2), 0.1), 1000, field_of(DirectField, 100), None)
        assert (found is not None) == chosen


@pytest.mark.parametrize(("direct", "chosen"), [(0.99 * np.sqrt(LEAST), False), (1.01 * np.sqrt(LEAST), True)])
def test_not_where_direct_light_is_as_sure_as_it_has_to_be(direct, chosen):
    assert (choose_texels(ERROR, stated(direct * 1.001, direct), 10**9, field_of(DirectField, 1000), None) is not None) == chosen


def test_of_light_that_is_all_that_errs_no_more_texels_than_bring_it_to_the_error():
    """One ray more halves the squared error of each: the two worst take off a fourth of the whole, and for more there must be three."""
    for direct, chosen in ((0.11, [3, 4]), (0.15, [2, 3, 4])):
        assert choose_texels(ERROR, stated(direct, direct), 1000, field_of(DirectField, 100), None)[1].tolist() == chosen


def test_the_one_whose_rays_help_most():
    direct, gathered = field_of(DirectField, 100), field_of(GatheredField, 10)
    for errors, expected in (((0.1, 0.09), gathered), ((0.3, 0.06), direct)):
        rays, texels, _ = choose_texels(ERROR, stated(0.4, *errors), 10**9, direct, gathered)
        assert rays is expected
        assert texels.tolist() == ([0, 1, 2, 3, 4] if expected is gathered else [2, 3, 4])  # of gathered light neighbours share their error
    assert choose_texels(ERROR, stated(0.4, 0.3), 10**9, direct, gathered)[0] is direct  # light that nothing was gathered of


def open_to(*errors):
    """What is stated of texels in two parts, those of an even index in the first."""
    told = stated(0.15, 0.1)
    told.parts, told.of_parts = Parts([np.arange(1)] * 2, np.ones(2, np.float32), np.array([0, 1, 0, 1, 0], np.int32)), np.array(errors)
    return told


def test_of_several_parts_those_that_have_come_to_the_error_get_no_more_rays():
    direct = field_of(DirectField, 100)
    assert choose_texels(ERROR, open_to(0.15, 0.05), 1000, direct, None)[1].tolist() == [2, 4]
    assert choose_texels(ERROR, open_to(0.05, 0.15), 1000, direct, None)[1].tolist() == [3]
