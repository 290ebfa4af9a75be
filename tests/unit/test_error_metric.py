"""Whose error is asked for: the whole's, or that of each object beside its own brightness."""

from itertools import pairwise

import numpy as np
import pytest
from leaflight.core.texels import error_metric
from leaflight.core.texels.error_metric import DARK_FLOOR, ErrorMetric
from trees import make_map

SIDE = 64  # texels


def strips_map(*columns, side=SIDE, rows=None):
    """A page of upright strips, each a chart and an object of so many columns, and rows or `side`; and the object of each triangle."""
    strips = list(zip(pairwise(np.cumsum([0, *columns])), rows or [side] * len(columns), strict=True))
    uv = [[[a, 0], [b, 0], [b, high]] for (a, b), high in strips] + [[[a, 0], [b, high], [a, high]] for (a, b), high in strips]
    thing = np.tile(np.arange(len(columns)), 2)
    return make_map(uv, chart=thing, size=side), thing


def test_the_whole_is_asked_all_over_and_its_objects_are_told_apart():
    texels, tri_object = strips_map(48, 16)
    whole = ErrorMetric.of("bake", texels, tri_object)
    assert whole.entry.tolist() == error_metric.choose_sample(texels).tolist()
    assert [rows.tolist() for rows in whole.groups] == [list(range(len(whole.entry)))]
    assert {thing: len(rows) for thing, rows in whole.objects.items()} == {0: 48 * SIDE, 1: 16 * SIDE}
    for thing, rows in whole.objects.items():
        assert (tri_object[texels.texel_tri[whole.entry[rows]]] == thing).all()


def test_each_object_is_asked_as_much_as_another():
    texels, tri_object = strips_map(100, 20, side=128)
    each = ErrorMetric.of("objects", texels, tri_object)
    small, large = (len(rows) for rows in each.groups)
    assert small == large < 20 * 128
    assert (np.diff(each.entry) > 0).all()
    for thing, rows in each.objects.items():
        assert rows.tolist() == each.groups[thing].tolist()
        assert (each.entry_group[each.entry[rows]] == thing).all()


@pytest.mark.parametrize(("rows", "groups"), [(32, [0, 1, 2]), (31, [0, 1, 1]), (15, [0, -1, -1])])
def test_objects_with_few_texels_are_judged_together_or_not_at_all(rows, groups):
    texels, tri_object = strips_map(62, 1, 1, rows=[SIDE, rows, rows])
    each = ErrorMetric.of("objects", texels, tri_object)
    thing = tri_object[texels.texel_tri]
    assert [sorted(set(each.entry_group[thing == one])) for one in range(3)] == [[group] for group in groups]
    assert len(each.groups) == max(groups) + 1
    assert sorted(each.objects) == [one for one, group in enumerate(groups) if groups.count(group) == 1]


def test_where_no_object_has_enough_texels_it_is_the_whole():
    texels, tri_object = strips_map(1, 1, rows=[15, 15])
    each = ErrorMetric.of("objects", texels, tri_object)
    assert each.entry_group is None
    assert len(each.groups[0]) == 30
    assert each.objects == {}


def test_each_object_is_judged_beside_its_own_brightness():
    """But not next to black: below a tenth of what is dark on the whole."""
    texels, tri_object = strips_map(32, 16, 16)
    each = ErrorMetric.of("objects", texels, tri_object)
    level = np.array([10.0, 0.5, 1e-6], np.float32)
    light = np.repeat(level[tri_object[texels.texel_tri[each.entry]]][:, None], 3, axis=1)
    parts = each.part(light, dark=0.2)
    assert parts.dark2 == pytest.approx((DARK_FLOOR * np.array([10.0, 0.5, 0.2])) ** 2, rel=1e-5)
    entries = np.array([np.flatnonzero(tri_object[texels.texel_tri] == one)[0] for one in range(3)])
    assert parts.find_dark2(entries)[:, 0] == pytest.approx(parts.dark2)
    whole = ErrorMetric.of("bake", texels, tri_object).part(light, dark=0.2)
    assert whole.find_dark2(entries) == pytest.approx([0.2**2])
