"""Direct light from an environment map: product sampling of radiance, cosine and visibility for each block of texels.

The map is divided into patches. For a block of neighbouring texels the probability of a patch is proportional to its power, the cosine to
the block's normals, and the square root of its measured visibility; within the patch a cell of the map is chosen by its power. Where most
of the sky is visible, a control variate reduces the variance: the irradiance of the whole unoccluded map at a normal is known. Where it
is seen only through openings, such as windows, neighbours share the estimate of the error too, since most rays of a texel miss.

Rays that are part of the estimate improve the probabilities of later ones, which stay independent of the rays they are used for.
"""

from dataclasses import replace

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

_REGIONS_BLOCKS = (16, 4, 1)  # blocks that share visibility: a large region, a small one, a single block; each is the next one's prior
_AROUND_RAYS = 4.0  # weight of the larger region's rate as a prior, in rays to a patch
_ANYWHERE = 0.3  # share of sampling by power and cosine alone, without visibility; bounds the rays' weight
_BACKSTOP = 0.05  # share of sampling by power alone: some of a block's normals may differ from those of _PROBES
_MOST_SEEN = 1 / 16  # visible share of the sky's light above which a texel sees it well
_MOSTLY_OPEN = 0.5  # visible share of the sky's light above which the control variate is used
# Stratification of n rays in two dimensions lowers the variance by a further factor n^0.375 that successive differences do not measure, as
# for soft lights in visibility_estimator. With it the stated error beside a wall is twice the real one, without it five times.
_STRATA_GAIN = 0.375
_PILOT_STEP = 4  # one of so many texels has a first pilot ray
_AIMED_PILOTS = 3  # further pilot rays per texel that sees little of the sky; they shape the pdf and are not part of the estimate
_PROBES = 4  # texels of a block whose normals represent it
# Lower bounds of the variance of a texel that sees little of the sky, as shares of its block's mean and of the predicted variance: a texel
# whose rays all missed has a sample variance of 0 and would get no more rays. Measured: 1 of the block's takes twice the rays; 0 loses a
# fourth of dim walls' light.
_LEAST_VARIANCE, _LEAST_FORESEEN = 1 / 8, 1 / 64
# Tolerance of rays through openings relative to that of lamps: neighbours have similar noise without outliers, which the filter removes.
_NOISIER = 2.5


