"""The subdivision rule, as three pure functions: is_stable, indicator and mark.

The indicator compares the function of a current node with the functions of the preview nodes below it, both from the same photons: those
shot from the node to its previews. If the light follows the node's function, the squared difference is noise with known mean and variance;
the excess estimates the squared bias of the node's function.

Source: [Tobler97] 3.4 (stability), 3.5 (oracle), 3.7 (hints). The significance oracle is a chi-square test of nested
least-squares fits; photons' powers vary, so their sum of squares estimates the variance (compound Poisson).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from ..util.arrays import BoolArray, Float64, Int64, IntArray
from . import basis
from .quadtree import Quadtree
from .tally import Solution, Totals, parts_of

SIGNIFICANT_SIGMAS = 3.0
# An additional basis function must reduce the squared bias by this factor times the variance that it adds. 1 is Mallows' C_p, which
# overfits where it selects among thousands of nodes; a little more suffices, because the noise of small leaves is filtered later.
NOISE_PRICE = 1.2
# Children that have received a smaller share than this of their node's photons must reduce the bias by more, in inverse proportion, since
# they replace many photons by few. Among thousands of nodes some always differ by chance after a small last round.
FAIR_SHARE = 0.5
FANOUT = 4
_PART = 1 << 13  # previews compared at once: the intermediate arrays fit a core's cache


@dataclass(frozen=True)
class Rule:
    """Settings of the subdivision rule; see util.settings for their meaning."""

    oracle: str
    threshold: float
    stability: int
    preview_depth: int


@dataclass(frozen=True)
class Difference:
    """Difference between nodes (m,) and their previews at one depth.

    excess       (m,) float64, (W/m^2)^2: mean square difference minus `noise`, summed over channels; may be negative
    common       (m, 3) float64, (W/m^2)^2: another estimate, per channel: inner product of the differences in both halves of the bake. It
                 does not depend on the noise model, but has a higher variance
    noise        (m,) float64, (W/m^2)^2: expected mean square difference under noise alone, the variance that splitting adds
    sigmas       (m,) float64: excess in standard deviations of the squared difference under noise
    greatest     (m,) float64, W/m^2: greatest difference of mean irradiance over the stable previews and the channels
    tiled        (m,) bool: whether the previews of this depth cover the node; if not, the other fields are 0
    """

    excess: Float64
    common: Float64
    noise: Float64
    sigmas: Float64
    greatest: Float64
    tiled: BoolArray


def is_stable(photons_shot: IntArray, stability: int) -> BoolArray:
    """Whether nodes have enough photons to be compared and shown.

    photons_shot   (n,) int
    Source: [Tobler97] 3.4
    """
    return photons_shot >= stability


def indicator(tree: Quadtree, totals: Totals, solution: Solution, nodes: IntArray, depth: int, stability: int) -> Difference:
    """Difference between `nodes` and their preview nodes `depth` levels below.

    nodes   (m,) int, nodes that have children
    """
    ids, above, tiled = _descendants(tree, nodes, depth)
    previews, m = ids[-1], len(nodes)
    transforms = basis.parent_transforms(tree.degree)
    raw = totals.raw.take(previews, axis=-1).sum(1)  # (2 halves, 3, K, previews)
    fit = basis.apply_matrices(tree.project[previews], raw)
    lifted, ancestor = totals.shot_raw.take(ids[depth - 1], axis=-1).sum(1), above[depth]
    for level in range(depth - 1, 0, -1):  # the previews' photons, transformed to the coordinates of the node
        up = basis.apply_transforms(transforms, tree.quadrant[ids[level]], lifted)
        lifted = _sum_by(above[level], up, len(ids[level - 1]))
        ancestor = above[level][ancestor]
    expected = basis.apply_matrices(tree.project[nodes], lifted)
    for level in range(1, depth + 1):
        expected = basis.apply_transforms(transforms.transpose(0, 2, 1), tree.quadrant[ids[level]], expected.take(above[level], axis=-1))

    gap = fit - expected
    dual = basis.apply_matrices(basis.gram_matrix(tree.moment[previews], tree.degree), gap)
    common = _sum_by(ancestor, 4.0 * (gap[0] * dual[1]).sum(1), m)
    gap = gap.sum(0)
    energy = _sum_by(ancestor, (gap * dual.sum(0)).sum((0, 1)), m)
    weight2 = _sum_by(ancestor, totals.weight2[:, previews].sum(0), m)
    area = np.where(tree.area[nodes] > 0.0, tree.area[nodes], 1.0)
    freedom = _sum_by(ancestor, tree.rank[previews].astype(float), m) - tree.rank[nodes]
    per_function = weight2 / area
    noise = freedom * per_function
    spread = np.sqrt(2.0 * np.maximum(freedom, 1.0)) * per_function
    excess = energy - noise
    usable = tiled & (per_function > 0.0)
    mean_gap = np.abs((gap * tree.moment[previews, : gap.shape[1]].T).sum(1)).max(0) / tree.area[previews]
    greatest = np.zeros(m)
    np.maximum.at(greatest, ancestor, np.where(is_stable(totals.received[previews], stability), mean_gap, 0.0))
    # Photons since the previews exist are scaled up to all that the node has received.
    received, shot = totals.raw[:, :, :, 0].take(nodes, axis=-1).sum((0, 1, 2)), lifted[:, :, 0].sum((0, 1))
    stands_for = np.divide(received, shot, out=np.ones(m), where=shot > 0.0)
    to_irradiance = stands_for * (solution.scale[:, nodes] / max(float(totals.photons.sum()), 1.0)).mean(0)
    return Difference(
        excess=np.where(usable, excess / area * to_irradiance**2, 0.0),
        common=np.where(usable, common / area * to_irradiance**2, 0.0).T,
        noise=np.where(usable, noise / area * to_irradiance**2, 0.0),
        sigmas=np.where(usable, excess / np.where(usable, spread, 1.0), 0.0),
        greatest=np.where(tiled, greatest * to_irradiance, 0.0),
        tiled=tiled,
    )


def _sum_by(group: IntArray, values: Float64, count: int) -> Float64:
    """Sums of values (..., n) over the members of each of `count` groups."""
    flat = values.reshape(math.prod(values.shape[:-1]), values.shape[-1])
    return np.array([np.bincount(group, row, count) for row in flat]).reshape(*values.shape[:-1], count)


def _descendants(tree: Quadtree, nodes: IntArray, depth: int) -> tuple[list[IntArray], list[IntArray], BoolArray]:
    """Nodes at each depth below `nodes`; the index of each one's parent among those one depth above; and whether the deepest cover each of
    `nodes`.
    """
    ids: list[IntArray] = [nodes]
    above: list[IntArray] = [np.arange(len(nodes))]
    ancestor = above[0]
    for _ in range(depth):
        children = tree.children[ids[-1]]
        row, column = np.nonzero(children >= 0)
        ids.append(children[row, column])
        above.append(row)
        ancestor = ancestor[row]
    texels = np.bincount(ancestor, tree.end[ids[-1]] - tree.start[ids[-1]], len(nodes))
    tiled: BoolArray = texels == tree.end[nodes] - tree.start[nodes]
    return ids, above, tiled


def find_comparable(tree: Quadtree, totals: Totals, stability: int) -> BoolArray:
    """(n,) bool: nodes that have shot enough photons to be compared with the previews below them."""
    return tree.has_children & is_stable(totals.shot // FANOUT, stability)


@dataclass(frozen=True)
class Comparison:
    """The indicator of one round's nodes, for each preview depth from 1.

    rows          for each depth (n,) int64: index of a node in its differences; -1 if it was not compared
    differences   differences of nodes that have shot enough photons: at depth 1 of all of them, since leaves are chosen among them; deeper
                  only of nodes that may be split, which are the current ones and those that become current if these are split
    stable        (n,) bool: nodes that have shot enough photons to be split
    price         (n,) float64: a node's children are shown if its excess exceeds price * noise
    """

    rows: tuple[Int64, ...]
    differences: tuple[Difference, ...]
    stable: BoolArray
    price: Float64

    @classmethod
    def of(cls, tree: Quadtree, totals: Totals, solution: Solution, rule: Rule) -> Comparison:
        stable = find_comparable(tree, totals, rule.stability)
        asked, may_split = [], tree.current.copy()
        for depth in range(rule.preview_depth, 0, -1):
            asked.append(np.flatnonzero(stable & may_split if depth > 1 else stable))
            children = tree.children[may_split]
            may_split[children[children >= 0]] = True
        pairs = [_compare(tree, totals, solution, nodes, depth, rule.stability) for depth, nodes in enumerate(reversed(asked), start=1)]
        rows, differences = zip(*pairs, strict=True)
        unfair = FAIR_SHARE * totals.received / np.maximum(totals.shot, 1)
        return cls(rows, differences, stable, NOISE_PRICE * np.maximum(unfair, 1.0))


def _compare(tree: Quadtree, totals: Totals, solution: Solution, nodes: IntArray, depth: int, stability: int) -> tuple[Int64, Difference]:
    """Rows and differences of a Comparison at one depth."""
    groups = list(parts_of(nodes, _PART >> 2 * depth)) or [nodes]
    rows = np.full(len(tree), -1)
    rows[nodes] = np.arange(len(nodes))
    return rows, _concatenate([indicator(tree, totals, solution, group, depth, stability) for group in groups])


def _concatenate(parts: list[Difference]) -> Difference:
    names = [field.name for field in fields(Difference)]
    return Difference(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def mark(
    tree: Quadtree, totals: Totals, solution: Solution, comparison: Comparison, rule: Rule, forced: BoolArray, background: Float64
) -> Int64:
    """Current nodes to split now.

    forced       (n,) bool: nodes that are split as soon as they are stable, whatever the light
    background   (3, n) float64, W/m^2: light on the nodes that is not in the tallies (direct light by rays)
    """
    nodes: Int64 = np.flatnonzero(tree.current & find_comparable(tree, totals, rule.stability))
    area = np.where(tree.area[nodes] > 0.0, tree.area[nodes], 1.0)
    level = (solution.flux[:, nodes] / area + background[:, nodes]).max(axis=0)
    marked = forced[nodes].copy()
    for all_rows, difference in zip(comparison.rows, comparison.differences, strict=True):
        asked = np.flatnonzero(all_rows[nodes] >= 0)  # the others were not compared at this depth
        rows = all_rows[nodes[asked]]
        if rule.oracle == "paper":
            marked[asked] |= difference.greatest[rows] > rule.threshold * level[asked]
        else:  # significant, however small; choose_leaves decides which children are shown
            marked[asked] |= difference.sigmas[rows] > SIGNIFICANT_SIGMAS
    return nodes[marked]


def choose_leaves(tree: Quadtree, comparison: Comparison) -> Int64:
    """The nodes to show: the tiling of every chart with the least expected squared error; all of them but roots are stable.

    The squared difference between a node and any tiling below it is the sum of the one-level differences in between (projections on nested
    spaces), so the best tiling is found from the bottom up.
    Source: Breiman et al. 1984, 10.2 (pruning by dynamic programming); Mallows 1973 (C_p) for the price of noise.
    """
    gain = np.zeros(len(tree))
    opened = np.zeros(len(tree), bool)
    difference = comparison.differences[0]
    for level in reversed(tree.levels[:-1]):
        nodes = level[comparison.stable[level]]
        rows, children = comparison.rows[0][nodes], tree.children[nodes]
        below = np.where(children >= 0, gain[children], 0.0).sum(1)
        worth = (difference.excess[rows] - comparison.price[nodes] * difference.noise[rows]) * tree.area[nodes] + below
        gain[nodes] = np.maximum(worth, 0.0)
        opened[nodes] = worth > 0.0
    roots = np.flatnonzero(tree.parent < 0)
    return open_nodes(tree, roots, opened)


def open_nodes(tree: Quadtree, nodes: IntArray, opened: BoolArray) -> Int64:
    """Nodes (k,) that tile the same texels as `nodes` (m,), after nodes with `opened` (n,) are replaced by their children, recursively."""
    front, tiles = nodes, [np.zeros(0, np.int64)]
    while len(front):
        tiles.append(front[~opened[front]])
        children = tree.children[front[opened[front]]]
        front = children[children >= 0]
    return np.concatenate(tiles).astype(np.int64)
