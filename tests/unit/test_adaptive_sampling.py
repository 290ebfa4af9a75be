"""More rays go from texels where one of them takes more off the squared error than a photon's ray does."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.integrate.adaptive_sampling import DIRECT_SHARE, choose_texels, have_look
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.gathered import GatheredField
from leaflight.core.texels.error_metric import Parts
from leaflight.core.transport.rounds import SPARE

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


def test_below_openings_neighbours_are_chosen_as_one():
    direct = field_of(DirectField, 100)
    direct.by_openings[:3] = True
    assert choose_texels(ERROR, stated(0.15, 0.1), 1000, direct, None)[1].tolist() == [3, 4]
    direct.by_openings[3] = True
    assert choose_texels(ERROR, stated(0.15, 0.1), 1000, direct, None)[1].tolist() == [0, 1, 2, 3, 4]


def test_not_where_a_photon_helps_as_much():
    by_direct = 0.1**2 / 100
    for photons, chosen in ((0.9 * by_direct * 1000, True), (1.1 * by_direct * 1000, False)):
        found = choose_texels(ERROR, stated(np.sqrt(photons + 0.1**2), 0.1), 1000, field_of(DirectField, 100), None)
        assert (found is not None) == chosen


@pytest.mark.parametrize(("direct", "chosen"), [(0.99 * np.sqrt(LEAST), False), (1.01 * np.sqrt(LEAST), True)])
def test_not_where_direct_light_is_as_sure_as_it_has_to_be(direct, chosen):
    assert (choose_texels(ERROR, stated(direct * 1.001, direct), 10**9, field_of(DirectField, 1000), None) is not None) == chosen


def test_the_one_whose_rays_help_most():
    direct, gathered = field_of(DirectField, 100), field_of(GatheredField, 10)
    for errors, expected in (((0.1, 0.09), gathered), ((0.3, 0.06), direct)):
        rays, texels, _ = choose_texels(ERROR, stated(0.4, *errors), 10**9, direct, gathered)
        assert rays is expected
        assert texels.tolist() == ([0, 1, 2] if expected is gathered else [2, 3, 4])
    assert choose_texels(ERROR, stated(0.4, 0.3), 10**9, direct, gathered)[0] is direct  # light that nothing was gathered of


def test_texels_that_had_their_share_are_left():
    direct = field_of(DirectField, 100)
    direct.passes[[2, 4]] = DirectField.most_passes
    assert choose_texels(ERROR, stated(0.15, 0.1), 1000, direct, None)[1].tolist() == [3]
    direct.passes[3] = DirectField.most_passes
    assert choose_texels(ERROR, stated(0.15, 0.1), 1000, direct, None) is None


# A batch has half as many estimates as there were: 5 of 10 texels that had one each, all of those that had three.
@pytest.mark.parametrize(("passes", "share", "expected"), [(1, 0.09, 5), (1, 0.33, 7), (3, 0.09, 10), (1, 0.5, 10), (1, 0.9, 10)])
def test_no_more_texels_than_are_enough_and_a_batch_has(passes, share, expected):
    """Of ten that err alike each takes half of a tenth off if it has had one estimate, and a quarter of that if it has had three."""
    told = stated(0.0, 0.2)
    told.texel_direct2 = lambda: np.full(10, 4 * ERROR**2, np.float32)
    told.relative = told.chosen = np.sqrt(ERROR**2 - (1 - share) * SPARE * told.direct**2 + told.direct**2)
    direct = DirectField.none(10)
    direct.counters["rays"], direct.passes[:] = 1, passes
    found = choose_texels(ERROR, told, 10**9, direct, None)[1]
    assert found.tolist() == list(range(expected))
    told.chosen *= 1.2  # the error that a bake stops by: what may be missing by chance is no ray's to take off
    assert len(choose_texels(ERROR, told, 10**9, direct, None)[1]) > expected or expected in (5, 10)


@pytest.mark.parametrize(("passes", "repeats"), [(1, 1), (4, 4), (40, 9)])
def test_a_few_texels_that_want_more_again_double_what_they_had(passes, repeats):
    """Three of 54 texels that had one estimate each: half as many as all had are 27, for three texels nine each, and a few more."""
    told = stated(0.15, 0.1)
    error2 = np.zeros(54, np.float32)
    error2[:3] = 1.0
    told.texel_direct2, told.parts = (lambda: error2), Parts.whole(54, 1.0)
    direct = DirectField.none(54)
    direct.counters["rays"], direct.passes[:] = 54, 1
    direct.passes[:3] = passes
    _, texels, found = choose_texels(ERROR, told, 10**9, direct, None)
    assert texels.tolist() == [0, 1, 2]
    assert found == min(repeats + (0 if passes < 40 else (51 + 3 * 40) // 2 // 3 - 9), passes)


def test_where_the_error_asked_for_is_far_all_are_sent_at_once():
    """A few at a time, each with a look at the whole page, would take longer."""
    direct = field_of(DirectField, 1)
    for chosen in (0.2, 0.1):  # far from it; and near, with direct light that is almost as sure as it has to be
        told = stated(chosen, 1.01 * np.sqrt(LEAST))
        assert choose_texels(ERROR, told, 10**9, direct, None)[1].tolist() == [2, 3, 4]


def test_those_that_err_most_are_enough():
    told = stated(0.0, 0.2)
    error2 = np.full(1000, 4 * ERROR**2, np.float32)
    error2[::10] *= 100
    error2[[3, 4]] = 1e9  # are among the worst, which the stated error leaves out
    told.texel_direct2 = lambda: error2
    told.relative = told.chosen = np.sqrt(ERROR**2 - 0.7 * SPARE * told.direct**2 + told.direct**2)
    direct = DirectField.none(1000)
    direct.counters["rays"], direct.passes[:] = 1, 1
    found = choose_texels(ERROR, told, 10**9, direct, None)[1]
    assert len(found) == 500  # a batch
    assert np.isin([3, 4, *range(0, 1000, 10)], found).all()


def test_light_is_gathered_more_often_than_shadow_rays_are_sent():
    """By hardly more rays than a texel takes at once, so that with as few looks small errors are missed."""
    gathered = field_of(GatheredField, 10)
    told = stated(0.4, 0.0, 0.3)
    for passes, left in ((DirectField.most_passes, [0, 1, 2]), (GatheredField.most_passes, [1, 2])):
        gathered.passes[0] = passes
        assert choose_texels(ERROR, told, 10**9, field_of(DirectField, 100), gathered)[1].tolist() == left


def test_so_are_those_of_the_field_that_is_chosen():
    direct, gathered = field_of(DirectField, 100), field_of(GatheredField, 10)
    direct.passes[:] = DirectField.most_passes
    assert choose_texels(ERROR, stated(0.4, 0.1, 0.09), 10**9, direct, gathered)[1].tolist() == [0, 1, 2]


def test_what_photons_may_gain_is_neither_of_both_rays():
    """Else an error that is all of shadow rays and gathering would be photons' too."""
    direct, gathered = field_of(DirectField, 1000), field_of(GatheredField, 1000)
    assert choose_texels(ERROR, stated(np.hypot(0.1, 0.09) * 1.001, 0.1, 0.09), 100, direct, gathered)[0] is direct


