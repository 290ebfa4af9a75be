"""The references that bakes are held against, and the claims judged by them."""

import numpy as np
import pytest
from cycles_reference import COMMITTED, REFERENCES, Reference

SIZE = 32


def make_reference(noise=0.02):
    rng = np.random.default_rng(1)
    covered = rng.random((SIZE, SIZE)) < 0.7
    truth = np.zeros((SIZE, SIZE, 4), np.float32)
    truth[covered] = [*rng.uniform(0.5, 2.0, 3), 1.0]
    truth[..., 0] *= 1.0 + np.arange(SIZE) / SIZE
    first, second = (truth[covered][:, :3] * (1.0 + rng.normal(0.0, noise, (covered.sum(), 3))) for _ in range(2))
    return Reference("toy", covered, first, second, rng.random((50, 3, 2))), truth


def test_a_reference_is_read_as_it_was_written(tmp_path):
    reference, truth = make_reference()
    reference.save(tmp_path, 16, "5.0")
    read = Reference.load("toy", SIZE, tmp_path)
    np.testing.assert_array_equal(read.covered, reference.covered)
    np.testing.assert_allclose(read.second, reference.second, rtol=1e-3)
    assert read.noise == pytest.approx(0.02 / np.sqrt(2.0), rel=0.1)
    bright = read.measure(truth * np.float32(1.1), reference.tri_uv)
    assert bright.bias == pytest.approx(0.1, abs=0.005)
    assert bright.texels == reference.covered.sum()


def test_another_layout_is_refused_and_rounding_is_not():
    reference, truth = make_reference()
    reference.check_layout(reference.tri_uv + 1e-6)
    for layout in (reference.tri_uv + 0.1 / SIZE, reference.tri_uv[:-1]):
        with pytest.raises(ValueError, match="layout is not that of the reference"):
            reference.measure(truth, layout)
    with pytest.raises(ValueError, match="32 texels a side, the page 16"):
        reference.measure(truth[:16, :16], reference.tri_uv)


@pytest.mark.parametrize(("name", "size"), [(name, size) for size, names in COMMITTED.items() for name in sorted(names)])
def test_committed_references_have_little_noise_and_are_small(name, size):
    reference = Reference.load(name, size)
    assert reference.noise < 0.02  # it cancels, but for what it does to the choice of the best texels
    assert (REFERENCES / f"{name}_{size}.npz").stat().st_size < 1_000_000
    assert len(reference.first) == reference.covered.sum()
