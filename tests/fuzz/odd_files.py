"""Damage to files from a seed: bytes that are missing, changed or repeated, and JSON and arrays that say something else."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from odd_values import draw_json

_LENGTH = 8  # bytes before the JSON of packed.bin
_EVIL_FIELDS = ["../../victim", "/etc/passwd", "tree", "no such field"]


def damage_bytes(rng: Random, data: bytes) -> bytes:
    """The content of a file after a disk, a network or an editor has been at it."""
    kind = rng.choice(["cut", "cut", "flip", "flip", "zero", "insert", "repeat", "empty", "noise"])
    place = rng.randrange(len(data)) if data else 0
    length = min(rng.choice([1, 16, 4096]), len(data) - place)
    if kind == "cut":
        return data[:place]
    if kind == "flip":
        out = bytearray(data)
        for _ in range(rng.choice([1, 1, 8, 64])):
            if out:
                out[rng.randrange(min(len(out), rng.choice([64, 4096, 1 << 40])))] ^= 1 << rng.randrange(8)
        return bytes(out)
    if kind == "zero":
        return data[:place] + bytes(length) + data[place + length :]
    if kind == "insert":
        return data[:place] + rng.randbytes(length) + data[place:]
    if kind == "repeat":
        return data[: place + length] + data[place:]
    return b"" if kind == "empty" else rng.randbytes(rng.choice([1, 100, 5000]))


def damage_json(rng: Random, text: str) -> str:
    """A document in which some values are others, missing, or too many."""
    if rng.random() < 0.1:
        return rng.choice(["[" * 100_000, '{"a":' * 50_000, "null", "[]", "1e999", '"' + "x" * 3_000_000 + '"', "{}" + " " * 2_000_000])
    document = json.loads(text)
    for _ in range(rng.choice([1, 1, 3])):
        document = _change(rng, document)
    return json.dumps(document)


def _change(rng: Random, node: Any) -> Any:
    if isinstance(node, dict) and node and rng.random() < 0.85:
        key = rng.choice(list(node))
        kind = rng.random()
        if kind < 0.1:
            return {name: value for name, value in node.items() if name != key}
        if kind < 0.2:
            return node | {rng.choice(_EVIL_FIELDS): node[key]}
        return node | {key: _change(rng, node[key])}
    if isinstance(node, list) and node and rng.random() < 0.85:
        place = rng.randrange(len(node))
        return [*node[:place], _change(rng, node[place]), *node[place + 1 :]] if rng.random() < 0.8 else node[:place]
    if isinstance(node, int | float) and not isinstance(node, bool) and rng.random() < 0.5:
        return rng.choice([-node, node + 1, node * 1000, 0, -1, 2**40, 10**30])
    return draw_json(rng)


def damage_array(rng: Random, array: np.ndarray) -> np.ndarray:
    """An array of another content, shape or type."""
    kind = rng.choice(["values", "values", "values", "shape", "type", "fewer", "more"])
    if kind == "values" and array.size and array.dtype.kind in "fiub":
        out = array.copy()
        flat = out.reshape(-1)
        for _ in range(rng.choice([1, 10, 1000])):
            odd = [0, 1, -1, 2**31, 10**12] if array.dtype.kind != "f" else [np.nan, np.inf, -1.0, 1e300, 0.0]
            with np.errstate(all="ignore"):
                flat[rng.randrange(flat.size)] = np.array(rng.choice(odd)).astype(array.dtype)
        return out
    if kind == "shape":
        return array.reshape(-1) if array.ndim != 1 else array[:, None]
    if kind == "type":
        return array.astype(rng.choice(["<f4", "<i8", "|b1", "<c16"])) if array.dtype.kind in "fiub" else np.zeros(3)
    if kind == "fewer":
        return array[: len(array) // 2] if array.ndim else np.zeros(0)
    return np.concatenate([array, array]) if array.ndim else np.zeros(5)


def damage_npz(rng: Random, path: Path) -> None:
    """The arrays of a note or of kept charts, in a file that is whole; the one called `header` is JSON."""
    with np.load(path) as stored:
        arrays = dict(stored)
    name = "header" if "header" in arrays and rng.random() < 0.6 else rng.choice(list(arrays))
    if name == "header":
        arrays[name] = np.frombuffer(damage_json(rng, arrays[name].tobytes().decode()).encode(), np.uint8)
    elif rng.random() < 0.1:
        arrays[name] = np.array([{"a": 1}], object)  # which needs a pickle
    else:
        arrays[name] = damage_array(rng, arrays[name])
    with open(path, "wb") as out:
        (np.savez_compressed if rng.random() < 0.2 else np.savez)(out, **arrays)


def damage_packed(rng: Random, path: Path) -> None:
    """The state's small arrays, or what is told of them."""
    data = path.read_bytes()
    end = _LENGTH + int.from_bytes(data[:_LENGTH], "little")
    if rng.random() < 0.6:
        told = damage_json(rng, data[_LENGTH:end].decode()).encode()
        told = told[: end - _LENGTH].ljust(end - _LENGTH) if rng.random() < 0.7 else told
        path.write_bytes(len(told).to_bytes(_LENGTH, "little") + told + data[end:])
        return
    out = bytearray(data)
    for _ in range(rng.choice([1, 100, 10_000])):
        out[rng.randrange(end, len(out))] = rng.choice([0, 1, 0x7F, 0xFF, rng.randrange(256)])
    path.write_bytes(bytes(out))


def replace_file(rng: Random, path: Path, victim: Path) -> None:
    """Something else of the file's name: a folder, a link to a file of the user's, or to nothing; or nothing at all."""
    kind = rng.choice(["folder", "link", "dangling", "ring", "gone"])
    path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind != "gone":
        path.symlink_to({"link": victim, "dangling": path.with_name("not there"), "ring": path}[kind])


def damage_file(rng: Random, path: Path, victim: Path) -> str:
    """Damage a file in one of these ways; gives a word about which."""
    ways: list[tuple[str, Callable[[], Any]]] = [
        ("bytes", lambda: path.write_bytes(damage_bytes(rng, path.read_bytes()))),
        ("replaced", lambda: replace_file(rng, path, victim)),
    ]
    if path.suffix == ".json":
        ways += 3 * [("json", lambda: path.write_text(damage_json(rng, path.read_text())))]
    elif path.name == "packed.bin":
        ways += 3 * [("packed", lambda: damage_packed(rng, path))]
    elif path.suffix in (".npz", ".charts", ".world"):
        ways += 3 * [("arrays", lambda: damage_npz(rng, path))]
    name, damage = rng.choice(ways)
    damage()
    return f"{path.name}: {name}"


def lay_traps(rng: Random, output: Path, victim: Path) -> None:
    """Links of names that a bake may write to on its way."""
    for file in [*output.glob(".leaflight_*"), *output.glob("*.exr")]:
        if file.is_file() and rng.random() < 0.5:
            part = file.with_name(f"{file.name}.part")
            if not part.is_symlink():
                part.symlink_to(victim)
    probe = output / ".leaflight_probe"
    if rng.random() < 0.3 and not probe.exists():
        probe.symlink_to(victim)


def copy_tree(source: Path, target: Path) -> None:
    """A folder with all that is in it."""
    shutil.copytree(source, target, symlinks=True, dirs_exist_ok=True)
