"""Light lost by the limit of bounces.

In a closed room of surfaces that reflect a share p of the light, p^n of it is, after n of them: 37 % of it where p is 0.999 and n is 1,000.
"""

from __future__ import annotations

import math
from dataclasses import replace

from ..integrate.light_field import LightField
from ..util.settings import Settings

_WORTH_A_WORD = 0.01


def state_lost(light: LightField, settings: Settings) -> tuple[LightField, list[tuple[str, str]]]:
    """The light with the loss added to its stated error, and warnings (subject, sentence).

    More photons do not reduce it, so that no bake continues for it.
    """
    lost = light.ledger.find_lost() if settings.wants_all_light else 0.0
    if not lost:
        return light, []
    sentence = (
        f"{lost:.0%} of the light was still under way after {settings.max_depth:,} surfaces and is missing, for they reflect nearly all; "
        "give the whitest materials a darker Base Color, as paint has (0.8), or raise --max-depth"
    )
    return replace(light, error=math.hypot(light.error, lost)), [("", sentence)] if lost >= _WORTH_A_WORD else []
