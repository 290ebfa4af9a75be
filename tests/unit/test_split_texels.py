"""What lies beyond a wall's foot within a texel is the next texel's: hits, area and moments agree on it."""

from dataclasses import fields

import numpy as np
import pytest
from leaflight.core.texels.split_texels import OPPOSITE, WAYS, TexelBorders, whole_texel
from leaflight.core.util.coverage import monomial_exponents

COLUMNS = 3  # of a block of whole texels, entries by rows


def borders_of(*walls, n_texel=COLUMNS**2):
    """Each wall: entry, way, how far the entry goes, and the one beyond towards it."""
    rows = []
    for entry, way, reach, back in walls:
        x, y = WAYS[way]
        beyond = entry + x + y * COLUMNS
        rows += [(way, entry, beyond, reach), (OPPOSITE[way], beyond, entry, back)]
    way, entry, beyond, reach = zip(*rows, strict=True)
    return TexelBorders.of(n_texel, np.array(way), np.array(entry), np.array(beyond), np.array(reach))


def count(borders, degree, n=400_000):
    """(M, b) moments of what places over the whole block count for, and a standard error, where the walls' inside is lit too."""
    x, y = np.random.default_rng(1).random((2, n)) * COLUMNS
    entry = (np.floor(y) * COLUMNS + np.floor(x)).astype(np.int32)
    row, column = np.divmod(entry, COLUMNS)
    owner = borders.find_owners(entry, x - column - 0.5, y - row - 0.5)
    row, column = np.divmod(owner, COLUMNS)
    slot = np.searchsorted(borders.entry, owner.clip(0, borders.entry[-1]))
    own = np.flatnonzero(borders.entry[slot] == owner)
    s, t = (x - column - 0.5)[own], (y - row - 0.5)[own]
    area = COLUMNS**2 / n
    return np.stack([np.bincount(slot[own], s**i * t**j, len(borders.entry)) * area for i, j in monomial_exponents(degree)])


def test_parts_are_joined_to_what_pairs_of_all_tell():
    """Three blocks, nothing in the second."""
    first, last = [(4, 0, 0.2, 0.8), (0, 1, 0.7, 0.3)], [(1, 1, 0.4, 0.6)]
    block = COLUMNS**2
    nothing = TexelBorders.of(block, *(np.zeros(0, np.int64),) * 3, np.zeros(0))
    joined = TexelBorders.join([borders_of(*first), nothing, borders_of(*last)])
    whole = borders_of(*first, *((2 * block + entry, *rest) for entry, *rest in last), n_texel=3 * block)
    for field in fields(TexelBorders):
        one, other = getattr(joined, field.name), getattr(whole, field.name)
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype


@pytest.mark.parametrize(
    "walls",
    [
        [(4, 0, 0.2, 0.8)],
        [(4, 0, 0.7, 0.3)],
        [(4, 1, 0.1, 0.9)],
        [(4, 3, 0.9, 0.1)],
        [(4, 0, 0.2, 0.8), (3, 0, 0.4, 0.6)],  # on both sides of a texel
        [(4, 0, 0.3, 0.7), (4, 1, 0.8, 0.2)],  # at a corner
        [(4, 0, 0.3, 0.7), (4, 1, 0.2, 0.8)],
        [(4, 1, 0.2, 0.8), (3, 0, 0.9, 0.1)],  # who takes from the left takes all of a texel, also what lies above the other wall
    ],
)
def test_moments_are_those_of_what_counts_for_a_texel(walls):
    borders = borders_of(*walls)
    found, measured = count(borders, 2), borders.measure(2)
    assert measured.shape == (6, len(borders.entry))
    np.testing.assert_allclose(found, measured, atol=4 * np.sqrt(COLUMNS**2 / 400_000))
    assert measured[0].sum() == pytest.approx(len(borders.entry), rel=1e-6)  # thin walls take no area from anybody
    assert np.abs(measured - whole_texel(2)).max() > 0.1


