"""Photons on a quadtree: functions, sums, slopes and the subdivision rule."""

import dataclasses

import numpy as np
import pytest
from leaflight.core.radiosity import basis, coefficient_shrinkage, quadtree, refine, tally
from leaflight.core.radiosity.radiosity_solution import RadiositySolution
from trees import SquareBake, even, make_map, make_square_map


# Bases are orthonormal on clipped domains.
def clipped_moments(rng, degree, points=400):
    """Moments of a random point cloud in a random strip across the square: a discrete measure stands for a clipped domain."""
    along, across = rng.uniform(-1, 1, (2, points))
    across = rng.uniform(-0.5, 0.5) + 0.5 * rng.uniform(0.1, 1.0) * across
    turn = rng.uniform(0, np.pi)
    s, t = np.cos(turn) * along - np.sin(turn) * across, np.sin(turn) * along + np.cos(turn) * across
    weight = rng.uniform(0.1, 1.0, points)
    values = np.array(basis.monomials(s, t, 2 * degree))
    return s, t, weight, (values * weight).sum(1)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_functions_are_orthonormal_on_clipped_domains(degree, hold):
    rng, off = np.random.default_rng(4), 0.0
    for _ in range(50):
        s, t, weight, moment = clipped_moments(rng, degree)
        functions = basis.orthonormal_functions(basis.gram_matrix(moment[None], degree))[0]
        values = functions @ np.array(basis.monomials(s, t, degree))
        off = max(off, np.abs((values * weight) @ values.T - np.eye(len(values))).max())
    hold("basis: inner products on random clipped domains off the identity", off, high=1e-10)


def test_a_line_of_a_domain_drops_to_lower_order():
    t = np.linspace(-1, 1, 9)
    s = np.full_like(t, 0.3)  # no extent in s: 1 and s are the same function here
    moment = np.array(basis.monomials(s, t, 2)).sum(1)
    functions = basis.orthonormal_functions(basis.gram_matrix(moment[None], 1))[0]
    assert (np.abs(functions).sum(1) > 0).sum() == 2
    assert np.isfinite(functions).all()


def test_an_empty_domain_keeps_no_function():
    assert not basis.orthonormal_functions(np.zeros((1, 3, 3))).any()


# Nodes tile their chart, areas add up, and children lie where their parents say.
@pytest.mark.parametrize("level", [0, 1])
def test_a_chart_may_leave_the_corners_of_its_square_empty(level):
    """Every node holds the texels that lie on its square, and no others."""
    texels = make_map([[[8, 1], [15, 8], [8, 15]], [[8, 15], [1, 8], [8, 1]]], size=16)
    tree = quadtree.grow_previews(quadtree.plant_trees(texels, 1, level, 1, False), texels, 4, 1)
    assert tree.side.min() == 1
    for start, end, origin, side in zip(tree.start, tree.end, tree.origin, tree.side, strict=True):
        inside = ((texels.texel_xy >= origin) & (texels.texel_xy < origin + side)).all(axis=1)
        assert np.flatnonzero(inside).tolist() == list(range(start, end))


@pytest.mark.parametrize("level", [0, 1, 2, 9])
def test_a_minimum_level_starts_there_or_at_texels(level):
    texels = make_square_map(8, 0)
    tree = quadtree.plant_trees(texels, 0, level, finest_texels=2, flat=False)
    assert len(tree) == 4 ** min(level, 2)
    assert tree.current.all()
    place = texels.texel_xy - tree.origin[quadtree.node_of_texel(tree, np.arange(len(tree)), 64)]
    assert ((place >= 0) & (place < tree.side[0])).all()


def test_nodes_that_do_not_tile_are_refused():
    bake = SquareBake(side=8, preview_depth=1)
    with pytest.raises(ValueError, match="expected to tile 64 texels"):
        quadtree.node_of_texel(bake.tree, bake.tree.children[0][:2], 64)
    with pytest.raises(ValueError, match="expected to tile 64 texels, got 80"):
        quadtree.node_of_texel(bake.tree, np.append(bake.tree.children[0], bake.tree.children[0][0]), 64)


