"""The measure that every comparison with Cycles uses."""

import numpy as np
import pytest
from lightmap_errors import measure_errors

N = 40_000


def renderings(noise: float, seed: int = 1):
    """True light, and two noisy renderings of it."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.5, 2.0, (N, 3))
    return truth, *(truth * (1.0 + rng.normal(0.0, noise, truth.shape)) for _ in range(2))


def test_the_renderings_noise_cancels():
    truth, first, second = renderings(0.05)
    errors = measure_errors(truth, first, second)
    assert errors.texels == N
    assert max(errors.rel, errors.nrmse) < 0.01
    assert abs(errors.bias) < 0.001
    assert errors.p99 > 0.05


def test_each_measure_is_what_it_says():
    truth, _, _ = renderings(0.0)
    errors = measure_errors(truth * 1.1, truth, truth)
    mean = truth.mean()
    assert errors.bias == pytest.approx(0.1)
    assert errors.nrmse == pytest.approx(0.1 * np.sqrt((truth**2).mean()) / mean)
    assert errors.rel == pytest.approx(np.sqrt(((0.1 * truth) ** 2 / (truth**2 + (0.1 * mean) ** 2)).mean()), rel=1e-3)
    assert errors.p99 == pytest.approx(np.quantile(0.1 * truth.sum(1) / (truth.sum(1) + 0.3 * mean), 0.99))


def test_few_bad_texels_are_left_out_of_rel_alone():
    truth, _, _ = renderings(0.0)
    value = truth.copy()
    value[: N // 200] = 0.0
    errors = measure_errors(value, truth, truth)
    assert errors.rel == 0.0
    assert errors.nrmse > 0.05
    assert errors.bias < -0.004
    value[: N // 50] = 0.0
    assert measure_errors(value, truth, truth).rel > 0.05


def test_black_texels_count_where_the_bake_left_them_not_where_a_rendering_did():
    truth, _, _ = renderings(0.0)
    value, first, second = truth.copy(), truth.copy(), truth.copy()
    value[:1000] = 0.0
    first[1000:2000] = 0.0
    second[2000:3000] = 0.0
    errors = measure_errors(value, first, second)
    assert errors.texels == N - 2000
    assert errors.bias == pytest.approx(-truth[:1000].sum() / np.delete(truth, slice(1000, 3000), 0).sum())
