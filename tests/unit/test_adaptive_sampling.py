"""More rays go from texels where one of them takes more off the squared error than a photon's ray does."""

from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.integrate.adaptive_sampling import DIRECT_SHARE, choose_texels
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.gathered import GatheredField
from leaflight.core.texels.error_metric import Parts

ERROR = 0.1  # that is asked for
LEAST = (DIRECT_SHARE * ERROR) ** 2  # below which rays are left as they are
TEXEL2 = np.array([0.0, 0.9, 1.1, 50.0, 50.0]) * LEAST


def field_of(kind, rays):
    field = kind.none(len(TEXEL2))
    field.counters["rays"] = rays
    field.passes[:] = 1
    return field


def stated(relative, direct, gathered=0.0):
    told = SimpleNamespace(relative=relative, chosen=relative, direct=direct, gathered=gathered, parts=Parts.whole(5, 1.0))
    told.texel_direct2 = lambda: TEXEL2.astype(np.float32)
    told.texel_gathered2 = (lambda: TEXEL2[::-1].astype(np.float32)) if gathered else None
    return told


def test_texels_that_err_too_much_are_chosen_where_shadow_rays_are_few():
    direct = field_of(DirectField, 100)
    rays, texels, _ = choose_texels(ERROR, stated(0.15, 0.1), 1000, direct, None)
    assert rays is direct
    assert texels.tolist() == [2, 3, 4]


def test_not_where_a_photon_helps_as_much():
    by_direct = 0.1**2 / 100
    for photons, chosen in ((0.9 * by_direct * 1000, True), (1.1 * by_direct * 1000, False)):
        found = choose_texels(ERROR, stated(np.sqrt(photons + 0.1**2), 0.1), 1000, field_of(DirectField, 100), None)
        assert (found is not None) == chosen


@pytest.mark.parametrize(("direct", "chosen"), [(0.99 * np.sqrt(LEAST), False), (1.01 * np.sqrt(LEAST), True)])
def test_not_where_direct_light_is_as_sure_as_it_has_to_be(direct, chosen):
    assert (choose_texels(ERROR, stated(direct * 1.001, direct), 10**9, field_of(DirectField, 1000), None) is not None) == chosen


def test_of_light_that_is_all_that_errs_no_more_texels_than_bring_it_to_the_error():
    """One ray more halves the squared error of each: the two worst take off a fourth of the whole, and for more there must be three."""
    for direct, chosen in ((0.11, [3, 4]), (0.15, [2, 3, 4])):
        assert choose_texels(ERROR, stated(direct, direct), 1000, field_of(DirectField, 100), None)[1].tolist() == chosen


def test_the_one_whose_rays_help_most():
    direct, gathered = field_of(DirectField, 100), field_of(GatheredField, 10)
    for errors, expected in (((0.1, 0.09), gathered), ((0.3, 0.06), direct)):
        rays, texels, _ = choose_texels(ERROR, stated(0.4, *errors), 10**9, direct, gathered)
        assert rays is expected
        assert texels.tolist() == ([0, 1, 2, 3, 4] if expected is gathered else [2, 3, 4])  # of gathered light neighbours share their error
    assert choose_texels(ERROR, stated(0.4, 0.3), 10**9, direct, gathered)[0] is direct  # light that nothing was gathered of


def open_to(*errors):
    """What is stated of texels in two parts, those of an even index in the first."""
    told = stated(0.15, 0.1)
    told.parts, told.of_parts = Parts([np.arange(1)] * 2, np.ones(2, np.float32), np.array([0, 1, 0, 1, 0], np.int32)), np.array(errors)
    return told


def test_of_several_parts_those_that_have_come_to_the_error_get_no_more_rays():
    direct = field_of(DirectField, 100)
    assert choose_texels(ERROR, open_to(0.15, 0.05), 1000, direct, None)[1].tolist() == [2, 4]
    assert choose_texels(ERROR, open_to(0.05, 0.15), 1000, direct, None)[1].tolist() == [3]
