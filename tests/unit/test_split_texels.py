"""What lies beyond a wall's foot within a texel is the next texel's: hits, area and moments agree on it."""

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


@pytest.mark.parametrize(
    ("quadrant", "walls", "entry", "diagonal"),
    [(0, [(1, 1, 0.2, 0.8), (3, 0, 0.3, 0.7)], 0, 4), (2, [(7, 3, 0.1, 0.9), (5, 2, 0.4, 0.6)], 8, 4)],
)
def test_a_corner_takes_what_lies_within_both_walls(quadrant, walls, entry, diagonal):
    borders = borders_of(*walls)

    def beside(entries, step):
        row, column = np.divmod(entries, COLUMNS)
        column, row = column + step[0], row + step[1]
        return np.where((np.minimum(row, column) >= 0) & (np.maximum(row, column) < COLUMNS), row * COLUMNS + column, -1)

    corners = borders.find_corners(beside)
    assert [corners[0].tolist(), corners[1].tolist(), corners[3].tolist()] == [[quadrant], [entry], [diagonal]]
    borders = borders.with_corners(*corners)
    found, measured = count(borders, 2), borders.measure(2)
    np.testing.assert_allclose(found, measured, atol=4 * np.sqrt(COLUMNS**2 / 400_000))
    assert measured[0].sum() < len(borders.entry) + 1e-6
    own = np.searchsorted(borders.entry, entry)
    lost = (0.5 - corners[2]).prod()
    assert measured[0, own] == pytest.approx(1 - lost, rel=1e-6)
    assert borders.see_beyond(np.array([entry]), 1.0).tolist() == [True]
    place = np.random.default_rng(1).permutation(COLUMNS**2).astype(np.int32)
    turned = borders.renumber(place)
    own = np.searchsorted(turned.entry, place[entry])
    assert turned.diagonal[quadrant, own] == place[diagonal]
    np.testing.assert_array_equal(turned.corner[quadrant, :, own], corners[2][:, 0].astype(np.float32))


def test_what_lies_below_a_thick_wall_is_nobody_s_area():
    """Its light is the next texel's, where a photon gets there."""
    borders = borders_of((4, 0, 0.2, 0.5))
    assert borders.measure(0)[0] == pytest.approx([0.7, 1.0])
    borders = borders_of((4, 0, 0.2, 0.6))
    assert borders.measure(0)[0] == pytest.approx([0.7, 1.1])


def test_texels_that_nothing_crosses_keep_their_hits():
    borders = borders_of((4, 0, 0.2, 0.8))
    every = np.arange(COLUMNS**2, dtype=np.int32)
    assert borders.find_owners(every, np.full(9, 0.4), np.zeros(9)).tolist() == [0, 1, 2, 3, 5, 5, 6, 7, 8]
    assert borders.find_owners(every, np.full(9, 0.1), np.full(9, 0.49)).tolist() == every.tolist()
    assert borders.find_owners(every[:3], np.full(3, 0.4), np.zeros(3)).tolist() == [0, 1, 2]
    none = TexelBorders.none()
    assert none.find_owners(every, np.full(9, 0.4), np.zeros(9)) is every
