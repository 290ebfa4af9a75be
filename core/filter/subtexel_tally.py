"""Tallies on the square footprints of texels where something touches the surface.

A leaf of one texel estimates the mean over that texel, while images are read at its centre. Where light changes fast within a texel - along
the edge of a rug, at the foot of a wall - the two differ for any number of photons. There the square around the centre, from which shadow
rays start too, has a tally of its own. Its light is mixed with the leaves' by a Wiener weight:

    share = signal / (signal + noise), signal = squared difference beyond noise, from the neighbours   [Wiener 1949]
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..radiosity.coefficient_shrinkage import beyond_noise
from ..radiosity.tally import ShardTally, Tally, deposit, with_direct
from ..texels.error_metric import DARK_FLOOR
from ..texels.texel_map import FOOTPRINT_SIDE, TexelMap
from ..util.ablation import uses
from ..util.arrays import Float64, FloatArray, IntArray
from ..util.coverage import clip_to_texels

_LEAST_SHARE = 0.02  # of a square's area on the triangle at its centre; a smaller part receives too few photons
_RADIUS = 4  # texels; the difference of leaves and squares is averaged over this neighbourhood
_LEAST_LIGHT = 1e-30  # W/m^2
_TINY = float(np.finfo(float).tiny)
_MUCH = 8.0  # mean photons of a square above which squares are more exact than the leaves around them
_DOUBT = 1.0  # standard errors subtracted from the signal; without it, chance would change a third of the good leaves


@dataclass(frozen=True)
class SubtexelLight:
    """Light on squares.

    entry        (m,) int32, ascending: texel entries
    irradiance   (2, 3, m) float64, W/m^2: per component and channel
    variance     (3, m) float64, (W/m^2)^2, of both components together
    grain        (3, m) float64, W/m^2: irradiance of one photon of mean power
    """

    entry: NDArray[np.int32]
    irradiance: Float64
    variance: Float64
    grain: Float64

    def only(self, rows: IntArray) -> SubtexelLight:
        """Only the squares in rows (k,), ascending."""
        return SubtexelLight(self.entry[rows], self.irradiance[..., rows], self.variance[:, rows], self.grain[:, rows])

    def are_reliable(self) -> bool:
        """Whether enough photons fell on the squares to change the shown light."""
        light, grain = self.irradiance.sum(axis=0), self.grain
        return bool(len(self.entry)) and float(light.sum()) > _MUCH * float(grain.sum())


@dataclass(frozen=True)
class Squares:
    """The squares with a tally of their own.

    entry   (m,) int32, ascending: texel entries
    area    (m,) float64, m^2: of the square's part on the triangle at its centre
    """

    entry: NDArray[np.int32]
    area: Float64

    @classmethod
    def of(cls, texels: TexelMap, wanted: NDArray[np.bool_]) -> Squares:
        """The squares of the texel entries `wanted` (n,) bool whose centres are covered."""
        entry = np.flatnonzero(wanted & texels.is_central & uses("subtexel_tallies"))
        density = texels.tri_density[texels.texel_tri[entry]]
        full = FOOTPRINT_SIDE * FOOTPRINT_SIDE * density
        area = full.copy()
        cut = np.flatnonzero(np.isin(entry, texels.part_entry))  # the others lie wholly inside their triangles
        corners, xy = texels.tri_uv[texels.texel_tri[entry[cut]]], texels.texel_xy[entry[cut]]
        pieces = clip_to_texels(corners, xy, np.full(len(cut), FOOTPRINT_SIDE))
        area[cut] = np.bincount(pieces.pair, pieces.area, len(cut)) * density[cut]
        kept = area > _LEAST_SHARE * full
        return cls(entry[kept].astype(np.int32), area[kept])

    def light(self, tally: Tally) -> SubtexelLight:
        """The estimate from the photons so far, whose `tally` is filled by `deposit_on_squares`."""
        divisor = max(float(tally.photons.sum()), 1.0) * self.area
        raw = with_direct(tally.raw.sum(0)[:, :, 0])
        sums = raw.sum(axis=(0, 2))
        power = np.divide(tally.weight2.sum(axis=1), sums, out=np.zeros_like(sums), where=sums > 0.0)
        return SubtexelLight(self.entry, raw / divisor, tally.weight2 / divisor**2, power[:, None] / divisor)


def deposit_on_squares(
    texels: TexelMap,
    square_entry: NDArray[np.int32],
    entry: IntArray,
    tri: IntArray,
    x: FloatArray,
    y: FloatArray,
    flux: FloatArray,
    is_first: NDArray[np.bool_] | None,
) -> ShardTally:
    """As tally.deposit, with squares instead of nodes.

    square_entry   (k,) int32, as in Squares
    entry, tri     (m,) int: the texel entry and the triangle of each hit
    x, y           (m,) float, page texels
    flux           (3, m) float, W
    is_first       (m,) bool or None
    """
    has_square = np.zeros(len(texels), bool)
    has_square[square_entry] = True
    rows = np.flatnonzero(has_square.take(entry)) if len(square_entry) else np.zeros(0, np.intp)
    rows = rows[tri.take(rows) == texels.texel_tri.take(entry.take(rows))]
    column, row = texels.texel_xy.take(entry.take(rows), axis=0).T
    rows = rows[(np.abs(x.take(rows) - column - 0.5) < FOOTPRINT_SIDE / 2) & (np.abs(y.take(rows) - row - 0.5) < FOOTPRINT_SIDE / 2)]
    slot = np.searchsorted(square_entry, entry.take(rows))
    nowhere = np.zeros(len(rows))
    first = None if is_first is None else is_first.take(rows)
    return deposit(slot, nowhere, nowhere, flux.take(rows, axis=1), first, len(square_entry), degree=0)


@dataclass(frozen=True)
class SubtexelMix:
    """Squares (m,) compared with the leaves' light on them.

    gap       (c, 3, m) float64, W/m^2: light of squares minus that of leaves, per component
    noise     (3, m) float64, (W/m^2)^2: variance of the squares
    share     (m,): Wiener weight of the gap
    missing   (m,), (W/m^2)^2: squared bias of the leaves' light, mean over channels; 0 if the squares together differ by noise alone
    """

    gap: Float64
    noise: Float64
    share: Float64
    missing: Float64

    @classmethod
    def of(cls, light: NDArray[Any], squares: SubtexelLight, texels: TexelMap) -> SubtexelMix:
        """Compare squares with the leaves' light there, (c, 3, m) float, W/m^2; c is 1 without a direct component."""
        traced = light.astype(np.float64)
        gap = squares.irradiance[-len(light) :] - traced
        # Without photons the sample variance is 0, so it is at least that of the photons expected by the leaves' light.
        noise = np.maximum(squares.variance, squares.grain * traced.sum(axis=0))
        noise2, seen2 = noise.sum(axis=0), (gap.sum(axis=0) ** 2).sum(axis=0)
        level = traced.sum(axis=(0, 1))
        # Relative weights keep one bright neighbour from dominating.
        scale = 1.0 / (level**2 + (DARK_FLOOR * level.mean() + _LEAST_LIGHT) ** 2)
        excess2 = (seen2 - noise2) * scale
        total = float(excess2.sum())
        sure = beyond_noise(total, float((excess2**2).sum())) / max(total, _TINY)
        (noise2, signal2, signal4), count = _average_around(np.stack([noise2 * scale, excess2, excess2**2]), squares.entry, texels)
        signal2 -= _DOUBT * np.sqrt(np.maximum(signal4 - signal2**2, 0.0) / np.maximum(count - 1.0, 1.0))
        signal2 = np.maximum(signal2, 0.0)
        share: Float64 = np.divide(signal2, signal2 + noise2, out=np.zeros_like(signal2), where=signal2 > 0.0)
        return cls(gap, noise, share, sure * signal2 / scale / 3.0)

    def find_error(self, rows: IntArray) -> Float64:
        """(3, k) float64, (W/m^2)^2: squared error of light mixed with squares `rows` (k,), without the leaves' own variance."""
        share = self.share[rows]
        error: Float64 = np.square(share) * self.noise[:, rows] + np.square(1.0 - share) * self.missing[rows]
        return error


