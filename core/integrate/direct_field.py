"""Direct light by shadow rays at all texels, sampled in shards, and sampled again where it dominates the error."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from itertools import chain, starmap
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..filter.denoise import Spread
from ..filter.filtered_field import GRAIN, FilteredField, find_grain
from ..texels.texel_map import TexelMap
from ..util.arrays import FloatArray, IntArray
from ..util.coverage import as_slice
from ..util.messages import Message, Status
from ..util.progress import ProgressReporter
from ..util.settings import Settings
from . import direct_shards, texel_shards
from .direct import DirectLight
from .direct_shards import NOTHING_AHEAD, ShotAhead

_BLOCK = 64  # successive texel entries, which are neighbours, that share their error below openings


def average_in_blocks(rows: IntArray, values: FloatArray) -> NDArray[np.float64]:
    """(m,): for each texel entry of `rows` (m,), the mean of the values (m,) in its block."""
    block = rows // _BLOCK
    out: NDArray[np.float64] = (np.bincount(block, values) / np.maximum(np.bincount(block), 1))[block]
    return out


@dataclass
class DirectField:
    """Direct irradiance by shadow rays at every texel entry; zeros when photons carry it. Estimates are added in place.

    irradiance   (n, 3) float32, W/m^2
    variance     (n, 3) float32, (W/m^2)^2: variance of that mean, from the samples within each estimate
    passes       (n,) int16: number of estimates in each texel's mean
    counters     DirectLight.counters, summed; empty when photons carry direct light
    turns        number of shots so far; each has random numbers of its own
    by_openings  (n,) bool: at least one estimate sampled the sky through openings
    """

    said: ClassVar = Status("direct", "Direct light")  # progress message
    most_passes: ClassVar = 64  # per texel

    irradiance: NDArray[np.float32]
    variance: NDArray[np.float32]
    passes: NDArray[np.int16]
    counters: dict[str, int] = field(default_factory=dict)
    turns: int = 0
    by_openings: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))

    def __post_init__(self) -> None:
        if not len(self.by_openings):
            self.by_openings = np.zeros(len(self.passes), bool)
        self._grain = GRAIN  # least relative noise that is filtered
        self._smoothed: FilteredField | None = None  # filtered light after the last shot, computed on demand
        self._smoothing: Callable[[], FilteredField] | None = None  # waits for that while it is being computed

    @classmethod
    def none(cls, n_texel: int) -> DirectField:
        return cls(np.zeros((n_texel, 3), np.float32), np.zeros((n_texel, 3), np.float32), np.zeros(n_texel, np.int16))

    def share_error(self, error2: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n,) float32: squared errors by which to choose texels to sample again: `error2` (n,), with block means below openings.

        Where bright samples are rare, stopping by each texel's own error is biased: a texel stops when it is dark by chance, and among
        equal texels those with a bright sample seem to have the largest error. Measured: 1 % of the light below a skylight is lost.
        """
        rows = np.flatnonzero(self.by_openings)
        if not len(rows):
            return error2
        out = error2.copy()
        out[rows] = average_in_blocks(rows, error2[rows])
        return out

    def ask_for(self, error: float) -> None:
        """Derive the least noise that is filtered from the requested relative error."""
        self._grain = find_grain(error)

    def show(self, texels: TexelMap, smooth: bool, spread: Spread = starmap) -> FilteredField:
        """The light as pages show it; filtered if `smooth`."""
        if not smooth:
            return FilteredField.plain(self.irradiance, self.variance)
        if self._smoothed is None:
            finish = self._smoothing or self._begin_smoothing(texels, spread)
            self._smoothed, self._smoothing = finish(), None
        return self._smoothed

    def begin_show(self, texels: TexelMap, smooth: bool, spread: Spread) -> None:
        """Start the filter on idle processes; `show` with the same arguments waits for it."""
        if smooth and self._smoothed is None and self._smoothing is None:
            self._smoothing = self._begin_smoothing(texels, spread)

    def _begin_smoothing(self, texels: TexelMap, spread: Spread) -> Callable[[], FilteredField]:
        return FilteredField.begin_smoothing(self.irradiance, self.variance, texels, spread, self._grain)

    def take_shown(self, texels: TexelMap, smooth: bool, spread: Spread = starmap, in_place: bool = False) -> NDArray[np.float32]:
        """(n, 3) float32: irradiance of `show`, for its last use: other results of the filter are dropped.

        in_place   overwrite this field's own irradiance, whose unfiltered values are no longer needed
        """
        shown, self._smoothed = self.show(texels, smooth, spread), None
        if not in_place:
            return shown.irradiance
        self.irradiance[shown.entry] = shown.smooth
        return self.irradiance

    def shoot(
        self,
        folder: Path,
        settings: Settings,
        executor: Executor,
        texels: IntArray | range,
        tell: Callable[[Message], None] = lambda message: None,
        should_stop: Callable[[], bool] = lambda: False,
        ahead: ShotAhead = NOTHING_AHEAD,
    ) -> bool:
        """Add one more estimate at the texels (m,), ascending; each texel holds the mean of all of its estimates.

        should_stop   called after every shard
        ahead         shards of a first shot at all texels that were sent already
        Returns False if it was stopped. Texels that had estimates before then return to them, so that the bake can go on as before.
        """
        self.ask_for(settings.error)
        shard = direct_shards.ask_for_direct(folder, settings, self.turns, texels)
        rows = as_slice(texels)
        kept = self._keep(rows) if self.passes.any() else None
        is_done = self._send_rays(executor, texel_shards.light_texels, shard, tell, should_stop, ahead)
        if kept and not is_done:
            self._put_back(rows, kept)
        return is_done

    def _keep(self, rows: IntArray | slice) -> DirectField:
        """Copy the estimates at texels `rows`, and the totals."""
        own = self.irradiance[rows].copy(), self.variance[rows].copy(), self.passes[rows].copy()
        return DirectField(*own, dict(self.counters), self.turns, self.by_openings[rows].copy())

    def _put_back(self, rows: IntArray | slice, kept: DirectField) -> None:
        self.irradiance[rows], self.variance[rows], self.passes[rows] = kept.irradiance, kept.variance, kept.passes
        self.counters, self.turns = kept.counters, kept.turns
        self.by_openings[rows] = kept.by_openings

    def _send_rays(
        self,
        executor: Executor,
        find_light: Callable[[Any], Any],
        whole: texel_shards.TexelShard,
        tell: Callable[[Message], None],
        should_stop: Callable[[], bool],
        ahead: ShotAhead = NOTHING_AHEAD,
    ) -> bool:
        """As shoot, for the texels of the shard `whole`; `find_light` turns each part of it into DirectLight, or a type with its fields."""
        self.turns += 1
        self._smoothed = self._smoothing = None
        texels = whole.texels
        shards = direct_shards.list_shards(whole)
        sent = executor.map(find_light, shards[ahead.count :])
        words = ProgressReporter(tell)
        for shard, light in zip(shards, chain(ahead.wait(), sent), strict=True):
            if should_stop():
                return False
            self._add(as_slice(shard.texels), light)
            for name, count in light.counters.items():
                self.counters[name] = self.counters.get(name, 0) + count
            words.say(self.said, 1 - shard.start / len(texels))  # once the shard is added, for the listener may read the light
        return True

    def _add(self, rows: IntArray | slice, light: DirectLight) -> None:
        """Add one more estimate at texels `rows`."""
        before = self.passes[rows, None].astype(np.float32)
        if before.any():
            self.irradiance[rows] = (self.irradiance[rows] * before + light.irradiance_rgb) / (before + 1)
            self.variance[rows] = (self.variance[rows] * before**2 + light.variance_rgb) / (before + 1) ** 2
        else:
            self.irradiance[rows], self.variance[rows] = light.irradiance_rgb, light.variance_rgb
        self.passes[rows] += 1
        self.by_openings[rows] |= light.by_openings
