"""What is told of charts that are too small for their page."""

from __future__ import annotations

import numpy as np
import pytest
from leaflight.core.charts import make_charts
from leaflight.core.outlines import Outlines
from leaflight.core.packing import Page
from leaflight.core.settings import Settings
from leaflight.core.small_charts import describe_small_charts, takes_padding_most
from scenes import box_mesh, make_scene, quad_mesh

PAGE = Page(256, 4)


def squares(count: int, side: float) -> Outlines:
    """Charts that are squares of so many metres."""
    return Outlines(
        np.zeros((0, 2, 2)), np.zeros(count + 1, np.int64), np.full((count, 2), side), np.full(count, side**2), np.ones(count, bool)
    )


@pytest.mark.parametrize(
    ("count", "side", "crowded", "told"),
    [
        (2000, 1.5, True, "its charts are so small and so many"),
        (2000, 0.9, True, "half of its charts are smaller than a texel"),
        (400, 9.0, False, ""),  # more covered than not
        (20, 1.5, False, ""),  # much room is left: it is not padding that keeps them small
    ],
)
def test_what_is_told(count, side, crowded, told):
    outlines = squares(count, side)
    assert takes_padding_most(outlines, 1.0, PAGE) == crowded
    sentence = describe_small_charts(outlines, 1.0, PAGE, crowded=crowded)
    assert sentence.startswith(told)
    assert bool(sentence) == bool(told)


def test_an_object_of_few_charts_is_not_to_blame():
    assert not describe_small_charts(squares(1, 60.0), 1.0, PAGE, crowded=True)


def test_it_is_told_of_the_object_with_the_many_charts():
    """260 boxes in one mesh, beside a floor, on a page of 256 texels."""
    boxes = [box_mesh(f"{i}", (0.03, 0.03, 0.03), (0.1 * (i % 20), 0.1 * (i // 20), 1.0)) for i in range(260)]
    vertex = np.concatenate([box.vertex for box in boxes])
    polygons = [[corner + 8 * i for corner in polygon] for i, box in enumerate(boxes) for polygon in box.polygons]
    many = type(boxes[0])("Many", vertex, polygons)
    warnings = make_charts(make_scene([quad_mesh("Floor", 0.3, 0.3), many]), Settings(size=256)).warnings
    assert [name for name, _ in warnings] == ["Many"]
    assert warnings[0][1].startswith("Many: its charts are so small and so many")
    assert not make_charts(make_scene([quad_mesh("Floor", 0.3, 0.3), many]), Settings(size=1024)).warnings
