"""Leaves are joined where their step is noise, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene, make_solver
from leaflight.core.filter import reconstruct
from leaflight.core.filter.blend_weights import find_shares
from leaflight.core.radiosity import quadtree
from leaflight.core.util.settings import Settings
from trees import SquareBake, even


def quartered(density, photons=20_000, side=32, degree=1):
    """Four leaves over the square, under photons thrown by `density(rng, n)`."""
    bake = SquareBake(side=side, degree=degree, preview_depth=1, level=1)
    bake.throw(*density(np.random.default_rng(8), photons))
    return bake


def join(texels, tree, solution, owner, halves=False):
    return reconstruct.Blend.of(texels, tree, solution, owner, halves)


def blend(bake):
    n = bake.n_texel
    leaves = np.flatnonzero(bake.tree.current)
    owner = quadtree.node_of_texel(bake.tree, leaves, n)
    values = join(bake.texels, bake.tree, bake.solution(), owner).at(np.arange(n))
    image = np.empty((bake.side, bake.side))
    image[bake.texels.texel_xy[:, 1], bake.texels.texel_xy[:, 0]] = values.irradiance.sum(0)[0]
    plain = np.empty_like(image)
    x, y = bake.texels.hit_texel_xy(bake.texels.texel_tri, *bake.texels.texel_bary[:, 1:].T)
    plain[bake.texels.texel_xy[:, 1], bake.texels.texel_xy[:, 0]] = reconstruct.evaluate_leaf(
        bake.tree, bake.solution(), owner, x, y
    ).irradiance.sum(0)[0]
    return image, plain


def step(rng, n):
    s, t = rng.random((2, n))
    return np.where(rng.random(n) < 0.75, s * 0.5, 0.5 + s * 0.5), t  # three times as much on the left


def gentle_step(rng, n):
    s, t = rng.random((2, n))
    return np.where(rng.random(n) < 0.6, s * 0.5, 0.5 + s * 0.5), t  # half as much again on the left


def ramp(rng, n):
    return np.sqrt(rng.random(n)), rng.random(n)


def jump(image):
    """Mean step between the two columns in the middle."""
    middle = image.shape[1] // 2
    return np.abs(image[:, middle] - image[:, middle - 1]).mean()


def test_noise_between_leaves_becomes_a_ramp():
    image, plain = blend(quartered(even))
    assert jump(image) < 0.4 * jump(plain)
    assert np.abs(image - 1).mean() < np.abs(plain - 1).mean()


def test_an_edge_of_light_stays_as_sharp():
    image, plain = blend(quartered(step))
    assert jump(plain) == pytest.approx(1.0, abs=0.1)
    assert jump(image) > 0.9 * jump(plain)


def test_a_ramp_over_several_leaves_stays_a_ramp():
    image, _ = blend(quartered(ramp, photons=400_000))
    expected = 2 * (np.arange(32) + 0.5) / 32
    np.testing.assert_allclose(image.mean(0), expected, atol=0.03)


def test_the_flux_of_even_light_is_kept():
    image, plain = blend(quartered(even))
    assert image.mean() == pytest.approx(plain.mean(), rel=0.005)


def test_one_leaf_is_its_own_function():
    bake = SquareBake(side=16, degree=2)
    bake.throw(*ramp(np.random.default_rng(0), 20_000))
    image, plain = blend(bake)
    np.testing.assert_allclose(image, plain, rtol=1e-9)


def test_stated_variance_is_that_of_repeated_blends():
    values, stated = [], []
    for seed in range(40):
        bake = SquareBake(side=16, degree=0, preview_depth=1, level=1)
        rng = np.random.default_rng(seed)
        bake.throw(*rng.random((2, rng.poisson(2000))), emitted=2000)  # most of a bake's photons land elsewhere
        owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), 256)
        light = join(bake.texels, bake.tree, bake.solution(), owner).at(np.arange(256))
        values.append(light.irradiance.sum(0)[0])
        stated.append(light.variance[0])
    assert np.var(values, axis=0).mean() == pytest.approx(np.mean(stated), rel=0.3)


def test_the_mean_of_the_halves_is_the_whole():
    bake = SquareBake(side=32, degree=1, preview_depth=1, level=1)
    rng = np.random.default_rng(2)
    for half in (0, 1):
        bake.throw(*ramp(rng, 20_000), half)
    owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), bake.n_texel)
    entries = np.arange(len(owner))
    whole, halves = (join(bake.texels, bake.tree, bake.solution(), owner, halves).at(entries).irradiance for halves in (False, True))
    np.testing.assert_allclose(halves.mean(0), whole.sum(0), rtol=1e-9)
    assert np.abs(halves[0] - halves[1]).max() > 0.01


def joined_leaves(degree):
    """Four leaves, alike to rounding and in the mirror; what is blended at all texels, and the leaf of each."""
    bake = SquareBake(side=32, degree=degree, preview_depth=1, level=1)
    s, t = np.random.default_rng(3).random((2, 500))
    for mirrored in ((s, t), (1 - s, t), (s, 1 - t), (1 - s, 1 - t)):
        bake.throw(*mirrored)
    owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), bake.n_texel)
    light = join(bake.texels, bake.tree, bake.solution(), owner).at(np.arange(len(owner)))
    return bake, light, owner


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_light_that_is_its_own_mirror_is_blended_into_its_own_mirror(degree):
    bake, light, _ = joined_leaves(degree)
    image = np.empty((32, 32))
    image[bake.texels.texel_xy[:, 1], bake.texels.texel_xy[:, 0]] = light.irradiance.sum(0)[0]
    x, y = np.meshgrid(np.arange(32), np.arange(32))
    central = (x != y) & (x != 31 - y)  # the square's diagonal runs through the others' centres: they are shown a little beside it
    for mirror in (image[::-1], image[:, ::-1]):
        np.testing.assert_allclose(image[central], mirror[central], rtol=1e-5)


@pytest.mark.parametrize(
    ("place", "shares"),
    [
        ((15, 15), (17 * 17, 15 * 17, 17 * 15, 15 * 15)),  # of a window of 32 half texels: half a texel from where all four meet
        ((11, 8), (25 * 31, 7 * 31, 25 * 1, 7 * 1)),
        ((8, 8), (31 * 31, 31 * 1, 1 * 31, 1 * 1)),
        ((1, 1), (1,)),  # most of its window lies outside of the chart
        ((30, 1), (1,)),
    ],
)
def test_leaves_err_apart(place, shares):
    bake, light, owner = joined_leaves(0)
    entry = np.flatnonzero((bake.texels.texel_xy == place).all(axis=1))
    expected = np.square(shares).sum() / np.sum(shares) ** 2
    np.testing.assert_allclose(light.variance[:, entry], bake.solution().variance[:, owner[entry]] * expected, rtol=1e-6)


def leaves_of_two_sizes(density, degree):
    """Under few photons: the tree, what is solved for, and the leaf of each texel."""
    bake = SquareBake(side=32, degree=degree, preview_depth=1, level=2)
    rng = np.random.default_rng(9)
    for half in (0, 1):
        bake.throw(*density(rng, 3000), half)
    tree = quadtree.split(bake.tree, np.flatnonzero(bake.tree.current)[::3])
    colour, grey = np.array([1.0, 0.4, 2.0]), bake.solution()
    coefficient, variance = grey.coefficient * colour[:, None, None], grey.variance * colour[:, None] ** 2
    solution = replace(grey, coefficient=coefficient, variance=variance)
    return bake, tree, solution, quadtree.node_of_texel(tree, np.flatnonzero(tree.current), bake.n_texel)


@pytest.mark.parametrize("straight", [True, False])
@pytest.mark.parametrize("degree", [0, 1])
def test_a_blend_is_the_mean_over_the_leaves_that_reach_a_place(degree, straight):
    """Leaf by leaf: what it has of the window, whether a step to it is noise, or a curve of reflected light, and how sure it is."""
    bake, tree, solution, owner = leaves_of_two_sizes(step if straight else gentle_step, degree)
    if not straight:
        solution = replace(solution, coefficient=solution.coefficient[::-1], variance=solution.variance / 9)
    joined_leaves = join(bake.texels, tree, solution, owner)
    blended, points = joined_leaves.at(np.arange(len(owner))), bake.texels.own_points(0, len(owner))
    in_part = refused = ironed = 0
    for entry in np.random.default_rng(1).choice(len(owner), 100, replace=False):
        place, own = points[:, entry], owner[entry]

        def light_of(node, place=place):
            return reconstruct.evaluate_leaf(tree, solution, np.array([node]), *place[:, None])

        mine = light_of(own)
        own_share, _, others, shares = find_shares(tree, joined_leaves.neighbours, own[None], *place[:, None])
        weights, lights = [], []
        for other, share in zip(others, shares, strict=True):
            theirs = light_of(other)
            sigmas = abs((theirs.irradiance - mine.irradiance).sum(0).mean()) / np.sqrt(theirs.variance.mean() + mine.variance.mean())
            joined = np.clip((5.0 - sigmas) / 2.0, 0.0, 1.0)
            if not straight:
                values = [light.irradiance.sum(0).mean() for light in (mine, theirs)]
                relative = abs(values[1] - values[0]) / np.mean(np.abs(values))
                ironed += joined < (joined := max(joined, np.clip((0.8 - relative) / 0.4, 0.0, 1.0)))
            in_part, refused = in_part + (0 < joined < 1), refused + (joined == 0)
            weights.append(share * joined * np.sqrt(mine.variance.mean() / theirs.variance.mean()))
            lights.append(theirs)
        weights, lights = np.array([*own_share, *weights]), [mine, *lights]
        weights /= weights.sum()
        mean = sum(weight * light.irradiance for weight, light in zip(weights, lights, strict=True))
        variance = sum(weight**2 * light.variance for weight, light in zip(weights, lights, strict=True))
        np.testing.assert_allclose(blended.irradiance[..., entry], mean[..., 0], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(blended.variance[:, entry], variance[:, 0], rtol=1e-9)
    assert in_part or not degree or not straight  # constant leaves have one step for each pair, here all far from the limits
    assert refused if straight else ironed


@pytest.mark.parametrize(
    ("own", "other", "light", "share"),
    [
        (0.0, 0.0, 1.0, 0.0),  # any step is light where nothing is noise
        (0.0, 1.0, 1.0, 7 / 16),  # who has no noise to tell speaks no louder; 7 of 16 half texels of the window lie there
        (1.0, 0.0, 1.0, 7 / 16),
        (1.0, 1.0, 1.0, 7 / 16),
        (0.5, 4.5, 1.0, 7 / (7 + 3 * 9)),  # a third as loud, of three times the standard error
        (0.0, 0.0, 0.0, 7 / 16),  # of equal light on the whole, each channel goes over
    ],
)
@pytest.mark.parametrize(("straight", "beside_it"), [(True, 0.0), (False, 0.0), (False, 0.7)])
def test_leaves_without_noise_speak_as_loud_as_others(own, other, light, share, straight, beside_it):
    """Of two leaves of 8 texels, half a texel from their border; light that was reflected goes over, if the step is not too large."""
    bake = SquareBake(side=16, degree=0, preview_depth=1, level=1)
    owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), bake.n_texel)
    entry, beside = (np.flatnonzero((bake.texels.texel_xy == place).all(axis=1)) for place in ((7, 3), (8, 3)))
    solution = bake.solution()
    coefficient, variance = np.zeros_like(solution.coefficient), np.zeros_like(solution.variance)
    kind = 0 if straight else 1
    coefficient[kind, :, 0, owner[entry]] = beside_it * light
    coefficient[kind, :, 0, owner[beside]] = light + np.array([-0.1, 0.0, 0.1])
    variance[:, owner[entry]], variance[:, owner[beside]] = own, other
    found = join(bake.texels, bake.tree, replace(solution, coefficient=coefficient, variance=variance), owner).at(entry)
    alone = [
        reconstruct.evaluate_leaf(bake.tree, replace(solution, coefficient=coefficient), node, np.zeros(1), np.zeros(1)).irradiance
        for node in (owner[entry], owner[beside])
    ]
    share = share or (7 / 16 if beside_it else 0.0)  # three tenths of light, more or less, is a curve
    np.testing.assert_allclose(found.irradiance, alone[0] + share * (alone[1] - alone[0]), atol=1e-9)


@pytest.mark.parametrize("step_share", [0.2, 0.4, 0.6, 0.79, 1.0])
def test_steps_of_reflected_light_stay_the_more_the_larger_they_are(step_share):
    bake = SquareBake(side=16, degree=0, preview_depth=1, level=1)
    owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), bake.n_texel)
    entry = np.flatnonzero((bake.texels.texel_xy == (7, 3)).all(axis=1))
    solution = bake.solution()
    coefficient = np.zeros_like(solution.coefficient)
    coefficient[1, :, 0] = np.where(bake.tree.origin[:, 0] < 8, 1.0 - step_share / 2, 1.0 + step_share / 2)
    found = join(bake.texels, bake.tree, replace(solution, coefficient=coefficient), owner).at(entry).irradiance[1]
    reach = 7 / 16 * np.clip((0.8 - step_share) / 0.4, 0.0, 1.0)
    np.testing.assert_allclose(found, 1.0 - step_share / 2 + step_share * reach / (9 / 16 + reach))


def test_steps_of_reflected_light_go_over_in_the_halves_as_in_the_whole():
    bake, rng = SquareBake(side=32, degree=1, preview_depth=1, level=1), np.random.default_rng(8)
    for half in (0, 1):
        bake.throw(*gentle_step(rng, 20_000), half, is_first=False)
    owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), bake.n_texel)
    solution, entries = bake.solution(), np.arange(bake.n_texel)
    assert not solution.coefficient[0].any()
    whole, halves = (join(bake.texels, bake.tree, solution, owner, halves).at(entries).irradiance for halves in (False, True))
    np.testing.assert_allclose(halves.mean(0), whole.sum(0), rtol=1e-9)


def test_steps_of_reflected_light_stay_where_a_chart_was_cut():
    """A wall may stand between leaves of what were one chart, though they touch by a door."""
    bake = quartered(gentle_step)
    owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), bake.n_texel)
    solution = bake.solution()
    solution = replace(solution, coefficient=solution.coefficient[::-1])
    whole = join(bake.texels, bake.tree, solution, owner)
    is_right = (bake.tree.origin[:, 0] >= 16).astype(np.int32)
    cut = replace(whole, tree=replace(bake.tree, chart=is_right))  # they still know of each other
    images = np.empty((2, 32, 32))
    for image, one in zip(images, (whole, cut), strict=True):
        image[bake.texels.texel_xy[:, 1], bake.texels.texel_xy[:, 0]] = one.at(np.arange(bake.n_texel)).irradiance.sum(0)[0]
    assert jump(images[0]) < 0.1
    assert jump(images[1]) > 0.3


def test_a_blender_knows_the_page_of_each_entry():
    texels = replace(SquareBake(side=8, preview_depth=1).texels, chart_page=np.array([1], np.int32), page_count=2)
    assert (texels.page_of(slice(None)) == 1).all()
    assert (texels.entry_at >= 0).sum((1, 2)).tolist() == [0, 64]


@pytest.mark.parametrize("degree", [0, 1])
def test_light_goes_on_across_the_borders_of_leaves(degree):
    """Of any two sizes: from either side it comes to the same, where more than two meet to little else."""
    bake, tree, solution, owner = leaves_of_two_sizes(even, degree)
    joined = join(bake.texels, tree, solution, owner)
    at = np.full((32, 32), -1)
    at[bake.texels.texel_xy[:, 1], bake.texels.texel_xy[:, 0]] = owner
    row, column = (at[:, 1:] != at[:, :-1]).nonzero()
    sides = [joined._blend(at[row, column + k], column + 1.0, row + 0.5) for k in (0, 1)]
    plain, blended = (np.abs(one.irradiance - other.irradiance).sum((0, 1)) for one, other in zip(*sides, strict=True))
    assert (tree.side[at[row, column]] != tree.side[at[row, column + 1]]).any()
    assert blended.mean() < 0.1 * plain.mean()


def blend_both(bake, pieces):
    """Blends (c, n) of all texels, one by one and by ranges that end at `pieces`, and the standard error (n,) of the first."""
    n = bake.n_texel
    owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), n)
    joined = join(bake.texels, bake.tree, bake.solution(), owner)
    each = joined.at(np.arange(n))
    ends = [0, *pieces, n]
    parts = [joined.range(*ends[i : i + 2]) for i in range(len(ends) - 1)]
    light = [values.irradiance.reshape(6, -1) for values in (each, *parts)]
    variance = [values.variance for values in (each, *parts)]
    return light[0], np.hstack(light[1:]), variance[0], np.hstack(variance[1:])


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_the_lattice_of_a_leaf_is_its_function(degree):
    bake = SquareBake(side=128, degree=degree)
    bake.throw(*ramp(np.random.default_rng(0), 20_000))
    each, by_cells, variance, variance_by_cells = blend_both(bake, [70, 128 * 64 + 1])
    np.testing.assert_allclose(by_cells, each, atol=1e-9 * each.max())
    np.testing.assert_allclose(variance_by_cells, variance, rtol=1e-9)


def test_a_lattice_follows_a_ramp_between_leaves():
    """Whose step is noise is asked at the corners of a cell, not at each of its texels."""
    bake = quartered(even, side=256)
    each, by_cells, variance, variance_by_cells = blend_both(bake, [1000])
    owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), bake.n_texel)
    alone = reconstruct.evaluate_leaf(bake.tree, bake.solution(), owner, *bake.texels.own_points(0, len(owner)))
    off, change = (np.sqrt((light**2).mean()) for light in (by_cells - each, each - alone.irradiance.reshape(6, -1)))
    assert 0 < off < 0.05 * change
    assert variance_by_cells.min() >= 0
    assert np.sqrt(((variance_by_cells - variance) ** 2).mean()) < 0.01 * variance.mean()


def join_wide(width):
    """Leaves of 128 texels' side, joined, on a square of 256 that is covered up to `width`."""
    bake = SquareBake(side=256, degree=1, width=width, preview_depth=1, level=1)
    bake.throw(*(np.random.default_rng(8).random((2, 20_000)) * [[width], [1.0]]))
    owner = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), bake.n_texel)
    return join(bake.texels, bake.tree, bake.solution(), owner)