def test_what_lies_below_a_thick_wall_is_nobody_s_area():
    """Its light is the next texel's, where a photon gets there."""
    borders = borders_of((4, 0, 0.2, 0.5))
    assert borders.measure(0)[0] == pytest.approx([0.7, 1.0])
    borders = borders_of((4, 0, 0.2, 0.6))
    assert borders.measure(0)[0] == pytest.approx([0.7, 1.1])


def test_things_behind_each_other_give_nothing_away():
    """What each of two texels meets first may stand behind what the other meets."""
    borders = borders_of((4, 0, 0.8, 0.9))
    assert borders.measure(0)[0] == pytest.approx([1.0, 1.0])
    here = np.array([4, 5], np.int32)
    assert borders.find_owners(here, np.array([0.49, -0.49]), np.zeros(2)).tolist() == [4, 5]


def test_texels_that_nothing_crosses_keep_their_hits():
    borders = borders_of((4, 0, 0.2, 0.8))
    every = np.arange(COLUMNS**2, dtype=np.int32)
    assert borders.find_owners(every, np.full(9, 0.4), np.zeros(9)).tolist() == [0, 1, 2, 3, 5, 5, 6, 7, 8]
    assert borders.find_owners(every, np.full(9, 0.1), np.full(9, 0.49)).tolist() == every.tolist()
    assert borders.find_owners(every[:3], np.full(3, 0.4), np.zeros(3)).tolist() == [0, 1, 2]
    none = TexelBorders.none()
    assert none.find_owners(every, np.full(9, 0.4), np.zeros(9)) is every


def test_what_a_square_around_the_centre_has_beyond():
    """A wall 0.1 right of the centre of texel 4, one right at it below, and one beyond the square above."""
    borders = borders_of((4, 0, 0.1, 0.9), (4, 3, 0.0, 1.0), (4, 1, 0.3, 0.7))
    entry, beyond, share = borders.list_beyond(0.5)
    assert list(zip(entry, beyond, share.round(6), strict=True)) == [(4, 5, 0.3), (4, 1, 0.5)]
    assert np.flatnonzero(borders.see_beyond(np.arange(9), 0.5)).tolist() == [4]
    assert np.flatnonzero(borders.see_beyond(np.arange(9)[::-1], 1.5)).tolist() == [1, 4]  # 7 and 4
    assert len(TexelBorders.none().list_beyond(0.5)[0]) == 0
    assert not TexelBorders.none().see_beyond(np.arange(9), 1.0).any()


def test_what_is_between_is_told_of_one_way_and_one_other():
    borders = borders_of((4, 0, 0.2, 0.8), (4, 1, 0.3, 0.7))
    one, other = np.array([4, 4, 4, 5, 0]), np.array([5, 7, 3, 4, 1])
    assert [borders.are_between(way, one, other).tolist() for way in (0, 1, 2)] == [
        [True, False, False, False, False],
        [False, True, False, False, False],
        [False, False, False, True, False],
    ]
    assert not TexelBorders.none().are_between(0, one, other).any()


def test_entries_can_have_other_numbers():
    borders = borders_of((4, 0, 0.2, 0.8), (4, 1, 0.3, 0.7))
    place = np.random.default_rng(1).permutation(9).astype(np.int32)
    moved = borders.renumber(place)
    assert (np.diff(moved.entry) > 0).all()
    assert moved.crossed.sum() == 3
    np.testing.assert_array_equal(moved.other < 0, np.isinf(moved.reach))
    every = np.arange(9, dtype=np.int32)
    for right, up in ((0.4, 0.1), (0.1, 0.4), (-0.4, 0.0)):
        before = borders.find_owners(every, np.full(9, right), np.full(9, up))
        assert moved.find_owners(place, np.full(9, right), np.full(9, up)).tolist() == place[before].tolist()
    np.testing.assert_allclose(moved.measure(2)[:, np.argsort(np.argsort(place[borders.entry]))], borders.measure(2))
