"""Lattices on which the filter runs: all texels of a page, and where quads share a sample, one texel of each quad."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..util.arrays import BoolArray, Int32, Int64, IntArray
from .quads import find_whole_quads, list_texels
from .texel_map import TexelMap


@dataclass(frozen=True)
class Lattice:
    """The texels of a page, or every second one in each direction.

    grainy     (m,) int64: entries to be filtered
    xy         (m, 2) int: their columns and rows
    entry_at   (h, w) int32, -1 where no chart covers the texel
    may        (n,) bool: further entries that may be filtered; None means all
    of_quads   whether each of these entries represents its quad
    """

    grainy: Int64
    xy: IntArray
    entry_at: Int32
    may: BoolArray | None
    of_quads: bool


def list_lattices(grainy: BoolArray, texels: TexelMap, by_quads: BoolArray | None = None) -> Iterator[Lattice]:
    """The lattices on which noise is filtered; arguments are as for denoise.begin_denoising.

    Charts begin anywhere, so the first texels of quads may lie on any of four lattices. The lattice of all texels filters those outside of
    quads, and its windows reach into quads, so light stays continuous at the borders of quads.
    """
    entries, first = np.flatnonzero(grainy), np.zeros(0, np.int64)
    is_first = is_single = None
    if by_quads is not None:
        whole = find_whole_quads(by_quads, texels.texel_code)
        is_first, is_single = np.zeros(len(texels), bool), np.ones(len(texels), bool)
        is_first[whole], is_single[list_texels(whole)] = True, False
        first = whole[grainy[whole]]
    page, page_of_first = texels.page_of(entries), texels.page_of(first)
    for number, entry_at in enumerate(texels.entry_at if len(entries) else ()):
        some = entries[page == number]
        yield Lattice(some, texels.texel_xy[some], entry_at, is_single, False)
        some = first[page_of_first == number]
        xy = texels.texel_xy[some]
        for column, row in product((0, 1), (0, 1)):
            rows = np.flatnonzero((xy & 1 == (column, row)).all(axis=1))
            if len(rows):
                yield Lattice(some[rows], xy[rows] >> 1, entry_at[row::2, column::2], is_first, True)