def mix(light: NDArray[np.float32], variance: NDArray[np.float32], squares: SubtexelLight, texels: TexelMap) -> NDArray[np.bool_]:
    """Mix the squares' light into the leaves', in place; returns which texels changed, (n,) bool.

    light      (2, 3, n) float32, W/m^2: components at the texel entries; (1, 3, n) without a direct component
    variance   (3, n) float32, (W/m^2)^2, of their sum
    """
    entry = squares.entry
    changed = np.zeros(light.shape[-1], bool)
    if not len(entry):
        return changed
    mixing = SubtexelMix.of(light[..., entry], squares, texels)
    light[..., entry] += (mixing.share * mixing.gap).astype(np.float32)
    variance[:, entry] = (1.0 - mixing.share) ** 2 * variance[:, entry] + mixing.share**2 * mixing.noise
    changed[entry] = mixing.share > 0.0
    return changed


def _average_around(value: Float64, entry: IntArray, texels: TexelMap) -> tuple[Float64, Float64]:
    """Means of values (k, m) over the entries around each of texel entries (m,), on the same piece of a chart; and their number, (m,).

    An entry's own value is left out, since a weight that depends on its own photons would favour squares with few.
    """
    chart = texels.texel_chart[entry]
    page, piece = texels.chart_page[chart].astype(np.int64), texels.chart_piece[chart]
    column, row = texels.texel_xy[entry].T.astype(np.int64)
    shown = np.flatnonzero(texels.entry_at[page, row, column] == entry)
    width = texels.page_size + 2 * _RADIUS  # a border saves the tests for the page's edge
    place = (page * width + row + _RADIUS) * width + column + _RADIUS
    slot_after = np.zeros(texels.page_count * width * width, np.int32)  # row + 1, 0 for none; untouched memory costs nothing
    slot_after[place[shown]] = shown + 1
    piece_after, value_after = np.append(np.int32(-1), piece), np.pad(value, ((0, 0), (1, 0)))
    total, count = np.zeros_like(value), np.zeros(len(entry))
    for dy, dx in product(range(-_RADIUS, _RADIUS + 1), repeat=2):
        if dx or dy:
            slot = slot_after.take(place + (dy * width + dx)).astype(np.intp)
            near = piece_after.take(slot, mode="clip") == piece
            slot *= near
            for sums, values in zip(total, value_after, strict=True):
                sums += values.take(slot, mode="clip")
            count += near
    return total / np.maximum(count, 1.0), count
