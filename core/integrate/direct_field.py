"""Direct light by shadow rays at all texels, shot in shards, and again where it is the larger part of the error."""

from __future__ import annotations

import copy
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from itertools import chain, starmap
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..filter.denoise import Spread
from ..filter.direct_shown import GRAIN, ShownDirect, find_grain
from ..parallel import shared_arrays
from ..texels.judged import DARK_FLOOR
from ..texels.texel_map import TexelMap
from ..util.ablation import uses
from ..util.arrays import FloatArray, IntArray
from ..util.coverage import as_slice
from ..util.messages import Message, Status
from ..util.settings import Settings
from ..util.words import Words
from . import direct_shards, texel_shards
from .direct import DirectLight
from .direct_shards import NOTHING_AHEAD, ShotAhead
from .other_light import OtherLight

_BLOCK = 64  # texels in a row, neighbours, whose variances are corrected together
# Weights in texels shot again: of variances as they were told in all texels' correction, and of that in a block's.
_PRIOR_VALUES, _PRIOR_OF_BLOCK = 64.0, 16.0


@dataclass(frozen=True)
class Repeats:
    """How estimates of texels that were shot again differ.

    sums   (3, n_block) float64: how often it was; squared differences between the new estimate and the mean of those before,
           relative to their brightness; and what their variances let expect of that
    """

    sums: NDArray[np.float64]

    def add(self, block: IntArray, seen: NDArray[np.float64], expected: NDArray[np.float64]) -> None:
        """One more estimate of some texels: all (m,)."""
        for row, values in zip(self.sums, (np.ones(len(block)), seen, expected), strict=True):
            row += np.bincount(block, values, len(row))

    def correct(self) -> NDArray[np.float32]:
        """(n_block,) float32: factors for the variances."""
        count, seen, expected = self.sums
        total = self.sums.sum(axis=1)
        common = (_divide(total[1:2], total[2:]) * total[0] + _PRIOR_VALUES) / (total[0] + _PRIOR_VALUES)
        factor: NDArray[np.float64] = (_divide(seen, expected) * count + _PRIOR_OF_BLOCK * common) / (count + _PRIOR_OF_BLOCK)
        return factor.astype(np.float32)


def _average_in_blocks(rows: IntArray, values: FloatArray) -> NDArray[np.float64]:
    """(m,): of each of some texel entries (m,) the mean of those values that are in its block."""
    block = rows // _BLOCK
    out: NDArray[np.float64] = (np.bincount(block, values) / np.maximum(np.bincount(block), 1))[block]
    return out


