"""The nodes and squares in which tracing processes tally photons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..parallel.shared_arrays import IN_MEMORY, Room
from ..util.arrays import Float32, FloatArray, Int32, IntArray
from .quadtree import Quadtree, node_of_texel


@dataclass(frozen=True)
class TreeView:
    """The part of a tree that a tracing process needs to deposit its hits: the deepest nodes, and the squares of subtexel_tally.

    node           (n_texel,) int32: deepest node at each texel entry
    centre         (n_node, 2) float32, page texels
    inverse_half   (n_node,) float32, 1/texel
    square_entry   (k,) int32, ascending: texel entries whose squares have a tally of their own
    """

    node: Int32
    centre: Float32
    inverse_half: Float32
    square_entry: Int32

    @classmethod
    def of_tree(cls, tree: Quadtree, n_texel: int, square_entry: Int32, room: Room = IN_MEMORY) -> TreeView:
        half = tree.side / 2.0
        deepest = np.flatnonzero(~tree.has_children)
        centre = (tree.origin + half[:, None]).astype(np.float32)
        return cls(node_of_texel(tree, deepest, n_texel, room), centre, (1.0 / half).astype(np.float32), square_entry)

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