# Sums become the right irradiance, and no photon's energy is lost by splitting.
@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("width", [1.0, 0.33])
def test_even_light_is_even_also_at_a_clipped_border(degree, width):
    """Photons on a fine lattice: every node must read flux over covered area, at its rim too."""
    bake = SquareBake(side=16, degree=degree, width=width)
    line = (np.arange(800) + 0.5) / 800
    s, t = (a.ravel() for a in np.meshgrid(line * width, line))
    bake.throw(s, t, emitted=len(s))
    deepest = np.flatnonzero(~bake.tree.has_children)
    at_s, at_t = np.random.default_rng(0).uniform(0.01, 0.99, (2, 50)) * [[width], [1]]
    np.testing.assert_allclose(bake.values(deepest, at_s, at_t), 1.0 / width, rtol=0.03)


def test_late_children_scale_their_functions_by_what_their_parent_saw():
    """Eq. 10 holds for the functions as it does for the flux: each integrates to its node's flux, level by level."""
    rng = np.random.default_rng(5)
    bake = SquareBake(side=16, degree=1, preview_depth=1)
    for _ in range(3):
        bake.throw(*rng.random((2, 3000)))
        bake.tree = quadtree.split(bake.tree, np.flatnonzero(bake.tree.current & bake.tree.has_children))
        bake.grow()
    bake.throw(*rng.random((2, 3000)))
    solution = bake.solution()
    whole = (solution.coefficient.sum(0) * bake.tree.moment[:, :3].T).sum(1)
    np.testing.assert_allclose(whole, solution.flux, rtol=1e-9)
    for level in bake.tree.levels:
        np.testing.assert_allclose(whole[:, level].sum(1), 1.0, rtol=0.01)


def test_components_and_halves_are_told_apart():
    """Indirect light of 2 W in the even half of the bake, on the right; direct of 1 W in the odd, on the left."""
    rng = np.random.default_rng(1)
    bake = SquareBake(side=8, degree=1, preview_depth=1)
    bake.throw(0.5 + 0.5 * rng.random(200), rng.random(200), half=0, emitted=400, flux=np.full((3, 200), 4.0), is_first=False)
    bake.throw(0.5 * rng.random(600), rng.random(600), half=1, emitted=600)
    solution, moment = bake.solution(), bake.tree.moment[0, :3]
    np.testing.assert_allclose(solution.flux_half[:, :, 0], [[2.0] * 3, [1.0] * 3])
    np.testing.assert_allclose((solution.half[..., 0] * moment).sum(2), solution.flux_half[:, :, 0])
    np.testing.assert_allclose((solution.coefficient[..., 0] * moment).sum(2), [[0.6] * 3, [0.8] * 3])  # of 1000 photons in all
    np.testing.assert_allclose(solution.flux[:, 0], 1.4)
    left, right = (bake.tree.origin[bake.tree.children[0, :], 0] == at for at in (0, 4))
    of_children = solution.coefficient[..., bake.tree.children[0]][:, 0, 0]
    assert of_children[0, left] == pytest.approx(1.2, rel=0.1)
    assert of_children[1, right] == pytest.approx(1.6, rel=0.15)
    assert not of_children[0, right].any()
    assert not of_children[1, left].any()


def test_children_without_photons_take_their_parents_function():
    rng = np.random.default_rng(5)
    bake = SquareBake(side=16, degree=1, preview_depth=1)
    bake.throw(np.sqrt(rng.random(100_000)), rng.random(100_000))
    bake.tree = quadtree.split(bake.tree, np.array([0]))
    bake.grow()
    bake.tally.grow(len(bake.tree))
    fine = np.flatnonzero(~bake.tree.has_children)
    coarse = bake.tree.children[0]
    at_s, at_t = rng.random((2, 40))
    np.testing.assert_allclose(
        bake.values(fine, at_s, at_t), bake.values(coarse, at_s, at_t), rtol=0.02
    )  # the parent's own is shrunk a hair


def test_variance_is_that_of_repeated_bakes():
    """Of four nodes, in bakes whose photons mostly land elsewhere; 120 of them show a variance to 7 %."""
    values, stated = [], []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        bake = SquareBake(side=8, degree=1, preview_depth=1)
        n = rng.poisson(2000)
        bake.throw(*rng.random((2, n)), emitted=2000, flux=np.broadcast_to(rng.choice([0.5, 1.5], n), (3, n)))
        solution = bake.solution()
        values.append(solution.flux[0, 1:] / bake.tree.area[1:])
        stated.append(solution.variance[0, 1:])
    assert np.var(values, axis=0).mean() == pytest.approx(np.mean(stated), rel=0.15)