def _divide(seen: NDArray[np.float64], expected: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.divide(seen, expected, out=np.ones_like(seen), where=expected > 0.0)


@dataclass
class DirectField:
    """Direct irradiance by shadow rays at every texel entry; zeros when photons carry it. Grows better in place.

    irradiance   (n, 3) float32, W/m^2
    variance     (n, 3) float32, (W/m^2)^2: as single estimates tell it
    passes       (n,) int16: how many estimates each texel is the mean of
    counters     of direct.direct_irradiance, summed; empty when photons carry it
    turns        shots so far, each with random numbers of its own
    repeats      of texels shot again, or None
    by_quads     (n,) bool: told by one of quads alone, whose texels err as one
    by_openings  (n,) bool: saw the sky through openings, in any of the estimates
    """

    said: ClassVar = Status("direct", "Direct light")  # of what is found, while it takes its time
    most_passes: ClassVar = 64  # of a texel

    irradiance: NDArray[np.float32]
    variance: NDArray[np.float32]
    passes: NDArray[np.int16]
    counters: dict[str, int] = field(default_factory=dict)
    turns: int = 0
    repeats: Repeats | None = None
    by_quads: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    by_openings: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))

    def __post_init__(self) -> None:
        if not len(self.by_quads):
            self.by_quads = np.zeros(len(self.passes), bool)
        if not len(self.by_openings):
            self.by_openings = np.zeros(len(self.passes), bool)
        self._grain = GRAIN  # least that is smoothed
        self._smoothed: ShownDirect | None = None  # of the last shot; made when it is asked for
        self._smoothing: Callable[[], ShownDirect] | None = None  # the same, while it is on its way

    @classmethod
    def none(cls, n_texel: int) -> DirectField:
        return cls(np.zeros((n_texel, 3), np.float32), np.zeros((n_texel, 3), np.float32), np.zeros(n_texel, np.int16))

    def share_error(self, error2: NDArray[np.float32]) -> NDArray[np.float32]:
        """Squared errors (n,) float32 of all texel entries by which they are chosen to be shot again: means of neighbours below openings.

        There rays seldom find much, and of texels that are alike those which it came to err most. Were each shot until its own error
        is small, it would be left when it has come out dark by chance: measured, 1 % of the light below a skylight.
        """
        rows = np.flatnonzero(self.by_openings)
        if not len(rows):
            return error2
        out = error2.copy()
        out[rows] = _average_in_blocks(rows, error2[rows])
        return out

    def ask_for(self, error: float) -> None:
        """Show it as fits a bake of which this relative error is asked for."""
        self._grain = find_grain(error)

    def show(self, texels: TexelMap, smooth: bool, spread: Spread = starmap) -> ShownDirect:
        """The light as it is shown, its grain smoothed or as it is."""
        if not smooth:
            return ShownDirect.plain(self.irradiance, self.find_variance())
        if self._smoothed is None:
            finish = self._smoothing or self._begin_smoothing(texels, spread)
            self._smoothed, self._smoothing = finish(), None
        return self._smoothed

    def begin_show(self, texels: TexelMap, smooth: bool, spread: Spread) -> None:
        """Have done what `show` will need, by whoever has nothing else to do; its arguments are the same."""
        if smooth and self._smoothed is None and self._smoothing is None:
            self._smoothing = self._begin_smoothing(texels, spread)

    def _begin_smoothing(self, texels: TexelMap, spread: Spread) -> Callable[[], ShownDirect]:
        by_quads = self.by_quads if self.by_quads.any() else None
        return ShownDirect.begin_smoothing(self.irradiance, self.find_variance(), texels, spread, by_quads, self._grain)

    def take_shown(self, texels: TexelMap, smooth: bool, spread: Spread = starmap, in_place: bool = False) -> NDArray[np.float32]:
        """ShownDirect.irradiance of `show`, for whoever asks last: what else was found with it is not kept any longer.

        in_place   it is this field's own, of which nobody wants to know how it was found any more
        """
        shown, self._smoothed = self.show(texels, smooth, spread), None
        if not in_place:
            return shown.irradiance
        self.irradiance[shown.entry] = shown.smooth
        return self.irradiance

    def find_variance(self) -> NDArray[np.float32]:
        """(n, 3) float32, (W/m^2)^2: where texels were shot again, corrected by how their estimates differ.

        What strata gain depends on how shadows lie, which a single estimate cannot tell.
        """
        if self.repeats is None or not uses("variance_correction"):
            return self.variance
        correction = self.repeats.correct()[np.arange(len(self.passes)) // _BLOCK]
        corrected: NDArray[np.float32] = self.variance * np.where(self.passes > 1, correction, np.float32(1.0))[:, None]
        return corrected

    def shoot(
        self,
        folder: Path,
        settings: Settings,
        executor: Executor,
        texels: IntArray | range,
        tell: Callable[[Message], None] = lambda message: None,
        should_stop: Callable[[], bool] = lambda: False,
        other: OtherLight | None = None,
        ahead: ShotAhead = NOTHING_AHEAD,
    ) -> bool:
        """One more estimate of the texels (m,), ascending; each becomes the mean of all it has had.

        should_stop   asked after every shard
        other         light that is shown with it; None where there is none, or direct light is shown by itself
        ahead         what has been sent already of a first shot of all texels
        False when it was stopped: texels that had an estimate before are left with that, so that a bake goes on as if this had not been.
        """
        self.ask_for(settings.error)
        shard = direct_shards.ask_for_direct(folder, settings, self.turns, texels)
        rows = as_slice(texels)
        kept = self._keep(rows) if self.passes.any() else None
        with shared_arrays.laid_out(folder, other) if other else nullcontext("") as view:
            shard = replace(shard, view=view)
            dark = direct_shards.find_dark(settings, self._find_brightness(shard, other))
            is_done = self._send_rays(executor, texel_shards.light_texels, replace(shard, dark=dark), tell, should_stop, ahead)
        if kept and not is_done:
            self._put_back(rows, kept)
        return is_done

    def _find_brightness(self, shard: texel_shards.DirectShard, other: OtherLight | None) -> float:
        """W/m^2, of all texels in the mean; 0 where nobody asks for it, below no sky."""
        if not direct_shards.is_below_sky(shard.tracing):
            return 0.0
        found = float(self.irradiance.mean(dtype=np.float64)) if self.passes.any() else direct_shards.glance(shard)
        return found + (float(other.level.mean(dtype=np.float64)) if other else 0.0)

    def _keep(self, rows: IntArray | slice) -> DirectField:
        """What there is of some texels, and of all in sum."""
        own = self.irradiance[rows].copy(), self.variance[rows].copy(), self.passes[rows].copy()
        return DirectField(
            *own, dict(self.counters), self.turns, copy.deepcopy(self.repeats), self.by_quads[rows].copy(), self.by_openings[rows].copy()
        )

    def _put_back(self, rows: IntArray | slice, kept: DirectField) -> None:
        self.irradiance[rows], self.variance[rows], self.passes[rows] = kept.irradiance, kept.variance, kept.passes
        self.counters, self.turns, self.repeats, self.by_quads[rows] = kept.counters, kept.turns, kept.repeats, kept.by_quads
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
        """As shoot, by what `find_light` gives for parts of the shard `whole`: DirectLight, or what has its fields too."""
        self.turns += 1
        self._smoothed = self._smoothing = None
        texels = whole.texels
        shards = direct_shards.list_shards(whole)
        sent = executor.map(find_light, shards[ahead.count :])
        words = Words(tell)
        floor = DARK_FLOOR * float(self.irradiance.mean(dtype=np.float64)) + 1e-30
        for shard, light in zip(shards, chain(ahead.wait(), sent), strict=True):
            if should_stop():
                return False
            self._note_difference(shard.entries, light, floor)
            self._add(as_slice(shard.texels), light)
            for name, count in light.counters.items():
                self.counters[name] = self.counters.get(name, 0) + count
            words.say(self.said, 1 - shard.start / len(texels))  # after it is added: whoever hears it may look
        return True

    def _add(self, rows: IntArray | slice, light: DirectLight) -> None:
        """One more estimate of some texels."""
        before = self.passes[rows, None].astype(np.float32)
        if before.any():
            self.irradiance[rows] = (self.irradiance[rows] * before + light.irradiance_rgb) / (before + 1)
            self.variance[rows] = (self.variance[rows] * before**2 + light.variance_rgb) / (before + 1) ** 2
        else:
            self.irradiance[rows], self.variance[rows] = light.irradiance_rgb, light.variance_rgb
        self.passes[rows] += 1
        self.by_quads[rows] = light.by_quads
        self.by_openings[rows] |= light.by_openings

    def _note_difference(self, rows: IntArray, light: DirectLight, floor: float) -> None:
        """Compares new estimates of the texels `rows` with those before; floor: brightness below which a texel counts as if it had that."""
        again = self.passes[rows] > 0
        if not again.any():
            return
        rows = rows[again]
        gap = light.irradiance_rgb[again] - self.irradiance[rows]
        joint = self.irradiance[rows] + gap / (self.passes[rows, None] + 1)  # which a texel's own noise moves independently of the gap
        few = np.flatnonzero(self.by_openings[rows])
        if len(few):  # where that is not so: one ray that found much makes a texel bright, and its gap seem small beside that
            joint[few] = np.stack([_average_in_blocks(rows[few], channel) for channel in joint[few].T], axis=1)
        weight = 1.0 / (joint + floor) ** 2
        seen = (weight * gap**2).sum(axis=1)
        expected = (weight * (light.variance_rgb[again] + self.variance[rows])).sum(axis=1)
        self.repeats = self.repeats or Repeats(np.zeros((3, -(-len(self.passes) // _BLOCK))))
        self.repeats.add(rows // _BLOCK, seen, expected)
