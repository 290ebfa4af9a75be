"""Direct light by shadow rays at all texels, shot in shards, and again where it is the larger part of the error."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import workers
from .direct_shown import ShownDirect
from .messages import Message, Status
from .scene import IntArray
from .settings import Settings
from .texel_map import TexelMap

SHARD_TEXELS = 1 << 12  # small enough that no worker waits long for another's last; larger ones are no quicker
TOLERANCE = 0.5  # of the error asked for: its noise is averaged over neighbours, at less cost than more rays
MOST_PASSES = 64
SECONDS_BETWEEN_WORDS = 1.0


@dataclass
class DirectField:
    """Direct irradiance by shadow rays at every texel entry; zeros when photons carry it. Grows better in place.

    irradiance   (n, 3) float32, W/m^2
    variance     (n, 3) float32, (W/m^2)^2
    passes       (n,) int16: how many estimates each texel is the mean of
    counters     of direct.direct_irradiance, summed; empty when photons carry it
    """

    irradiance: NDArray[np.float32]
    variance: NDArray[np.float32]
    passes: NDArray[np.int16]
    counters: dict[str, int] = field(default_factory=dict)
    turns: int = 0  # shots so far, each with random numbers of its own

    def __post_init__(self) -> None:
        self._smoothed: ShownDirect | None = None  # of the last shot; made when it is asked for

    @classmethod
    def none(cls, n_texel: int) -> DirectField:
        return cls(np.zeros((n_texel, 3), np.float32), np.zeros((n_texel, 3), np.float32), np.zeros(n_texel, np.int16))

    def show(self, texels: TexelMap, page: NDArray[np.int32], smooth: bool, threads: int = 1) -> ShownDirect:
        """The light as it is shown, its grain smoothed or as it is; page (n,) int32, of each entry."""
        if not smooth:
            return ShownDirect.plain(self.irradiance, self.variance)
        if self._smoothed is None:
            self._smoothed = ShownDirect.smoothed(self.irradiance, self.variance, texels, page, threads)
        return self._smoothed

    def shoot(
        self,
        folder: Path,
        settings: Settings,
        executor: Executor,
        texels: IntArray,
        tell: Callable[[Message], None] = lambda message: None,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> bool:
        """One more estimate of the texels (m,), ascending; each becomes the mean of all it has had. False when it was stopped."""
        turn, self.turns = self.turns, self.turns + 1
        self._smoothed = None
        shards = [
            workers.DirectShard(str(folder), settings.seed, turn, start, texels[start : start + SHARD_TEXELS], TOLERANCE * settings.error)
            for start in range(0, len(texels), SHARD_TEXELS)
        ]
        told = time.monotonic()
        for shard, light in zip(shards, executor.map(workers.light_texels, shards), strict=True):
            if should_stop():
                return False
            rows = shard.texels
            before = self.passes[rows, None].astype(np.float32)
            self.irradiance[rows] = (self.irradiance[rows] * before + light.irradiance_rgb) / (before + 1)
            self.variance[rows] = (self.variance[rows] * before**2 + light.variance_rgb) / (before + 1) ** 2
            self.passes[rows] += 1
            for name, count in light.counters.items():
                self.counters[name] = self.counters.get(name, 0) + count
            if time.monotonic() - told > SECONDS_BETWEEN_WORDS:  # after it is added: whoever hears it may look
                told = time.monotonic()
                tell(Status("direct", f"Direct light, {(shard.start + len(rows)) / len(texels):.0%}"))
        return True
