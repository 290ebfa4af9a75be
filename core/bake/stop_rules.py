"""Stop rules of a bake, and its progress."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from ..integrate.light_field import LightField
from ..util.messages import Progress
from ..util.settings import Settings
from .deadline import Deadline


@dataclass(frozen=True)
class StopRules:
    """Stop rules of one bake.

    should_stop   returns whether the user wants to stop with the best light so far; once true it stays true
    started       time.monotonic() at the start
    deadline      that of the whole bake; None if the time limit counts from `started`
    """

    settings: Settings
    should_stop: Callable[[], bool]
    started: float
    deadline: Deadline | None = None

    def is_late(self) -> bool:
        if self.deadline is not None:
            return self.deadline.is_over()
        return 0.0 < self.settings.time_limit <= time.monotonic() - self.started

    def break_off(self) -> bool:
        """Whether to abandon work under way."""
        return self.should_stop() or self.is_late()

    def find_reason(self, error: float, photons: int) -> str:
        """The reason to stop after so many photons with this stated error, as LightField.stopped_by; "" for none."""
        if self.should_stop():
            return "interrupted"
        if error <= self.settings.error:
            return "error"
        if self.settings.max_photons - photons < 2:
            return "max_photons"
        return "time_limit" if self.is_late() else ""

    def measure_progress(self, light: LightField, before: int) -> Progress:
        """before   photons that an earlier bake traced"""
        seconds = max(time.monotonic() - self.started, 1e-6)
        settings = self.settings
        fractions = [light.photons / settings.max_photons]
        if light.error > 0.0:
            fractions.append(min((settings.error / light.error) ** 2, 1.0))
        if settings.time_limit:
            left = seconds + self.deadline.left() if self.deadline else settings.time_limit
            fractions.append(seconds / left if left > 0.0 else 1.0)
        fraction = 1.0 if light.stopped_by else min(max(fractions), 1.0)
        done = fraction * (1.0 - before / max(light.photons, 1))  # by this bake
        left = seconds * (1.0 - fraction) / done if done > 0.0 else math.nan
        return Progress(fraction, light.photons, (light.photons - before) / seconds, light.error, left, len(light.leaves))
