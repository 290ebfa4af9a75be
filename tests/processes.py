"""Processes as Linux tells of them, and as an executor does."""

import time
from collections.abc import Iterable
from pathlib import Path

from leaflight.core.parallel import executors

PATIENCE_S = 20.0


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that ended and that nobody has asked for its code does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_for_end(pids: Iterable[int]) -> list[int]:
    """Those that still run when patience ends."""
    limit, left = time.monotonic() + PATIENCE_S, list(pids)
    while any(map(is_alive, left)) and time.monotonic() < limit:
        time.sleep(0.05)
    return [pid for pid in left if is_alive(pid)]


def wait_until_ready(executor: executors.LocalExecutor) -> None:
    """Has the other processes of an executor started."""
    executor.wake()
    for _ in range(600):
        if executor._ready == executor._others:
            return
        time.sleep(0.1)
    raise AssertionError("the other processes never started")
