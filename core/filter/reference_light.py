"""Total light of texels, direct and indirect: the reference level of relative errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..radiosity.quadtree import Quadtree, node_of_texel
from ..radiosity.spatial_shrinkage import SpatialShrinkage
from ..radiosity.tally import Solution
from ..texels.error_metric import DARK_FLOOR, ErrorMetric, Parts, cut_entries
from ..util.arrays import IntArray
from .filtered_field import FilteredField

_TINY = float(np.finfo(float).tiny)
# Returns variances (k, 3) float32, (W/m^2)^2, of some texel entries (k,).
VarianceAt: TypeAlias = Callable[[NDArray[np.int64]], NDArray[np.float32]]


@dataclass(frozen=True)
class ReferenceLight:
    """Light by photons and by rays.

    leaf         (n,) int32: the node of each texel entry
    node_light   (n_node, 3) float32, W/m^2: mean light by photons
    direct       light by rays
    dark         W/m^2: floor of the reference level of a texel, for the bake as a whole
    parts        groups of texels with one error each
    """

    leaf: NDArray[np.int32]
    node_light: NDArray[np.float32]
    direct: FilteredField
    dark: float
    parts: Parts

    @classmethod
    def of(
        cls,
        tree: Quadtree,
        solution: Solution,
        nodes: IntArray,
        direct: FilteredField,
        metric: ErrorMetric,
        few: SpatialShrinkage | None = None,
    ) -> ReferenceLight:
        """The light on the `nodes` (m,), which tile the charts, plus direct light by rays.

        few   nodes that are shrunk towards their surroundings
        """
        node_light = np.ascontiguousarray((solution.flux / np.maximum(tree.area, _TINY)).astype(np.float32).T)
        if few:
            node, row = few.find(np.arange(len(node_light)))
            node_light[node] = few.mean[:, row].T
        by_photons = (np.maximum(node_light[nodes], 0.0).sum(axis=1, dtype=np.float64) * (tree.end - tree.start)[nodes]).sum()
        mean = (float(by_photons) + direct.total_light) / max(direct.found.size, 1)
        found = cls(node_of_texel(tree, nodes, len(direct)), node_light, direct, 0.0, Parts.whole(len(metric.entry), 0.0))
        light = found.at(metric.entry)
        dark = DARK_FLOOR * mean / metric.find_share(light.any(axis=1))
        parts = Parts.whole(len(light), dark) if metric.entry_group is None else metric.part(light, dark)
        return replace(found, dark=dark, parts=parts)

    def at(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """(k, 3) float32, W/m^2: the light at texel entries (k,)."""
        light: NDArray[np.float32] = np.maximum(self.node_light[self.leaf[rows]] + self.direct.irradiance_at(rows), 0.0)
        return light

    def weigh(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """(k, 3) float32: factor that makes squared errors at texel entries (k,) relative; 0 where no error is measured."""
        scale2 = self.at(rows) ** 2
        scale2 += self.parts.find_dark2(rows)
        weight: NDArray[np.float32] = np.divide(np.float32(1.0), scale2, out=np.zeros_like(scale2), where=scale2 > 0.0)
        return weight

    def relate(self, variance_at: VarianceAt, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """(k,) float32: variances at texel entries (k,), relative to the light there; mean of channels."""
        found: NDArray[np.float32] = (self.weigh(rows) * variance_at(rows)).mean(1)
        return found

    def relate_all(self, variance_at: VarianceAt) -> NDArray[np.float32]:
        """(n,) float32: `relate` at all texel entries."""
        parts = (np.arange(part.start, part.stop) for part in cut_entries(len(self.leaf)))
        return np.concatenate([np.zeros(0, np.float32), *(self.relate(variance_at, part) for part in parts)])
