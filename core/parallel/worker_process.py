"""Start and end of an executor's process on this machine, and the transfer of results."""

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

# Greatest result that a pipe takes atomically, together with what a pool adds. Source: POSIX, write() of {PIPE_BUF} bytes
_AT_ONCE = getattr(select, "PIPE_BUF", 512) - 256


def start(load_ahead: Callable[[], None]) -> None:
    """Set up the process before its first call; `load_ahead` loads what calls will need."""
    atexit.register(os._exit, 0)  # skips the interpreter's shutdown, which would take time; the system frees everything
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the main process decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a fork inherits the main process's handler
    load_ahead()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Exit with the main process: if that is killed, it cannot announce the end of work, and its workers would wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()  # forks hold the pipes of earlier ones open, so they end in reverse order
        os._exit(1)


def time_call(run: Callable[[], T]) -> tuple[T, float, float]:
    """The result of `run`, its wall seconds, and the CPU seconds of this process meanwhile."""
    begin, cpu_begin = time.perf_counter(), time.process_time()
    result = run()
    return result, time.perf_counter() - begin, time.process_time() - cpu_begin


def keep_result(run: Callable[[], Any], folder: str) -> bytes | str:
    """The pickled result of `run`; or, if a pipe would not take it atomically, the name of a file with it.

    If a process were killed while it writes to the pipe, the main process would wait for the rest for ever, since it holds the pipe open
    itself. And a full pipe would block this process until the main one, which also traces, reads it.
    """
    result = pickle.dumps(run(), pickle.HIGHEST_PROTOCOL)
    if len(result) <= _AT_ONCE:
        return result
    try:
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            file.write(result)
    except OSError:  # the disk is full
        return result
    return file.name


def fetch_result(kept: bytes | str) -> Any:
    """The result of keep_result; its file is removed."""
    if isinstance(kept, bytes):
        return pickle.loads(kept)
    file = Path(kept)
    result = file.read_bytes()
    file.unlink()
    return pickle.loads(result)
