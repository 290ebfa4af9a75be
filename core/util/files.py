"""Atomic writing of files, and reading of untrusted files with limits."""

import json
import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

_MOST_JSON_BYTES = 1 << 20


def save_whole(file: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write an .npz that replaces another file only when it is complete.

    Raises OSError if it cannot be written.
    """
    with write_aside(file) as unfinished, open(unfinished, "xb") as out:
        write_arrays(out, arrays)


def write_arrays(out: IO[bytes], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write an .npz into an open file.

    np.savez is not used: if the disk is full it leaves its archive open, and Python then prints that it could not close it.
    Raises OSError if the file cannot be written.
    """
    with zipfile.ZipFile(out, "w") as members:
        for name, array in arrays.items():
            with members.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.save(member, array, allow_pickle=False)


def write_text_whole(file: Path, text: str) -> None:
    """As save_whole, for a text in UTF-8."""
    with write_aside(file) as unfinished, open(unfinished, "xb") as out:
        out.write(text.encode())


@contextmanager
def write_aside(file: Path) -> Iterator[Path]:
    """A path beside `file` to write to: at the end it takes the place of `file`, or is removed if something failed."""
    unfinished = file.with_name(f".{file.name.removeprefix('.')}.{os.getpid()}.part")
    try:
        unfinished.unlink(missing_ok=True)  # a link of that name could lead to another user's file
        yield unfinished
        os.replace(unfinished, file)
    finally:
        unfinished.unlink(missing_ok=True)


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text.

    Raises ValueError if it is not valid, or is nested so deeply that reading it would end the process.
    """
    try:
        return json.loads(text)
    except RecursionError as reason:
        raise ValueError("is nested too deeply") from reason


def read_json(file: Path) -> Any:
    """The value of a small JSON file.

    Raises OSError if it cannot be read, ValueError if it is damaged or larger than any that we write.
    """
    with open(file, "rb") as stored:
        content = stored.read(_MOST_JSON_BYTES + 1)
    if len(content) > _MOST_JSON_BYTES:
        raise ValueError(f"{file.name}: is larger than {_MOST_JSON_BYTES:,} bytes")
    return parse_json(content)


def load_arrays(file: Path) -> dict[str, NDArray[Any]]:
    """The arrays that save_whole wrote. None of them may take more memory than the file takes on disk.

    Raises OSError if it cannot be read, ValueError if it is damaged or compressed, or if it contains pickled objects.
    """
    try:
        with zipfile.ZipFile(file) as members:
            most = file.stat().st_size
            if any(one.compress_type != zipfile.ZIP_STORED or one.file_size > most for one in members.infolist()):
                raise ValueError(f"{file.name}: is compressed, or says that it is larger than it is")
        with np.load(file, allow_pickle=False) as stored:
            return dict(stored.items())
    except (zipfile.BadZipFile, EOFError, KeyError, TypeError, AttributeError, NotImplementedError, MemoryError, OverflowError) as reason:
        raise ValueError(f"{file.name}: is damaged ({reason})") from reason
