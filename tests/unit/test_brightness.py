"""One number for three channels."""

import numpy as np
import pytest
from leaflight.core.util.brightness import LUMINANCE, weigh_channels


def test_grey_weighs_what_it_is():
    assert weigh_channels([[0.3] * 3, [0.0] * 3]) == pytest.approx([0.3, 0.0])


def test_every_channel_counts_between_the_eyes_weight_and_an_equal_one():
    for channel, weight in zip(np.eye(3), LUMINANCE, strict=True):
        least, most = sorted([weight, 1 / 3])
        assert least < weigh_channels([channel])[0] < most


def test_it_is_of_the_precision_of_sums():
    assert weigh_channels(np.ones((2, 3), np.float32)).dtype == np.float64
    assert weigh_channels(np.zeros((0, 3))).shape == (0,)
