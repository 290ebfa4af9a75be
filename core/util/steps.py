"""Work that is done a step at a time: a window is drawn between steps, the command line takes them all at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from enum import Enum
from typing import Any, TypeVar

T = TypeVar("T")
_LOOK_S = 0.005  # between two looks at a thread


class Pause(Enum):
    """What may happen before the next step.

    HOLD   the scene must not change
    WAIT   the same, and there is nothing to do yet: others are at work
    LONG   the same, and the next step may take seconds: the world is read
    FREE   anything: the rest needs nothing of Blender
    """

    HOLD = 0
    WAIT = 1
    LONG = 2
    FREE = 3


# A step is sent True where there was a pause before it, False where not, None by those who never pause.
Steps = Generator[Pause, bool | None, T]


def run_steps(steps: Generator[Any, Any, T], watch: Callable[[Any], None] = lambda _: None) -> T:
    """The result of work whose steps are all taken at once; `watch` is given each pause."""
    while True:
        try:
            watch(next(steps))
        except StopIteration as end:
            result: T = end.value
            return result


def run_aside(call: Callable[[], T]) -> Steps[T]:
    """The result of a call that needs nothing of Blender, made by a thread meanwhile."""
    with ThreadPoolExecutor(1) as pool:
        begun = pool.submit(call)
        while not begun.done() and (yield Pause.FREE) is not None:
            time.sleep(_LOOK_S)
        return begun.result()
