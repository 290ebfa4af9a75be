"""What the benchmark of files makes of texels that are see-through."""

from pathlib import Path

import numpy as np
import pytest
from bench_files import compare_objects, sum_light
from zoo_reference import PageReference, Subject


def test_texels_count_by_how_opaque_they_are():
    light = np.ones((128, 3), np.float32)
    opaque = np.where(np.arange(128) % 2, 1.0, 0.25).astype(np.float32)
    owner = np.zeros(128, np.int16)
    reference = PageReference(np.ones((8, 16), bool), light, light, owner, 8, 1.0, opaque)
    subject = Subject(Path(), "leaf", ("Leaf",), "", 16, 2, "")
    value = light.copy()
    value[::2] = 2.0  # of those that are a quarter opaque
    (leaf,) = compare_objects(subject, value, reference)
    assert leaf.off == pytest.approx(0.25 / 1.25)
    assert sum_light(reference, value) / sum_light(reference, light) - 1.0 == pytest.approx(0.25 / 1.25)
