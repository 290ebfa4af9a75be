"""What is told of an unwrapped object whose charts are too small for the page they are on."""

from __future__ import annotations

import numpy as np

from .outlines import Outlines
from .packing import Page

_FEWEST_TEXELS = 1.0  # a chart of less area than this is hardly a lightmap
_MOSTLY = 1 / 8  # share of what is taken that charts cover, below which all that one sees is padding
_FULL = 0.5  # share of a page that charts take together with their padding, from which on it is for want of room that they are small


def takes_padding_most(outlines: Outlines, density: float, page: Page) -> bool:
    """Whether a page on which charts lie at so many texels/m is full, and that with padding for the most."""
    taken = _count_taken(outlines, density, page)
    return taken > _FULL * page.size**2 and _count_covered(outlines, density) < _MOSTLY * min(taken, page.size**2)


def describe_small_charts(outlines: Outlines, density: float, page: Page, *, crowded: bool) -> str:
    """A sentence about the charts of one object, "" where nothing is to be told.

    crowded   what takes_padding_most says of the charts of all objects on the page
    """
    if float(np.median(outlines.area)) * density**2 < _FEWEST_TEXELS:
        return "half of its charts are smaller than a texel; choose a greater page size or density, or merge small faces"
    if crowded and _count_covered(outlines, density) < _MOSTLY * _count_taken(outlines, density, page):
        return (
            "its charts are so small and so many that the padding between them takes most of the page; choose a greater page size or less "
            "padding, or give it a UV layer with fewer charts"
        )
    return ""


def _count_covered(outlines: Outlines, density: float) -> float:
    return float(outlines.area.sum()) * density**2


def _count_taken(outlines: Outlines, density: float, page: Page) -> float:
    """Texels of the charts' boxes, each with its padding on two sides."""
    return float((outlines.extent * density + page.padding).prod(axis=1).sum())
