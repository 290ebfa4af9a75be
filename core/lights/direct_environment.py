"""Direct light from an environment map: product sampling of radiance, cosine and visibility for each block of texels.

The map is divided into patches. For a block of neighbouring texels the probability of a patch is proportional to its power, the cosine to
the block's normals, and the square root of its measured visibility; within the patch a cell of the map is chosen by its power. Where most
of the sky is visible, a control variate reduces the variance: the irradiance of the whole unoccluded map at a normal is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene.shadow_rays import ShadowRays, Sight
from ..util.ablation import uses
from ..util.arrays import Float64, FloatArray, Int64, IntArray
from ..util.brightness import weigh_channels
from ..util.geometry import dot_rows, take_rows
from ..util.sphere_map import find_solid_angles
from .direct_lights import INFINITE, Aim
from .direct_points import LIGHT_PLACE, MIDDLE, STAGES, Receivers, TexelChunk, light_points, random_shift, row_pieces
from .environment import EnvironmentTable, PatchChoice
from .stratified_choice import BLOCK_TEXELS, Demand, Span, sample_adaptively, sum_regions

_REGION_BLOCKS = 16  # blocks whose pooled visibility is a prior
_AROUND_RAYS = 4.0  # weight of that prior, in rays to a sector
_ANYWHERE = 0.3  # share of sampling by power and cosine alone, without visibility; bounds the rays' weight
_BACKSTOP = 0.05  # share of sampling by power alone: some of a block's normals may differ from those of _PROBES
_MOST_SEEN = 1 / 16  # visible share of the sky's light below which neighbours share one error estimate, see sky_openings
_MOSTLY_OPEN = 0.5  # visible share of the sky's light above which the control variate is used
# Stratification of n rays in two dimensions lowers the variance by a further factor n^0.375 that successive differences do not measure, as
# for soft lights in visibility_estimator. With it the stated error beside a wall is twice the real one, without it five times.
_STRATA_GAIN = 0.375
_AIMED_LOOKS = 3  # pilot rays per texel that sees little of the sky; they shape the pdf and are not part of the estimate
_PROBES = 4  # texels of a block whose normals represent it
_LEAST_VARIANCE, _LEAST_FORESEEN = 1 / 8, 1 / 64  # as in sky_openings


class EnvironmentLight:
    """The light of an environment at the texels of a chunk.

    few    (m,) int64: texels that see little of it, which share an error estimate (see sky_openings)
    rays   number of pilot rays
    """

    def __init__(self, table: EnvironmentTable, rays: ShadowRays, chunk: TexelChunk, rng: np.random.Generator) -> None:
        self._table, self.rays = table, 0
        n_block = -(-len(chunk) // BLOCK_TEXELS)
        probe = np.arange(n_block)[:, None] * BLOCK_TEXELS + np.arange(_PROBES) * (BLOCK_TEXELS // _PROBES)
        normal = chunk.receivers_at(np.minimum(probe, len(chunk) - 1).ravel(), MIDDLE).normal
        self._brings = table.rate_by_normals(np.asarray(normal).reshape(n_block, _PROBES, 3))
        n_sector = int(table.sector.max()) + 1
        self._shot, self._lit = np.zeros((2, n_block, n_sector))
        self._explore(rays, chunk, np.arange(len(chunk)), rng)
        seen = self._see_share()
        seldom = (seen < _MOST_SEEN) & (sum_regions(self._lit.sum(axis=1), _REGION_BLOCKS) > 0) & uses("openings")
        self.few = np.flatnonzero(np.repeat(seldom, BLOCK_TEXELS)[: len(chunk)])
        for _ in range(_AIMED_LOOKS if len(self.few) else 0):
            self._explore(rays, chunk, self.few, rng)
        self._chance = self._share_out()
        # With less visible sky, the control variate would turn the light of a texel that sees nothing into noise around 0.
        share = self._see_share()
        self._open = np.where(share > _MOSTLY_OPEN, np.minimum(share, 1), 0.0)

    def irradiance(
        self, rays: ShadowRays, chunk: TexelChunk, demand: Demand, base_rgb: Float64, rng: np.random.Generator
    ) -> tuple[Float64, Float64, int]:
        """As EmitterPool.irradiance."""
        total, variance, n_ray = np.zeros_like(base_rgb), np.zeros_like(base_rgb), 0
        choice, shift = PatchChoice(self._chance), random_shift(rng, len(chunk))

        def gather(rows: IntArray, span: Span) -> tuple[Float64, int]:
            return self._gather(rays, chunk, rows, choice, shift, span)

        share = self._see_share()[np.arange(len(chunk)) // BLOCK_TEXELS]

        def gain(taken: Int64) -> Float64:
            rarer = 2 * taken * np.minimum(share, np.maximum(1 - share, 0))
            return np.maximum(rarer, 1) ** _STRATA_GAIN

        is_few = np.zeros(len(chunk), bool)
        is_few[self.few] = True
        block = np.arange(len(chunk)) // BLOCK_TEXELS
        mean, square = self._foresee()
        dark = base_rgb + np.maximum(demand.dark - weigh_channels(base_rgb), 0.0)[:, None]
        for rows, base, foreseen in (
            (np.flatnonzero(~is_few), base_rgb, None),
            (self.few, dark, (np.where(is_few, mean[block], 0.0), np.where(is_few, square[block], 0.0))),
        ):
            by_two = None if foreseen else gain
            found, error, traced = sample_adaptively(gather, rows, demand, base, STAGES, foreseen=foreseen, gain=by_two)
            total[rows], variance[rows], n_ray = found[rows], error[rows], n_ray + traced
        if len(self.few):
            own = block[self.few]
            for channel, colour in zip(variance.T, self._tint(), strict=True):
                of_block = _LEAST_VARIANCE * np.bincount(own, channel[self.few]) / np.maximum(np.bincount(own), 1)
                of_ray = _LEAST_FORESEEN * colour**2 * square / STAGES[-1][1]
                channel[self.few] = np.maximum(channel[self.few], np.maximum(of_block[own], of_ray[own]))
        return np.maximum(total, 0.0), variance, n_ray

    def _gather(
        self, rays: ShadowRays, chunk: TexelChunk, rows: IntArray, choice: PatchChoice, shift: NDArray[np.uint32], span: Span
    ) -> tuple[Float64, int]:
        """(k, len(rows), 3) float64: estimates by one ray each, in the order of their strata of the choice."""
        (first, last), table = span, self._table
        receivers, block = chunk.receivers(rows, first, last), rows // BLOCK_TEXELS
        every = np.tile(block, last - first)
        weight, seen = self._trace(rays, receivers, *choice.choose(every, light_points(take_rows(shift, rows), first, last)))
        open_ = self._open[every]
        value = seen.times(weight) - weight * open_[:, None]
        unoccluded = table.find_irradiance(receivers.normal[: len(rows)])
        if receivers.normal is not receivers.side:
            unoccluded = table.find_irradiance(receivers.normal).reshape(last - first, -1, 3).mean(axis=0)
        ordered = np.empty((last - first, len(rows), 3))
        ordered[LIGHT_PLACE[span]] = value.reshape(ordered.shape)
        return ordered + self._open[block, None] * unoccluded, seen.rays

    def _trace(self, rays: ShadowRays, receivers: Receivers, patch: Int64, chance: FloatArray, u: FloatArray) -> tuple[Float64, Sight]:
        """Unoccluded contribution of rays to patches (n, 3), W/m^2, and their visibility."""
        direction, cell, density = self._table.choose(patch, u)
        cosine = np.maximum(dot_rows(direction, receivers.normal), 0)
        per_radiance = np.divide(cosine, chance * density, out=np.zeros(len(cell), np.float32), where=density > 0, casting="same_kind")
        aim = Aim(direction, np.full(len(cell), INFINITE), per_radiance, per_radiance, of_sky=True)
        seen = receivers.see(rays, aim)
        radiance = self._table.environment.radiance.reshape(-1, 3)[cell]
        return radiance * per_radiance[:, None].astype(np.float64), seen

    def _explore(self, rays: ShadowRays, chunk: TexelChunk, rows: Int64, rng: np.random.Generator) -> None:
        """Trace a pilot ray from each of texels (m,) to measure visibility. Pilots are not part of the estimate, which stays unbiased."""
        choice = PatchChoice(self._share_out())
        for piece in row_pieces(rows, 1):
            block = piece // BLOCK_TEXELS
            patch, chance, rest = choice.choose(block, rng.random((len(piece), 2), np.float32))
            weight, seen = self._trace(rays, chunk.receivers_at(piece, MIDDLE), patch, chance, rest)
            front = weight.any(axis=1)
            at = block * self._shot.shape[1] + self._table.sector[patch]
            for counts, weights in ((self._shot, front), (self._lit, seen.share)):
                counts += np.bincount(at, weights, counts.size).reshape(counts.shape)
            self.rays += seen.rays

    def _rates(self) -> Float64:
        """(n_block, n_patch): visibility of each patch from the block, shrunk towards that of its region."""
        known = self._shot.sum()
        share = float(self._lit.sum() / known) if known else 1.0
        around = (sum_regions(self._lit, _REGION_BLOCKS) + share) / (sum_regions(self._shot, _REGION_BLOCKS) + 1)
        rate: Float64 = (self._lit + _AROUND_RAYS * around) / (self._shot + _AROUND_RAYS)
        return rate[:, self._table.sector]

    def _share_out(self) -> Float64:
        """(n_block, n_patch): probabilities of the patches."""
        plain = self._brings / np.maximum(self._brings.sum(axis=1, keepdims=True), 1e-300)
        aimed = self._brings * np.sqrt(self._rates())  # minimizes the variance
        aimed /= np.maximum(aimed.sum(axis=1, keepdims=True), 1e-300)
        anywhere = self._table.power / self._table.power.sum()
        dark = plain.sum(axis=1, keepdims=True) == 0  # the block faces away from all light
        return (1 - _ANYWHERE - _BACKSTOP) * aimed + _ANYWHERE * plain + np.where(dark, 1.0, _BACKSTOP) * anywhere

    def _see_share(self) -> Float64:
        """(n_block,): visible share of the map's irradiance."""
        return (self._brings * self._rates()).sum(axis=1) / np.maximum(self._brings.sum(axis=1), 1e-300)

    def _foresee(self) -> tuple[Float64, Float64]:
        """(n_block,) each: predicted mean and variance of a ray's brightness, control variate included."""
        rate, open_ = self._rates(), self._open[:, None]
        mean = (self._brings * rate).sum(axis=1)
        squares = np.divide(self._brings**2, self._chance, out=np.zeros_like(self._chance), where=self._chance > 0)
        square = (squares * (rate * (1 - 2 * open_) + open_**2)).sum(axis=1)
        off = (self._brings * (rate - open_)).sum(axis=1)
        return mean, np.maximum(square - off**2, 0.0)

    def _tint(self) -> Float64:
        """(3,): the map's mean colour over its brightness."""
        height, width, _ = self._table.environment.radiance.shape
        flux = (self._table.environment.radiance * find_solid_angles(height, width)[:, None, None]).sum(axis=(0, 1))
        return flux / max(float(weigh_channels(flux[None])[0]), 1e-300)
