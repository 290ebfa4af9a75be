"""Frozen dataclasses of arrays as a folder of .npy files, which processes map into memory and so share."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np

T = TypeVar("T")


def save_struct(folder: Path, struct: Any) -> None:
    """Write a dataclass whose fields are arrays, plain numbers or such dataclasses, or None; `folder` is made."""
    folder.mkdir(parents=True)
    plain: dict[str, Any] = {}
    for field in dataclasses.fields(struct):
        value = getattr(struct, field.name)
        if isinstance(value, np.ndarray):
            np.save(folder / f"{field.name}.npy", value)
        elif dataclasses.is_dataclass(value):
            save_struct(folder / field.name, value)
        else:
            plain[field.name] = value
    (folder / "plain.json").write_text(json.dumps(plain), encoding="utf-8")


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
