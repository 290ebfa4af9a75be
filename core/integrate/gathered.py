"""Indirect light gathered at every texel, where leaves would need many more photons."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from itertools import starmap
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..filter.denoise import Spread
from ..filter.filtered_field import FilteredGather
from ..parallel import shared_arrays
from ..texels.texel_map import TexelMap
from ..util.arrays import IntArray
from ..util.messages import Message, Status
from ..util.settings import Settings
from . import texel_shards
from .direct_field import DirectField
from .gather import KnownLight

# Neighbours whose rays see much the same surfaces, so that one mean over all their rays estimates the photons' noise on these.
_BLOCK = 64
# Blocks that gather before all do, and at most one in so many: the mean of the squared means of 64 is known to 18 %.
_PILOT_BLOCKS, _BLOCKS_PER_PILOT = 64, 16
# As direct_shards.TOLERANCE. Measured on three samples, squared error times rays: with half of it the same, with twice
# of it 1.1 to 1.8 times.
_TOLERANCE = 1.0


@dataclass
class GatheredField(DirectField):
    """As DirectField, of indirect light.

    doubt   (n,) float32, W/m^2: of GatheredLight
    """

    said: ClassVar = Status("photons", "Indirect light")
    most_passes: ClassVar = 256  # of hardly more rays than a texel takes at once; with 64 small errors are missed

    doubt: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))

    @classmethod
    def none(cls, n_texel: int) -> GatheredField:
        irradiance, variance = np.zeros((2, n_texel, 3), np.float32)
        doubt = np.zeros(n_texel, np.float32)
        return cls(irradiance, variance, np.zeros(n_texel, np.int16), doubt=doubt)

    def gather(
        self,
        folder: Path,
        settings: Settings,
        executor: Executor,
        texels: IntArray,
        known: KnownLight,
        tell: Callable[[Message], None] = lambda message: None,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> bool:
        """As shoot."""
        self.ask_for(settings.error)
        with shared_arrays.laid_out(folder, known) as view:
            whole = texel_shards.GatherShard(str(folder), settings.seed, self.turns, 0, texels, _TOLERANCE * settings.error, view)
            return self._send_rays(executor, texel_shards.gather_texels, whole, tell, should_stop)

    def _add(self, rows: IntArray | slice, light: Any) -> None:
        before = self.passes[rows].astype(np.float32)
        self.doubt[rows] = (self.doubt[rows] * before + light.doubt) / (before + 1)
        super()._add(rows, light)

    def show_gathered(self, texels: TexelMap, smooth: bool, spread: Spread = starmap) -> FilteredGather:
        """Arguments as of show."""
        return FilteredGather(self.show(texels, smooth, spread), self.find_doubt2(), self.passes > 0)

    def find_doubt2(self) -> NDArray[np.float32]:
        """(n,) float32, (W/m^2)^2: variance that the photons' noise leaves in gathered light."""
        start = np.arange(0, len(self.doubt), _BLOCK)
        size = np.diff(np.append(start, len(self.doubt)))
        mean = np.add.reduceat(self.doubt, start) / size
        return np.repeat(mean * mean, size).astype(np.float32)


def choose_pilots(n_texel: int) -> NDArray[np.int64]:
    """(m,) int64, ascending: texel entries, in whole blocks spread over all, of which the doubt of all is estimated."""
    blocks = -(-n_texel // _BLOCK)
    chosen = np.unique(np.linspace(0, blocks - 1, min(_PILOT_BLOCKS, -(-blocks // _BLOCKS_PER_PILOT))).astype(np.int64))
    entry: NDArray[np.int64] = (chosen[:, None] * _BLOCK + np.arange(_BLOCK)).ravel()
    return entry[entry < n_texel]