@pytest.mark.parametrize("watts", [1e-30, 1e-17, 1.0, 1e17, 1e25, 1e30])
def test_squares_of_any_power_are_summed(watts):
    """Photons carry all of a scene's light: those of planets that a sun shines on have more watts than float32 can square."""
    flux = np.float32(watts) * np.float32([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [0.5, 0.5, 0.5]])
    sums = tally.deposit(np.array([0, 1, 1]), *np.zeros((2, 3)), flux, None, 2, 0)
    np.testing.assert_allclose(sums.weight2 / float(np.float32(watts)) ** 2, [[1.0, 13.0], [0.0, 0.0], [0.25, 0.5]], rtol=1e-6)


# The light of photons on leaves: how much of it comes from lamps, and how much from surfaces.
@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("width", [1.0, 0.3])
def test_the_direct_share_of_a_leafs_light_is_that_of_its_photons(degree, width):
    """Direct light falls on one half of a chart, and as much indirect light everywhere; the node may reach far beyond the chart."""
    rng = np.random.default_rng(1)
    bake = SquareBake(side=16, degree=degree, width=width, preview_depth=1)
    bake.throw(width * (1 - rng.random(4000) ** 2 / 2), rng.random(4000))
    bake.throw(width * rng.random(4000), rng.random(4000), half=1, is_first=False)
    reading = RadiositySolution.of(bake.tree, bake.tally, refine.Rule("significance", 0.0, 1 << 20, 1), False)
    direct = (reading.direct_share * reading.mean)[reading.leaves] * bake.tree.area[reading.leaves, None]
    np.testing.assert_allclose(direct.sum(axis=0), reading.solution.flux[:, reading.leaves].sum(axis=1) / 2, rtol=1e-6)


# Shrunk functions of leaves: less noise where light is even, the whole slope where it is steep, and the same flux.
ROOT = np.array([0])


def shrunk_bake(sampler, photons, degree, seed=0, **kwargs):
    """A bake, its solution as photons have it, and with the root shrunk."""
    bake = SquareBake(side=16, degree=degree, preview_depth=1, **kwargs)
    bake.throw(*sampler(np.random.default_rng(seed), photons))
    totals = bake.totals()
    shown = coefficient_shrinkage.shrink_leaves(bake.tree, totals, ROOT)
    return bake, shown, tally.solve_tallies(bake.tree, totals), tally.solve_tallies(shown, totals)


def ramp(rng, n):
    return np.sqrt(rng.random(n)), rng.random(n)


def test_a_slope_keeps_the_share_that_is_not_noise():
    """Of photons of different powers, in both halves of the bake and both components, on a strip: told by orthonormal functions."""
    rng, width = np.random.default_rng(3), 0.25
    bake = SquareBake(side=16, width=width, preview_depth=1)
    square = energy = 0.0
    for half, is_first in ((0, True), (1, True), (1, False)):
        x, y = rng.random((2, 400)) * [[width], [1.0]]
        flux = rng.uniform(0.1, 2.0, (3, 400)) * (0.8 + 0.4 * y)
        bake.throw(x, y, half, flux=flux, is_first=is_first)
        along = np.sqrt(12.0 / width) * np.stack([x / width - 0.5, y - 0.5])
        energy, square = energy + flux @ along.T, square + (flux**2).sum()
    share = 1.0 - 2 * square / width / (energy**2).sum()
    assert 0.2 < share < 0.9
    plain, totals = tally.solve_tallies(bake.tree, bake.totals()), bake.totals()
    shrunk = tally.solve_tallies(coefficient_shrinkage.shrink_leaves(bake.tree, totals, ROOT), totals)
    slopes = [solution.coefficient[..., 1:, 0] * [width, 1.0] for solution in (plain, shrunk)]
    np.testing.assert_allclose(slopes[1], share * slopes[0], rtol=1e-5)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_slope_that_many_photons_tell_stays(degree):
    _, _, plain, shrunk = shrunk_bake(ramp, 20_000, degree)
    slope = (shrunk.coefficient[:, :, 1, 0].sum(0) / plain.coefficient[:, :, 1, 0].sum(0))[0]
    assert 0.98 < slope < 1.02


def test_each_degree_is_shrunk_for_itself():
    """A ramp has nothing that only quadratic functions could hold."""
    before, after = np.zeros((2, 40))
    for seed in range(40):
        _, _, plain, shrunk = shrunk_bake(ramp, 5_000, 2, seed)
        before[seed], after[seed] = ((solution.coefficient[:, 0, 3:, 0].sum(0) ** 2).sum() for solution in (plain, shrunk))
    assert after.mean() < 0.6 * before.mean()


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("width", [1.0, 0.3])
def test_flux_stays_and_so_do_other_nodes(degree, width):
    def strip(rng, n):
        s, t = rng.random((2, n))
        return s * width, t

    bake, shown, plain, shrunk = shrunk_bake(strip, 300, degree, width=width)
    np.testing.assert_allclose(shrunk.flux, plain.flux, rtol=1e-9)
    np.testing.assert_array_equal(shown.project[1:], bake.tree.project[1:])
    if degree == 0:
        np.testing.assert_allclose(shown.project, bake.tree.project)


