"""What is written is what is mapped."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from leaflight.core.parallel import shared_arrays


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
