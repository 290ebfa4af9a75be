"""The decision whether to gather indirect light by rays from texels."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from ..filter.error_estimate import StatedError
from ..integrate.adaptive_sampling import DIRECT_SHARE
from ..radiosity.basis import DEGREES
from ..texels.texel_map import TexelMap
from ..texels.tiles import TILE_TEXELS, find_tiles
from ..transport.energy_audit import Ledger
from ..transport.rounds import grow_photons
from ..util.ablation import uses
from ..util.settings import Settings

# Least share of texels in tiles for gathering: texels of small charts have too few neighbours for the filter to average noise with.
# Measured on random interiors of small charts, asked for 2 %: gathering takes 1.3 to 1.45 times the CPU seconds of leaves.
_LEAST_TILED = 0.6
# rays per texel = share of indirect light * (_RAYS_EACH + _RAYS_BY_ERROR / error). Measured on the samples: 24 and 0.9; halved, for a
# gather ray takes half as long as a photon's.
_RAYS_EACH, _RAYS_BY_ERROR = 12.0, 0.45
# Greatest stated error over the requested one for gathering: at most half the requested error then carries over, see gathered.
_MOST_KNOWN = 2.5
# Growth of the photons after which gathering that was not enough is tried again: their light has half the variance then. Without retries
# photons alone are sent for dim objects until the limit, and the error stays greater (two_rooms, by objects).
_AGAIN = 2.0


@dataclass
class GatherPlan:
    """Decides, for one bake, whether indirect light is gathered.

    n_texel         number of texels of the bake
    tiled           share of them in tiles
    given_up        least requested error for which gathering was not enough; inf where it was not tried
    given_up_weight   photons at that time, as Ledger.total_weight
    budget_rays     gather rays after which the bake returns to leaves for good: the estimated photon rays instead of them, so that a wrong
                    forecast costs at most twice the better choice (ski rental problem; Karlin et al. 1988)
    """

    n_texel: int
    tiled: float
    given_up: float = math.inf
    given_up_weight: float = 0.0
    budget_rays: float = math.inf

    @classmethod
    def of(cls, texels: TexelMap) -> GatherPlan:
        tiles = find_tiles(texels.texel_chart, texels.texel_code)
        return cls(len(texels), len(tiles) * TILE_TEXELS / max(len(texels), 1))

    def give_up(self, error: float, total_weight: float) -> None:
        """Record that gathering was not enough for this error with the light of so many photons."""
        self.given_up, self.given_up_weight = error, total_weight

    def pays(self, settings: Settings, stated: StatedError, ledger: Ledger, round_: int, weigh: Callable[[], float]) -> bool:
        """Whether gathering takes less time than the photons that the requested error would need.

        round_   number of rounds so far
        weigh    returns the weight of a photon of the next round, relative to one of the first
        """
        is_given_up = settings.error >= self.given_up and ledger.total_weight < _AGAIN * self.given_up_weight
        is_given_up |= ledger.gathered >= self.budget_rays
        is_planned = uses("gathering_plan")
        if round_ < 2 or (is_planned and (is_given_up or self.tiled < _LEAST_TILED)):  # after one round the light is too noisy
            return False
        if not settings.gather or settings.direct != "rays" or not settings.hierarchical:
            return False
        if not settings.wants_all_light:  # a gather ray adds one bounce
            return False
        if not is_planned:
            return True
        degree = DEGREES[settings.basis]
        # In fully refined trees bias^2 = variance / (degree + 1) (see grow_photons); early trees are too coarse, and their bias says
        # nothing about the photons to come.
        noise2 = stated.photons**2 * (degree + 2) / (degree + 1)
        wanted2 = (1.0 - DIRECT_SHARE**2) * settings.error**2
        if noise2 <= wanted2 or stated.relative > _MOST_KNOWN * settings.error:
            return False
        if ledger.total_weight * (noise2 / wanted2 - 1.0) > settings.max_photons - ledger.photons:  # photons alone cannot reach the error
            self.budget_rays = math.inf
            return True
        rays = (_RAYS_EACH + _RAYS_BY_ERROR / settings.error) * stated.indirect * self.n_texel
        photons = ledger.total_weight * (grow_photons(noise2, wanted2, degree) - 1.0) / weigh()
        instead = photons * ledger.rays / ledger.photons
        if instead <= rays:
            return False
        if math.isinf(self.budget_rays):
            self.budget_rays = ledger.gathered + instead
        return True
