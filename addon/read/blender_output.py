"""What Blender and its add-ons print by themselves, past Python's streams."""

from __future__ import annotations

import ctypes
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

# Blender's reports, its log (time, category, text) and Python's, of levels below a warning; and empty lines.
_NEWS = re.compile(rb"\s*$|Info: |INFO[ :]|\d+:\d+\.\d+ +\S+ +\| (?!WARN|ERROR|FATAL)")


@contextmanager
def hold_output(quiet: bool = False) -> Iterator[None]:
    """Nothing is printed until the end; then all of it is, but nothing where an exception ends it, whose sentence says what matters.

    quiet   leave out what is no warning and no error
    """
    with tempfile.TemporaryFile() as held:
        _flush()
        kept = [os.dup(number) for number in (1, 2)]
        for number in (1, 2):
            os.dup2(held.fileno(), number)
        try:
            yield
        except BaseException:
            _let_go(kept)
            raise
        _let_go(kept)
        held.seek(0)
        os.write(2, b"".join(line for line in held if not (quiet and _NEWS.match(line))))


def _let_go(kept: list[int]) -> None:
    _flush()
    for number, copy in zip((1, 2), kept, strict=True):
        os.dup2(copy, number)
        os.close(copy)


def _flush() -> None:
    """What Python holds back, and the C library, through which Blender prints."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    if os.name == "posix":
        ctypes.CDLL(None).fflush(None)
