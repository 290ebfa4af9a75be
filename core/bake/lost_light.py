"""Light that is lost by the limit of bounces.

In a closed room whose surfaces reflect a share p of the light, p^n of it is left after n bounces: 37 % for p = 0.999 and n = 1,000.
"""

from __future__ import annotations

import math
from dataclasses import replace

from ..integrate.light_field import LightField
from ..util.settings import Settings

_WORTH_A_WORD = 0.01


def state_lost(light: LightField, settings: Settings) -> tuple[LightField, list[tuple[str, str]]]:
    """The light with the loss added to its stated error, and warnings (subject, sentence).

    The loss is added after the stop rules, since more photons do not reduce it.
    """
    lost = light.ledger.find_lost() if settings.wants_all_light else 0.0
    if not lost:
        return light, []
    sentence = (
        f"{lost:.0%} of the light was still under way after {settings.max_depth:,} surfaces and is missing, for they reflect nearly all; "
        "give the whitest materials a darker Base Color, as paint has (0.8), or raise Max Depth (--max-depth)"
    )
    return replace(light, error=math.hypot(light.error, lost)), [("", sentence)] if lost >= _WORTH_A_WORD else []
