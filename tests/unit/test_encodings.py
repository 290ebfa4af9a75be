"""Light in four bytes: known bytes, and how far a colour may be off after a round trip."""

import numpy as np
import pytest
from leaflight.core.util import encodings

# Of a round trip, relative to a colour's brightest channel; RGBM's and RGBD's bounds follow from half a step of 1/255.
LOGLUV_ERROR = 0.022  # of any Rec.709 colour: half a step of u' and v'
LOGLUV_LUMINANCE_ERROR = 2.0 ** (1 / 512) - 1.0


def colours(n=200_000, low=-3.0, high=1.0):
    """Colours of every hue, saturation and brightness, the darkest and brightest parts of a decade alike."""
    rng = np.random.default_rng(1)
    return rng.random((n, 3)) ** 3 * 10.0 ** rng.uniform(low, high, (n, 1))


def round_trip(rgb, encoding, value_range):
    stored = encodings.encode(rgb, encoding, value_range)
    assert stored.shape == (*rgb.shape[:-1], 4)
    assert stored.dtype == np.uint8
    out = encodings.decode(stored, encoding, value_range)
    assert out.dtype == np.float32
    return out


@pytest.mark.parametrize("value_range", [10.0, 16.0, 64.0])
def test_rgbm_and_rgbd_are_within_half_a_step_of_their_factor(value_range):
    rgb = colours()
    most = rgb.max(1, keepdims=True)
    for encoding, bound in (("rgbm", most + value_range / 255), ("rgbd", np.maximum(2 * most, value_range / 255))):
        assert (np.abs(round_trip(rgb, encoding, value_range) - rgb) <= bound / 510 * (1 + 1e-5)).all()


def test_logluv_is_within_half_a_step_of_its_chromaticity():
    rgb = colours(low=-9, high=15)  # darker ones, cubed, would fall below the least luminance
    error = np.abs(round_trip(rgb, "logluv", 1.0) - rgb) / rgb.max(1, keepdims=True)
    assert 0.5 * LOGLUV_ERROR < error.max() <= LOGLUV_ERROR


def test_logluv_keeps_luminance_to_a_step_of_its_logarithm():
    """Of colours that are not clipped at the border of Rec.709."""
    rgb = np.random.default_rng(2).uniform(0.2, 1.0, (100_000, 3)) * 10.0 ** np.random.default_rng(3).uniform(-15, 15, (100_000, 1))
    luminance = [values @ [0.2126390, 0.7151687, 0.0721923] for values in (rgb, round_trip(rgb, "logluv", 1.0))]
    assert np.abs(luminance[1] / luminance[0] - 1.0).max() == pytest.approx(LOGLUV_LUMINANCE_ERROR, rel=0.01)


def test_bytes_are_those_of_the_formulas():
    """Worked out by hand: RGBM 2.0 of 8 is a multiplier of 64/255; RGBD divides 8 by 2.0; white's u' v' are 0.1978 and 0.4683."""
    rgb = np.array([2.0, 1.0, 0.0])
    assert encodings.encode(rgb, "rgbm", 8.0).tolist() == [round(2 / 8 * 255 / 64 * 255), round(1 / 8 * 255 / 64 * 255), 0, 64]
    assert encodings.encode(rgb, "rgbd", 8.0).tolist() == [255, 128, 0, 4]
    white = encodings.encode(np.ones(3), "logluv", 1.0)
    assert white.tolist() == [64, 0, int(410 * 0.19784), int(410 * 0.46832)]
    assert encodings.encode(np.full(3, 2.0), "logluv", 1.0).tolist() == [65, 0, *white[2:]]


@pytest.mark.parametrize("encoding", encodings.ENCODINGS)
def test_black_stays_black_and_what_is_beyond_the_range_stays_at_it(encoding):
    rgb = np.array([[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [np.inf, 0.0, 0.0], [50.0, 50.0, 50.0]])
    out = round_trip(rgb, encoding, 5.0)
    assert not out[:2].any()
    assert np.isfinite(out).all()
    if encoding != "logluv":
        np.testing.assert_allclose(out[2:], [[5, 0, 0], [5, 5, 5]], rtol=1e-6)
    else:
        assert out[2, 0] > 1e18
        assert out[2, 1:].max() < 0.05 * out[2, 0]


def test_logluv_holds_its_greatest_luminance_and_no_more():
    out = round_trip(np.array([np.full(3, 1e30), np.full(3, 0.9 * encodings.LOGLUV_MAX)]), "logluv", 1.0)
    np.testing.assert_allclose(out[0], encodings.LOGLUV_MAX, rtol=LOGLUV_ERROR)
    np.testing.assert_allclose(out[1], 0.9 * encodings.LOGLUV_MAX, rtol=LOGLUV_ERROR)


@pytest.mark.parametrize("encoding", encodings.ENCODINGS)
def test_any_bytes_decode_to_numbers(encoding):
    stored = np.random.default_rng(4).integers(0, 256, (100_000, 4)).astype(np.uint8)
    stored[:, 2:] = np.maximum(stored[:, 2:], 1) if encoding == "logluv" else stored[:, 2:]
    out = encodings.decode(stored, encoding, 6.0)
    assert np.isfinite(out).all()
    assert out.min() >= 0


@pytest.mark.parametrize("greatest", [1.0, 9.98749, 1.00049, 47.31657028198242, 1e-4, 65504.0])
def test_range_is_short_and_holds_the_brightest(greatest):
    found = encodings.find_range(np.array([[0.0, greatest, 0.1 * greatest]]))
    assert greatest <= found <= greatest * 1.0006
    assert len(f"{found:g}") <= 9
    black = np.zeros((2, 2, 3))
    assert not round_trip(black, "rgbm", encodings.find_range(black)).any()


@pytest.mark.parametrize("convert", [lambda *a: encodings.encode(np.ones(3), *a), lambda *a: encodings.decode(np.ones(4, np.uint8), *a)])
def test_what_is_unknown_is_refused(convert):
    with pytest.raises(ValueError, match="expected one of rgbm, rgbd, logluv, got 'rgbe'"):
        convert("rgbe", 1.0)
    for odd in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="range: expected a number above 0"):
            convert("rgbm", odd)
