"""One quadtree per UV chart, all of them in one node table.

A chart's root is the smallest power-of-two square of texels that covers it. Texel entries are sorted by chart and Morton code, so a node is
a range of entries. *Current* nodes tile every chart and carry the solution; *preview* nodes lie below them. A photon is deposited in the
deepest node at its texel; sums of the nodes above are computed from those below (see tally). There are no nodes for squares without texels.

Source: [Tobler97] 3.2 and 3.3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..parallel.shared_arrays import IN_MEMORY, Room
from ..texels.texel_map import TexelMap
from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int32, Int64, IntArray
from . import basis

_CHUNK = 1 << 16  # texel entries at a time
_Value = TypeVar("_Value", bound=np.generic)


@dataclass(frozen=True)
class Quadtree:
    """The immutable node table.

    degree      of the basis: 0, 1 or 2
    chart       (n,) int32
    side        (n,) int32, texels
    origin      (n, 2) int32, page texel of the lower left corner
    code        (n,) int64, first Morton code of its square within the chart
    parent      (n,) int32, -1 for the nodes that the tree started with
    quadrant    (n,) int8, index among its parent's children
    children    (n, 4) int32, -1 where there is none
    start, end  (n,) int64, range of texel entries
    depth       (n,) int16, 0 for the nodes that the tree started with
    current     (n,) bool
    moment      (n, M) float64, m^2: integrals of the monomials up to 2 * degree in node coordinates
    project     (n, K, K) float64, 1/m^2: see basis.projector
    rank        (n,) int64: number of basis functions that were not dropped
    """

    degree: int
    chart: Int32
    side: Int32
    origin: Int32
    code: Int64
    parent: Int32
    quadrant: NDArray[np.int8]
    children: Int32
    start: Int64
    end: Int64
    depth: NDArray[np.int16]
    current: BoolArray
    moment: Float64
    project: Float64
    rank: Int64

    def __len__(self) -> int:
        return len(self.chart)

    @property
    def area(self) -> Float64:
        """(n,) float64, m^2 covered by the chart."""
        return self.moment[:, 0]

    @cached_property
    def has_children(self) -> BoolArray:
        """(n,) bool."""
        return (self.children >= 0).any(1)

    @cached_property
    def levels(self) -> list[Int64]:
        """Nodes of each depth, from the top."""
        return [np.flatnonzero(self.depth == d) for d in range(int(self.depth.max(initial=-1)) + 1)]


def plant_trees(texels: TexelMap, degree: int, level: int, finest_texels: int, flat: bool) -> Quadtree:
    """Trees whose current nodes lie `level` below each chart's root, or at the finest level when `flat`.

    finest_texels   side of the smallest node allowed, a power of two
    """
    finest = int(finest_texels).bit_length() - 1
    depth_limit = np.maximum(texels.chart_log2 - finest, 0)
    chart_level = depth_limit if flat else np.minimum(level, depth_limit)
    side_log2 = (texels.chart_log2 - chart_level).astype(np.int64)
    first = _find_nodes(texels, side_log2)
    end = np.append(first[1:], len(texels))[: len(first)]
    chart = texels.texel_chart[first]
    side = (1 << side_log2[chart]).astype(np.int32)
    relative = (texels.texel_xy[first] - texels.chart_origin[chart]) // side[:, None] * side[:, None]
    return _append(
        None,
        degree,
        texels,
        chart=chart,
        side=side,
        origin=(texels.chart_origin[chart] + relative).astype(np.int32),
        code=texels.texel_code[first] >> 2 * side_log2[chart] << 2 * side_log2[chart],
        parent=np.full(len(first), -1, np.int32),
        quadrant=np.zeros(len(first), np.int8),
        start=first,
        end=end,
        depth=np.zeros(len(first), np.int16),
        current=np.ones(len(first), bool),
    )


def _find_nodes(texels: TexelMap, side_log2: Int64) -> Int64:
    """(m,) int64: the first texel entry of every node, of side 2**side_log2 (n_chart,) texels in each chart."""
    # Entries of one node share the high bits of their codes, and entries are sorted, so each run of equal high bits is a node.
    is_first = np.zeros(len(texels), bool)
    is_first[texels.chart_start[:-1][np.diff(texels.chart_start) > 0]] = True
    for start in range(0, len(is_first), _CHUNK):
        part = slice(max(start - 1, 0), start + _CHUNK)
        code = texels.texel_code[part] >> 2 * side_log2[texels.texel_chart[part]]
        is_first[part.start + 1 : part.stop] |= code[1:] != code[:-1]
    return np.flatnonzero(is_first)


def _append(tree: Quadtree | None, degree: int, texels: TexelMap, **new: NDArray[Any]) -> Quadtree:
    """The tree with new nodes, or a tree of these alone; their other columns are computed."""
    half = new["side"] / 2.0
    moment = texels.range_moments(new["start"], new["end"], new["origin"] + half[:, None], half, 2 * degree)
    functions = basis.orthonormal_functions(basis.gram_matrix(moment, degree))
    new |= {"moment": moment, "project": basis.projector(functions), "rank": functions.any(2).sum(1)}
    new["children"] = np.full((len(moment), 4), -1, np.int32)
    if tree is None:
        return Quadtree(degree, **new)
    columns = {name: np.concatenate([getattr(tree, name), values]) for name, values in new.items()}
    columns["children"][new["parent"], new["quadrant"]] = np.arange(len(tree), len(tree) + len(moment))
    return replace(tree, **columns)


def add_children(tree: Quadtree, nodes: IntArray, texels: TexelMap) -> Quadtree:
    """The tree with children below `nodes`, which must have none and be larger than a texel."""
    if len(nodes) == 0:
        return tree
    side = np.repeat(tree.side[nodes] // 2, 4)
    quadrant = np.tile(np.arange(4, dtype=np.int8), len(nodes))
    parent = np.repeat(nodes, 4).astype(np.int32)
    code = tree.code[parent] + quadrant * side.astype(np.int64) ** 2
    codes, begins, first, last = texels.texel_code, code.reshape(-1, 4).T, tree.start[nodes], tree.end[nodes]
    middle = _find_codes(codes, first, last, begins[2])
    one, three = _find_codes(codes, first, middle, begins[1]), _find_codes(codes, middle, last, begins[3])
    cuts = np.stack([first, one, middle, three, last], axis=1)
    start, end = cuts[:, :-1].ravel(), cuts[:, 1:].ravel()
    covered = end > start
    offset = np.stack([quadrant & 1, quadrant >> 1], 1) * side[:, None]
    return _append(
        tree,
        tree.degree,
        texels,
        chart=tree.chart[parent][covered],
        side=side[covered],
        origin=(tree.origin[parent] + offset)[covered].astype(np.int32),
        code=code[covered],
        parent=parent[covered],
        quadrant=quadrant[covered],
        start=start[covered],
        end=end[covered],
        depth=(tree.depth[parent] + 1)[covered].astype(np.int16),
        current=np.zeros(int(covered.sum()), bool),
    )


def _find_codes(code: Int32, low: Int64, high: Int64, wanted: Int64) -> Int64:
    """(m,) int64: by binary search, the lower bound of each `wanted` (m,) in code[low:high], which is ascending; low and high (m,)."""
    low, high = low.copy(), high.copy()
    while (rows := np.flatnonzero(low < high)).size:
        middle = (low[rows] + high[rows]) >> 1
        is_below = code[middle] < wanted[rows]
        low[rows[is_below]] = middle[is_below] + 1
        high[rows[~is_below]] = middle[~is_below]
    return low


def grow_previews(tree: Quadtree, texels: TexelMap, preview_depth: int, finest_texels: int) -> Quadtree:
    """The tree with `preview_depth` levels of preview nodes below every current node, down to sides of finest_texels."""
    below = np.flatnonzero(tree.current)
    for _ in range(preview_depth):
        bare = below[~tree.has_children[below] & (tree.side[below] > finest_texels)]
        tree = add_children(tree, bare, texels)
        children = tree.children[below]
        below = children[children >= 0]
    return tree


def split(tree: Quadtree, marked: IntArray) -> Quadtree:
    """The tree in which the children of the `marked` current nodes are current instead of these."""
    current = tree.current.copy()
    current[marked] = False
    children = tree.children[marked]
    current[children[children >= 0]] = True
    return replace(tree, current=current)


def node_of_texel(tree: Quadtree, nodes: IntArray, n_texel: int, room: Room = IN_MEMORY) -> Int32:
    """The node at each texel entry, (n_texel,) int32.

    nodes   indices of nodes that tile every chart: the current ones, or those without children
    room    where the result is allocated, under the name "node"
    """
    count = int((tree.end - tree.start)[nodes].sum())
    if count != n_texel:
        raise ValueError(f"nodes: expected to tile {n_texel} texels, got {count}")
    return spread_over_texels(tree, nodes, nodes.astype(np.int32), "node", room)


def node_at_entries(tree: Quadtree, nodes: IntArray, entry: IntArray) -> Int64:
    """(m,) int64: node_of_texel at texel entries (m,) only."""
    order = nodes[np.argsort(tree.start[nodes])]
    return order[np.searchsorted(tree.start[order], entry, side="right") - 1]


def spread_over_texels(tree: Quadtree, nodes: IntArray, values: NDArray[_Value], name: str, room: Room = IN_MEMORY) -> NDArray[_Value]:
    """(n_texel,): values (m,) of nodes that tile every chart, repeated for their texel entries.

    name, room   name of the result, and where it is allocated
    """
    order = np.argsort(tree.start[nodes])
    values, count = values[order], (tree.end - tree.start)[nodes[order]]
    n_texel = int(count.sum())
    cuts = np.searchsorted(np.cumsum(count), np.arange(_CHUNK, n_texel, _CHUNK))
    runs = pairwise(np.unique([0, *cuts, len(order)]))  # in chunks, since the result may be a file
    return room.collect(name, n_texel, values.dtype, (np.repeat(values[first:last], count[first:last]) for first, last in runs))


def any_in_nodes(tree: Quadtree, flag: BoolArray) -> BoolArray:
    """(n,) bool: nodes that have a texel entry with the flag (n_texel,) bool."""
    flagged = np.flatnonzero(flag)
    return np.searchsorted(flagged, tree.end) > np.searchsorted(flagged, tree.start)


def mean_in_nodes(tree: Quadtree, per_texel: Float32) -> Float64:
    """(3, n) float64: means over each node's texel entries of values (n_texel, 3)."""
    ends, place = np.unique(np.concatenate([tree.start, tree.end]), return_inverse=True)
    first, last = place[: len(tree)], place[len(tree) :]
    out = np.zeros((3, len(tree)))
    # Intervals between the ends of nodes are summed once for all levels; in parts, since numpy copies what it sums.
    cuts = np.flatnonzero(np.diff(ends[:-1] // _CHUNK, prepend=-1))
    parts = [ends[begin : end + 1] for begin, end in pairwise([*cuts, len(ends) - 1])]
    for channel, values in zip(out, per_texel.T, strict=True):
        sums = [np.add.reduceat(values[part[0] : part[-1]], part[:-1] - part[0], dtype=np.float64) for part in parts]
        total = np.append(0.0, np.cumsum(np.concatenate([np.zeros(0), *sums])))
        channel[:] = (total[last] - total[first]) / (tree.end - tree.start)
    return out


@dataclass(frozen=True)
class TreeView:
    """The part of a tree that a tracing process needs to deposit its hits: the deepest nodes.

    node           (n_texel,) int32: deepest node at each texel entry
    centre         (n_node, 2) float32, page texels
    inverse_half   (n_node,) float32, 1/texel
    """

    node: Int32
    centre: Float32
    inverse_half: Float32

    @classmethod
    def of_tree(cls, tree: Quadtree, n_texel: int, room: Room = IN_MEMORY) -> TreeView:
        half = tree.side / 2.0
        deepest = np.flatnonzero(~tree.has_children)
        centre = (tree.origin + half[:, None]).astype(np.float32)
        return cls(node_of_texel(tree, deepest, n_texel, room), centre, (1.0 / half).astype(np.float32))

    def locate(self, entry: IntArray, x: FloatArray, y: FloatArray) -> tuple[Int32, FloatArray, FloatArray]:
        """The deepest node at each hit, and the hit in its coordinates s, t.

        entry   (m,) int, texel entries, none of them -1;  x, y   (m,) float, page texels
        """
        node = self.node.take(entry, mode="wrap")
        inverse_half = self.inverse_half.take(node, mode="wrap")
        # A texel at the node's edge may extend over half of the next one, see split_texels; beyond that the polynomial is not extrapolated.
        most = 1.0 + 0.5 * inverse_half
        least, places = -most, []
        for axis, at in enumerate((x, y)):
            place = at - self.centre[:, axis].take(node, mode="wrap")
            place *= inverse_half
            np.minimum(place, most, out=place)
            places.append(np.maximum(place, least, out=place))
        s, t = places
        return node, s, t
