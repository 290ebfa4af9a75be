"""Files of a SceneSnapshot: one .npz of plain arrays, one of which is a JSON header; no pickle."""

import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util import ablation
from ..util.arrays import Float32
from ..util.digest import hash_code, hash_pieces
from ..util.files import write_arrays
from ..util.job import Job
from .scene import ARRAYS, Light, Material, SceneObject, SceneSnapshot, TextureImage

FORMAT = "leaflight-snapshot"
FORMAT_VERSION = 11
_HEADER, _IMAGE, _WORLD_MAP, _PROFILE = "header", "image_", "world_map", "profile_"
_DAMAGED = (zipfile.BadZipFile, ValueError, EOFError, KeyError, AttributeError, TypeError)


def save_snapshot(path: str | Path, snapshot: SceneSnapshot) -> None:
    """Write a snapshot to `path`, without changing its suffix.

    Raises OSError if the file cannot be written.
    """
    arrays = list_arrays(snapshot)
    arrays[_HEADER] = np.frombuffer(json.dumps(describe_snapshot(snapshot)).encode(), dtype=np.uint8)
    with open(path, "wb") as file:
        write_arrays(file, arrays)


def describe_snapshot(snapshot: SceneSnapshot) -> dict[str, Any]:
    """Everything in a snapshot but its arrays, as JSON values."""
    return {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "objects": [dict(vars(item)) for item in snapshot.objects],
        "materials": [dict(vars(item)) for item in snapshot.materials],
        "lights": [dict(vars(item)) for item in snapshot.lights],
        "images": [
            {"shape": image.pixels.shape, **{name: value for name, value in vars(image).items() if name != "pixels"}}
            for image in snapshot.images
        ],
        "world_rgb": snapshot.world_rgb,
    }


def list_arrays(snapshot: SceneSnapshot) -> dict[str, NDArray[Any]]:
    """The arrays of a snapshot, including images."""
    arrays = {name: getattr(snapshot, name) for name in ARRAYS}
    if snapshot.world_map is not None:
        arrays[_WORLD_MAP] = snapshot.world_map
    arrays |= {f"{_PROFILE}{index}": profile for index, profile in enumerate(snapshot.profiles)}
    return arrays | {_image_key(index): image.pixels for index, image in enumerate(snapshot.images)}


def load_snapshot(path: str | Path) -> SceneSnapshot:
    """Read the snapshot in `path`.

    Raises OSError if there is no such file, ValueError with a sentence if it has no snapshot of this version.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files if not name.startswith(_IMAGE)}
        header = json.loads(arrays[_HEADER].tobytes())
        if header["format"] != FORMAT:
            raise ValueError(f"its format is {header['format']!r}")
        version = header["version"]
    except _DAMAGED as reason:
        raise ValueError(f"{path}: is not a Leaflight snapshot or is damaged ({reason}); export the scene again.") from reason
    if version != FORMAT_VERSION:
        raise ValueError(
            f"{path}: holds snapshot version {version}, this Leaflight reads version {FORMAT_VERSION}; export the scene again."
        )
    try:
        return _build_snapshot(header, arrays, _read_pictures(path, header["images"]))
    except _DAMAGED as reason:
        raise ValueError(f"{path}: is a damaged snapshot ({reason}); export the scene again.") from reason


def _read_pictures(path: str | Path, described: Sequence[Mapping[str, Any]]) -> list[Float32]:
    """The pixels of all images, as parts of one array, so that they can be looked up together (textures.lay_together)."""
    if not described:
        return []
    lengths = [math.prod(entry["shape"]) for entry in described]
    parts = np.split(np.empty(sum(lengths), np.float32), np.cumsum(lengths)[:-1])
    pictures = []
    with np.load(path, allow_pickle=False) as stored:
        for index, (entry, part) in enumerate(zip(described, parts, strict=True)):
            pixels, shape = stored[_image_key(index)], tuple(entry["shape"])
            if pixels.shape != shape or shape[2:] != (3,) or pixels.dtype != np.float32:
                raise ValueError(f"image {entry['name']}: expected {(*shape[:2], 3)} float32, got {pixels.shape} {pixels.dtype}")
            part[:] = pixels.reshape(-1)
            pictures.append(part.reshape(shape))
    return pictures


def _build_snapshot(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], pictures: Sequence[Float32]) -> SceneSnapshot:
    described = ({name: value for name, value in entry.items() if name != "shape"} for entry in header["images"])
    images = tuple(TextureImage(pixels=pixels, **entry) for pixels, entry in zip(pictures, described, strict=True))
    objects = tuple(SceneObject(**_frozen(entry)) for entry in header["objects"])
    materials = tuple(Material(**_frozen(entry)) for entry in header["materials"])
    lights = tuple(Light(**_frozen(entry)) for entry in header["lights"])
    snapshot = SceneSnapshot(
        **{name: arrays[name] for name in ARRAYS},
        objects=objects,
        materials=materials,
        images=images,
        lights=lights,
        world_rgb=_frozen(header["world_rgb"]),
        world_map=arrays.get(_WORLD_MAP),
        profiles=tuple(arrays[f"{_PROFILE}{index}"] for index in range(sum(name.startswith(_PROFILE) for name in arrays))),
    )
    if snapshot.world_map is not None and snapshot.world_map.dtype != np.float32:
        raise ValueError(f"{_WORLD_MAP}: expected float32, got {snapshot.world_map.dtype}")
    for name, (_, kind) in ARRAYS.items():
        if arrays[name].dtype.kind != kind:
            raise ValueError(f"{name}: expected numbers of kind {kind!r}, got {arrays[name].dtype}")
    return snapshot


def _frozen(value: Any) -> Any:
    """The value with JSON's lists turned back into tuples."""
    if isinstance(value, list):
        return tuple(_frozen(item) for item in value)
    if isinstance(value, dict):
        return {name: _frozen(item) for name, item in value.items()}
    return value


def _image_key(index: int) -> str:
    return f"{_IMAGE}{index}"


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
