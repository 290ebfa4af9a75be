"""Leaves are joined where their step is noise, and only there."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from boxes import lamp_scene, make_solver
from leaflight.core.filter import reconstruct
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


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_light_of_a_range_is_that_of_its_texels(degree):
    """It is interpolated on large leaves, tile by tile; ranges begin and end anywhere."""
    bake = quartered(gentle_step, photons=20_000, side=128, degree=degree)
    leaf = quadtree.node_of_texel(bake.tree, np.flatnonzero(bake.tree.current), bake.n_texel)
    blended = join(bake.texels, bake.tree, bake.solution(), leaf)
    ends = [0, 5, 700, 4096, 4500, 9000, bake.n_texel]
    ranges = [blended.range(*part) for part in pairwise(ends)]
    exact = blended.at(np.arange(bake.n_texel))
    for name in ("irradiance", "variance"):
        found, expected = np.concatenate([getattr(part, name) for part in ranges], axis=-1), getattr(exact, name)
        off = np.abs(found - expected) / expected.max()
        assert off.mean() < 3e-3
        assert off.max() < 0.2  # next to other leaves, where blending changes within a cell
        np.testing.assert_allclose(getattr(blended.range(0, bake.n_texel), name), found, atol=1e-9 * expected.max())
