"""A process of an executor on this machine: its start and end, and the transfer of results."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import pickle
import select
import signal
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

# Bytes of a result that a pipe takes whole or not at all, with what a pool writes around it. Source: POSIX, write() of {PIPE_BUF} bytes
_AT_ONCE = getattr(select, "PIPE_BUF", 512) - 256


def start(load_ahead: Callable[[], None]) -> None:
    """Before the first call; `load_ahead` loads what calls will need."""
    atexit.register(os._exit, 0)  # interpreter shutdown would take time from the others, and the system frees all
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the main process decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a copy would inherit the main process's handler
    load_ahead()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Exit with the main process: if it is killed, it cannot announce the end of work, and its workers would wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()  # a copy holds open the pipes of earlier copies, so that the last copy ends first
        os._exit(1)


def time_call(run: Callable[[], T]) -> tuple[T, float, float]:
    """The result of `run`, the seconds that it took, and the CPU seconds of this process meanwhile."""
    begin, cpu_begin = time.perf_counter(), time.process_time()
    result = run()
    return result, time.perf_counter() - begin, time.process_time() - cpu_begin


def keep_result(run: Callable[[], Any], folder: str) -> bytes | str:
    """The result of `run`, pickled; where a pipe would not take it at once, the name of a file that holds it.

    From a process killed while it writes, the main one would have a part and wait for the rest for ever, for it holds the pipe open itself.
    And a full pipe would block this process until the main one, which traces, has read it.
    """
    result = pickle.dumps(run(), pickle.HIGHEST_PROTOCOL)
    if len(result) <= _AT_ONCE:
        return result
    try:
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            file.write(result)
    except OSError:  # no room there
        return result
    return file.name


def fetch_result(kept: bytes | str) -> Any:
    """The result given to keep_result; a file is removed."""
    if isinstance(kept, bytes):
        return pickle.loads(kept)
    file = Path(kept)
    result = file.read_bytes()
    file.unlink()
    return pickle.loads(result)
