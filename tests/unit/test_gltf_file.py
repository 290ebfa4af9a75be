"""Binary glTF files: their JSON is read, replaced and renamed, and the manifest says what it holds."""

import json
import math
import struct

import pytest
from leaflight.addon.gltf import gltf_file

DOCUMENT = {
    "asset": {"version": "2.0"},
    "nodes": [{"name": "a"}, {"name": "kept"}, {}],
    "materials": [
        {"name": "a", "occlusionTexture": {"index": 1, "texCoord": 1}},
        {"name": "plain"},
        {"name": "b", "occlusionTexture": {"index": 1}},
        {"name": "theirs", "occlusionTexture": {"index": 0}},
    ],
    "textures": [{"source": 0}, {"source": 1}],
    "images": [{"name": "dirt"}, {"name": "light"}],
}


def make_glb(text, binary=b"12345678"):
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


@pytest.mark.parametrize("letters", range(4))
def test_another_json_leaves_the_binary_part_and_is_padded(letters):
    glb = make_glb(json.dumps(DOCUMENT).encode())
    changed = {"asset": {"version": "2.0", "generator": "ä" + "x" * letters}}
    out = gltf_file.replace_document(glb, changed)
    assert gltf_file.read_document(out) == changed
    assert out.endswith(glb[-16:])
    assert len(out) % 4 == 0
    assert struct.unpack_from("<I", out, 8)[0] == len(out)


@pytest.mark.parametrize(
    ("glb", "error"),
    [(b"", "no binary"), (b'{"asset":{}}' * 3, "no binary"), (b"glTF" + struct.pack("<IIII", 2, 20, 0, 5), "not its JSON")],
)
def test_what_is_no_binary_file_is_refused(glb, error):
    with pytest.raises(ValueError, match=error):
        gltf_file.read_document(glb)


def test_names_are_given_by_kind():
    document = json.loads(json.dumps(DOCUMENT))
    gltf_file.rename(document, {"nodes": {"a": "Floor"}, "materials": {"a": "Wood", "b": "Wood"}, "scenes": {"a": "none there"}})
    assert [node.get("name") for node in document["nodes"]] == ["Floor", "kept", None]
    assert [material["name"] for material in document["materials"]] == ["Wood", "plain", "Wood", "theirs"]


def test_manifest_names_lightmaps_and_nothing_of_the_users():
    manifest = gltf_file.make_manifest("room.glb", DOCUMENT, {0: 2.5, 2: 2.5})
    assert manifest["images"] == [{"image": 1, "name": "light", "range": 2.5}]
    assert manifest["materials"] == [
        {"material": 0, "name": "a", "image": 1, "texcoord": 1},
        {"material": 2, "name": "b", "image": 1, "texcoord": 0},
    ]
    assert (manifest["gltf"], manifest["slot"], manifest["encoding"]) == ("room.glb", "occlusionTexture", "srgb")
    assert manifest["irradiance_factor"] == math.pi


def test_what_is_no_number_is_cleared_and_everything_else_stays():
    place, normal, other = [1.0, math.nan, -math.inf], [math.nan, 0.0, 1.0, 0.0, 0.0, 1.0], b"\xff" * 6
    binary = struct.pack("<3f6f", *place, *normal) + other
    views = [{"byteOffset": 0, "byteLength": 12}, {"byteOffset": 12, "byteLength": 24}, {"byteOffset": 36, "byteLength": 6}]
    kinds = [5126, 5126, 5123]
    document = {
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": [{"bufferView": view, "componentType": kind} for view, kind in enumerate(kinds)],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}}]}],
    }
    glb = make_glb(json.dumps(document).encode(), binary + bytes(-len(binary) % 4))
    out = gltf_file.clear_numbers(glb, document)
    cleared = struct.pack("<3f6f", 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0) + other + bytes(-len(binary) % 4)
    assert out == glb[: -len(cleared)] + cleared
    assert gltf_file.clear_numbers(out, document) == out
