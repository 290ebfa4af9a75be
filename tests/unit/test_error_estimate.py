"""The stated error against the real one, on a square whose light is known."""

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.filter import bias_estimate, denoise, error_estimate, error_terms
from leaflight.core.filter.filtered_field import FilteredField, FilteredGather
from leaflight.core.filter.radiosity_solution import RadiositySolution
from leaflight.core.filter.reconstruct import Blend
from leaflight.core.filter.subtexel_tally import SubtexelLight, mix
from leaflight.core.radiosity import coefficient_shrinkage, quadtree, refine, tally
from leaflight.core.radiosity.spatial_shrinkage import SpatialShrinkage
from leaflight.core.texels import error_metric
from leaflight.core.texels.split_texels import TexelBorders
from trees import SIDE, SquareBake, current, even, even_truth, glow, glow_truth, hill, hill_truth, throw


def state(bake, nodes, direct_variance=0.0, smooth_grain=False, risk=None, squares=None):
    dark = np.zeros((bake.n_texel, 3), np.float32)
    direct = FilteredField.plain(dark, dark + np.float32(direct_variance))
    return error_estimate.state_error(read(bake, nodes, risk=risk, squares=squares), direct, bake.texels, smooth_grain)


def read(bake, nodes=None, **more):
    """What state_error asks: of the bake's current nodes if none are named."""
    totals, solution = bake.totals(), bake.solution()
    comparison = refine.Comparison.of(bake.tree, totals, solution, refine.Rule("significance", 0.0, 16, 2))
    return RadiositySolution(bake.tree, totals, solution, comparison, current(bake) if nodes is None else nodes, **more)


def dark_of(bake):
    """No direct light."""
    return FilteredField.plain(*np.zeros((2, bake.n_texel, 3), np.float32))


def noise_of(bake, nodes):
    """What state_error says of photons' noise alone, relative; nodes of one size."""
    solution = bake.solution()
    brightness = solution.flux[0, nodes] / bake.tree.area[nodes]
    variance = solution.variance[0, nodes] * bake.tree.rank[nodes] * state(bake, nodes).correction[0]
    return np.sqrt((variance / (brightness**2 + (error_metric.DARK_FLOOR * brightness.mean()) ** 2)).mean())


def real_error(bake, nodes, truth):
    """As estimate states it: of blended leaves at texels' middles, relative to local brightness, over the best of them."""
    s, t = (bake.texels.texel_xy.T + 0.5) / SIDE
    leaf = quadtree.node_of_texel(bake.tree, nodes, bake.n_texel)
    shown = Blend.of(bake.texels, bake.tree, bake.solution(), leaf).at(np.arange(len(leaf))).irradiance.sum(0)[0]
    squares = (shown - truth(s, t)) ** 2 / (truth(s, t) ** 2 + error_metric.DARK_FLOOR**2)
    return np.sqrt(np.sort(squares)[: int(error_metric.BEST_TEXELS * len(squares))].mean())


def ratio_of_errors(make, truth, n_bake):
    """Root mean squares of stated over real error, over bakes."""
    stated, real = [], []
    for seed in range(n_bake):
        bake = make(seed)
        stated.append(state(bake, current(bake)).relative)
        real.append(real_error(bake, current(bake), truth))
    return np.sqrt(np.mean(np.square(stated)) / np.mean(np.square(real)))


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_noise_alone_is_stated_within_a_quarter(degree):
    """On the safe side: what is left of a bias by chance is added where it is positive."""
    ratio = ratio_of_errors(lambda seed: throw(even, 50_000, seed, degree=degree, level=3), even_truth, n_bake=6)
    assert 0.95 < ratio < 1.25


@pytest.mark.parametrize(("degree", "level"), [(0, 3), (1, 2), (2, 2)])
def test_light_that_coarse_leaves_cannot_hold_is_stated_within_a_quarter(degree, level):
    ratio = ratio_of_errors(lambda seed: throw(hill, 1_000_000, seed, degree=degree, level=level), hill_truth, n_bake=1)
    assert 0.75 < ratio < 1.25
    bake = throw(hill, 1_000_000, 0, degree=degree, level=level)
    nodes = current(bake)
    assert state(bake, nodes).relative > 2 * noise_of(bake, nodes)  # or the test would be of noise again