def test_tiles_hold_what_a_lattice_tells_of_their_texels(monkeypatch):
    joined = join_wide(0.7165)  # 183.4 texels: the last of a row lies in a tile, and its centre is not covered
    off_centre = joined.texels.off_centre
    by_tiles = joined.range(0, len(joined.leaf))
    tiles = joined._find_smooth_tiles(0, len(joined.leaf))
    assert len(tiles) == 22 * 32
    assert len(off_centre) == 256
    monkeypatch.setattr(reconstruct.Blend, "_find_smooth_tiles", lambda self, start, stop: np.zeros(0, np.int64))
    by_lattice = joined.range(0, len(joined.leaf))
    np.testing.assert_allclose(by_tiles.irradiance, by_lattice.irradiance, rtol=1e-9)
    np.testing.assert_allclose(by_tiles.variance, by_lattice.variance, rtol=3e-3)
    np.testing.assert_array_equal(by_tiles.irradiance[..., off_centre], by_lattice.irradiance[..., off_centre])


@pytest.mark.parametrize("pieces", [[1, 64, 100, 30_000], [16_383, 16_385]])
def test_ranges_that_cut_tiles_hold_what_the_whole_does(pieces):
    joined = join_wide(1.0)
    ends = [0, *pieces, len(joined.leaf)]
    whole, parts = joined.range(0, len(joined.leaf)), [joined.range(*ends[i : i + 2]) for i in range(len(ends) - 1)]
    for name in ("irradiance", "variance"):
        np.testing.assert_allclose(np.concatenate([getattr(part, name) for part in parts], axis=-1), getattr(whole, name), rtol=1e-12)


