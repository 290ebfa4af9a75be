"""Indirect light gathered at every texel by rays."""

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
from ..filter.error_estimate import PhotonLight
from ..lights.direct_points import STAGES
from ..parallel import shared_arrays
from ..texels.texel_map import TexelMap
from ..util.arrays import IntArray
from ..util.messages import Message, Status
from ..util.settings import Settings
from . import texel_shards
from .direct_field import DirectField, average_in_blocks
from .gather import SIGNS, KnownLight

_BLOCK = 64  # texels over which the photons' noise is averaged; a mean over them all would miss what differs between them
_NEIGHBOURS = 4  # successive texel entries, mostly a square of 2 * 2
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

    doubt           (n, k) float32, W/m^2: of GatheredLight
    rays_of_pass    rays of a texel in each pass, 0 before the first
    """

    said: ClassVar = Status("photons", "Indirect light")
    most_passes: ClassVar = 256  # of hardly more rays than a texel takes at once; with 64 small errors are missed

    doubt: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, SIGNS), np.float32))
    rays_of_pass: int = 0

    @classmethod
    def none(cls, n_texel: int) -> GatheredField:
        irradiance, variance = np.zeros((2, n_texel, 3), np.float32)
        doubt = np.zeros((n_texel, SIGNS), np.float32)
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
        repeats: int = 1,
    ) -> bool:
        """As shoot, `repeats` times."""
        self.ask_for(settings.error)
        self.rays_of_pass = self.rays_of_pass or count_rays(settings.error)
        with shared_arrays.laid_out(folder, known) as view:
            for _ in range(repeats):
                whole = texel_shards.GatherShard(str(folder), settings.seed, self.turns, 0, texels, self.rays_of_pass, view)
                if not self._send_rays(executor, texel_shards.gather_texels, whole, tell, should_stop):
                    return False
        return True

    def share_error(self, error2: NDArray[np.float32]) -> NDArray[np.float32]:
        """As of DirectField, in blocks everywhere: a filtered texel errs as its neighbours do, not as its own rays."""
        return average_in_blocks(np.arange(len(error2)), error2).astype(np.float32)

    def _add(self, rows: IntArray | slice, light: Any) -> None:
        before = self.passes[rows, None].astype(np.float32)
        self.doubt[rows] = (self.doubt[rows] * before + light.doubt) / (before + 1)
        super()._add(rows, light)

    def show_photons(self, texels: TexelMap, smooth: bool, spread: Spread = starmap) -> PhotonLight:
        """As show, with the error that the photons' noise leaves in it."""
        shown, doubt2 = self.show(texels, smooth, spread), self.find_doubt2()
        return PhotonLight(shown.irradiance_at, shown.total_light, lambda entry: np.repeat(doubt2[entry, None], 3, axis=1), shown)

    def find_doubt2(self) -> NDArray[np.float32]:
        """(n,) float32, (W/m^2)^2: variance that the photons' noise leaves in gathered light.

        Neighbours have about the same doubt, but rays of their own, so that the mean of their products contains no noise of rays. It is
        negative by chance where there is little doubt; means over many texels alone are meaningful.
        """
        whole = len(self.doubt) // _NEIGHBOURS * _NEIGHBOURS
        if not whole:
            return (self.doubt**2).mean(axis=1)
        near = self.doubt[:whole].reshape(-1, _NEIGHBOURS, SIGNS).astype(np.float64)
        product = ((near.sum(axis=1) ** 2 - (near**2).sum(axis=1)) / (_NEIGHBOURS * (_NEIGHBOURS - 1))).mean(axis=1)
        block = np.arange(len(product)) // (_BLOCK // _NEIGHBOURS)
        count = np.bincount(block)
        mean = np.bincount(block, product) / count
        # One standard error more of the page's mean: of few texels the mean may be 0, or less, by chance.
        spread = np.sqrt(np.bincount(block, (product - mean[block]) ** 2)) / count
        mean += spread / math.sqrt(len(count))
        return mean[np.minimum(np.arange(len(self.doubt)) // _BLOCK, len(mean) - 1)].astype(np.float32)
