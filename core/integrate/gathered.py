"""Indirect light gathered at every texel, where leaves would need many more photons."""

from __future__ import annotations

import math
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
from ..lights.direct_points import STAGES
from ..parallel import shared_arrays
from ..texels.error_metric import BEST_TEXELS
from ..texels.texel_map import TexelMap
from ..util.arrays import IntArray
from ..util.messages import Message, Status
from ..util.settings import Settings
from . import texel_shards
from .direct_field import DirectField
from .gather import KnownLight

# Neighbours whose rays see much the same surfaces, so that one mean over all their rays estimates the photons' noise on these.
_BLOCK = 64
# Number of pilot blocks, and least number of blocks for each of them: the mean of the squares of 64 normal variables has an error of 18 %.
_PILOT_BLOCKS, _BLOCKS_PER_PILOT = 64, 16
# An estimate of photons' noise is too small by chance where rare photons carry much power: on a level below a sky it was 3.3, 13, 12, 4.7,
# 8.7, 6.6 and 3.0 % after successive rounds. The first squared estimate is multiplied by this; later ones are compared with the one before.
_FIRST_PILOT2 = 4.0
# Rays of a texel in one pass at this requested error, besides those to bright places; their number goes as its inverse, as further passes
# add rays where they help most. Measured on eight random scenes and two files: asked for 5 %, 4 rays leave an error of 2.1 to 4.5 %, on one
# scene 6.4 %, and take 0.55 to 0.9 times as long as 16; asked for 2 %, 64 rays take 1.2 to 1.7 times as long as 16.
_RAYS, _RAYS_ERROR = 16, 0.02


def count_rays(error: float) -> int:
    """Rays of a texel in one pass, the end of a stage of STAGES, for a requested relative error."""
    wanted = math.log(_RAYS * _RAYS_ERROR / max(error, 1e-6))
    return min((last for _, last in STAGES), key=lambda last: abs(math.log(last) - wanted))


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
            whole = texel_shards.GatherShard(str(folder), settings.seed, self.turns, 0, texels, count_rays(settings.error), view)
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
    """(m,) int64, ascending: texel entries of whole blocks, spread evenly over all, from which the error of gathered light is estimated."""
    blocks = -(-n_texel // _BLOCK)
    chosen = np.unique(np.linspace(0, blocks - 1, min(_PILOT_BLOCKS, -(-blocks // _BLOCKS_PER_PILOT))).astype(np.int64))
    entry: NDArray[np.int64] = (chosen[:, None] * _BLOCK + np.arange(_BLOCK)).ravel()
    return entry[entry < n_texel]


@dataclass(frozen=True)
class PilotError:
    """Squared relative errors of light that pilot texels have gathered.

    photons    of the bake so far
    photons2   error from photons' noise
    cautious2  upper estimate of photons2, in view of an earlier estimate
    """

    photons: int
    photons2: float
    cautious2: float

    @classmethod
    def of(
        cls, pilot: GatheredField, entry: NDArray[np.int64], weight: NDArray[np.float32], photons: int, before: PilotError | None
    ) -> PilotError:
        """The errors at texel entries (m,) of a field.

        weight   (m, 3), of ReferenceLight.weigh
        before   the errors after fewer photons; None for none
        """
        photons2 = _mean_best((weight * pilot.find_doubt2()[entry, None]).mean(axis=1))
        cautious2 = max(photons2, before.photons2 * before.photons / photons) if before else _FIRST_PILOT2 * photons2
        return cls(photons, photons2, cautious2)


def _mean_best(error2: NDArray[np.float32]) -> float:
    """Mean of squared errors (n,), clipped at their quantile of error_metric.BEST_TEXELS."""
    return float(np.minimum(error2, np.quantile(error2, BEST_TEXELS)).mean(dtype=np.float64))
