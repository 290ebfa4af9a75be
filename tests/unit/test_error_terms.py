"""What texels err by, by where it comes from, and sums over some of them."""

import dataclasses

import numpy as np
import pytest
from leaflight.core.filter import error_terms
from leaflight.core.filter.bias_estimate import Bias
from leaflight.core.filter.error_terms import RayNoise, Terms, judge_rays_alone
from leaflight.core.filter.filtered_field import FilteredField, FilteredGather
from leaflight.core.filter.variance_estimate import PhotonNoise
from leaflight.core.texels.error_metric import BEST_TEXELS, DARK_FLOOR

COUNT = 1000


def terms_of(light, photons, direct, missing=0.0, dark=1.0):
    """Noise in W/m^2 of photons and of rays, and what is missing, on texels that are judged as one with this floor; each (n,)."""
    light = np.repeat(np.asarray(light, np.float32)[:, None], 3, axis=1)
    scale2 = light**2 + np.float32(dark) ** 2
    weight = np.divide(1.0, scale2, out=np.zeros_like(scale2), where=scale2 > 0.0)
    zero, n = np.zeros(len(light)), len(light)
    missing2 = weight[:, 0] * np.broadcast_to(missing, n) ** 2
    told = Bias(np.arange(n, dtype=np.int32), missing2, missing2, zero, zero + np.nan, zero + np.nan)
    photons2 = weight[:, 0] * np.broadcast_to(photons, n) ** 2.0
    shown = FilteredField.plain(light, np.repeat(np.broadcast_to(np.float32(direct), n)[:, None] ** 2, 3, axis=1))
    rays = RayNoise(shown.tell_smoothing(np.arange(n)), np.ones(n, bool), weight[:, 0] * shown.noise[:, 0])
    return Terms(light, dark, weight, PhotonNoise(photons2, zero, 0.0, 0.0), zero, told, rays, None, weight * 0.0 + 0.5)


def test_squares_of_all_that_texels_err_by_are_added():
    told = terms_of(np.full(COUNT, 10.0), photons=0.3, direct=0.4, missing=1.2, dark=0.0).sum_up(np.arange(COUNT))
    assert told.photons2 == pytest.approx(0.03**2)
    assert told.direct2 == pytest.approx(0.04**2, rel=1e-5)
    assert told.missing2 == pytest.approx(0.12**2, rel=2e-3)  # a thousandth of it could be chance
    assert told.relative**2 == pytest.approx(told.photons2 + told.direct2 + told.missing2)
    assert told.indirect == pytest.approx(0.5)
    assert told.chosen >= told.relative


def test_the_worst_texels_are_left_out():
    noise = np.where(np.arange(COUNT) < (1.0 - BEST_TEXELS) * COUNT - 0.5, 1e6, 0.1)
    assert terms_of(np.ones(COUNT), noise, 0.0, dark=0.0).sum_up(np.arange(COUNT)).relative == pytest.approx(0.1, rel=1e-5)
    noise[0:11] = 1e6  # one more than that
    assert terms_of(np.ones(COUNT), noise, 0.0, dark=0.0).sum_up(np.arange(COUNT)).relative > 1e3


def test_texels_that_no_light_reaches_do_not_make_the_others_look_better():
    noise, light = np.where(np.arange(COUNT) < 500, 0.1, 0.0), np.where(np.arange(COUNT) < 500, 1.0, 0.0)
    told = terms_of(light, noise, 2.0 * noise, dark=0.0).sum_up(np.arange(COUNT))
    assert (told.photons2, told.direct2) == pytest.approx((0.1**2, 0.2**2), rel=1e-4)
    told_alone = judge_rays_alone(*alone(light, noise), np.arange(COUNT))
    assert told_alone == pytest.approx(0.1 / np.hypot(1.0, DARK_FLOOR), rel=1e-4)


@pytest.mark.parametrize("kind", ["photons", "direct", "missing"])
def test_the_worst_are_so_whatever_they_err_by(kind):
    noise = np.where(np.arange(COUNT) < (1.0 - BEST_TEXELS) * COUNT - 0.5, 100.0, 0.1)
    terms = terms_of(np.ones(COUNT), **{"photons": 0.01, "direct": 0.01, "missing": 0.0, kind: noise}, dark=0.0)
    assert terms.sum_up(np.arange(COUNT)).relative < 0.2


def test_only_texels_that_are_asked_count():
    noise = np.where(np.arange(COUNT) < 500, 0.1, 0.7)
    terms = terms_of(np.ones(COUNT), noise, 0.0, dark=0.0)
    assert terms.sum_up(np.arange(500)).relative == pytest.approx(0.1, rel=1e-5)
    assert terms.sum_up(np.arange(500, 1000)).relative == pytest.approx(0.7, rel=1e-5)


