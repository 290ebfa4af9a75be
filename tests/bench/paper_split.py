"""Where the error of the hierarchy comes from: light that its leaves cannot hold, noise, and what the best leaves would leave of both."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from leaflight.core.radiosity import basis, quadtree, refine, tally
from leaflight.core.radiosity.quadtree import Quadtree
from leaflight.core.radiosity.tally import Tally, Totals
from paper_bakes import Bake, Reference, Stage
from paper_tables import DEFAULTS, FIXED_MESH, percent
from tables import Table


@dataclass(frozen=True)
class Split:
    """One way to choose leaves; errors as `rel` of Errors.

    missing   of the truth itself on the leaves' functions
    noise     of the light on them against that
    """

    name: str
    leaves: int
    rel: float
    missing: float
    noise: float


def texel_moments(stage: Stage, tree: Quadtree, node: np.ndarray) -> np.ndarray:
    """(n, K) m^2: integrals over each texel of the monomials of its `node` (n,)."""
    half, entry = tree.side[node] / 2.0, np.arange(len(node))
    moments = stage.texels.range_moments(entry, entry + 1, tree.origin[node] + half[:, None], half, 2 * tree.degree)
    return moments[:, : basis.count_functions(tree.degree)]


def texel_means(area: np.ndarray, moments: np.ndarray, node: np.ndarray, coefficient: np.ndarray) -> np.ndarray:
    """(n, 3) W/m^2, light at texels.

    area          (n,) m^2
    moments       (n, K) m^2, of texel_moments
    coefficient   (3, K, n_node) W/m^2
    """
    total = sum(coefficient[:, k].take(node, axis=-1) * moment for k, moment in enumerate(moments.T))
    return np.maximum((total / area).T, 0.0)


def hold_light(area: np.ndarray, moments: np.ndarray, tree: Quadtree, node: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(n, 3) W/m^2: what the functions of each texel's `node` hold of the light (n, 3) at texels; others as for texel_means."""
    raw = [[np.bincount(node, values * moment, len(tree)) for moment in moments.T] for values in light.T]
    return texel_means(area, moments, node, basis.apply_matrices(tree.project, np.array(raw)))


def split_error(name: str, reference: Reference, stage: Stage, tree: Quadtree, leaf: np.ndarray, values: np.ndarray) -> Split:
    """The error of `values` (n, 3) on the functions of each texel's `leaf`, over the best texels of the whole."""
    moments = texel_moments(stage, tree, leaf)
    held = [hold_light(reference.area, moments, tree, leaf, light) for light in (reference.first, reference.second)]

    def root_mean(one: np.ndarray, other: np.ndarray) -> float:
        return float(np.sqrt(max((one * other / reference.local2)[best].mean(), 0.0)))

    best = reference.find_best(values)
    rel = root_mean(values - reference.first, values - reference.second)
    missing = root_mean(held[0] - reference.first, held[1] - reference.second)
    return Split(name, len(np.unique(leaf)), rel, missing, root_mean(values - held[0], values - held[1]))


def plant_whole(stage: Stage, degree: int) -> Quadtree:
    """Trees with all their nodes, down to texels."""
    texels = stage.texels
    tree = quadtree.plant_trees(texels, degree, 0, 1, False)
    while len(bare := np.flatnonzero(~tree.has_children & (tree.side > 1))):
        tree = quadtree.add_children(tree, bare, texels)
    return tree


def count_whole(tree: Quadtree, fixed: Bake) -> Totals:
    """What every node of plant_whole would have received of the photons of a bake on the fixed mesh: no node is late."""
    own, deepest = fixed.tally, np.flatnonzero(~tree.has_children)
    deepest = deepest[np.argsort(tree.start[deepest])]
    order = np.argsort(fixed.light.tree.start)
    whole = Tally.empty(len(tree), tree.degree, own.raw.shape[1])
    whole.photons[:] = own.photons
    whole.count[deepest], whole.weight2[:, deepest], whole.raw[..., deepest] = own.count[order], own.weight2[:, order], own.raw[..., order]
    return tally.accumulate(tree, whole)


def walk_levels(tree: Quadtree, n_texel: int) -> Iterator[np.ndarray]:
    """(n_texel,) each: the nodes of one depth after the other, and the deepest where there are none so deep."""
    for depth in range(len(tree.levels)):
        nodes = np.flatnonzero((tree.depth == depth) | (~tree.has_children & (tree.depth < depth)))
        yield quadtree.node_of_texel(tree, nodes, n_texel)


