"""What a process does to which an executor of this machine gives calls: how it begins and ends, and how it hands over what they give."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import pickle
import signal
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from . import denoise, photon_shards, workers

_OF_SHARDS = denoise, photon_shards, workers  # with functions that a process is given: loaded with this module, not by the first of them
_MUCH = 1 << 16  # bytes


def start() -> None:
    """Before the first call."""
    atexit.register(os._exit, 0)  # to take Python apart would take time from the others, and what is left is the system's to free
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the main process decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a copy would do what the main process does then
    workers.load_ahead()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A main process that is killed cannot say that no more work comes: its workers would wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()  # a copy holds open what tells those before it, so that of copies the last ends first
        os._exit(1)


def keep_result(run: Callable[[], Any], folder: str) -> bytes | str:
    """What `run` gives, pickled; if that is much, the name of a file that holds it: a pipe is full with 64 KB, and this process would
    wait for the main one, which traces, to read it all."""
    result = pickle.dumps(run(), pickle.HIGHEST_PROTOCOL)
    if len(result) < _MUCH:
        return result
    try:
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            file.write(result)
    except OSError:  # no room there
        return result
    return file.name


def fetch_result(kept: bytes | str) -> Any:
    """What keep_result was given; a file is taken away."""
    if isinstance(kept, bytes):
        return pickle.loads(kept)
    file = Path(kept)
    result = file.read_bytes()
    file.unlink()
    return pickle.loads(result)