@pytest.mark.parametrize("dark_of_all", [5.0, 0.02])
def test_an_object_alone_is_judged_beside_its_own_brightness(dark_of_all):
    """As if it had been all there is: what is told of it is the same, whatever floor it was judged with among others."""
    light = np.where(np.arange(COUNT) % 2, 0.1, 0.5)
    given = {"photons": 0.02, "direct": 0.01, "missing": 0.015}
    own_floor = DARK_FLOOR * max(0.3, dark_of_all)
    alone = terms_of(light, **given, dark=own_floor).sum_up(np.arange(COUNT)).relative
    among = dataclasses.replace(terms_of(light, **given, dark=dark_of_all), dark=dark_of_all)
    assert among.judge_alone(np.arange(COUNT)) == pytest.approx(alone, rel=1e-4)


def test_what_is_unseen_is_asked_of_an_object_and_of_no_whole():
    terms = dataclasses.replace(terms_of(np.ones(COUNT), 0.3, 0.0, dark=0.0), unseen2=np.full(COUNT, 0.16))
    assert terms.sum_up(np.arange(COUNT)).relative == pytest.approx(0.3)
    assert terms.sum_up(np.arange(COUNT), unseen=True).relative == pytest.approx(0.5)
    assert terms.judge_alone(np.arange(COUNT)) == pytest.approx(0.5 / np.hypot(1.0, DARK_FLOOR), rel=1e-4)


def test_what_is_unseen_of_an_object_counts_where_no_light_is_known_yet():
    terms = terms_of(np.where(np.arange(COUNT) < 500, 1.0, 0.0), 0.0, 0.0)
    terms = dataclasses.replace(terms, unseen2=np.where(np.arange(COUNT) < 500, 0.0, 0.04))
    assert terms.sum_up(np.arange(COUNT), unseen=True).photons2 == pytest.approx(0.02, rel=0.02)
    assert terms.sum_up(np.arange(COUNT)).photons2 == 0.0


def test_gathered_light_takes_the_place_of_all_that_leaves_err_by():
    """And of nothing else, where it is told."""
    terms = dataclasses.replace(terms_of(np.ones(COUNT), 0.3, 0.2, missing=0.1, dark=0.0), unseen2=np.full(COUNT, 0.16))
    told = np.arange(COUNT) < COUNT // 2
    noise = np.full((COUNT, 3), 0.05**2, np.float32)
    shown = FilteredGather(FilteredField.plain(np.ones((COUNT, 3), np.float32), noise), np.full(COUNT, 0.01, np.float32), told, 0.02)
    with_it = terms.with_gathered(shown, np.arange(COUNT))
    for rows, expected2 in ((told, 0.01 + 0.02 + 0.2**2 + 0.05**2), (~told, 0.3**2 + 0.2**2 + 0.1**2 + 0.16)):
        assert with_it.sum_up(np.flatnonzero(rows), unseen=True).relative ** 2 == pytest.approx(expected2, rel=2e-3)


@pytest.mark.parametrize("light", [0.0, 1e-25])
def test_where_there_is_no_light_an_object_errs_by_nothing(light):
    """Or so little that its square is none in float32, as of a lamp beside a face as large as a galaxy."""
    assert terms_of(np.full(50, light), 0.0, 0.0, dark=0.0).judge_alone(np.arange(50)) == 0.0


def alone(light, direct, dark=0.0):
    """Arguments of judge_rays_alone but for the rows."""
    terms = terms_of(light, 0.0, direct, dark=dark)
    return terms.light, terms.dark, terms.weight, terms.direct


def test_rays_alone_are_judged_likewise():
    terms = terms_of(np.full(COUNT, 0.2), 0.0, 0.03, dark=4.0)
    told = judge_rays_alone(*alone(np.full(COUNT, 0.2), 0.03, dark=4.0), np.arange(COUNT))
    assert told == pytest.approx(terms.judge_alone(np.arange(COUNT)), rel=1e-4)
    assert told == pytest.approx(0.03 / np.hypot(0.2, DARK_FLOOR * 4.0), rel=1e-4)


def test_root_mean_squares_of_rays_leave_out_the_worst(monkeypatch):
    monkeypatch.setattr(error_terms, "BEST_TEXELS", 0.5)
    _, _, weight, rays = alone(np.ones(3), np.array([2.0, 10.0, 1.0]))
    assert rays.find_error(weight, np.arange(2)) == 2.0
    assert rays.find_error(weight, np.zeros(0, np.int64)) == 0.0


@pytest.mark.parametrize(("blur2", "counted"), [(0.03, 0.03), (0.0, 0.0), (-0.03, 0.0)])
def test_of_rays_alone_blur_counts_but_never_below_nothing(blur2, counted):
    """Nor is noise that smoothing did not find taken for none."""
    _, _, weight, rays = alone(np.ones(COUNT), 0.1)
    smoothing = dataclasses.replace(rays.smoothing, blur2=np.full((COUNT, 3), np.float32(blur2)), is_smoothed=np.ones(COUNT, bool))
    blurred = dataclasses.replace(rays, smoothing=smoothing)
    assert blurred.find_error(weight, np.arange(COUNT)) ** 2 == pytest.approx(0.01 + counted, rel=1e-5)
    blurred.smoothing.blur2[:-10] = 0.0  # and there is none among the others
    assert blurred.find_error(weight, np.arange(500)) ** 2 == pytest.approx(0.01, rel=1e-5)
