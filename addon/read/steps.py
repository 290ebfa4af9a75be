"""Work in steps: a window can be redrawn between steps, while the command line runs all of them at once."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from enum import Enum
from typing import Any, TypeVar

T = TypeVar("T")


class Pause(Enum):
    """What may happen before the next step.

    HOLD   anything that does not change the scene
    WAIT   the same; there is nothing to do yet, since other processes or threads work
    LONG   the same; the next step may take seconds, as reading the world does
    FREE   anything, since the rest does not use Blender
    ASIDE  the same as both FREE and WAIT
    """

    HOLD = 0
    WAIT = 1
    LONG = 2
    FREE = 3
    ASIDE = 4


# A step is sent True if there was a pause before it, False if not, and None by callers that never pause.
Steps = Generator[Pause, bool | None, T]


def run_steps(steps: Generator[Any, Any, T], watch: Callable[[Any], None] = lambda _: None) -> T:
    """Run all steps at once and return their result; `watch` receives each pause."""
    while True:
        try:
            watch(next(steps))
        except StopIteration as end:
            return end.value


def never_halved(steps: Steps[T]) -> Steps[T]:
    """The same steps. Closing them runs the rest at once: what they change must not be left half done."""
    sent = None
    while True:
        try:
            pause = steps.send(sent)
        except StopIteration as end:
            result: T = end.value
            return result
        try:
            sent = yield pause
        except GeneratorExit:
            with contextlib.suppress(ReferenceError):  # the scene was deleted meanwhile
                run_steps(steps)
            raise


def run_aside(call: Callable[[], T]) -> Steps[T]:
    """The result of a call that does not use Blender, which a thread runs meanwhile."""
    with ThreadPoolExecutor(1) as pool:
        begun = pool.submit(call)
        while not begun.done() and (yield Pause.ASIDE) is not None:
            pass
        return begun.result()
