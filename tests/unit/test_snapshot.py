"""A snapshot comes back from disk as it was, and a damaged file is refused with a sentence."""

import json
import pickle

import numpy as np
import pytest
from leaflight.core.scene.scene import Light, Material, SceneObject, SceneSnapshot, TextureImage
from leaflight.core.scene.snapshot import FORMAT_VERSION, load_snapshot, save_snapshot


def make_snapshot():
    rng = np.random.default_rng(3)
    return SceneSnapshot(
        vertex_position=rng.normal(size=(4, 3)),
        tri_vertex=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        tri_object=np.array([0, 1], np.int32),
        tri_material=np.array([0, 1], np.int32),
        tri_polygon=np.array([0, 0], np.int32),
        tri_corner=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        tri_normal=rng.normal(size=(2, 3, 3)).astype(np.float32),
        tri_uv=rng.random((2, 3, 2)),
        tri_albedo_uv=rng.random((2, 3, 2)).astype(np.float32),
        tri_emission_uv=rng.random((2, 3, 2)).astype(np.float32),
        objects=(SceneObject("Wand", mesh=2), SceneObject("Möbel", receives=False, casts_shadow=False)),
        materials=(Material("Putz", (0.1, 0.2, 0.3), 0, normal_strength=0.5), Material("Lampe", emission_rgb=(1.0, 2.0, 3.0))),
        images=(TextureImage("Karo", rng.random((3, 5, 3)).astype(np.float32), "CLIP", True, True),),
        lights=(Light("AREA", "Fenster", (1.0, 2.0, 3.0), power_rgb=(4.0, 5.0, 6.0), size_m=(2.0, 0.5), casts_shadow=False),),
        world_rgb=(0.1, 0.2, 0.3),
        world_map=rng.random((2, 4, 3)).astype(np.float32),
        tri_tangents=rng.normal(size=(2, 3, 3, 3)).astype(np.float32),
    )


def rewrite(path, **changes):
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in stored.files}
    header = json.loads(arrays["header"].tobytes())
    arrays.update(changes)
    arrays = {name: array for name, array in arrays.items() if array is not None}
    return arrays, header


def test_round_trip(tmp_path):
    before = make_snapshot()
    path = tmp_path / "scene.leaflight"
    save_snapshot(path, before)
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.leaflight"]
    after = load_snapshot(path)
    for name in before.__dataclass_fields__:
        expected, found = getattr(before, name), getattr(after, name)
        if isinstance(expected, np.ndarray):
            assert found.dtype == expected.dtype, name
            assert np.array_equal(found, expected), name
        elif name != "images":
            assert found == expected, name
    assert (after.images[0].name, after.images[0].extension, after.images[0].closest) == ("Karo", "CLIP", True)
    assert after.images[0].per_triangle
    assert np.array_equal(after.images[0].pixels, before.images[0].pixels)


def test_empty_scene(tmp_path):
    path = tmp_path / "empty.npz"
    names = (name for name in SceneSnapshot.__dataclass_fields__ if name.startswith(("vertex_", "tri_")))
    empty = {name: array[:0] for name in names if (array := getattr(make_snapshot(), name)) is not None}
    save_snapshot(path, SceneSnapshot(**empty, objects=(), materials=()))
    assert load_snapshot(path).n_tri == 0


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x03\x04 cut", pickle.dumps({"a": 1})])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"other\.npz: is not a Leaflight snapshot"):
        load_snapshot(path)


def test_truncated_and_flipped_files_are_refused(tmp_path):
    path = tmp_path / "scene.npz"
    save_snapshot(path, make_snapshot())
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="export the scene again"):
        load_snapshot(path)
    flipped = bytearray(whole)
    flipped[whole.index(make_snapshot().vertex_position.tobytes())] ^= 0xFF
    path.write_bytes(flipped)
    with pytest.raises(ValueError, match="export the scene again"):
        load_snapshot(path)


def test_a_pickled_array_is_refused(tmp_path):
    path = tmp_path / "scene.npz"
    np.savez(path, header=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="is not a Leaflight snapshot"):
        load_snapshot(path)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"tri_uv": None}, "tri_uv"),
        ({"tri_vertex": np.array([[0, 1, 9], [0, 2, 3]], np.int32)}, "tri_vertex: expected indices"),
        ({"tri_vertex": np.zeros((2, 3))}, "tri_vertex: expected numbers"),
        ({"image_0": np.zeros((3, 5), np.float32)}, "image Karo"),
    ],
)
def test_wrong_arrays_are_named(tmp_path, changes, text):
    path = tmp_path / "scene.npz"
    save_snapshot(path, make_snapshot())
    arrays, _ = rewrite(path, **changes)
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=text):
        load_snapshot(path)


def test_another_version_is_refused(tmp_path):
    path = tmp_path / "scene.npz"
    save_snapshot(path, make_snapshot())
    arrays, header = rewrite(path)
    header["version"] = FORMAT_VERSION + 1
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=f"holds snapshot version {FORMAT_VERSION + 1}"):
        load_snapshot(path)