def test_more_photons_want_all_that_was_gathered_again():
    """The little that photons err by would fall quickly, were theirs the only rays."""
    gathered = field_of(GatheredField, 1_000_000)
    told = stated(np.hypot(0.09, 0.02), 0.0, 0.09)
    assert choose_texels(ERROR, told, 10_000, field_of(DirectField, 100), gathered)[0] is gathered
    told = stated(np.hypot(0.09, 0.2), 0.0, 0.09)  # there is no way round them
    assert choose_texels(ERROR, told, 10_000, field_of(DirectField, 100), gathered) is None


@pytest.mark.parametrize("heard", [[], ["Direct light, 3%"]])
def test_who_heard_of_a_look_is_told_what_follows(heard):
    told = []

    def stop():
        return False

    def look(tell, should_stop):
        assert should_stop is stop
        for word in heard:
            tell(word)

    have_look(look, told.append, stop, "Tracing photons")
    assert told == [*heard, *(["Tracing photons"] if heard else [])]


def open_to(*errors):
    """What is stated of texels in two parts, those of an even index in the first."""
    told = stated(0.15, 0.1)
    told.parts, told.of_parts = Parts([np.arange(1)] * 2, np.ones(2, np.float32), np.array([0, 1, 0, 1, 0], np.int32)), np.array(errors)
    return told


def test_of_several_parts_those_that_have_come_to_the_error_get_no_more_rays():
    direct = field_of(DirectField, 100)
    assert choose_texels(ERROR, open_to(0.15, 0.05), 1000, direct, None)[1].tolist() == [2, 4]
    assert choose_texels(ERROR, open_to(0.05, 0.15), 1000, direct, None)[1].tolist() == [3]


def test_rays_of_one_part_cost_less_than_those_of_all():
    """So that they are sent sooner: by so much as it is smaller."""
    direct = field_of(DirectField, 1000)
    traced = 0.75 * 1000 * (0.15**2 - 0.1**2) / 0.1**2  # photons that take as much off for three quarters of the rays
    assert choose_texels(ERROR, stated(0.15, 0.1), traced, direct, None) is None
    assert choose_texels(ERROR, open_to(0.15, 0.05), traced, direct, None)[1].tolist() == [2, 4]
