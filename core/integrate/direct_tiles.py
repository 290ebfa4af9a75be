"""First samples of a light by tiles of texels: an interpolated closed form, and one shadow ray per texel where all of these agree.

A tile is a square of covered texels on one triangle. Far from a light its unoccluded irradiance is so smooth over a tile that cubic
interpolation from a few points suffices. One ray from each texel, to strata of the light that the tile's texels divide among them, tests
whether the light is visible from everywhere in the tile or from nowhere. The result counts only where adjacent tiles agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

import numpy as np
from numpy.typing import NDArray

from ..lights.direct_lights import Source
from ..lights.direct_points import MIDDLE, Receivers, TexelChunk, base_points, row_pieces, shift_points
from ..scene.shadow_rays import ShadowRays, Sight
from ..texels.texel_grid import interleave_bits
from ..texels.tiles import NODE_WEIGHTS, TILE_LINES, TILE_NODES, TILE_SIDE, TILE_TEXELS, Tiles
from ..util.arrays import Float32, Float64

_CHECKS = ((2, 1), (5, 2), (1, 5), (6, 6))  # texels x, y where the interpolation is compared with the closed form
_CLOSED_ERROR = 2e-3  # relative tolerance of the interpolation there
_STRATA = 16  # texels in a quarter of a tile; the rays of each quarter are a stratified sample of the whole light

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class TileSamples:
    """What the tiles found about one light at the texels of a chunk.

    closed   (n,) float64   unoccluded irradiance for rgb = 1; nan where no tile interpolates it
    off      (n,) float64   standard error of `closed`
    lit      (n,) bool      the light is visible as a whole
    leader   (n,) int64     row of the texel whose rays also count for this one, where a tile sees nothing of a light with an extent; else
                            the texel's own row
    dark     (n,) bool      the light has no extent and is hidden
    rays     number of rays traced
    """

    closed: Float64
    off: Float64
    lit: Bools
    dark: Bools
    leader: NDArray[np.int64]
    rays: int


def sample_tiles(rays: ShadowRays, chunk: TexelChunk, tiles: Tiles, source: Source, shift: NDArray[np.uint32]) -> TileSamples:
    """Sample a light by the tiles of a chunk.

    A small gap that the few rays missed may let through a little of a light with an extent: in a dark tile one random texel goes on
    sampling for all of them, which is unbiased.

    shift   (m, 2) uint32: random shift of each tile's points on the light
    """
    count = len(chunk)
    closed, lit, dark = np.full(count, np.nan), np.zeros(count, bool), np.zeros(count, bool)
    accepted, values, gap = _closed_at_tiles(chunk, tiles, source)
    texels, off = tiles.texels(), np.zeros(count)
    closed[texels[accepted]], off[texels[accepted]] = values, gap[:, None]
    reached = np.flatnonzero(accepted)[values.any(axis=1)]
    full, none = np.zeros((2, len(tiles)), bool)
    traced = 0
    for piece in row_pieces(reached, TILE_TEXELS):
        rows = texels[piece].ravel()
        to = shift_points(_TILE_POINTS, shift[piece]).transpose(1, 0, 2).reshape(-1, 2)
        full[piece], none[piece], n_ray = _see_tiles(rays, chunk.receivers(rows, 0, 1), source, to)
        traced += n_ray
    asked, whole = np.zeros((2, len(tiles)), bool)
    asked[reached], whole[accepted] = True, values.all(axis=1)
    lit[texels[full & ~tiles.near(asked & ~full)]] = True
    leader = np.arange(count)
    unlit = none & ~tiles.near(asked & ~none)
    if source.is_sharp:
        dark[texels[unlit]] = True
    else:  # chosen by the low bits of the shift, which points on lights do not use
        chosen = tiles.start + (shift[:, 0] % np.uint32(TILE_TEXELS)).astype(np.int64)
        leader[texels[unlit & whole]] = chosen[unlit & whole, None]
    return TileSamples(closed, off, lit, dark, leader, traced)


def _see_tiles(rays: ShadowRays, receivers: Receivers, source: Source, points: Float32) -> tuple[Bools, Bools, int]:
    """Trace the first rays of m tiles, from receivers (m * 64). Returns (m,) bool, whether the light is visible as a whole from all of a
    tile; (m,) bool, whether it is hidden from all of it; and the number of rays traced.
    """
    aim = source.aim(receivers.position, receivers.normal, points)
    seen = receivers.see(rays, aim) if source.casts_shadow else Sight(np.ones(len(points), bool), None, 0)
    # Texels at a cone's edge, in the beam of an area light's spread, whose horizon cuts the light, and that face away from it are sampled
    # one by one.
    full = (seen.share == 1) & (aim.share > 0) & (aim.weight == aim.share)
    none = (seen.share == 0) | (aim.weight <= 0)
    return full.reshape(-1, TILE_TEXELS).all(axis=1), none.reshape(-1, TILE_TEXELS).all(axis=1), seen.rays


def _closed_at_tiles(chunk: TexelChunk, tiles: Tiles, source: Source) -> tuple[Bools, Float64, Float64]:
    """Interpolate the closed form over tiles. Returns (m,) bool, whether it is smooth over a tile; for the k tiles where it is, (k, 64)
    float64, its values at the texels; and (k,) float64, their standard error.
    """
    if not len(tiles):
        return np.zeros(0, bool), np.zeros((0, TILE_TEXELS)), np.zeros(0)
    rows = (tiles.start + np.concatenate([TILE_NODES, _CHECK_TEXELS])[:, None]).ravel()
    receivers = chunk.receivers_at(rows, MIDDLE)
    found = source.irradiance(receivers.position, receivers.normal).reshape(-1, len(tiles))
    nodes, checks = found[: len(TILE_NODES)], found[len(TILE_NODES) :]
    gap = NODE_WEIGHTS[_CHECK_TEXELS] @ nodes - checks
    accepted = (np.abs(gap) <= _CLOSED_ERROR * checks).all(axis=0)
    values: Float64 = np.maximum(NODE_WEIGHTS @ nodes[:, accepted], 0.0).T
    return accepted, values, np.sqrt(_OFF_ELSEWHERE * (gap[:, accepted] ** 2).mean(axis=0))


def _find_off_elsewhere() -> float:
    """Ratio of the mean squared interpolation error over a tile to that at the checks, from a cubic's remainder along each axis."""
    off2 = np.prod([np.arange(TILE_SIDE) - node for node in TILE_LINES], axis=0).astype(float) ** 2
    return float(2.0 * off2.mean() / off2[np.array(_CHECKS)].sum(axis=1).mean())


def _tile_points() -> NDArray[np.uint32]:
    """(64, 2) uint32: the point on the light of each texel of a tile, one per stratum, in random order within each quarter of the tile."""
    points, random = base_points(TILE_TEXELS), Random(1)
    order = [i for first in range(0, TILE_TEXELS, _STRATA) for i in sorted(range(first, first + _STRATA), key=lambda _: random.random())]
    out = points[order]
    out.flags.writeable = False
    return out


_TILE_POINTS = _tile_points()
_OFF_ELSEWHERE = _find_off_elsewhere()
_CHECK_TEXELS = interleave_bits(*np.array(_CHECKS).T)
_CHECK_TEXELS.flags.writeable = False
