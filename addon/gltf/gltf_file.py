"""What is changed in a .glb after Blender's exporter has written it, and the manifest beside it; no bpy here."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

_MAGIC, _VERSION, _JSON_CHUNK = 0x46546C67, 2, 0x4E4F534A
_FLOAT = 5126  # componentType of an accessor
_HEADER = struct.Struct("<III")  # magic, version, length of the file
_CHUNK = struct.Struct("<II")  # length, kind


def read_document(glb: bytes) -> dict[str, Any]:
    """The JSON of a binary glTF file.

    Raises ValueError when it is none.
    Source: Khronos, glTF 2.0 specification, section 4.4.
    """
    start = _HEADER.size + _CHUNK.size
    if len(glb) < start or _HEADER.unpack_from(glb)[:2] != (_MAGIC, _VERSION):
        raise ValueError("this is no binary glTF 2.0 file")
    length, kind = _CHUNK.unpack_from(glb, _HEADER.size)
    if kind != _JSON_CHUNK:
        raise ValueError("the file's first part is not its JSON")
    document: dict[str, Any] = json.loads(glb[start : start + length])
    return document


def replace_document(glb: bytes, document: Mapping[str, Any]) -> bytes:
    """The file with another JSON and the same binary part."""
    length, _ = _CHUNK.unpack_from(glb, _HEADER.size)
    rest = glb[_HEADER.size + _CHUNK.size + length :]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    whole = _HEADER.size + _CHUNK.size + len(text) + len(rest)
    return _HEADER.pack(_MAGIC, _VERSION, whole) + _CHUNK.pack(len(text), _JSON_CHUNK) + text + rest


def clear_numbers(glb: bytes, document: Mapping[str, Any]) -> bytes:
    """The file with 0 for what is no finite number in its floats, and +Y for normals that have such: no glTF file may hold it.

    Blender computes normals that are none on meshes of enormous size. An export has one buffer, which is the file's binary part.
    """
    start = _HEADER.size + 2 * _CHUNK.size + _CHUNK.unpack_from(glb, _HEADER.size)[0]
    normals = {one["attributes"].get("NORMAL") for mesh in document.get("meshes", ()) for one in mesh["primitives"]}
    out = np.frombuffer(glb, np.uint8).copy()
    for number, accessor in enumerate(document.get("accessors", ())):
        if accessor["componentType"] != _FLOAT or "bufferView" not in accessor:
            continue
        view = document["bufferViews"][accessor["bufferView"]]
        begin = start + view.get("byteOffset", 0)
        values = out[begin : begin + view["byteLength"] // 4 * 4].view("<f4")
        if number in normals:
            rows = values.reshape(-1, 3)
            rows[~np.isfinite(rows).all(axis=1)] = (0.0, 1.0, 0.0)
        values[~np.isfinite(values)] = 0.0
    return out.tobytes()


def rename(document: dict[str, Any], names: Mapping[str, Mapping[str, str]]) -> None:
    """Give things their names, in place.

    names   kind ("nodes", "meshes", "materials", "scenes") -> name in the file -> name wanted
    """
    for kind, wanted in names.items():
        for entry in document.get(kind, ()):
            entry["name"] = wanted.get(entry.get("name"), entry.get("name"))


def make_manifest(glb_name: str, document: Mapping[str, Any], ranges: Mapping[int, float]) -> dict[str, Any]:
    """What an engine must know to read the lightmaps in the occlusion slots.

    ranges   index of a material with a lightmap -> linear value of the lightmap's brightest byte
    """
    images: dict[int, dict[str, Any]] = {}
    materials = []
    for index, value_range in ranges.items():
        material = document["materials"][index]
        slot = material["occlusionTexture"]
        image = document["textures"][slot["index"]]["source"]
        images[image] = {"image": image, "name": document["images"][image]["name"], "range": value_range}
        materials.append({"material": index, "name": material["name"], "image": image, "texcoord": slot.get("texCoord", 0)})
    return {
        "gltf": glb_name,
        "slot": "occlusionTexture",
        "light": "irradiance / pi of diffuse surfaces, W/m2/sr, linear Rec.709",
        "encoding": "srgb",
        "decode": "light = srgb_to_linear(rgb) * range",
        "irradiance_factor": math.pi,
        "images": [images[image] for image in sorted(images)],
        "materials": materials,
    }