def test_small_leaves_are_blended_texel_by_texel():
    each, by_cells, variance, variance_by_cells = blend_both(quartered(even, side=16), [100])
    np.testing.assert_array_equal(by_cells, each)
    np.testing.assert_array_equal(variance_by_cells, variance)


def glance_of_charts(folder, size):
    """The first light of a block on a floor, which are seven charts close to each other; who blends it, and the leaf of each texel."""
    solver = make_solver(folder, lamp_scene(), Settings(size=size, padding=1, max_photons=20_000, direct="photons", basis="constant"))
    light = solver.glance()
    return light, solver.tracing.texels, quadtree.node_of_texel(light.tree, light.leaves, len(solver.tracing.texels))


def test_leaves_of_other_charts_have_no_say(tmp_path):
    """Though windows reach them, and their light is about the same."""
    light, texels, leaf = glance_of_charts(tmp_path, 32)
    even = replace(light.solution, coefficient=np.ones_like(light.solution.coefficient))
    chart_of_entry = light.tree.chart[leaf]
    for chart in np.unique(chart_of_entry):
        other = replace(even, coefficient=np.where(light.tree.chart == chart, even.coefficient, 1.001))
        found = reconstruct.Blend.of(texels, light.tree, other, leaf).at(np.arange(len(leaf))).irradiance
        assert (found[..., chart_of_entry == chart] == 1).all()
        np.testing.assert_allclose(found[..., chart_of_entry != chart], 1.001)


def test_charts_of_one_texel_are_not_one_cell(tmp_path):
    light, texels, leaf = glance_of_charts(tmp_path, 8)
    assert (np.bincount(light.tree.chart[leaf]) == 1).sum() > 1
    joined = reconstruct.Blend.of(texels, light.tree, light.solution, leaf)
    each, by_cells = joined.at(np.arange(len(leaf))), joined.range(0, len(leaf))
    np.testing.assert_array_equal(by_cells.irradiance, each.irradiance)
    np.testing.assert_array_equal(by_cells.variance, each.variance)
