"""How much of a bake is done, and how long the rest takes, from the messages of its stages; no bpy here."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from ...core.util.messages import Progress, Status

_BAR = {  # the part of the bar that each stage takes
    "read": (0.0, 0.03),
    "load": (0.03, 0.04),
    "charts": (0.04, 0.1),
    "texels": (0.1, 0.13),
    "scene": (0.13, 0.14),
    "contacts": (0.14, 0.2),
    "preview": (0.2, 0.21),
    "direct": (0.21, 0.4),
    "photons": (0.4, 0.93),
    "write": (0.93, 0.98),
    "keep": (0.98, 1.0),
}
_AFTER_LIGHT = ("write", "keep")
_GATHERED = 0.8  # of the way to the error asked for, that light which is gathered once goes: some texels' has to be so again
_AGREES = 0.5  # two predictions of the end, apart by this share of the time that is left


@dataclass
class Bar:
    """The bar of one bake.

    fraction    of the whole bake that is done, every stage counted; it never falls
    is_writing  the light is found
    """

    fraction: float = 0.0
    is_writing: bool = False
    _has_light: bool = False
    _traced: float = 0.0  # of the way to the error asked for
    _share: float = 0.0  # of the light that is gathered, about which the photons' error says nothing
    _before: float = 0.0  # _traced, when that began
    _ends: tuple[float, ...] = ()  # by time.monotonic(), as the last two rounds predict the end of the photons

    def hear_status(self, said: Status) -> None:
        """A stage begins, or says how far it is."""
        if said.stage in _AFTER_LIGHT:
            self.is_writing = True
            self._advance(said.stage, said.share)
        elif not self._has_light:
            if said.stage != "photons":  # some fly before the direct light, and do not say how many
                self._advance(said.stage, said.share)
        elif said.stage == "photons":
            if said.share < self._share:  # another look at the texels
                self._before = self._traced
            self._share = said.share
            self._traced = max(self._traced, self._before + _GATHERED * said.share * (1.0 - self._before))
            self._advance("photons", self._traced)

    def hear_progress(self, said: Progress) -> None:
        """A round of photons is done; a later one may know better, and say less."""
        self._has_light, self._share = True, 0.0
        self._before = self._traced = max(self._traced, said.fraction)
        self._advance("photons", self._traced)
        self._ends = (*self._ends[-1:], time.monotonic() + said.seconds_left) if math.isfinite(said.estimated_error) else ()

    def predict_seconds(self) -> float:
        """Seconds until the photons are done; 0 where two rounds have not predicted the same end yet, or light is gathered meanwhile."""
        if len(self._ends) < 2 or self._share or self.is_writing:
            return 0.0
        left = self._ends[1] - time.monotonic()
        return left if abs(self._ends[1] - self._ends[0]) <= _AGREES * left else 0.0

    def _advance(self, stage: str, share: float) -> None:
        start, end = _BAR.get(stage, (0.0, 0.0))
        self.fraction = max(self.fraction, start + share * (end - start))