class EnvironmentLight:
    """The light of an environment at texels of a chunk.

    rows   (n,) int64, ascending: the texels
    few    (m,) int64, ascending: those of them that see little of it, through openings
    rays   number of pilot rays
    """

    def __init__(self, table: EnvironmentTable, rays: ShadowRays, chunk: TexelChunk, rows: Int64, rng: np.random.Generator) -> None:
        self._table, self.rows, self.rays = table, rows, 0
        n_block = -(-len(chunk) // BLOCK_TEXELS)
        probe = np.arange(n_block)[:, None] * BLOCK_TEXELS + np.arange(_PROBES) * (BLOCK_TEXELS // _PROBES)
        normal = chunk.receivers_at(np.minimum(probe, len(chunk) - 1).ravel(), MIDDLE).normal
        self._brings = table.rate_by_normals(np.asarray(normal).reshape(n_block, _PROBES, 3))
        self._shot, self._lit = np.zeros((2, n_block, len(table.power)))
        self._learn()
        self._explore(rays, chunk, rows[::_PILOT_STEP], rng)
        seldom = (self._see_share() < _MOST_SEEN) & self._lit.any() & uses("openings")
        self.few = rows[seldom[rows // BLOCK_TEXELS]]
        for _ in range(_AIMED_PILOTS if len(self.few) else 0):
            self._explore(rays, chunk, self.few, rng)
        # With less visible sky, the control variate would turn the light of a texel that sees nothing into noise around 0.
        share = self._see_share()
        self._open = np.where((share > _MOSTLY_OPEN) & ~seldom, np.minimum(share, 1), 0.0)

    def irradiance(
        self, rays: ShadowRays, chunk: TexelChunk, demand: Demand, base_rgb: Float64, rng: np.random.Generator
    ) -> tuple[Float64, Float64, int]:
        """As EmitterPool.irradiance."""
        if not len(self.rows):
            return np.zeros_like(base_rgb), np.zeros_like(base_rgb), 0
        shift, block, learned = random_shift(rng, len(chunk)), np.arange(len(chunk)) // BLOCK_TEXELS, 0
        lit = (self._chance * self._rate).sum(axis=1)[block]

        def gather(rows: IntArray, span: Span) -> tuple[Float64, int]:
            nonlocal learned
            if span[0] > learned:  # unbiased: the pdf of a stage depends on earlier rays only
                self._learn()
            learned = span[0]
            return self._gather(rays, chunk, rows, shift, span)

        def gain(taken: Int64) -> Float64:
            rarer: Float64 = 2 * taken * np.minimum(lit, np.maximum(1 - lit, 0))
            return np.maximum(rarer, 1) ** _STRATA_GAIN

        mean, square = self._foresee()
        open_ = np.setdiff1d(self.rows, self.few, assume_unique=True)
        total, variance, n_ray = sample_adaptively(gather, open_, demand, base_rgb, gain=gain)
        if len(self.few):
            own, foreseen = block[self.few], np.zeros((2, len(chunk)))
            foreseen[:, self.few] = mean[own], square[own]
            demand = replace(demand, tolerance=_NOISIER * demand.tolerance)
            expected = foreseen[0], foreseen[1]
            by_few, error, traced = sample_adaptively(gather, self.few, demand, base_rgb, foreseen=expected, gain=gain)
            for channel, colour in zip(error.T, self._tint(), strict=True):
                of_block = _LEAST_VARIANCE * np.bincount(own, channel[self.few]) / np.maximum(np.bincount(own), 1)
                of_ray = _LEAST_FORESEEN * colour**2 * square / STAGES[-1][1]
                channel[self.few] = np.maximum(channel[self.few], np.maximum(of_block[own], of_ray[own]))
            total, variance, n_ray = total + by_few, variance + error, n_ray + traced
        return np.maximum(total, 0.0), variance, n_ray

    def _gather(self, rays: ShadowRays, chunk: TexelChunk, rows: IntArray, shift: NDArray[np.uint32], span: Span) -> tuple[Float64, int]:
        """(k, len(rows), 3) float64: estimates by one ray each, in the order of their strata of the choice."""
        (first, last), table = span, self._table
        receivers, block = chunk.receivers(rows, first, last), rows // BLOCK_TEXELS
        every = np.tile(block, last - first)
        weight, seen = self._trace(rays, receivers, every, light_points(take_rows(shift, rows), first, last))
        value, open_ = seen.times(weight), self._open[block, None]
        if open_.any():
            unoccluded = table.find_irradiance(receivers.normal[: len(rows)])
            if receivers.normal is not receivers.side:
                unoccluded = table.find_irradiance(receivers.normal).reshape(last - first, -1, 3).mean(axis=0)
            value = value - weight * self._open[every, None]
            value = value.reshape(last - first, -1, 3) + open_ * unoccluded
        ordered = np.empty((last - first, len(rows), 3))
        ordered[LIGHT_PLACE[span]] = value.reshape(ordered.shape)
        return ordered, seen.rays

    def _trace(self, rays: ShadowRays, receivers: Receivers, block: Int64, u: FloatArray) -> tuple[Float64, Sight]:
        """Unoccluded contribution of rays from texels of blocks (n,), for numbers u (n, 2): (n, 3), W/m^2; and their visibility, which is
        counted.
        """
        patch, chance, rest = self._choice.choose(block, u)
        direction, cell, density = self._table.choose(patch, rest)
        cosine = np.maximum(dot_rows(direction, receivers.normal), 0)
        per_radiance = np.divide(cosine, chance * density, out=np.zeros(len(cell), np.float32), where=density > 0, casting="same_kind")
        aim = Aim(direction, np.full(len(cell), INFINITE), per_radiance, per_radiance, by_chance=True)
        seen = receivers.see(rays, aim)
        at = block * len(self._table.power) + patch
        for counts, weights in ((self._shot, per_radiance > 0), (self._lit, seen.share)):
            counts += np.bincount(at, weights, counts.size).reshape(counts.shape)
        radiance = self._table.environment.radiance.reshape(-1, 3)[cell]
        return radiance * per_radiance[:, None].astype(np.float64), seen

    def _explore(self, rays: ShadowRays, chunk: TexelChunk, rows: Int64, rng: np.random.Generator) -> None:
        """Trace a pilot ray from each of texels (m,) to measure visibility. Pilots are not part of the estimate, which stays unbiased."""
        for piece in row_pieces(rows, 1):
            _, seen = self._trace(rays, chunk.receivers_at(piece, MIDDLE), piece // BLOCK_TEXELS, rng.random((len(piece), 2), np.float32))
            self.rays += seen.rays
        self._learn()

    def _learn(self) -> None:
        """Derive from all rays so far the visibility (n_block, n_patch), shrunk towards that of regions, and the patches' probabilities."""
        known = self._shot.sum()
        share = float(self._lit.sum() / known) if known else 1.0
        largest, *others = _REGIONS_BLOCKS
        shot, lit = (self._table.blur(sum_regions(counts, largest)) for counts in (self._shot, self._lit))
        rate: Float64 = (lit + share) / (shot + 1)  # blurred, since an opening's direction changes over a region
        for n_block in others:
            shot, lit = (sum_regions(counts, n_block) for counts in (self._shot, self._lit))
            rate = (lit + _AROUND_RAYS * rate) / (shot + _AROUND_RAYS)
        plain = self._brings / np.maximum(self._brings.sum(axis=1, keepdims=True), 1e-300)
        aimed = self._brings * np.sqrt(rate)  # minimizes the variance
        aimed /= np.maximum(aimed.sum(axis=1, keepdims=True), 1e-300)
        anywhere = self._table.power / self._table.power.sum()
        dark = plain.sum(axis=1, keepdims=True) == 0  # the block faces away from all light
        self._rate = rate
        self._chance = (1 - _ANYWHERE - _BACKSTOP) * aimed + _ANYWHERE * plain + np.where(dark, 1.0, _BACKSTOP) * anywhere
        self._choice = PatchChoice(self._chance)

    def _see_share(self) -> Float64:
        """(n_block,): visible share of the map's irradiance."""
        return (self._brings * self._rate).sum(axis=1) / np.maximum(self._brings.sum(axis=1), 1e-300)

    def _foresee(self) -> tuple[Float64, Float64]:
        """(n_block,) each: predicted mean and variance of a ray's brightness, control variate included."""
        rate, open_, chance = self._rate, self._open[:, None], self._chance
        mean = (self._brings * rate).sum(axis=1)
        squares = np.divide(self._brings**2, chance, out=np.zeros_like(chance), where=chance > 0)
        square = (squares * (rate * (1 - 2 * open_) + open_**2)).sum(axis=1)
        off = (self._brings * (rate - open_)).sum(axis=1)
        return mean, np.maximum(square - off**2, 0.0)

    def _tint(self) -> Float64:
        """(3,): the map's mean colour over its brightness."""
        height, width, _ = self._table.environment.radiance.shape
        flux = (self._table.environment.radiance * find_solid_angles(height, width)[:, None, None]).sum(axis=(0, 1))
        return flux / max(float(weigh_channels(flux[None])[0]), 1e-300)
