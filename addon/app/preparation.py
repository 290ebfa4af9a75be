"""What Blender itself has to do for a bake beside its window, a little at a time, so that the window never stands still."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from ..read.steps import Pause, Steps

T = TypeVar("T")


class Preparation(Generic[T]):
    """The scene being read, or the first light being put on. Where the scene changes between two steps, all is done again, at once.

    begin     gives the steps anew
    version   a number that grows with every change of Blender's data
    holds     the scene must not change now: it looks as it is rendered, or is read
    is_long   the next step may take seconds: the world is read
    """

    def __init__(self, begin: Callable[[], Steps[T]], version: Callable[[], int]) -> None:
        self._begin, self._version = begin, version
        self._steps: Steps[T] | None = None
        self._seen = 0
        self._is_whole = False
        self.holds, self.is_long = True, False

    def advance(self, seconds: float) -> T | None:
        """Work for about so many seconds of this thread's processor, or without a pause; gives the result once it is there.

        By the clock, little or nothing would be done on a machine that is busy, where Blender takes seconds between two calls.

        Raises what the steps raise.
        """
        if self._version() != self._seen:
            self.give_back()
        sent = self._steps is not None or None
        self._steps = self._steps or self._begin()
        until, is_whole = time.thread_time() + seconds, self._is_whole or seconds == math.inf
        while True:
            try:
                pause = self._steps.send(sent)
            except StopIteration as end:
                result: T = end.value
                return result
            self.holds, self.is_long = pause not in (Pause.FREE, Pause.ASIDE), pause is Pause.LONG
            if not is_whole and (pause in (Pause.WAIT, Pause.LONG, Pause.ASIDE) or time.thread_time() >= until):
                break
            sent = None if is_whole else False
        self._seen = self._version()
        return None

    def give_back(self) -> None:
        """Put the scene back as it was, before it changes."""
        if self.holds and self._steps is not None:
            self._is_whole = True
            self.close()

    def close(self) -> None:
        """Put everything back, and do no more."""
        if self._steps is not None:
            self._steps.close()
            self._steps = None
