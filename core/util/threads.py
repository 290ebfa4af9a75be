"""Work on texel entries by threads of this process, which run in parallel while numpy and embree release the interpreter lock."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from .progress import Say

T = TypeVar("T")

# Entries at a time. With fewer, numpy's calls are short and threads wait for the interpreter lock: with a quarter of _MOST, two threads
# were no faster than one. A small page is divided nevertheless.
_LEAST, _MOST = 1 << 16, 1 << 18
_PARTS = 8


def count_usable() -> int:
    """Number of processors that this process may use; a batch system or a container may allow fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def is_alone() -> bool:
    """Whether this process has only one thread; False except on Linux, where it is known."""
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:
        return False


def split_entries(count: int, within: slice | None = None) -> list[slice]:
    """Ranges that divide `count` entries, at least one; they do not depend on the number of threads.

    within   divides only these entries, which are then numbered from the first of them
    """
    step = min(max(count // _PARTS, _LEAST), _MOST)
    low, high = (within.start, within.stop) if within else (0, count)
    first = low - low % step
    return [slice(max(start, low) - low, min(start + step, high) - low) for start in range(first, max(high, first + 1), step)]


def run_on_threads(
    work: Callable[[slice], T], count: int, threads: int, say: Say = lambda share: None, within: slice | None = None
) -> list[T]:
    """Results of `work` for each part of `count` entries, in order; its errors are raised.

    say      receives the finished share of the parts; if it raises, no further part is begun
    within   as for split_entries
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
