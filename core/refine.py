"""When to split a node: is_stable, indicator and mark, three pure functions, the only home of the subdivision rule.

The indicator compares the function of a current node with the functions of the preview nodes below it, both from the
same photons: those shot from the node to its previews. Where the light follows the node's function, the squared
difference is noise with a known mean and spread; what goes beyond is light that the node cannot hold.

Source: [Tobler97] 3.4 (stability), 3.5 (oracle), 3.7 (hints). The significance oracle is a chi-square test of nested
least-squares fits; photons' powers vary, so their sum of squares stands for the variance (compound Poisson).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import basis
from .quadtree import Quadtree
from .tally import CHANNELS, Solution, Totals

SIGNIFICANT_SIGMAS = 3.0
# What a function more must win over the noise that it adds. 1 would be C_p, which picks up noise where it can choose
# among thousands of nodes.
NOISE_PRICE = 2.0
FANOUT = 4


@dataclass(frozen=True)
class Rule:
    """Knobs of the subdivision rule; see core.settings for their meaning."""

    oracle: str
    threshold: float
    stability: int
    preview_depth: int


@dataclass(frozen=True)
class Difference:
    """What lies between nodes and their previews at one depth, per node of the list asked for.

    excess       (m,) float64, (W/m^2)^2: mean square difference less what noise alone gives, summed over channels; noise
                 can make it negative
    noise        (m,) float64, (W/m^2)^2: what noise alone gives: by so much splitting raises the mean square error
    sigmas       (m,) float64: how far the squared difference lies above its expectation under noise
    greatest     (m,) float64, W/m^2: greatest difference of mean over the stable previews, over channels
    tiled        (m,) bool: the previews of this depth cover the node; elsewhere the rest is 0
    """

    excess: NDArray[np.float64]
    noise: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    greatest: NDArray[np.float64]
    tiled: NDArray[np.bool_]


def is_stable(photons_shot: NDArray[np.integer], stability: int) -> NDArray[np.bool_]:
    """Whether nodes have been shot enough photons to be compared and shown.

    photons_shot   (n,) int
    Source: [Tobler97] 3.4
    """
    return photons_shot >= stability


def indicator(
    tree: Quadtree, totals: Totals, solution: Solution, nodes: NDArray[np.integer], depth: int, stability: int
) -> Difference:
    """Difference between `nodes` and their preview nodes `depth` levels below.

    nodes   (m,) int, nodes that have children
    """
    ids, above, tiled = _descendants(tree, nodes, depth)
    transforms = basis.parent_transforms(tree.degree)
    project = basis.projector(tree.functions[ids[-1]])
    gram = basis.gram_matrix(tree.moment[ids[-1]], tree.degree)
    raw = totals.raw.sum((0, 1))[..., ids[-1]]  # (3, K, previews)
    fit = np.einsum("nij,cjn->cin", project, raw)

    lifted, ancestor = raw, np.arange(len(ids[-1]))
    for level in range(depth, 0, -1):  # the same photons, in the coordinates of the node
        up = np.einsum("nij,cjn->cin", transforms[tree.quadrant[ids[level]]], lifted)
        lifted = np.zeros((*raw.shape[:2], len(ids[level - 1])))
        for row in range(up.shape[1]):
            for channel in range(CHANNELS):
                lifted[channel, row] = np.bincount(above[level], up[channel, row], len(ids[level - 1]))
        ancestor = above[level][ancestor]
    expected = np.einsum("nij,cjn->cin", basis.projector(tree.functions[nodes]), lifted)
    for level in range(1, depth + 1):
        expected = np.einsum("nji,cjn->cin", transforms[tree.quadrant[ids[level]]], expected[..., above[level]])

    gap = fit - expected
    to_irradiance = (solution.scale / max(int(totals.photons.sum()), 1)).mean(0)[nodes]
    m = len(nodes)
    energy = np.bincount(ancestor, np.einsum("cin,nij,cjn->n", gap, gram, gap), m)
    weight2 = np.bincount(ancestor, totals.weight2[:, ids[-1]].sum(0), m)
    area = np.where(tree.area[nodes] > 0.0, tree.area[nodes], 1.0)
    freedom = np.bincount(ancestor, tree.n_functions[ids[-1]], m) - tree.n_functions[nodes]
    per_function = weight2 / area
    noise = freedom * per_function
    spread = np.sqrt(2.0 * np.maximum(freedom, 1)) * per_function
    excess = energy - noise
    usable = tiled & (per_function > 0.0)
    mean_gap = np.abs(np.einsum("cin,ni->cn", gap, tree.moment[ids[-1], : gap.shape[1]])).max(0) / tree.area[ids[-1]]
    greatest = np.zeros(m)
    np.maximum.at(greatest, ancestor, np.where(is_stable(totals.received[ids[-1]], stability), mean_gap, 0.0))
    return Difference(
        excess=np.where(usable, excess / area * to_irradiance**2, 0.0),
        noise=np.where(usable, noise / area * to_irradiance**2, 0.0),
        sigmas=np.where(usable, excess / np.where(usable, spread, 1.0), 0.0),
        greatest=np.where(tiled, greatest * to_irradiance, 0.0),
        tiled=tiled,
    )


def _descendants(
    tree: Quadtree, nodes: NDArray[np.integer], depth: int
) -> tuple[list[NDArray[np.integer]], list[NDArray[np.integer]], NDArray[np.bool_]]:
    """Nodes of each depth below `nodes`, the position of each one's parent in the depth above, and who is covered."""
    ids, above = [nodes], [np.arange(len(nodes))]
    ancestor = np.arange(len(nodes))
    for _ in range(depth):
        children = tree.children[ids[-1]]
        row, column = np.nonzero(children >= 0)
        ids.append(children[row, column])
        above.append(row)
        ancestor = ancestor[row]
    texels = np.bincount(ancestor, tree.end[ids[-1]] - tree.start[ids[-1]], len(nodes))
    return ids, above, texels == tree.end[nodes] - tree.start[nodes]


