"""The digest of everything that decides the images of a bake."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np

from ..util import ablation
from ..util.digest import hash_code, hash_pieces
from ..util.job import Job
from .scene import SceneSnapshot
from .snapshot import describe_snapshot, list_arrays


def hash_bake(snapshot: SceneSnapshot, job: Job) -> str:
    """Digest of the scene, the code and the settings that decide the images of a bake."""
    knobs = {knob.name: getattr(job.settings, knob.name) for knob in fields(job.settings) if knob.metadata["decides_images"]}
    pieces: list[bytes | memoryview] = [
        hash_code().encode(),
        json.dumps([knobs, ablation.list_without(), job.atlas_name, job.taken, describe_snapshot(snapshot)]).encode(),
    ]
    for name, array in list_arrays(snapshot).items():
        pieces += [f"{name} {array.dtype.str} {array.shape}".encode(), np.ascontiguousarray(array).reshape(-1).view(np.uint8).data]
    return hash_pieces(pieces)