def expect_errors(stage: Stage, tree: Quadtree, even: Quadtree, reference: Reference) -> np.ndarray:
    """(2, n_node): squared relative error expected of each node as a leaf, with its slope and `even`, summed over texels and channels."""
    out = np.zeros((2, len(tree)))
    for node in walk_levels(tree, len(reference.area)):
        moments = texel_moments(stage, tree, node)
        size = moments.shape[1]
        product = [moments[:, i] * moments[:, j] for i, j in np.ndindex(size, size)]
        covariance = [np.array([np.bincount(node, one * both, len(tree)) for one in reference.variance.T]) for both in product]
        for sums, functions in zip(out, (tree, even), strict=True):
            held = [hold_light(reference.area, moments, functions, node, light) for light in (reference.first, reference.second)]
            square = (held[0] - reference.first) * (held[1] - reference.second)
            weight = np.einsum("nk,nkj->nj", moments / reference.area[:, None], functions.project[node])
            for (i, j), one in zip(np.ndindex(size, size), covariance, strict=True):
                square += (weight[:, i] * weight[:, j] * one[:, node]).T
            sums[node] = np.bincount(node, (square / reference.local2).sum(1), len(tree))[node]
    return out


def choose_best(tree: Quadtree, error: np.ndarray) -> np.ndarray:
    """Nodes (m,) that tile the charts with the least sum of errors (n_node,)."""
    least, opened = error.copy(), np.zeros(len(tree), bool)
    for level in reversed(tree.levels):
        nodes = level[tree.has_children[level]]
        children = tree.children[nodes]
        below = np.where(children >= 0, least[children], 0.0).sum(1)
        opened[nodes] = below < error[nodes]
        least[nodes] = np.minimum(below, error[nodes])
    return refine.open_nodes(tree, np.flatnonzero(tree.parent < 0), opened)


def drop_slopes(tree: Quadtree) -> Quadtree:
    """The tree with functions that are constant."""
    project = np.zeros_like(tree.project)
    project[:, 0, 0] = 1.0 / tree.area
    return dataclasses.replace(tree, project=project)


def measure_split(stage: Stage, truth: Reference, judge: Reference, photons: float) -> list[Split]:
    """How the default basis does, and how it would with what it cannot know.

    truth   what the best leaves are chosen by;  judge   independent of it, what all are held against
    """
    baked, flat = stage.bake(photons), stage.bake(photons, **FIXED_MESH)
    n_texel, tree = len(stage.texels.texel_area), baked.light.tree
    rows = [
        split_error("fixed mesh", judge, stage, flat.light.tree, flat.leaf, flat.values()),
        split_error("hierarchy", judge, stage, tree, baked.leaf, baked.values()),
        split_error("slopes not shrunk", judge, stage, tree, baked.leaf, baked.values(baked.leaf)),
    ]
    whole = plant_whole(stage, tree.degree)
    totals = count_whole(whole, stage.bake(photons, hierarchical=False))
    solution = tally.solve_tallies(whole, totals)
    rule = refine.Rule(DEFAULTS.oracle, DEFAULTS.threshold, DEFAULTS.stability, 1)
    chosen = refine.choose_leaves(whole, refine.Comparison.of(whole, totals, solution, rule))
    even = drop_slopes(whole)
    errors = expect_errors(stage, whole, even, truth)
    for name, leaves, flattened in (
        ("... and no node late", chosen, np.zeros(len(whole), bool)),
        ("... and the best leaves", choose_best(whole, errors[0]), np.zeros(len(whole), bool)),
        ("... each with or without its slope", choose_best(whole, errors.min(0)), errors[1] < errors[0]),
    ):
        project = np.where(flattened[:, None, None], even.project, whole.project)
        shown, leaf = dataclasses.replace(whole, project=project), quadtree.node_of_texel(whole, leaves, n_texel)
        light = tally.solve_tallies(shown, totals).coefficient.sum(0)
        values = texel_means(judge.area, texel_moments(stage, shown, leaf), leaf, light)
        rows.append(split_error(name, judge, stage, shown, leaf, values))
    return rows


def table_split(rows: list[Split]) -> Table:
    head = ("", "leaves", "rel", "of flat's", "leaves cannot hold", "noise")
    of = rows[0].rel
    return Table(head, [[r.name, f"{r.leaves:,}", percent(r.rel), f"{r.rel / of:.2f}", percent(r.missing), percent(r.noise)] for r in rows])
