"""Saves frozen dataclasses of arrays as files in a folder, which processes share by mapping them into memory."""

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

from ..util.digest import hash_file, hash_pieces
from ..util.files import parse_json

T = TypeVar("T")

_LEAST_FILE = 1 << 20  # bytes; arrays of this size or more have files of their own. Also the size of writes that clear a file
_PACKED_FILE = "packed.bin"  # contains the length of a JSON index, the index, and all smaller arrays
_LENGTH_BYTES, _ALIGNMENT = 8, 64


@dataclass(frozen=True)
class Room:
    """Allocates large arrays that save_struct will save: in files of its folder, or in memory if it has no folder.

    An array in memory would take its space twice once it is saved, and the system clears new memory page by page. Other processes of this
    machine see the contents of the files at once; other machines see them after synchronisation, see cluster.stamp_folder.
    """

    folder: Path | None = None

    def within(self, name: str) -> Room:
        """The room for a nested struct in the field `name`."""
        return Room(self.folder / name) if self.folder else self

    def empty(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """An uninitialised array for the field `name`. Raises OSError if the disk is full."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if self.folder is None or size < _LEAST_FILE:
            return np.empty(shape, dtype)
        # The file is written before it is mapped: filling a sparse mapped file on a full disk kills the process, and allocating it page by
        # page is slower.
        nothing = (bytes(min(_LEAST_FILE, size - start)) for start in range(0, size, _LEAST_FILE))
        return _write_and_map(self.folder, name, nothing, shape, dtype, "r+")

    def collect(self, name: str, count: int, dtype: DTypeLike, parts: Iterable[NDArray[Any]]) -> NDArray[Any]:
        """A read-only array (count,) for the field `name`, concatenated from parts (n,).

        Its file is written once, while that of `empty` is cleared first. Raises OSError if the disk is full.
        """
        if self.folder is None or count * np.dtype(dtype).itemsize < _LEAST_FILE:
            out = np.concatenate([np.empty(0, dtype), *parts], dtype=dtype, casting="unsafe")
            out.flags.writeable = False
            return out
        return _write_and_map(self.folder, name, (np.ascontiguousarray(part, dtype).data for part in parts), (count,), dtype, "r")


def _write_and_map(
    folder: Path, name: str, contents: Iterable[bytes | memoryview], shape: tuple[int, ...], dtype: DTypeLike, mode: Literal["r", "r+"]
) -> NDArray[Any]:
    """Write `contents` in order to the field's file, and map it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.npy"
    path.unlink(missing_ok=True)  # as in save_struct
    with open(path, "w+b") as file:
        header = {"descr": np.dtype(dtype).str, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)  # type: ignore[no-untyped-call]
        offset = file.tell()
        for part in contents:
            file.write(part)
        file.flush()
        mapped = np.memmap(file, dtype, mode, offset, shape)
    return mapped.view(np.ndarray)


IN_MEMORY = Room()


def save_struct(folder: Path, struct: Any) -> None:
    """Save a dataclass whose fields are arrays, plain numbers, None or such dataclasses into `folder`, which is created.

    Large arrays have files of their own; those from a Room of that folder exist already. All others share one file, since a bake has about
    a hundred small arrays, and opening a file takes longer than writing one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    packed = _Packed()
    header = json.dumps(_put_away(folder, struct, packed)).encode()
    path = folder / _PACKED_FILE
    path.unlink(missing_ok=True)  # unlinked, not truncated, since a process may have it mapped
    with open(path, "wb") as file:
        file.write(len(header).to_bytes(_LENGTH_BYTES, "little") + header)
        begin = _align(file.tell())
        for start, array in packed.arrays:
            file.seek(begin + start)
            file.write(array.tobytes("A"))


class _Packed:
    """Arrays that are written into one file."""

    def __init__(self) -> None:
        self.arrays: list[tuple[int, NDArray[Any]]] = []  # offset in bytes, and array
        self._end = 0

    def add(self, array: NDArray[Any]) -> int:
        """Add an array and return its offset."""
        start = _align(self._end)
        self._end = start + array.nbytes
        self.arrays.append((start, array))
        return start


def _describe(array: NDArray[Any]) -> tuple[str, tuple[int, ...], str]:
    """Type, shape and memory order of an array."""
    return array.dtype.str, array.shape, "F" if array.flags.fnc else "C"


def _put_away(folder: Path, struct: Any, packed: _Packed) -> dict[str, Any]:
    """Save the large arrays of a struct and its nested structs, add the small ones to `packed`, and return an index of the fields."""
    header: dict[str, Any] = {"plain": {}, "packed": {}, "files": {}, "structs": {}}
    for field in dataclasses.fields(struct):
        name, value = field.name, getattr(struct, field.name)
        if dataclasses.is_dataclass(value):
            header["structs"][name] = _put_away(folder / name, value, packed)
        elif not isinstance(value, np.ndarray):
            header["plain"][name] = value
        elif value.dtype.kind in "OV":
            raise TypeError(f"{name}: expected an array of plain numbers, got {value.dtype}")
        elif value.nbytes < _LEAST_FILE:
            header["packed"][name] = (*_describe(value), packed.add(value))
        else:
            header["files"][name] = _describe(value)
            file = folder / f"{name}.npy"
            if not _is_of_file(value, file):
                folder.mkdir(parents=True, exist_ok=True)
                file.unlink(missing_ok=True)  # as above
                with open(file, "wb") as out:  # numpy.save does not say why a disk takes no more
                    np.lib.format.write_array_header_1_0(out, np.lib.format.header_data_from_array_1_0(value))  # type: ignore[no-untyped-call]
                    out.write((value.T if value.flags.fnc else np.ascontiguousarray(value)).data)
    return header


@contextmanager
def laid_out(folder: Path, struct: Any) -> Iterator[str]:
    """A new folder within `folder` with the saved struct; it is removed at the end."""
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as place:
        save_struct(Path(place), struct)
        yield place


def _is_of_file(array: NDArray[Any], file: Path) -> bool:
    """Whether the array is the whole of that mapped file, made by a Room; slices of it have the array as base, not the file."""
    mapped = array.base
    return isinstance(mapped, np.memmap) and Path(str(mapped.filename)) == file


def load_struct(folder: Path, cls: type[T]) -> T:
    """Load what save_struct saved; arrays are mapped read-only.

    Raises OSError if files are missing; ValueError, KeyError, TypeError or AttributeError if they are damaged.
    """
    whole = np.memmap(folder / _PACKED_FILE, np.uint8, "r").view(np.ndarray)  # np.memmap's own indexing is slow
    end = _LENGTH_BYTES + int.from_bytes(whole[:_LENGTH_BYTES].tobytes(), "little")
    header = parse_json(whole[_LENGTH_BYTES:end].tobytes())
    return _find_fields(folder, cls, header, whole[_align(end) :])


def _find_fields(folder: Path, cls: type[T], header: dict[str, Any], packed: NDArray[np.uint8]) -> T:
    """Build the dataclass from the index of _put_away."""
    fields: Any = cls.__dataclass_fields__  # type: ignore[attr-defined]
    unknown = {name for of_kind in header.values() for name in of_kind} - set(fields)
    if unknown:  # checked, since names become file names
        raise ValueError(f"it has no fields {', '.join(sorted(unknown))}")
    values: dict[str, Any] = dict(header["plain"])
    values |= {name: _unpack(packed, *of_array) for name, of_array in header["packed"].items()}
    values |= {name: _map_file(folder / f"{name}.npy", *of_array) for name, of_array in header["files"].items()}
    if header["structs"]:
        hints = get_type_hints(cls)
        for name, of_struct in header["structs"].items():
            inner: Any = next(filter(dataclasses.is_dataclass, get_args(hints[name])), hints[name])  # unwraps Optional
            values[name] = _find_fields(folder / name, inner, of_struct, packed)
    return cls(**values)


def hash_struct(folder: Path) -> str:
    """Digest of all files that save_struct wrote into a folder.

    Raises OSError if they cannot be read.
    """
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return hash_pieces(part.encode() for path in files for part in (path.relative_to(folder).as_posix(), hash_file(path)))


def _count_bytes(dtype: str, shape: list[int]) -> int:
    kind = np.dtype(dtype)
    if kind.kind not in "biufcU" or any(not isinstance(side, int) or side < 0 for side in shape):
        raise ValueError(f"it has an array of {kind}, {shape}")
    return math.prod(shape) * kind.itemsize


def _unpack(packed: NDArray[np.uint8], dtype: str, shape: list[int], order: Literal["C", "F"], start: int) -> NDArray[Any]:
    size = _count_bytes(dtype, shape)
    return packed[start : start + size].view(dtype).reshape(shape, order=order)


def _map_file(path: Path, dtype: str, shape: list[int], order: Literal["C", "F"]) -> NDArray[Any]:
    """Map an array saved by np.save, skipping its header, which repeats the index."""
    begin = path.stat().st_size - _count_bytes(dtype, shape)
    if begin < 0:
        raise ValueError(f"{path.name} is not whole")
    return np.memmap(path, dtype, "r", begin, tuple(shape), order).view(np.ndarray)


def _align(place: int) -> int:
    """The next aligned offset."""
    return -(-place // _ALIGNMENT) * _ALIGNMENT


def remove_struct(folder: Path) -> None:
    """Delete the files of save_struct. A system may refuse to delete mapped files; these are deleted with the job's folder."""
    shutil.rmtree(folder, ignore_errors=True)