# The subdivision rule: quiet on even light, awake at edges, blind to noise.
def rule(oracle="significance", threshold=0.05, stability=16, preview_depth=2):
    return refine.Rule(oracle, threshold, stability, preview_depth)


def marks(bake, the_rule, forced=None, background=None):
    forced = np.zeros(len(bake.tree), bool) if forced is None else forced
    background = np.zeros((3, len(bake.tree))) if background is None else background
    totals, solution = bake.totals(), bake.solution()
    comparison = refine.Comparison.of(bake.tree, totals, solution, the_rule)
    return refine.mark(bake.tree, totals, solution, comparison, the_rule, forced, background)


def shown(bake):
    totals = bake.totals()
    comparison = refine.Comparison.of(bake.tree, totals, bake.solution(), rule())
    return refine.choose_leaves(bake.tree, comparison)


def refined(photons, sampler, rounds=8, **kwargs):
    bake = SquareBake(**kwargs)
    rng = np.random.default_rng(11)
    for _ in range(rounds):
        bake.throw(*sampler(rng, photons // rounds))
        while len(marked := marks(bake, rule())):
            bake.tree = quadtree.split(bake.tree, marked)
        bake.grow()
    bake.tally.grow(len(bake.tree))
    return bake


def half_lit(rng, n):
    s, t = rng.random((2, n))
    return s * 0.3, t


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_even_light_is_not_split(degree):
    bake = refined(50_000, even, degree=degree)
    assert bake.tree.current.sum() <= 4  # the root, but for one false alarm


def uneven(cells, photons):
    """Places of photons: on the left halves of `cells` columns of the square 0.8 times their mean, on the right halves 1.2."""
    s, t, side = np.random.default_rng(0).random((3, photons))
    column = np.floor(s * cells)
    return (column + (s * cells - column + (side > 0.4)) / 2) / cells, t


@pytest.mark.parametrize("direct", [False, True])
def test_a_difference_is_judged_beside_all_light(direct):
    """As much direct light again halves it."""
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    bake.throw(*uneven(1, 20_000))
    light = np.where(direct, bake.solution().flux / bake.tree.area, 0.0)
    assert [len(marks(bake, rule("paper", one), background=light)) for one in (0.07, 0.15)] == ([1, 0] if direct else [1, 1])


def test_a_difference_is_relative_whatever_the_size_of_the_node():
    """In every one of 64 nodes a step of 20 % about its mean."""
    bake = SquareBake(side=32, degree=0, preview_depth=1, level=3)
    bake.throw(*uneven(8, 400_000))
    assert [len(marks(bake, rule("paper", threshold))) for threshold in (0.15, 0.3)] == [64, 0]


def chi_squares(n_bake, depth, noise_share=1.0):
    """(n_bake,) sigmas of even light; the noise that is expected may be a share of the right one."""
    sigmas = []
    for seed in range(n_bake):
        bake = SquareBake(side=4 * 2**depth, degree=1, preview_depth=depth)
        bake.throw(*np.random.default_rng(seed).random((2, 2000)))
        totals = bake.totals()
        totals = dataclasses.replace(totals, weight2=totals.weight2 * noise_share)
        sigmas.append(refine.indicator(bake.tree, totals, bake.solution(), np.array([0]), depth, 16).sigmas[0])
    return np.array(sigmas)


@pytest.mark.slow
def test_the_chi_square_of_even_light_has_its_mean_and_spread():
    """Over many bakes sigmas has mean 0 and deviation 1: neither asleep nor nervous."""
    sigmas = chi_squares(300, 1)
    assert abs(np.mean(sigmas)) < 0.2
    assert np.std(sigmas) == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_a_noise_of_3_percent_too_little_shows():
    """Of 64 previews' functions; in 200 bakes the mean is known to 0.07."""
    right, wrong = chi_squares(200, 3), chi_squares(200, 3, 0.97)
    assert abs(np.mean(right)) < 0.15 < np.mean(wrong)


def test_a_step_is_split_however_low_it_is():
    """Of 3 % about the mean, once photons tell it from noise."""
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    low = np.random.default_rng(0).random((2, 200_000))
    low[0] = np.where(np.random.default_rng(1).random(200_000) < 0.03, low[0] / 2, low[0])
    bake.throw(*low[:, :2000])
    assert len(marks(bake, rule())) == 0
    bake.throw(*low[:, 2000:])
    assert len(marks(bake, rule())) == 1


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_the_edge_of_light_is_found(degree):
    bake = refined(200_000, half_lit, degree=degree, side=32)
    current = np.flatnonzero(bake.tree.current)
    smallest = current[bake.tree.side[current] == bake.tree.side[current].min()]
    middle = (bake.tree.origin[smallest, 0] + bake.tree.side[smallest] / 2) / 32
    assert bake.tree.side[smallest[0]] <= 4
    assert np.abs(middle - 0.3).max() < 0.15


def test_a_linear_ramp_needs_no_split_of_a_linear_basis():
    def ramp(rng, n):
        return np.sqrt(rng.random(n)), rng.random(n)

    assert refined(100_000, ramp, degree=1).tree.current.sum() == 1
    assert refined(100_000, ramp, degree=0).tree.current.sum() > 16


def test_the_papers_oracle_compares_means_of_stable_previews():
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    rng = np.random.default_rng(0)
    bake.throw(rng.random(400) * 0.5, rng.random(400))
    bake.throw(rng.random(30), rng.random(30))
    assert len(marks(bake, rule("paper", threshold=0.5))) == 1
    assert len(marks(bake, rule("paper", threshold=3.0))) == 0
    assert len(marks(bake, rule("paper", threshold=0.5, stability=1000))) == 0


def test_too_few_photons_are_never_compared():
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    rng = np.random.default_rng(0)
    bake.throw(rng.random(63) * 0.5, rng.random(63))
    assert len(marks(bake, rule())) == 0
    bake.throw(rng.random(1) * 0.5, rng.random(1))
    assert len(marks(bake, rule())) == 1


def test_shown_leaves_tile_and_are_fewest_where_light_is_even():
    bake = refined(200_000, half_lit, degree=1, side=32)
    leaves = shown(bake)
    quadtree.node_of_texel(bake.tree, leaves, bake.n_texel)
    dark = bake.tree.origin[leaves, 0] >= 16
    assert (bake.tree.side[leaves[dark]] == 16).all()  # unlit half: as large as the root's split allows


def test_pruning_takes_back_a_split_that_only_noise_asked_for():
    bake = SquareBake(side=32, degree=1, preview_depth=2)
    bake.tree = quadtree.split(bake.tree, np.array([0]))
    bake.grow()
    bake.throw(*np.random.default_rng(1).random((2, 5000)))
    assert shown(bake).tolist() == [0]


@pytest.mark.parametrize(("photons", "count"), [(100, 1), (1600, 4)])
def test_children_that_saw_few_of_many_photons_must_differ_by_more(photons, count):
    """A step of light in a node of even light, eight times the noise of 100 photons: the price is then 30."""
    rng = np.random.default_rng(1)
    bake = SquareBake(side=32, degree=1, preview_depth=0)
    bake.throw(*rng.random((2, 5000)))
    bake.preview_depth = 1
    bake.grow()
    bake.throw(*half_lit(rng, photons))
    assert len(shown(bake)) == count
    alone = SquareBake(side=32, degree=1, preview_depth=1)
    alone.throw(*half_lit(rng, photons))
    assert len(shown(alone)) == 4


@pytest.mark.parametrize("side", [16, 400])
def test_nodes_tell_of_the_texels_in_them(side):
    """Their means, and whether any has a flag."""
    bake, rng = SquareBake(side=side, width=0.7, preview_depth=3), np.random.default_rng(2)
    flag, values = rng.random(bake.n_texel) < 13.0 / side**2, rng.random((bake.n_texel, 3)).astype(np.float32)
    texels = [slice(start, end) for start, end in zip(bake.tree.start, bake.tree.end, strict=True)]
    found = quadtree.any_in_nodes(bake.tree, flag)
    assert found.tolist() == [bool(flag[inside].any()) for inside in texels]
    assert found.any() != found.all()
    means = np.transpose([values[inside].mean(axis=0, dtype=np.float64) for inside in texels])
    np.testing.assert_allclose(quadtree.mean_in_nodes(bake.tree, values), means, rtol=1e-9)
    assert not quadtree.mean_in_nodes(bake.tree, np.zeros_like(values)).any()
