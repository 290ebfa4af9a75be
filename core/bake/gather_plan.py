"""When indirect light is gathered by rays from texels."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from ..filter.estimate import StatedError
from ..integrate.next_rays import DIRECT_SHARE
from ..radiosity.basis import DEGREES
from ..texels.texel_map import TexelMap
from ..texels.tiles import TILE_TEXELS, find_tiles
from ..transport.ledger import Ledger
from ..transport.rounds import grow_photons
from ..util.ablation import uses
from ..util.settings import Settings

# Share of texels that lie in tiles, below which gathering does not pay: where charts are small a texel has too few neighbours to average
# its noise with. Measured on random interiors of small charts, asked for 2 %: gathering takes 1.3 to 1.45 times the CPU seconds of leaves.
_LEAST_TILED = 0.6
# Rays of a texel if all of its light is indirect, and more over the error asked for. Measured on the samples: 24 and 0.9, and each takes
# half as long as a photon's.
_RAYS_EACH, _RAYS_BY_ERROR = 12.0, 0.45
# Times the error asked for, that all light may err by before it is gathered: what goes on of it, see gathered, is half of that at most.
_MOST_KNOWN = 2.5
# Times the photons by which what was gathered was not enough, from which on it is tried anew: what they tell of it has half the squared
# noise then. Without that, photons alone are sent for dim things until there are no more, and err more there (two_rooms, by objects).
_AGAIN = 2.0


@dataclass
class GatherPlan:
    """Decides, for one bake, whether indirect light is gathered.

    n_texel         of the bake
    tiled           share of them that lie in tiles
    given_up        least error that it was tried for and was not enough; inf where it was not tried
    given_up_told   photons that there were then, as Ledger.told
    budget_rays     that may gather before leaves are gone back to for good: as many as photons were likely to need instead, so that a
                    wrong forecast costs no more than twice the better choice (the rule of the ski rental problem; Karlin et al. 1988)
    """

    n_texel: int
    tiled: float
    given_up: float = math.inf
    given_up_told: float = 0.0
    budget_rays: float = math.inf

    @classmethod
    def of(cls, texels: TexelMap) -> GatherPlan:
        tiles = find_tiles(texels.texel_chart, texels.texel_code)
        return cls(len(texels), len(tiles) * TILE_TEXELS / max(len(texels), 1))

    def give_up(self, error: float, told: float) -> None:
        """What was gathered for this error, by what so many photons told, was not enough."""
        self.given_up, self.given_up_told = error, told

    def pays(self, settings: Settings, stated: StatedError, ledger: Ledger, round_: int, weigh: Callable[[], float]) -> bool:
        """Whether to gather takes less time than the photons that the error asked for would need.

        round_   number of rounds so far
        weigh    gives how much a photon of the next round tells, over one of a first
        """
        is_given_up = settings.error >= self.given_up and ledger.told < _AGAIN * self.given_up_told
        is_given_up |= ledger.gathered >= self.budget_rays
        is_planned = uses("gathering_plan")
        if round_ < 2 or (is_planned and (is_given_up or self.tiled < _LEAST_TILED)):  # a first round knows too little of what there is
            return False
        if not settings.gather or settings.direct != "rays" or not settings.hierarchical:
            return False
        if not settings.wants_all_light:  # what is gathered has met one surface more
            return False
        if not is_planned:
            return True
        degree = DEGREES[settings.basis]
        # Where leaves are as large as they should be, what they miss is 1 / (degree + 1) of their noise (see grow_photons); early trees are
        # too coarse, and what these miss tells nothing of the photons to come.
        noise2 = stated.photons**2 * (degree + 2) / (degree + 1)
        wanted2 = (1.0 - DIRECT_SHARE**2) * settings.error**2
        if noise2 <= wanted2 or stated.relative > _MOST_KNOWN * settings.error:
            return False
        if ledger.told * (noise2 / wanted2 - 1.0) > settings.max_photons - ledger.photons:  # at best: the bake may not have so many
            self.budget_rays = math.inf
            return True
        rays = (_RAYS_EACH + _RAYS_BY_ERROR / settings.error) * stated.indirect * self.n_texel
        photons = ledger.told * (grow_photons(noise2, wanted2, degree) - 1.0) / weigh()
        instead = photons * ledger.rays / ledger.photons
        if instead <= rays:
            return False
        if math.isinf(self.budget_rays):
            self.budget_rays = ledger.gathered + instead
        return True