@pytest.mark.parametrize("degree", [1, 2])
def test_noise_is_stated_as_shrinking_leaves_it(degree):
    """Even light: with all noise of the functions that are shrunk it would be stated half too large."""
    stated, real = [], []
    for seed in range(12):
        bake = throw(even, 50_000, seed, degree=degree, level=2, preview_depth=0)
        nodes, tree = current(bake), bake.tree
        shown, risk = coefficient_shrinkage.shrink_leaves(tree, bake.totals(), nodes)
        solution = tally.solve_tallies(shown, bake.totals())
        bake.solution = lambda solution=solution: solution
        stated.append(state(bake, nodes, risk=risk).relative)
        real.append(real_error(bake, nodes, even_truth))
    assert 0.8 < np.sqrt(np.mean(np.square(stated)) / np.mean(np.square(real))) < 1.25


def test_steep_functions_state_all_their_noise():
    bake = throw(even, 50_000, 1, degree=1, level=2, preview_depth=0)
    nodes = current(bake)
    all_of_it, none = (state(bake, nodes, risk=np.full(len(nodes), share)).relative for share in (3.0, -3.0))
    assert all_of_it == state(bake, nodes).relative
    assert none**2 == pytest.approx(all_of_it**2 / 2.5, rel=0.2)  # the mean's is a third of it, a little more where leaves are blended


def test_whoever_stops_by_the_error_is_told_what_is_sure_of_shrinking():
    bake = throw(even, 50_000, 1, degree=1, level=2, preview_depth=0)
    nodes = current(bake)
    differing = np.where(np.arange(len(nodes)) % 2, 1.0, -1.0)
    all_of_it, agreed, unsure = (state(bake, nodes, risk=risk) for risk in (None, np.zeros(len(nodes)), differing))
    assert agreed.chosen == pytest.approx(agreed.relative, rel=0.01)
    assert unsure.relative == pytest.approx(agreed.relative, rel=0.05)
    assert 1.1 * unsure.relative < unsure.chosen < all_of_it.chosen


