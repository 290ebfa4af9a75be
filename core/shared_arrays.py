"""Frozen dataclasses of arrays as a folder of .npy files, which processes map into memory and so share."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import DTypeLike, NDArray

T = TypeVar("T")

_LEAST_FILE = 1 << 20  # bytes from which on an array is worth a file before all of them are written; also how much of it is written at once


@dataclass(frozen=True)
class Room:
    """Where large arrays that save_struct will write are filled: in its folder at once, or in memory where there is none.

    New memory is cleared by the system page by page. Arrays that are filled there and then written take it twice. Processes of this machine
    see what is filled; others once it is synchronised, see cluster.stamp_folder.
    """

    folder: Path | None = None

    def within(self, name: str) -> Room:
        """For the fields of a field."""
        return Room(self.folder / name) if self.folder else self

    def empty(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """An array for the field `name`. Raises OSError where its file finds no place on the disk."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if self.folder is None or size < _LEAST_FILE:
            return np.empty(shape, dtype)
        # Written before it is mapped: who fills a mapped file of which the disk has no place ends at once, and a system that is
        # asked for a file's pages one by one takes longer.
        nothing = (bytes(min(_LEAST_FILE, size - start)) for start in range(0, size, _LEAST_FILE))
        return _write_and_map(self.folder, name, nothing, shape, dtype, "r+")

    def collect(self, name: str, count: int, dtype: DTypeLike, parts: Iterable[NDArray[Any]]) -> NDArray[Any]:
        """An array (count,) for the field `name` of parts (n,) that follow each other and fill it; nobody may change it any more.

        It is written once, where what `empty` gives is cleared first. Raises OSError as `empty` does.
        """
        if self.folder is None or count * np.dtype(dtype).itemsize < _LEAST_FILE:
            out = np.concatenate([np.empty(0, dtype), *parts], dtype=dtype, casting="unsafe")
            out.flags.writeable = False
            return out
        return _write_and_map(self.folder, name, (np.ascontiguousarray(part, dtype).data for part in parts), (count,), dtype, "r")


def _write_and_map(
    folder: Path, name: str, contents: Iterable[bytes | memoryview], shape: tuple[int, ...], dtype: DTypeLike, mode: Literal["r", "r+"]
) -> NDArray[Any]:
    """The field's file, mapped; `contents` follow each other in it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.npy"
    path.unlink(missing_ok=True)  # as in save_struct
    with open(path, "w+b") as file:
        told = {"descr": np.dtype(dtype).str, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, told)  # type: ignore[no-untyped-call]
        offset = file.tell()
        for part in contents:
            file.write(part)
        file.flush()
        mapped = np.memmap(file, dtype, mode, offset, shape)
    array: NDArray[Any] = mapped.view(np.ndarray)
    return array


IN_MEMORY = Room()


def save_struct(folder: Path, struct: Any) -> None:
    """Write a dataclass whose fields are arrays, plain numbers or such dataclasses, or None; `folder` is made.

    Arrays of a Room of that folder are there already.
    """
    folder.mkdir(parents=True, exist_ok=True)
    plain: dict[str, Any] = {}
    for field in dataclasses.fields(struct):
        value = getattr(struct, field.name)
        if isinstance(value, np.ndarray):
            file = folder / f"{field.name}.npy"
            if not _is_of_file(value, file):
                file.unlink(missing_ok=True)  # not emptied, for someone may have it mapped
                np.save(file, value)
        elif dataclasses.is_dataclass(value):
            save_struct(folder / field.name, value)
        else:
            plain[field.name] = value
    (folder / "plain.json").write_text(json.dumps(plain), encoding="utf-8")


@contextmanager
def laid_out(folder: Path, struct: Any) -> Iterator[str]:
    """A folder within `folder` that has never been, with the struct in it until the work on it has ended, well or not."""
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as place:
        save_struct(Path(place), struct)
        yield place


def _is_of_file(array: NDArray[Any], file: Path) -> bool:
    """Whether an array is what a Room made of that file; numpy says of its parts that they are based on it, not on the file."""
    mapped = array.base
    return isinstance(mapped, np.memmap) and Path(str(mapped.filename)) == file


def load_struct(folder: Path, cls: type[T]) -> T:
    """The dataclass of save_struct, its arrays mapped read-only."""
    values: dict[str, Any] = json.loads((folder / "plain.json").read_text(encoding="utf-8"))
    hints = get_type_hints(cls)
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        if field.name in values:
            continue
        file = folder / f"{field.name}.npy"
        if file.exists():
            array = np.load(file, mmap_mode="r" if file.stat().st_size > 4096 else None)
            values[field.name] = array.view(np.ndarray)  # np.memmap's own indexing is slow
        else:
            hint = hints[field.name]
            inner: Any = next(filter(dataclasses.is_dataclass, get_args(hint)), hint)  # of one that may be None
            values[field.name] = load_struct(folder / field.name, inner)
    return cls(**values)


def remove_struct(folder: Path) -> None:
    """Delete what save_struct wrote, where the system lets a mapped file go; the rest goes with the job's folder."""
    shutil.rmtree(folder, ignore_errors=True)
