"""The time limit of a bake as wall time: from the request until its images are written and shown."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from ..filter.denoise import Spread
from ..util.messages import Status
from ..util.progress import Watch
from ..util.settings import Settings

# Predicted times of writing (which filters the light once more, draws pages and fills margins) and of one estimate of the light, over the
# time in which the texels were measured, which is known by then. Measured on five scenes of 512 to 1024 texels: 0.8 to 3.3, and 1.5 to 2.8.
# Writing takes at least so many seconds for each texel of a page, since a page of one large chart is measured fast.
_WRITE_OF_TEXELS, _LIGHT_OF_TEXELS, _WRITE_OF_PAGES_S = 2.5, 1.5, 1e-6
_WRITE_OF_LIGHT = 2.2  # time of writing over that of an estimate of the light, once that is known; measured 1.2 to 2.2
_SPARE = 1.2  # safety factor on the time of the last estimate: the next one may take longer
_GRACE_SHARE, _GRACE_S = 0.1, 2.0  # a bake without any light yet may exceed the limit by the greater of both
_UNKNOWN_PHOTONS = 1 << 18  # most photons of a round whose speed is not known yet
_FIRST_ERROR = 0.05  # relative, of a first estimate
_SOON = 0.1  # share of the time left after which the forecast of a stage is used
_LEAST_STEPS = 5  # steps before their mean time is used: the first results of several processes come late, and together
_FITS = 0.85  # share of the time left that a stage may take
_CONTACTS = 0.25  # share of it that the search for contacts may take


class OutOfTime(Exception):
    """A stage that a bake can do without would take too long."""


@dataclass
class Deadline:
    """Deadline of a bake, and the estimated time of its end.

    limit_s   seconds, 0 no limit
    began     time.monotonic() of the request for the bake, in any process of this machine
    after_s   seconds that Blender will take once the images are written
    """

    limit_s: float = 0.0
    began: float = field(default_factory=lambda: time.monotonic())
    after_s: float = 0.0
    _texels_s: float = 0.0
    _pages_s: float = 0.0
    _light_s: float = 0.0  # longest estimate of the light
    _last_s: float = 0.0
    _photons_per_s: float = 0.0

    @property
    def reserve_s(self) -> float:
        """Seconds that the end of the bake takes: one more estimate of the light, and the images."""
        write_s = max(_WRITE_OF_TEXELS * self._texels_s, _WRITE_OF_LIGHT * self._light_s, self._pages_s)
        return self.after_s + write_s + (_SPARE * self._last_s if self._light_s else _LIGHT_OF_TEXELS * self._texels_s)

    def left(self) -> float:
        """Seconds left for improving the light, infinity without a limit."""
        return self.began + self.limit_s - self.reserve_s - time.monotonic() if self.limit_s else math.inf

    def is_over(self) -> bool:
        """Whether to write the best light so far."""
        return self.left() <= 0.0

    def is_write_late(self) -> bool:
        """Whether pages must be drawn now from the present light."""
        return bool(self.limit_s) and time.monotonic() > self.began + self.limit_s - self.after_s - self._pages_s

    def limit_spread(self, spread: Spread, is_late: Callable[[], bool]) -> Spread:
        """Wrap `spread` so that it yields no more results once time is up."""

        def limited(fn: Callable[..., Any], calls: Iterable[tuple[Any, ...]]) -> Iterable[Any]:
            answers = spread(fn, calls)  # called at once, so that other processes can begin
            return _take_until(answers, is_late) if self.limit_s else answers

        return limited

    def is_lost(self) -> bool:
        """Whether a bake without any light is too late to get some."""
        return bool(self.limit_s) and time.monotonic() - self.began > self.limit_s + max(_GRACE_SHARE * self.limit_s, _GRACE_S)

    def note_texels(self, seconds: float, page_texels: int = 0, slowness: float = 1.0) -> None:
        """Record the seconds in which the texels were measured.

        page_texels   number of texels of all pages
        slowness      wall seconds over CPU seconds
        """
        self._texels_s, self._pages_s = seconds, _WRITE_OF_PAGES_S * page_texels * max(slowness, 1.0)

    def note_light(self, seconds: float) -> None:
        """Record the seconds of an estimate of the light with its error."""
        self._last_s, self._light_s = seconds, max(self._light_s, seconds)

    def note_round(self, photons: int, seconds: float) -> None:
        """Record the seconds of a round of photons."""
        self._photons_per_s = photons / max(seconds, 1e-6)

    def cap_photons(self, photons: int) -> int:
        """Number of photons of a round, at most `photons`, that can be traced in the time left."""
        if not self.limit_s:
            return photons
        if not self._photons_per_s:
            return min(photons, _UNKNOWN_PHOTONS)
        return max(min(photons, int(_FITS * self.left() * self._photons_per_s)), 0)

    def ease(self, settings: Settings) -> Settings:
        """Settings of a first estimate at all texels: coarse if time is limited, so that time remains to improve the worst texels."""
        return replace(settings, error=max(settings.error, _FIRST_ERROR)) if self.limit_s else settings

    def foresee(self, steps: int) -> Callable[[], bool]:
        """A function to call after each of the steps, which returns whether they will exceed the time left; once true it stays true.

        It extrapolates the mean time of the steps after the first, which also opens the scene in the processes that trace.
        """
        began, left = time.monotonic(), self.left()
        done, first, is_late = 0, 0.0, False

        def is_too_late() -> bool:
            nonlocal done, first, is_late
            done += 1
            passed = time.monotonic() - began
            first = first or passed
            each = (passed - first) / max(done - 1, 1)
            forecast = passed + (each * (steps - done) if done >= _LEAST_STEPS and passed > _SOON * left else 0.0)
            is_late = is_late or (bool(self.limit_s) and forecast > _FITS * left)
            return is_late

        return is_too_late

    def watch_contacts(self, watch: Watch) -> Watch:
        """A Watch that raises OutOfTime once the search for contacts has used its share of the time left."""
        began, left = time.monotonic(), self.left()

        def say(said: Status, share: float, about: str) -> None:
            if self.limit_s and time.monotonic() - began > _CONTACTS * left:
                raise OutOfTime
            watch(said, share, about)

        return say


def _take_until(answers: Iterable[Any], is_late: Callable[[], bool]) -> Iterator[Any]:
    for answer in answers:
        yield answer
        if is_late():
            return