def test_the_stated_error_takes_the_correction():
    """Four photons at each place err as a quarter as many, as few leaves state without seeing it."""
    clumped, single = [], []
    for seed in range(4):
        for stated, copies in ((clumped, 4), (single, 1)):
            bake = throw(lambda rng, n, k=copies: np.repeat(rng.random((2, n // k)), k, axis=1), 80_000, seed, degree=0, level=4)
            stated.append(state(bake, current(bake)).relative)
    assert np.mean(clumped) == pytest.approx(2 * np.mean(single), rel=0.2)


def test_no_photons_are_no_statement():
    bake = SquareBake(side=8)
    assert np.isnan(state(bake, current(bake)).relative)


def test_noise_of_direct_light_counts_and_is_told_apart():
    bake = throw(even, 50_000, 1, degree=0, level=3)
    without, with_it = state(bake, current(bake)), state(bake, current(bake), direct_variance=0.2**2)
    expected = 0.2**2 / (1 + error_metric.DARK_FLOOR**2)
    assert with_it.relative**2 - without.relative**2 == pytest.approx(expected, rel=0.1)
    assert with_it.direct**2 == pytest.approx(expected, rel=0.02)
    assert with_it.texel_direct2() == pytest.approx(np.full(SIDE * SIDE, expected), rel=0.2)
    assert without.direct == 0
    assert not without.texel_direct2().any()


def test_blur_of_direct_light_counts_as_its_noise_does_but_never_below_nothing():
    bake = throw(even, 50_000, 1, degree=0, level=3)
    zero = np.zeros((bake.n_texel, 3), np.float32)
    found = []
    for blur2 in (0.0, 0.03, -0.03):
        every, noise = np.arange(bake.n_texel, dtype=np.int32), zero + np.float32(0.01)
        shown = FilteredField(zero, noise, every, zero, noise, zero + np.float32(blur2))
        found.append(error_estimate.state_error(read(bake), shown, bake.texels))
    plain, blurred, clear = found
    assert blurred.direct**2 == pytest.approx(4 * plain.direct**2, rel=1e-3)
    assert blurred.relative**2 - plain.relative**2 == pytest.approx(3 * plain.direct**2, rel=1e-3)
    assert clear.direct**2 == pytest.approx(0.25 * plain.direct**2, rel=1e-3)  # see SmoothedAt.find_noise_share
    assert plain.relative**2 - clear.relative**2 == pytest.approx(0.75 * plain.direct**2, rel=1e-3)


def shown_of(bake, irradiance, variance, blur2=0.0):
    """Direct light of which every texel was smoothed: by rays it was found dark, and as noisy again as it is shown."""
    zero, every = np.zeros((bake.n_texel, 3), np.float32), np.arange(bake.n_texel, dtype=np.int32)
    values = (zero + np.float32(value) for value in (irradiance, variance, blur2))
    return FilteredField(zero, zero + np.float32(2 * variance), every, *values)


def test_direct_light_is_judged_as_it_is_shown():
    """Beside the brightness and by the noise of what was smoothed, not of what was found."""
    bake = throw(even, 50_000, 1, degree=0, level=3)
    solution, nodes = bake.solution(), current(bake)
    stated = error_estimate.state_error(read(bake), shown_of(bake, 2.0, 0.09), bake.texels)
    light = (solution.flux[:, nodes] / bake.tree.area[nodes])[:, quadtree.node_of_texel(bake.tree, nodes, bake.n_texel)] + 2.0
    dark2 = (error_metric.DARK_FLOOR * light.mean()) ** 2
    expected = (0.09 / (light**2 + dark2)).mean(axis=0)
    assert nodes.tolist() == sorted(nodes)
    np.testing.assert_allclose(stated.texel_direct2(), expected, rtol=1e-4)
    assert stated.direct**2 == pytest.approx(expected.mean(), rel=0.03)  # of the best texels
    floor = np.sqrt(1 + error_metric.DARK_FLOOR**2)  # which brightness is held against, where light is even
    assert stated.indirect == pytest.approx((light.mean() - 2.0) / light.mean() / floor, rel=0.01)
    plain = error_estimate.state_error(read(bake), shown_of(bake, 0.0, 0.0), bake.texels)
    assert plain.indirect == pytest.approx(1.0 / floor, rel=0.01)
    assert plain.photons == pytest.approx(plain.relative, rel=0.02)  # even light is all of it noise
    assert stated.photons**2 + stated.direct**2 == pytest.approx(stated.relative**2, rel=0.02)
    brighter = light.mean() / (light.mean() - 2.0)  # as much brighter all light is, as much less is photons' noise
    assert stated.relative**2 - stated.direct**2 == pytest.approx(plain.relative**2 / brighter**2, rel=0.1)


def test_gathered_light_is_judged_as_it_is_shown_where_it_is_told():
    bake = throw(even, 50_000, 1, degree=0, level=3)
    solution, nodes = bake.solution(), current(bake)
    told = np.arange(bake.n_texel) < bake.n_texel // 2
    found = []
    for blur2 in (0.0, 0.08):
        gathered = FilteredGather(shown_of(bake, 1.0, 0.04, blur2), np.zeros(bake.n_texel, np.float32), told)
        found.append(error_estimate.state_error(read(bake), dark_of(bake), bake.texels, gathered=gathered))
    plain, blurred = found
    light = (solution.flux[:, nodes] / bake.tree.area[nodes])[:, quadtree.node_of_texel(bake.tree, nodes, bake.n_texel)]
    expected = (0.04 / (light**2 + (error_metric.DARK_FLOOR * light.mean()) ** 2)).mean(axis=0) * told
    np.testing.assert_allclose(plain.texel_gathered2(), expected, rtol=1e-4)
    assert plain.gathered**2 == pytest.approx(expected.mean(), rel=0.03)
    assert blurred.gathered**2 == pytest.approx(3 * plain.gathered**2, rel=0.03)


@pytest.mark.parametrize(("share", "counted"), [(1 / 64, 1 / 64 - 0.01), (0.005, 0.0)])
def test_the_worst_texels_are_left_out(share, counted):
    """Some texels are far off: of those, what is over 1 % of all counts."""
    bake = throw(even, 50_000, 1, degree=0, level=3)
    variance = np.zeros((SIDE * SIDE, 1))
    variance[: round(share * SIDE * SIDE)] = 100.0
    variance *= 1 + 1e-3 * np.random.default_rng(1).random(variance.shape)  # no two alike, so that their order is told
    brightness2 = 1 + error_metric.DARK_FLOOR**2
    found = state(bake, current(bake), direct_variance=variance).direct
    assert found**2 == pytest.approx(counted / error_metric.BEST_TEXELS * 100.0 / brightness2, rel=0.15, abs=1e-9)


def test_more_photons_state_less():
    few, many = (state(bake, current(bake)).relative for bake in (throw(even, n, 3, degree=1, level=2) for n in (20_000, 320_000)))
    assert many == pytest.approx(few / 4, rel=0.35)


def test_leaves_without_previews_take_the_word_of_their_parents():
    def low_hill(rng, n):  # brightness is about the same everywhere
        return np.concatenate([hill(rng, n // 5), even(rng, n - n // 5)], axis=1)

    bake = throw(low_hill, 1_000_000, 1, degree=0, level=2, preview_depth=1)
    parents = current(bake)
    told2 = state(bake, parents).relative ** 2 - noise_of(bake, parents) ** 2
    bake.tree = quadtree.split(bake.tree, parents)
    children = current(bake)
    blind2 = state(bake, children).relative ** 2 - noise_of(bake, children) ** 2
    assert blind2 == pytest.approx(bias_estimate.BIAS_DECAY * told2, rel=0.1)


def test_leaves_that_are_shown_with_what_is_around_err_by_what_they_state():
    """Half of them, three times as bright as they are; the others as without."""
    bake = throw(even, 4000, seed=3, level=2)
    nodes = np.flatnonzero(bake.tree.current)
    row_of = np.full(len(bake.tree), -1, np.int32)
    row_of[nodes[::2]] = np.arange(len(nodes[::2]))
    own = bake.solution().flux[:, nodes[::2]] / bake.tree.area[nodes[::2]]
    few = SpatialShrinkage(row_of, own, np.ones(len(own[0])), 3.0 * own, np.full_like(own, 0.25))
    alone, stated = (error_estimate.state_error(read(bake), dark_of(bake), bake.texels, False, few=one) for one in (None, few))
    assert stated.photons**2 == pytest.approx((0.25 / (9.0 + 4 * error_metric.DARK_FLOOR**2) + alone.photons**2) / 2, rel=0.1)
    surer = replace(few, variance=0.0 * few.variance)
    assert error_estimate.state_error(read(bake), dark_of(bake), bake.texels, False, few=surer).relative < 0.8 * alone.relative


def test_what_those_miss_is_in_their_variance():
    """It is not what their own functions cannot hold, for they do not show these."""
    bake = throw(hill, 100_000, seed=3, level=1)
    nodes = np.flatnonzero(bake.tree.current)
    row_of = np.full(len(bake.tree), -1, np.int32)
    row_of[nodes] = np.arange(len(nodes))
    own = bake.solution().flux[:, nodes] / bake.tree.area[nodes]
    few = SpatialShrinkage(row_of, own, np.ones(len(nodes)), own, 0.0 * own)
    alone, stated = (error_estimate.state_error(read(bake), dark_of(bake), bake.texels, False, few=one) for one in (None, few))
    assert alone.relative > 0.05
    assert stated.relative == 0.0


def test_those_that_are_shown_black_are_not_asked():
    bake = throw(even, 4000, seed=3, level=2)
    nodes = np.flatnonzero(bake.tree.current)
    row_of = np.full(len(bake.tree), -1, np.int32)
    row_of[nodes[::2]] = np.arange(len(nodes[::2]))
    dark = np.zeros((3, len(nodes[::2])))
    few = SpatialShrinkage(row_of, dark, dark[0], dark, dark)
    alone, stated = (error_estimate.state_error(read(bake), dark_of(bake), bake.texels, False, few=one) for one in (None, few))
    assert stated.relative == pytest.approx(alone.relative, rel=0.2)  # of the other half


def test_nodes_of_few_photons_do_not_judge():
    """Even light on 16 leaves; what single texels below them say, which have seen two photons each, is noise and no doubt."""
    ratios = []
    for seed in range(6):
        bake = throw(even, 8000, seed, level=2, preview_depth=4)
        told = state(bake, current(bake))
        ratios.append(told.chosen / noise_of(bake, current(bake)))
    assert max(ratios) < 1.27  # 1.32 to 1.44 with the deepest as judges


def test_the_doubt_of_a_bias_is_how_much_it_varies_over_bakes(monkeypatch):
    """Which is held against whoever chooses; texels of one judge err together."""
    biases, doubts = [], []
    find_bias = bias_estimate.find_bias

    def watch(*args):
        bias = find_bias(*args)
        biases.append(bias.told.mean())
        return bias

    monkeypatch.setattr(bias_estimate, "find_bias", watch)
    monkeypatch.setattr(error_terms, "BEST_TEXELS", 1.0)
    for seed in range(60):
        bake = throw(even, 8000, seed, degree=0, level=2, preview_depth=1)
        told = state(bake, current(bake))
        doubts.append(told.chosen**2 - told.relative**2)
    assert 0.9 < np.mean(doubts) / np.std(biases) < 1.3  # 1.1; a judge's texels alone would make it a tenth of that


@pytest.mark.parametrize(("level", "left"), [(1, 1.0), (2, denoise.GRAIN_LEFT)])  # of 32 texels and of 16
def test_noise_counts_as_it_is_smoothed(level, left):
    bake = throw(even, 50_000, 1, degree=0, level=level, preview_depth=0)  # nobody judges: all that is stated is noise
    plain, smoothed = (state(bake, current(bake), smooth_grain=smooth).relative for smooth in (False, True))
    assert smoothed**2 == pytest.approx(left * plain**2, rel=1e-6)


def ripple_squares(bake, rows, height, photons, seed):
    """Squares of the texels `rows`, on which photons tell of ripples that leaves do not hold; and that light, (n,)."""
    truth = np.ones(bake.n_texel)
    truth[rows] += height * np.where(bake.texels.texel_xy[rows, 0] % 2, 1, -1)
    irradiance = np.zeros((2, 3, len(rows)))
    irradiance[1] = np.random.default_rng(seed).poisson(photons * truth[rows]) / photons
    return SubtexelLight(rows.astype(np.int32), irradiance, irradiance[1] / photons, np.full((3, len(rows)), 1 / photons)), truth


@pytest.mark.parametrize(("height", "photons"), [(0.3, 40.0), (0.3, 400.0), (0.1, 1000.0)])
def test_what_squares_add_and_leave_is_stated(height, photons):
    real2, stated2, unaware2 = [], [], []
    for seed in range(4):
        bake = throw(even, 100_000, seed, degree=0, level=3)
        rows = np.arange(0, bake.n_texel, 2)
        squares, truth = ripple_squares(bake, rows, height, photons, seed)
        leaf = quadtree.node_of_texel(bake.tree, current(bake), bake.n_texel)
        light = Blend.of(bake.texels, bake.tree, bake.solution(), leaf).at(np.arange(bake.n_texel)).irradiance.astype(np.float32)
        mix(light, np.zeros(light.shape[1:], np.float32), squares, bake.texels)
        errors2 = (((light.sum(0) - truth) / np.hypot(truth, error_metric.DARK_FLOOR)) ** 2).mean(0)
        real2.append(np.sort(errors2)[: int(error_metric.BEST_TEXELS * len(errors2))].mean())
        stated2.append(state(bake, current(bake), squares=squares).relative ** 2)
        unaware2.append(state(bake, current(bake)).relative ** 2)
    assert np.sqrt(np.mean(stated2) / np.mean(real2)) == pytest.approx(1, abs=0.25)
    assert np.mean(unaware2) < 0.5 * np.mean(real2)  # or the test could not fail


def test_where_squares_are_shown_little_of_what_shrinking_took_is_in_doubt():
    bake = throw(even, 50_000, 1, degree=1, level=2, preview_depth=0)
    squares, _ = ripple_squares(bake, np.arange(bake.n_texel), 0.3, 4000.0, 1)
    differing = np.where(np.arange(len(current(bake))) % 2, 1.0, -1.0)
    plain, mixed = (state(bake, current(bake), risk=differing, squares=shown) for shown in (None, squares))
    assert 0 < mixed.chosen**2 - mixed.relative**2 < 0.1 * (plain.chosen**2 - plain.relative**2)


def test_squares_of_texels_that_something_crosses_are_not_asked():
    """What is shown there is in part the light beyond, before it is mixed."""
    bake = throw(even, 100_000, 1, degree=0, level=3)
    rows = np.arange(0, bake.n_texel, 2)
    squares, _ = ripple_squares(bake, rows, 0.3, 400.0, 1)
    plain = state(bake, current(bake)).relative
    stated = []
    for crossed in (rows, rows[::8]):
        pair = np.append(crossed, crossed ^ 1), np.append(crossed ^ 1, crossed)  # beside it in Morton order
        way = np.repeat([0, 2], len(crossed))
        bake.texels = replace(bake.texels, borders=TexelBorders.of(bake.n_texel, way, *pair, np.full(len(way), 0.4)))
        stated.append(state(bake, current(bake), squares=squares).relative)
    assert stated[0] == plain
    assert stated[1] > 1.5 * plain


def test_squares_that_few_photons_met_are_not_asked():
    bake = throw(even, 100_000, 1, degree=0, level=3)
    few, _ = ripple_squares(bake, np.arange(bake.n_texel), 0.9, 5.0, 1)
    assert not few.tell_much()
    assert state(bake, current(bake), squares=few).relative == state(bake, current(bake)).relative


def test_where_gathered_light_is_shown_nothing_is_missing():
    """Nor is anything in doubt that shrinking took off."""
    bake = throw(hill, 200_000, 1, degree=1, level=2)
    dark, doubt2 = dark_of(bake), np.zeros(bake.n_texel, np.float32)
    differing = np.where(np.arange(len(current(bake))) % 2, 1.0, -1.0)
    assert error_estimate.state_error(read(bake), dark, bake.texels).relative > 0.05
    found = []
    for blur2 in (0.0, -0.05):  # below nothing it is noise
        gathered = FilteredGather(shown_of(bake, 1.0, 1e-4, blur2), doubt2, np.ones(bake.n_texel, bool))
        found.append(error_estimate.state_error(read(bake, risk=differing), dark, bake.texels, gathered=gathered))
    for stated in found:
        assert stated.relative == stated.chosen == pytest.approx(stated.gathered)
    assert 0.9 * found[0].gathered < found[1].gathered < found[0].gathered  # of 0.0502 stated 0.05 was not there


def test_what_goes_on_in_gathered_light_is_stated_with_the_photons_where_it_is_told():
    bake = throw(hill, 200_000, 1, degree=1, level=2)
    dark, doubt2 = dark_of(bake), np.zeros(bake.n_texel, np.float32)
    every, carried2 = np.ones(bake.n_texel, bool), 1e-4
    plain, carried, none = (
        error_estimate.state_error(read(bake), dark, bake.texels, gathered=FilteredGather(shown_of(bake, 1.0, 1e-4), doubt2, where, of))
        for where, of in ((every, 0.0), (every, carried2), (~every, carried2))
    )
    assert carried.relative**2 - plain.relative**2 == pytest.approx(carried2, rel=1e-3)
    assert carried.photons**2 - plain.photons**2 == pytest.approx(carried2, rel=1e-3)
    assert carried.gathered == plain.gathered
    assert none.relative == error_estimate.state_error(read(bake), dark, bake.texels).relative


def test_the_worst_by_what_leaves_miss_are_left_out(monkeypatch):
    bake, missing = throw(even, 50_000, 1, degree=0, level=3), np.zeros(SIDE * SIDE)
    nodes = current(bake)
    missing[: SIDE * SIDE // 64] = 100.0

    def some(tree, solution, comparison, nodes, sample, *_):
        none = np.full(len(sample), np.nan)
        return bias_estimate.Bias(np.arange(len(sample), dtype=np.int32) % len(tree), missing, missing, 0 * missing, none, none)

    monkeypatch.setattr(bias_estimate, "find_bias", some)
    assert state(bake, nodes).relative ** 2 == pytest.approx((1 / 64 - 0.01) / 0.99 * 100, rel=0.05)


def test_what_is_missing_is_asked_of_the_sampled_texels_leaves(monkeypatch):
    bake, asked = throw(hill, 50_000, 1, degree=0, level=2), []
    find = bias_estimate.find_bias

    def watch(*args):
        asked.append(args[4:6])
        return find(*args)

    monkeypatch.setattr(bias_estimate, "find_bias", watch)
    state(bake, current(bake))
    [(sample, light)] = asked
    assert len(sample) == min(bake.n_texel, 8192)
    assert ((bake.tree.start[light.leaf] <= sample) & (sample < bake.tree.end[light.leaf])).all()


def refined(sampler, photons, seed, degree):
    """As bakes do: nodes split from round to round, of which each has as many photons as all before it; and the leaves."""
    bake, rng, rule = SquareBake(SIDE, degree), np.random.default_rng(seed), refine.Rule("significance", 0.0, 16, 2)
    for number in (6, 6, 5, 4, 3, 2, 1):
        for half in (0, 1):
            part = photons >> number + 1
            bake.throw(*sampler(rng, part), half, emitted=part)
        totals, solution = bake.totals(), bake.solution()
        comparison = refine.Comparison.of(bake.tree, totals, solution, rule)
        leaves = refine.choose_leaves(bake.tree, comparison)
        nothing = np.zeros(len(bake.tree), bool), np.zeros((3, len(bake.tree)))
        marked = refine.mark(bake.tree, totals, solution, comparison, rule, *nothing) if number > 1 else leaves[:0]
        bake.tree = quadtree.split(bake.tree, marked) if len(marked) else bake.tree
        bake.grow()
    bake.tally.grow(len(bake.tree))
    return bake, leaves


@pytest.mark.slow
@pytest.mark.parametrize(("degree", "low", "high", "worst"), [(1, 0.75, 0.9, 1.65), (2, 0.9, 1.15, 1.4)])
def test_what_is_stated_of_a_glow_that_fades(degree, low, high, worst):
    """To a twentieth, of a fixed number of photons: linear leaves miss more than is foretold, which docs/accuracy.md tells."""
    x, y = (np.indices((SIDE, SIDE)) + 0.5) / SIDE
    mean = glow_truth(x, y).mean()
    found = []
    for seed in range(24):
        bake, leaves = refined(glow, 1 << 18, seed, degree)
        found.append((state(bake, leaves).relative, real_error(bake, leaves, lambda s, t: glow_truth(s, t) / mean)))
    stated, real = np.array(found).T
    assert low < np.sqrt((stated**2).mean() / (real**2).mean()) < high
    assert (real / stated).max() < worst
