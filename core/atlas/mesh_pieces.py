"""Cuts dense meshes into pieces, which bounds the size of charts.

For each triangle that xatlas adds to a chart, it evaluates the whole chart again, so its time grows with the square of the number of
triangles: a smooth ground of 20,000 takes ten times as long as one of 5,000, and one of a million would take half a day. Coplanar triangles
cost nothing and stay together. In dense pieces, xatlas also grows small charts first and then joins them (xatlas_process).
"""

from __future__ import annotations

import numpy as np

from ..scene.topology import join_sets
from ..util.arrays import Float64, Int64, IntArray

_MOST_FACETS = 1 << 11  # with half as many more, xatlas takes half as long again on rough grounds, and hardly more texels fit on a page
_DENSE_FACETS = 1 << 10  # pieces with fewer grow large charts in little time


def is_dense(tri_facet: IntArray) -> bool:
    """Whether a piece has so many facets, given for each of its triangles (n,), that xatlas should grow small charts first."""
    return len(tri_facet) > _DENSE_FACETS and len(np.unique(tri_facet)) > _DENSE_FACETS


def split_part(tri_facet: IntArray, tri_polygon: IntArray, tri_centre: Float64) -> list[Int64]:
    """Rows of the triangles of each piece: the part is halved along its longest axis until no piece has more than _MOST_FACETS facets.

    tri_facet     (n,) int, equal for connected coplanar triangles, which stay together
    tri_polygon   (n,) int, equal for triangles of a polygon, which stay together too
    tri_centre    (n, 3) float64
    """
    if len(tri_facet) <= _MOST_FACETS:
        return [np.arange(len(tri_facet))]
    facet, polygon = (np.unique(label, return_inverse=True)[1].ravel() for label in (tri_facet, tri_polygon))
    n_facet = int(facet.max()) + 1
    whole = join_sets(n_facet + len(polygon), facet, n_facet + polygon)[:n_facet]  # facets that share a polygon
    whole = np.unique(whole, return_inverse=True)[1].ravel()
    owner = whole[facet]
    count = np.bincount(owner)
    centre = np.stack([np.bincount(owner, tri_centre[:, axis]) / count for axis in range(3)], axis=1)
    piece = np.zeros(len(count), np.int64)
    for number, rows in enumerate(_halve(centre, np.bincount(whole))):
        piece[rows] = number
    order = np.argsort(piece[owner], kind="stable")
    return np.split(order, np.flatnonzero(np.diff(piece[owner[order]])) + 1)


def _halve(place: Float64, facets: Int64) -> list[Int64]:
    """Sets of rows near each other, with at most _MOST_FACETS facets each, of items at positions (n, 3) with facets (n,)."""
    rest, done = [np.arange(len(place))], []
    while rest:
        rows = rest.pop()
        if len(rows) == 1 or facets[rows].sum() <= _MOST_FACETS:
            done.append(rows)
            continue
        axis = int(np.ptp(place[rows], axis=0).argmax())
        order = rows[np.argsort(place[rows, axis], kind="stable")]
        rest += [order[len(rows) // 2 :], order[: len(rows) // 2]]
    return done
