"""What is written is what is mapped."""

from dataclasses import dataclass

import numpy as np
import pytest
from leaflight.core import shared_arrays


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


@dataclass(frozen=True)
class Maybe:
    inner: Inner | None


def test_a_struct_that_may_be_none_comes_back_either_way(tmp_path):
    shared_arrays.save_struct(tmp_path / "none", Maybe(None))
    assert shared_arrays.load_struct(tmp_path / "none", Maybe).inner is None
    shared_arrays.save_struct(tmp_path / "some", Maybe(Inner(np.arange(3))))
    assert shared_arrays.load_struct(tmp_path / "some", Maybe).inner.values.tolist() == [0, 1, 2]


def test_mapped_arrays_cannot_be_changed_by_accident(tmp_path):
    shared_arrays.save_struct(tmp_path / "s", Inner(np.zeros(5000)))
    with pytest.raises(ValueError, match="read-only"):
        shared_arrays.load_struct(tmp_path / "s", Inner).values[0] = 1.0
