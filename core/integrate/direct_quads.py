"""Direct light sampled once per quad of texels where that is as accurate; elsewhere texel by texel."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..texels.quads import QUAD_TEXELS, Quads, find_misfit, spread_over_texels
from ..texels.texel_footprint import TexelFootprints
from ..texels.texel_map import TexelMap
from ..texels.tiles import TILE_TEXELS, Tiles
from ..util.ablation import uses
from ..util.arrays import IntArray
from ..util.brightness import weigh_channels
from ..util.coverage import as_slice
from .direct import DirectLight

# Side of the smallest page, in texels, on which quads are used. Measured: direct light takes half the time there. At 1024^2 rejected quads
# cost as much as accepted ones save, and light changes so much from one quad to the next that errors grow.
_LEAST_PAGE = 2048
_SIDE = 2.0  # texels: rays start on the whole quad, or a row of quads could miss an object thinner than a texel


FootprintsAt: TypeAlias = Callable[[IntArray], TexelFootprints]


class FindLight(Protocol):
    """direct.direct_irradiance with the arguments shared by a shard's texels and its quads."""

    def __call__(
        self, footprints_at: FootprintsAt, texel: IntArray, *, tiles: Tiles, crossed: NDArray[np.bool_] | None, beside: NDArray[np.float32]
    ) -> DirectLight: ...


def find_quads(texels: TexelMap, entry: IntArray, tiles: Tiles, crossed: NDArray[np.bool_]) -> Quads:
    """Find the quads to try among texel entries (n,), ascending; tiles and crossed (n,) bool as in direct.direct_irradiance."""
    if texels.page_size < _LEAST_PAGE or not uses("quads"):
        return Quads.none()
    rows = as_slice(entry)
    alone = crossed | texels.is_part[rows]
    alone |= texels.borders.are_crossed(entry)  # a quad's footprint covers its texels whole, beyond the foot of what divides them
    return Quads.of(tiles, texels.texel_tri[rows], alone)


def light_by_quads(
    find_light: FindLight,
    texels: TexelMap,
    entry: IntArray,
    tolerance: float,
    tiles: Tiles,
    crossed: NDArray[np.bool_],
    beside: NDArray[np.float32],
    quads: Quads,
) -> DirectLight:
    """Direct light at texel entries (n,), in float32: by quads where they are accurate. Other arguments as in direct.direct_irradiance."""
    irradiance, variance = np.empty((2, len(entry), 3), np.float32)
    out = DirectLight(irradiance, variance, {}, *np.zeros((2, len(entry)), bool))
    left = np.ones(len(entry), bool)
    if len(quads):
        first = quads.first
        footprints = partial(texels.footprints_at, side=_SIDE, middle=0.5 * _SIDE)
        found = find_light(footprints, entry[first], tiles=quads.tiles(), crossed=None, beside=beside[first])
        value, noise = found.irradiance_rgb.astype(np.float64), found.variance_rgb.astype(np.float64)
        misfit = np.stack([find_misfit(*of) for of in zip(value.T, noise.T, strict=True)], axis=1)
        level = (weigh_channels(value) + beside[first]).reshape(len(quads), -1).mean(axis=1)
        # Light through openings is mostly noise, which hides a misfit; and four times as many samples leave less noise after the filter.
        enough = (weigh_channels(misfit) <= (tolerance * level) ** 2) & ~found.by_openings.reshape(-1, TILE_TEXELS).any(axis=1)
        accepted, rows = np.repeat(enough, TILE_TEXELS), quads.texels(enough)
        irradiance[rows] = np.maximum(spread_over_texels(value[accepted]), 0.0)
        variance[rows] = np.repeat(noise[accepted] + np.repeat(misfit[enough], TILE_TEXELS, axis=0), QUAD_TEXELS, axis=0)
        out.by_quads[rows], left[rows] = True, False
        out.count(found.counters, by_quads=len(rows))
    rows = np.flatnonzero(left)
    found = find_light(texels.footprints_at, entry[rows], tiles=tiles.within(rows), crossed=crossed[rows], beside=beside[rows])
    into = as_slice(rows)
    irradiance[into], variance[into], out.by_openings[into] = found.irradiance_rgb, found.variance_rgb, found.by_openings
    out.count(found.counters)
    return out
