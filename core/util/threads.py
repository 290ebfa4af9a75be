"""Work on texel entries by threads of this process, side by side where numpy and embree let go of the interpreter."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from .progress import Say

T = TypeVar("T")

# Entries at a time. Of fewer numpy's calls are soon done, and threads wait for each other to have the interpreter: with a quarter of the
# most two of them were no quicker than one. A small page is shared all the same.
_LEAST, _MOST = 1 << 16, 1 << 18
_PARTS = 8


def count_usable() -> int:
    """Processors that this process may use, as where a batch system or a container gives it some of a machine's."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def is_alone() -> bool:
    """Whether this process has one thread, which is known only on Linux."""
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:
        return False


def split_entries(count: int, within: slice | None = None) -> list[slice]:
    """Parts of so many entries, one at least, and the same for any number of threads.

    within   only of these entries, which are then numbered from the first of them
    """
    step = min(max(count // _PARTS, _LEAST), _MOST)
    low, high = (within.start, within.stop) if within else (0, count)
    first = low - low % step
    return [slice(max(start, low) - low, min(start + step, high) - low) for start in range(first, max(high, first + 1), step)]


def run_on_threads(
    work: Callable[[slice], T], count: int, threads: int, say: Say = lambda share: None, within: slice | None = None
) -> list[T]:
    """Results of `work` for each part of so many entries, in order; its errors are raised.

    say      receives the share of parts that are done; if it raises, no further part is begun
    within   as split_entries has it
    """
    parts, found = split_entries(count, within), list[T]()
    pool = ThreadPoolExecutor(threads)
    try:
        for one in pool.map(work, parts):
            found.append(one)
            say(len(found) / len(parts))
    finally:
        pool.shutdown(cancel_futures=True)
    return found
