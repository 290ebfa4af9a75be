"""How the error of single objects is measured and judged."""

import bench_objects
import numpy as np
import pytest
from cycles_reference import Reference
from lightmap_errors import DARK_FLOOR


def make_reference(level, noise=0.0):
    """Texels (n,) of these brightnesses, W/m^2 over pi, in one row of a page."""
    rng = np.random.default_rng(1)
    light = np.repeat(np.asarray(level, float)[:, None], 3, axis=1)
    first, second = (light * (1.0 + rng.normal(0.0, noise, light.shape)) for _ in range(2))
    return Reference("toy", np.ones((1, len(light)), bool), first, second, np.zeros((2, 3, 2)))


def test_an_object_is_measured_beside_its_own_brightness_and_noise_of_the_reference_cancels():
    level = np.where(np.arange(10_000) < 5000, 100.0, 20.0)
    reference, dim = make_reference(level, noise=0.02), level == 20.0
    value = np.repeat(level[:, None], 3, axis=1) * np.where(dim, 1.1, 1.0)[:, None]
    assert bench_objects.measure_alone(value, reference, dim) == pytest.approx(0.1 / np.hypot(1.0, DARK_FLOOR), rel=0.03)
    assert bench_objects.measure_alone(value, reference, ~dim) == pytest.approx(0.0, abs=0.004)


def measured(rel, stated, error_of="objects", finest=0.0):
    rel, stated = (np.array(values, float)[None] for values in (rel, stated))
    names = tuple("ABCDEF"[: rel.shape[1]])
    return bench_objects.Measured("toy", error_of, [1.0], [10**6], [0.02], names, rel, stated, np.full(rel.shape[1], finest))


def test_objects_are_judged_by_the_median_the_worst_and_what_they_state():
    whole, good = measured([0.2, 0.05, 0.05], [0.2, 0.05, 0.05], "bake"), measured([0.05, 0.02, 0.04], [0.05, 0.03, 0.04])
    assert good.worst == 0
    assert [claim.holds for claim in bench_objects.judge(whole, good)] == [True, True, True]
    assert [claim.measured for claim in bench_objects.judge(whole, good)] == pytest.approx([0.8, 0.25, 1.0])
    far = measured([0.18, 0.06, 0.07], [0.02, 0.01, 0.02])
    assert [claim.holds for claim in bench_objects.judge(whole, far)] == [False, False, False]
    assert len(good.row()) == len(bench_objects.HEAD)
    assert "A, 5.0%" in good.row()
