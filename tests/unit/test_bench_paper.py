"""The measure of error of the benchmark of the paper."""

import numpy as np
import paper_bakes
import pytest


def test_noise_of_the_references_cancels():
    rng = np.random.default_rng(1)
    truth = rng.uniform(1.0, 2.0, (20_000, 3))
    noisy = [truth + rng.normal(0.0, 0.3, truth.shape) for _ in range(2)]
    reference = paper_bakes.Reference(*noisy, truth, truth[:, 0], np.ones(len(truth)))
    none, some = (reference.measure(truth * (1 + error)) for error in (0.0, 0.1))
    assert none.nrmse < 0.03
    assert some.nrmse == pytest.approx(0.1 * np.sqrt((truth**2).mean()) / truth.mean(), rel=0.1)
