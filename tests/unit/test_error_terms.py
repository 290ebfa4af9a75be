"""What texels err by, by where it comes from, and sums over some of them."""

import dataclasses

import numpy as np
import pytest
from leaflight.core.filter.bias_estimate import Bias
from leaflight.core.filter.error_terms import RayNoise, Terms
from leaflight.core.filter.filtered_field import FilteredField, FilteredGather, SmoothedAt
from leaflight.core.filter.variance_estimate import PhotonNoise
from leaflight.core.texels.error_metric import BEST_TEXELS, DARK_FLOOR

COUNT = 1000


def terms_of(light, photons, direct, missing=0.0, gathered=None, dark=1.0):
    """Noise in W/m^2 of photons and of rays, and what is missing, on texels that are judged as one with this floor; each (n,)."""
    light = np.repeat(np.asarray(light, np.float32)[:, None], 3, axis=1)
    scale2 = light**2 + np.float32(dark) ** 2
    weight = np.divide(1.0, scale2, out=np.zeros_like(scale2), where=scale2 > 0.0)
    zero, n = np.zeros(len(light)), len(light)
    missing2 = weight[:, 0] * np.broadcast_to(missing, n) ** 2
    bias = Bias(np.arange(n, dtype=np.int32), missing2, missing2, zero, zero + np.nan, zero + np.nan)
    photons2 = weight[:, 0] * np.broadcast_to(photons, n) ** 2.0

    def rays(noise):
        shown = FilteredField.plain(light, np.repeat(np.broadcast_to(np.float32(noise), n)[:, None] ** 2, 3, axis=1))
        return RayNoise(shown.smoothing_at(np.arange(n)), np.ones(n, bool), weight[:, 0] * shown.noise[:, 0])

    noise = PhotonNoise(photons2, zero, 0.0, 0.0)
    return Terms(light, dark, weight, noise, zero, bias, rays(direct), None if gathered is None else rays(gathered), weight * 0.0 + 0.5)


def test_squares_of_all_that_texels_err_by_are_added():
    found = terms_of(np.full(COUNT, 10.0), photons=0.3, direct=0.4, missing=1.2, dark=0.0).sum_up(np.arange(COUNT))
    assert found.photons2 == pytest.approx(0.03**2)
    assert found.direct2 == pytest.approx(0.04**2, rel=1e-5)
    assert found.missing2 == pytest.approx(0.12**2, rel=2e-3)  # a thousandth of it could be chance
    assert found.relative**2 == pytest.approx(found.photons2 + found.direct2 + found.missing2)
    assert found.indirect == pytest.approx(0.5)
    assert found.chosen >= found.relative


@pytest.mark.parametrize("source", ["photons", "direct", "missing", "gathered"])
def test_the_worst_texels_are_left_out(source):
    noise = np.where(np.arange(COUNT) < (1.0 - BEST_TEXELS) * COUNT - 0.5, 1e6, 0.1)

    def error():
        terms = terms_of(np.ones(COUNT), **{"photons": 0.0, "direct": 0.0, source: noise}, dark=0.0)
        return terms.sum_up(np.arange(COUNT)).relative

    assert error() == pytest.approx(0.1, rel=1e-2 if source == "missing" else 1e-5)  # some of a bias could be chance
    noise[0:11] = 1e6  # one more than that
    assert error() > 0.13


def test_noise_that_the_filter_did_not_find_counts_less():
    """Half of the texels were filtered, and changed by half of the stated variance."""
    terms, is_smoothed = terms_of(np.ones(COUNT), 0.0, direct=0.2, dark=0.0), np.arange(COUNT) < COUNT // 2
    change = np.where(is_smoothed, np.float32(0.1), np.float32(0.0))[:, None].repeat(3, axis=1)
    found = dataclasses.replace(terms.direct, smoothing=SmoothedAt(change, -(change**2), is_smoothed))
    assert dataclasses.replace(terms, direct=found).sum_up(np.arange(COUNT)).direct2 == pytest.approx(0.75 * 0.2**2, rel=1e-2)


def test_dark_texels_count_for_their_object_if_light_may_have_missed_it():
    half = np.arange(COUNT) < COUNT // 2
    terms = dataclasses.replace(terms_of(half.astype(float), 0.1 * half, 0.0), unseen2=np.where(half, 0.0, 0.16))
    every = np.arange(COUNT)
    assert terms.sum_up(every).relative ** 2 == pytest.approx(0.1**2 / 2, rel=1e-5)  # half of the brightness is the floor
    assert terms.sum_up(every, unseen=True).photons2 > 0.07
    unlit = dataclasses.replace(terms, unseen2=0.0 * terms.unseen2)
    assert unlit.sum_up(every, unseen=True).relative == pytest.approx(terms.sum_up(every).relative)


@pytest.mark.parametrize("dark_of_all", [5.0, 0.02])
def test_an_object_alone_is_judged_beside_its_own_brightness(dark_of_all):
    """As if it had been all there is: its error is the same, whatever floor it had among others."""
    light = np.where(np.arange(COUNT) % 2, 0.1, 0.5)
    given = {"photons": 0.02, "direct": 0.01, "missing": 0.015}
    own_floor = DARK_FLOOR * max(0.3, dark_of_all)
    alone = terms_of(light, **given, dark=own_floor).sum_up(np.arange(COUNT)).relative
    among = dataclasses.replace(terms_of(light, **given, dark=dark_of_all), dark=dark_of_all)
    assert among.find_error_alone(np.arange(COUNT)) == pytest.approx(alone, rel=1e-4)


def test_gathered_light_takes_the_place_of_all_that_leaves_err_by():
    """And of nothing else, where it is shown."""
    terms = dataclasses.replace(terms_of(np.ones(COUNT), 0.3, 0.2, missing=0.1, dark=0.0), unseen2=np.full(COUNT, 0.16))
    shown_there = np.arange(COUNT) < COUNT // 2
    noise = np.full((COUNT, 3), 0.05**2, np.float32)
    shown = FilteredGather(FilteredField.plain(np.ones((COUNT, 3), np.float32), noise), np.full(COUNT, 0.01, np.float32), shown_there)
    with_it = terms.with_gathered(shown, np.arange(COUNT))
    for rows, expected2 in ((shown_there, 0.01 + 0.2**2 + 0.05**2), (~shown_there, 0.3**2 + 0.2**2 + 0.1**2 + 0.16)):
        assert with_it.sum_up(np.flatnonzero(rows)).relative ** 2 == pytest.approx(expected2, rel=2e-3)
