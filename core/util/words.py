"""How far a stage has come, told now and then; and whether to go on with it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

from .messages import Message, Status

Watch: TypeAlias = Callable[[Status, float, str], None]  # as Words.say
Say: TypeAlias = Callable[[float], None]  # which share of a piece of work is done; it may raise

SECONDS_BETWEEN_WORDS = 1.0


def unwatched(said: Status, share: float, about: str) -> None:
    """A Watch where nobody listens."""


def stretch(watch: Watch, said: Status, start: float = 0.0, end: float = 1.0) -> Say:
    """For a piece of work that takes a stage from the share `start` to the share `end`."""
    return lambda share: watch(said, start + share * (end - start), "")


class Interrupted(Exception):
    """The best so far was asked for before there was any light."""


@dataclass
class Words:
    """What is told from now on; the beginning of the stage has been.

    should_stop   asked whenever there may be a word, of work that comes to nothing if it is not done; but not in the first half second:
                  what is soon over may as well come to some light
    """

    tell: Callable[[Message], None]
    should_stop: Callable[[], bool] = lambda: False
    _began: float = 0.0
    _spoke: float = 0.0
    _said: Status | None = None

    def __post_init__(self) -> None:
        self._began = self._spoke = time.monotonic()

    def say(self, said: Status, share: float, about: str = "") -> None:
        """That this share of what is `said` is done, if it is time for a word, and not the same word again.

        about   name of what is at work
        Raises Interrupted where nobody wants the rest.
        """
        now = time.monotonic()
        if now - self._began > SECONDS_BETWEEN_WORDS / 2 and self.should_stop():
            raise Interrupted
        if now - self._spoke <= SECONDS_BETWEEN_WORDS:
            return
        told = replace(said, text=f"{said.text}, {share:.0%}" + (f": {about}" if about else ""), share=share)
        if told != self._said:
            self._spoke, self._said = now, told
            self.tell(told)