def mark(
    tree: Quadtree,
    totals: Totals,
    solution: Solution,
    rule: Rule,
    forced: NDArray[np.bool_],
    background: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Current nodes to be split now.

    forced       (n,) bool: split as soon as stable, whatever the light
    background   (3, n) float64, W/m^2: light on the node that does not come through the tallies (direct light by rays)
    """
    nodes = np.flatnonzero(tree.current & tree.has_children)
    nodes = nodes[is_stable(totals.shot[nodes] // FANOUT, rule.stability)]
    area = np.where(tree.area[nodes] > 0.0, tree.area[nodes], 1.0)
    level = np.linalg.norm(solution.flux[:, nodes] / area + background[:, nodes], axis=0)
    marked = forced[nodes].copy()
    for depth in range(1, rule.preview_depth + 1):
        difference = indicator(tree, totals, solution, nodes, depth, rule.stability)
        if rule.oracle == "paper":
            marked |= difference.greatest > rule.threshold * level
        else:
            above_noise = difference.sigmas > SIGNIFICANT_SIGMAS
            marked |= above_noise & (difference.excess > (rule.threshold * level) ** 2)
    return nodes[marked]


def choose_leaves(tree: Quadtree, totals: Totals, solution: Solution, stability: int) -> NDArray[np.int64]:
    """The nodes to show: they tile every chart with the least expected squared error, and all but the first are stable.

    The squared difference between a node and any tiling below it is the sum of the one-level differences in between
    (projections on nested spaces), so the best tiling follows from the bottom up.
    Source: Breiman et al. 1984, 10.2 (pruning by dynamic programming); Mallows 1973 (C_p) for the price of noise.
    """
    gain = np.zeros(len(tree))
    opened = np.zeros(len(tree), bool)
    for level in reversed(tree.levels[:-1]):
        nodes = level[tree.has_children[level] & is_stable(totals.shot[level] // FANOUT, stability)]
        difference = indicator(tree, totals, solution, nodes, 1, stability)
        children = tree.children[nodes]
        below = np.where(children >= 0, gain[children], 0.0).sum(1)
        worth = (difference.excess - NOISE_PRICE * difference.noise) * tree.area[nodes] + below
        gain[nodes] = np.maximum(worth, 0.0)
        opened[nodes] = worth > 0.0
    shown = [level[tree.parent[level] < 0] for level in tree.levels[:1]]
    leaves = []
    while len(shown[-1]):
        front = shown[-1]
        leaves.append(front[~opened[front]])
        children = tree.children[front[opened[front]]]
        shown.append(children[children >= 0])
    return np.concatenate([np.zeros(0, np.int64), *leaves]).astype(np.int64)
