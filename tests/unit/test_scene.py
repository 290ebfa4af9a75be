"""A snapshot is consistent or is never made, and comes back from disk as it was; so do the arrays that processes share."""

import dataclasses
import json
import os
import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from leaflight.core.parallel import shared_arrays
from leaflight.core.scene.scene import Light, Material, SceneObject, SceneSnapshot, TextureImage
from leaflight.core.scene.snapshot import FORMAT_VERSION, load_snapshot, save_snapshot
from scenes import box_scene, quad_scene

# A snapshot is consistent or is never made.
ARRAYS = [field.name for field in dataclasses.fields(SceneSnapshot) if field.name.startswith(("vertex_", "tri_"))]


def planted(scene, name, place, value):
    """The scene with one element of an array changed."""
    array = getattr(scene, name).copy()
    array[place] = value
    return dataclasses.replace(scene, **{name: array})


@pytest.mark.parametrize("name", ARRAYS)
def test_each_array_must_have_its_shape(name):
    scene = box_scene()
    array = getattr(scene, name)
    wrong = array[:, :-1] if array.ndim > 1 else array[:-1]
    with pytest.raises(ValueError, match=f"^{name}: expected shape ") as caught:
        dataclasses.replace(scene, **{name: wrong})
    assert str(caught.value).endswith(f"{array.shape}, got {wrong.shape}")


@pytest.mark.parametrize(("name", "count"), [("tri_vertex", 8), ("tri_object", 1), ("tri_material", 1)])
def test_indices_must_name_what_is_there(name, count):
    for value in (-1, count):
        with pytest.raises(ValueError, match=f"^{name}: expected indices 0 to {count - 1}, got "):
            planted(box_scene(), name, 3, value)
    assert getattr(planted(box_scene(), name, 3, count - 1), name).flat[0] >= 0


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_positions_must_be_finite(value):
    with pytest.raises(ValueError, match="vertex_position: expected finite"):
        planted(quad_scene(), "vertex_position", (2, 1), value)


@pytest.mark.parametrize("slot", ["albedo_image", "emission_image"])
def test_materials_must_name_images_that_are_there(slot):
    image = TextureImage("Wood", np.zeros((1, 1, 3), np.float32))
    first, second = Material("Oak", **{slot: 0}), Material("Oak", **{slot: 1})
    dataclasses.replace(quad_scene(), images=(image,), materials=(first,))
    with pytest.raises(ValueError, match=r"^Oak: names an image that is not in the snapshot"):
        dataclasses.replace(quad_scene(), images=(image,), materials=(second,))


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_density_factors_must_be_above_zero(factor):
    scene = quad_scene()
    named = dataclasses.replace(scene.objects[0], name="Oak", density_factor=factor)
    with pytest.raises(ValueError, match=r"^Oak: expected a density factor above 0"):
        dataclasses.replace(scene, objects=(named,))


# A snapshot comes back from disk as it was, and a damaged file is refused with a sentence.
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


# What is written is what is mapped.
@dataclass(frozen=True)
class Inner:
    values: np.ndarray


@dataclass(frozen=True)
class Outer:
    count: int
    empty: np.ndarray
    inner: Inner


def test_a_struct_comes_back_with_shapes_types_and_numbers(tmp_path):
    struct = Outer(3, np.zeros((0, 2), np.int32), Inner(np.arange(6000, dtype=np.float32).reshape(3, 2000)))
    shared_arrays.save_struct(tmp_path / "s", struct)
    loaded = shared_arrays.load_struct(tmp_path / "s", Outer)
    assert loaded.count == 3
    assert loaded.empty.shape == (0, 2)
    assert loaded.empty.dtype == np.int32
    np.testing.assert_array_equal(loaded.inner.values, struct.inner.values)
    assert type(loaded.inner.values) is np.ndarray


@pytest.mark.parametrize("damage", [lambda b: b"", lambda b: b[:5], lambda b: b[:300], lambda b: b[:5000], lambda b: b"\xff" * len(b)])
def test_what_is_not_whole_is_told(damage, tmp_path):
    """No length that stands there makes it ask for more memory than the file has."""
    shared_arrays.save_struct(tmp_path / "s", Outer(3, np.zeros(4), Inner(np.ones(3000))))
    (file,) = (tmp_path / "s").iterdir()
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(ValueError, match=r"empty file|JSON|Expecting|Unterminated|reshape|decode|column"):
        shared_arrays.load_struct(tmp_path / "s", Outer)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"values"', '"../../v"'),  # a name becomes the name of a file
        ('"<f8"', '"|O8"'),
        ('"<f8"', '"V88"'),
        ("[3000]", "[-300]"),
        ("[3000]", "[3e30]"),
    ],
)
def test_what_is_told_of_arrays_is_not_believed(old, new, tmp_path):
    shared_arrays.save_struct(tmp_path / "s", Outer(3, np.zeros(4, np.int8), Inner(np.ones(3000))))
    (file,) = (tmp_path / "s").iterdir()
    changed = file.read_bytes().replace(old.encode(), new.encode(), 1)
    assert changed != file.read_bytes()
    file.write_bytes(changed.ljust(len(file.read_bytes())))
    with pytest.raises((ValueError, TypeError)):
        shared_arrays.load_struct(tmp_path / "s", Outer)


@pytest.mark.parametrize("damage", [lambda b: b"", lambda b: b[:-1000]])
def test_a_large_array_that_is_not_whole_is_told(damage, tmp_path):
    shared_arrays.save_struct(tmp_path / "s", Inner(np.ones(1 << 17)))
    file = tmp_path / "s" / "values.npy"
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(ValueError, match="is not whole"):
        shared_arrays.load_struct(tmp_path / "s", Inner)
    file.unlink()
    with pytest.raises(OSError, match=r"values\.npy"):
        shared_arrays.load_struct(tmp_path / "s", Inner)


@pytest.mark.parametrize("values", [np.array([None, 1]), np.zeros(3, [("a", np.int32), ("b", np.float64, 2)])])
def test_what_is_more_than_numbers_is_refused(values, tmp_path):
    with pytest.raises(TypeError, match="values: expected an array of plain numbers"):
        shared_arrays.save_struct(tmp_path / "s", Inner(values))


def test_mapped_arrays_cannot_be_changed_by_accident(tmp_path):
    shared_arrays.save_struct(tmp_path / "s", Inner(np.zeros(5000)))
    with pytest.raises(ValueError, match="read-only"):
        shared_arrays.load_struct(tmp_path / "s", Inner).values[0] = 1.0


@pytest.mark.skipif(os.name != "posix", reason="limits of a file's size, which stand for a full disk here, are POSIX's")
def test_a_room_whose_file_cannot_be_as_large_raises_before_it_is_mapped(tmp_path):
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, hard))
    try:
        with pytest.raises(OSError, match="too large"):
            shared_arrays.Room(tmp_path / "s").empty("values", (1 << 20,), np.int64)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("fails", [False, True])
def test_what_is_laid_out_is_there_while_it_is_worked_with(fails, tmp_path):
    places = []
    for value in (1.0, 2.0):
        try:
            with shared_arrays.laid_out(tmp_path, Inner(np.full(5000, value))) as place:
                places.append(place)
                assert shared_arrays.load_struct(Path(place), Inner).values[-1] == value
                if fails:
                    raise OSError
        except OSError:
            assert fails
    assert places[0] != places[1]  # who keeps the first open by its name does not take it for the second
    assert not list(tmp_path.iterdir())
