"""Digests that tell one scene, one code and one bake from another."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import fields
from functools import lru_cache
from pathlib import Path

import numpy as np

from .job import Job
from .scene import SceneSnapshot
from .snapshot import describe_snapshot, list_arrays

_DIGEST_BYTES = 20


def hash_pieces(pieces: Iterable[bytes | memoryview]) -> str:
    """Digest of pieces in their order, each with its length."""
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for piece in pieces:
        digest.update(memoryview(piece).nbytes.to_bytes(8, "little"))
        digest.update(piece)
    return digest.hexdigest()


def hash_file(path: Path) -> str:
    """Digest of a file's bytes.

    Raises OSError where it cannot be read.
    """
    with open(path, "rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=_DIGEST_BYTES)).hexdigest()


@lru_cache(maxsize=1)
def hash_code() -> str:
    """Digest of the core's own source files: another version may bake other bytes."""
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return hash_pieces(piece for path in sources for piece in (path.name.encode(), path.read_bytes()))


def hash_bake(snapshot: SceneSnapshot, job: Job) -> str:
    """Digest of all that decides the images of a bake: the scene, the code and the knobs that matter."""
    knobs = {knob.name: getattr(job.settings, knob.name) for knob in fields(job.settings) if knob.metadata["decides_images"]}
    pieces: list[bytes | memoryview] = [hash_code().encode(), json.dumps([knobs, job.atlas_name, describe_snapshot(snapshot)]).encode()]
    for name, array in list_arrays(snapshot).items():
        pieces += [f"{name} {array.dtype.str} {array.shape}".encode(), np.ascontiguousarray(array).reshape(-1).view(np.uint8).data]
    return hash_pieces(pieces)
