"""Progress messages at intervals, and cancellation."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

from .messages import Message, Status

Watch: TypeAlias = Callable[[Status, float, str], None]  # as ProgressReporter.say
Say: TypeAlias = Callable[[float], None]  # takes the finished share of the work; may raise Interrupted

SECONDS_BETWEEN_WORDS = 1.0


def unwatched(said: Status, share: float, about: str) -> None:
    """A Watch that does nothing."""


def stretch(watch: Watch, said: Status, start: float = 0.0, end: float = 1.0) -> Say:
    """A Say for work that takes a stage from the share `start` to the share `end`."""
    return lambda share: watch(said, start + share * (end - start), "")


class Interrupted(Exception):
    """The bake was stopped before there was any light to keep."""


@dataclass
class ProgressReporter:
    """Sends the progress messages of a stage, after its first.

    should_stop   checked at every call of `say`, for work that is useless unless finished; not in the first half second, so that short work
                  may finish
    """

    tell: Callable[[Message], None]
    should_stop: Callable[[], bool] = lambda: False
    _began: float = 0.0
    _spoke: float = 0.0
    _said: Status | None = None

    def __post_init__(self) -> None:
        self._began = self._spoke = time.monotonic()

    def say(self, said: Status, share: float, about: str = "") -> None:
        """Report the finished share of stage `said`, at most once per interval and only if the message has changed.

        about   name of the current object or task
        Raises Interrupted if should_stop() holds.
        """
        now = time.monotonic()
        if now - self._began > SECONDS_BETWEEN_WORDS / 2 and self.should_stop():
            raise Interrupted
        if now - self._spoke <= SECONDS_BETWEEN_WORDS:
            return
        status = replace(said, text=f"{said.text}, {share:.0%}" + (f": {about}" if about else ""), share=share)
        if status != self._said:
            self._spoke, self._said = now, status
            self.tell(status)
