"""Leaves that few photons fell on, held against the light around them.

A chart of less than a texel, as the facets of a leaf or a screw have, waits for a photon that hardly ever comes; and the one that does
would light it hundreds of times too much, so that it shines out of the dark. Where few photons were to be expected, what fell says less
than what fell around: in cells of space from the whole scene down to about the thing itself, each held against the next larger one.

Source: Marshall 1991, "Mapping disease and mortality rates using empirical Bayes estimators", local estimates; a Poisson count whose mean
has a gamma prior of one photon, with the prior's mean from the next larger cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .coverage import Float64
from .geometry import UnitBox, triangle_normals_areas
from .light_field import LightField
from .scene import IntArray, SceneSnapshot
from .texel_map import TexelMap

_FEW = 16  # photons; more of them say more than any surroundings
# Photons that what is around counts for: for a leaf, and for a cell, whose own ones the leaf's are among and must not count each time.
_OF_LEAF, _OF_CELL = 1.0, 4.0
# Of what is darker than around: it may be turned away from what lights that, and to shine out of the dark is worse. Measured on a room of
# furniture and on people with faces inside: with all of it up to half more squared relative error, with none 1.7 times as many dark specks.
_LIFTED = 0.5
_LEVELS = (0, 3, 5, 7)  # halvings of the scene's box; in all of them what faces different ways is told apart
_FACINGS = 6
_TINY = float(np.finfo(float).tiny)


def lean_on_surroundings(
    light: NDArray[np.float32], leaf: NDArray[np.int32], field: LightField, texels: TexelMap, scene: SceneSnapshot
) -> None:
    """Brings the light of leaves that few photons fell on towards that of what is around, in place.

    light   (n, 3) float32, W/m^2, of the texel entries: of photons that came by way of a surface
    leaf    (n,) int32: which each is on
    """
    leaves = field.leaves
    few = field.received[leaves] < _FEW
    if not few.any() or not field.photons:
        return
    area, flux = field.tree.area[leaves], np.maximum(field.solution.flux[:, leaves], 0.0)
    power2 = (field.solution.variance[:, leaves] * field.correction[:, None]).sum(axis=0) * area**2
    around = _Around.of_all(flux, area, power2)
    for key in _find_cells(scene, texels.texel_tri[field.tree.start[leaves]]):
        around = around.within(key, flux, area, power2)
    own, around = flux[:, few] / np.maximum(area[few], _TINY), around.take(few)
    keeps, adds = np.ones((3, len(field.tree))), np.zeros((3, len(field.tree)))
    share = around.find_share(area[few], _OF_LEAF) * np.where(own < around.mean, _LIFTED, 1.0)
    nodes, shown = leaves[few], own + share * (around.mean - own)
    keeps[:, nodes] = np.divide(shown, own, out=np.zeros_like(own), where=own > 0.0)
    adds[:, nodes] = np.where(own > 0.0, 0.0, shown)
    is_few = np.zeros(len(field.tree), bool)
    is_few[nodes] = True
    rows = np.flatnonzero(is_few[leaf])
    for channel in range(3):
        light[rows, channel] = light[rows, channel] * keeps[channel, leaf[rows]] + adds[channel, leaf[rows]]


@dataclass(frozen=True)
class _Around:
    """What is known around each of m leaves.

    mean     (3, m) float64, W/m^2
    photon   (m,) float64, W: the power of one photon there, of a channel
    """

    mean: Float64
    photon: Float64

    @classmethod
    def of_all(cls, flux: Float64, area: Float64, power2: Float64) -> _Around:
        """The same for each: flux (3, m) W, area (m,) m^2, and the sum of its photons' squared powers (m,) W^2, of leaves."""
        count, total = len(area), flux.sum(axis=1)
        mean, photon = total / max(float(area.sum()), _TINY), float(power2.sum()) / max(float(total.sum()), _TINY)
        return cls(np.repeat(mean[:, None], count, axis=1), np.full(count, photon))

    def within(self, key: IntArray, flux: Float64, area: Float64, power2: Float64) -> _Around:
        """In cells, of those leaves that have the same key (m,), held against this, of which all leaves of a cell have the same."""
        _, first, cell = np.unique(key, return_index=True, return_inverse=True)
        total, surface = np.stack([np.bincount(cell, row) for row in flux]), np.bincount(cell, area).astype(np.float64)
        larger, own = self.take(first), total / np.maximum(surface, _TINY)
        mean = own + larger.find_share(surface, _OF_CELL) * (larger.mean - own)
        one = len(total) * larger.photon  # as if one more had come, lest a single one tells what all of them carry
        photon = (np.bincount(cell, power2) + one * larger.photon) / np.maximum(total.sum(axis=0) + one, _TINY)
        return _Around(mean[:, cell], photon[cell])

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> _Around:
        return _Around(self.mean[:, rows], self.photon[rows])

    def find_share(self, area: Float64, prior: float) -> Float64:
        """(m,): how far surfaces of area (m,), m^2, lean on the mean: the more, the fewer photons were to be expected; at a prior, half."""
        expected = self.mean.mean(axis=0) * area / np.maximum(self.photon, _TINY)
        share: Float64 = prior / (expected + prior)
        return share


def _find_cells(scene: SceneSnapshot, tri: IntArray) -> list[IntArray]:
    """Of each of _LEVELS a key (m,) int to the cell that each of the triangles (m,) lies in."""
    corner = scene.vertex_position[scene.tri_vertex[tri]].astype(np.float64)
    bits = max(_LEVELS)
    middle = UnitBox.from_points(scene.vertex_position).to_unit(corner.mean(axis=1)) + 0.5
    x, y, z = np.clip(middle * (1 << bits), 0, (1 << bits) - 1).astype(np.int64).T
    normal = triangle_normals_areas(corner)[0]
    axis = np.abs(normal).argmax(axis=1)
    facing = 2 * axis + (normal[np.arange(len(tri)), axis] < 0)
    out = []
    for level in _LEVELS:
        drop = bits - level
        place = ((x >> drop) << level | y >> drop) << level | z >> drop
        out.append(_FACINGS * place + facing)
    return out
