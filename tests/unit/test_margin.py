"""Margins on pages small enough to know every texel."""

import numpy as np
import pytest
from leaflight.core.texels.margin import add_margin


def fill_margin(page: np.ndarray, covered: np.ndarray, texels: int) -> np.ndarray:
    add_margin(out := page.copy(), covered, texels)
    return out


def test_between_two_charts_is_their_mean() -> None:
    page = np.zeros((5, 3, 1), np.float32)
    page[:, 0], page[:, 2] = 1.0, 5.0
    covered = np.array([[True, False, True]] * 5)
    np.testing.assert_array_equal(fill_margin(page, covered, 4)[:, 1, 0], np.full(5, 3.0))


@pytest.mark.parametrize(("texels", "height"), [(0, 17), (1, 17), (3, 17), (8, 17), (2, 400)])
def test_reach_is_the_number_of_steps(texels: int, height: int) -> None:
    rng = np.random.default_rng(texels)
    covered = rng.random((height, 23)) < 0.01
    covered[5, 6] = True
    page = np.where(covered[..., None], rng.uniform(1.0, 2.0, (height, 23, 3)), -1.0).astype(np.float32)
    filled = fill_margin(page, covered, texels)
    y, x = np.nonzero(covered)
    rows, columns = np.indices(covered.shape)
    distance = np.maximum(abs(rows[..., None] - y), abs(columns[..., None] - x)).min(axis=-1)
    np.testing.assert_array_equal(filled[..., 0] > 0.0, distance <= texels)
    np.testing.assert_array_equal(filled[covered], page[covered])
    assert filled[distance <= texels].max() <= page.max()
    assert filled.dtype == np.float32


def test_empty_and_full_pages_stay() -> None:
    page = np.arange(30, dtype=np.float32).reshape(3, 5, 2)
    for covered in (np.zeros((3, 5), bool), np.ones((3, 5), bool)):
        np.testing.assert_array_equal(fill_margin(page, covered, 4), page)


def test_a_colour_field_stays_smooth() -> None:
    """The first ring off a straight edge takes the mean of three neighbours along it, so a ramp along the edge goes on."""
    page, covered = np.zeros((9, 6, 1), np.float32), np.zeros((9, 6), bool)
    covered[:, :3] = True
    page[:, :3, 0] = np.arange(9)[:, None]
    np.testing.assert_allclose(fill_margin(page, covered, 1)[1:-1, 3, 0], np.arange(1, 8), rtol=1e-6)


def test_a_page_that_cannot_be_filled_in_place_is_told() -> None:
    with pytest.raises(ValueError, match="rows do not follow each other"):
        add_margin(np.zeros((4, 6, 3), np.float32).transpose(1, 0, 2), np.zeros((6, 4), bool), 1)


def test_a_part_of_a_page_is_filled_in_place() -> None:
    """Three of four channels: the fourth stays."""
    page, covered = np.zeros((4, 6, 4), np.float32), np.zeros((4, 6), bool)
    page[2, 3], covered[2, 3] = (1.0, 2.0, 3.0, 4.0), True
    add_margin(page[..., :3], covered, 1)
    np.testing.assert_array_equal(page[1:4, 2:5, :3], np.broadcast_to(np.float32([1.0, 2.0, 3.0]), (3, 3, 3)))
    assert page.sum() == 9 * 6.0 + 4.0
