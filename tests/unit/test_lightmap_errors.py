"""The measure that every comparison with Cycles uses."""

import numpy as np
import pytest
from lightmap_errors import measure_errors, reference_noise

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


def test_noise_beyond_the_error_is_not_taken_off_twice():
    truth, rng = np.tile(renderings(0.0)[0], (5, 1)), np.random.default_rng(2)
    # Of a path tracer's noise the channels have nearly the same.
    first, second, value = (truth * (1.0 + rng.normal(0.0, noise, (5 * N, 1))) for noise in (0.1, 0.1, 0.02))
    of_clean = measure_errors(value, truth, truth).rel
    assert measure_errors(value, first, second, noisy=True).rel == pytest.approx(of_clean, rel=0.15)
    assert measure_errors(value, first, second).rel < 0.6 * of_clean
    assert measure_errors(value, truth, truth, noisy=True).rel == pytest.approx(of_clean)


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


def test_the_noise_of_the_reference_is_told():
    _, first, second = renderings(0.1)
    assert reference_noise(first, second) == pytest.approx(0.1 / np.sqrt(2.0), rel=0.1)  # a tenth: dark ones count a little less
    assert reference_noise(first, first) == 0.0


def test_renderings_without_any_light_have_no_noise_to_measure():
    with pytest.raises(ValueError, match="No texel"):
        reference_noise(np.zeros((4, 3)), np.zeros((4, 3)))
