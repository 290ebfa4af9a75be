"""Contacts on the texels of a scene, and charts cut along them.

Where a wall or a cupboard stands on a floor, light jumps: there is another room behind the wall, and none below the cupboard. A leaf over
both sides could hold neither, and what it says of one would leak to the other. So a piece of a chart that is parted from the rest by what
stands on it becomes a chart of its own, as the sides of a crease do. So does what lies below a rug, or behind a curtain that hangs close to
a wall and touches it nowhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..parallel import folders, shared_arrays
from ..texels import contact
from ..texels.contact_parts import part_in_squares
from ..texels.entry_order import EntryOrder, put_in_order
from ..texels.split_texels import OPPOSITE, WAYS, TexelBorders, share_texels
from ..texels.texel_grid import interleave_bits, step_codes
from ..texels.texel_map import CHART_SHIFT, TexelMap
from ..texels.tiles import TILE_SIDE
from ..util.ablation import uses
from ..util.arrays import BoolArray, Int64
from ..util.messages import Status
from ..util.progress import Say, Watch, stretch, unwatched
from ..util.threads import run_on_threads
from . import traced_scene
from .contact_probes import Probes, Surroundings
from .traced_scene import TracedScene

if TYPE_CHECKING:  # the search alone needs no charts
    from ..atlas.charts import ChartAtlas

LOOKING = Status("contacts", "Looking for contacts")
_IN_TILE = interleave_bits(np.array([TILE_SIDE - 1, 0]), np.array([0, TILE_SIDE - 1]))  # bits of a key: column and row within a tile
_NARROW = 0.02  # texels; what is narrower between two surfaces is the inaccuracy of one
_LEAST_PIECE = 4  # texels; smaller ones, between books or blades of grass, would catch too few photons each for itself


@dataclass(frozen=True)
class ContactMap:
    """Where other things meet the surface.

    touched   (n,) bool: texel entries that something touches
    patches   that tile all entries of charts that something parts
    piece     (k,) int64: the first patch of the piece that each patch is of
    whole     (k,) int64: the same of what hangs together somehow, of which a piece may be a part
    borders   of texels with something between them and the next one
    """

    touched: BoolArray
    patches: _Patches
    piece: Int64
    whole: Int64
    borders: TexelBorders

    @classmethod
    def join(cls, parts: Sequence[ContactMap]) -> ContactMap:
        """That of all entries, of parts of them that follow each other, whole charts each, and each numbered for itself."""
        first_entry = [0, *accumulate(len(part.touched) for part in parts[:-1])]
        first_patch = [0, *accumulate(len(part.piece) for part in parts[:-1])]
        patches = [part.patches for part in parts]
        return cls(
            np.concatenate([part.touched for part in parts]),
            _Patches(
                _number_on(first_entry, [some.start for some in patches]),
                np.concatenate([some.size for some in patches]),
                np.concatenate([some.key for some in patches]),
            ),
            _number_on(first_patch, [part.piece for part in parts]),
            _number_on(first_patch, [part.whole for part in parts]),
            TexelBorders.join([part.borders for part in parts]),
        )


@dataclass(frozen=True)
class _Patches:
    """Entries, and tiles that nothing touches.

    start   (k,) int64, ascending: first entry of each
    size    (k,) int64: 1 or TILE_TEXELS entries, in Morton order
    key     (k,) int64, ascending, of TexelMap.list_keys
    """

    start: Int64
    size: Int64
    key: Int64

    def find_beside(self, rows: Int64, step: tuple[int, int]) -> tuple[Int64, Int64]:
        """Those of the patches `rows` (m,) that have a texel of their chart so many columns and rows from their first; and its patch.

        out   (j,) int64 twice
        """
        _, other = self._find(self.key[rows], step)
        found = np.flatnonzero(other >= 0)
        return rows[found], other[found]

    def find_entries(self, key: Int64, step: tuple[int, int]) -> Int64:
        """The entries that lie so many columns and rows from those of keys (m,) in their charts, -1 for none."""
        beside, patch = self._find(key, step)
        return np.where(patch >= 0, self.start[patch] + beside - self.key[patch], -1)

    def _find(self, key: Int64, step: tuple[int, int]) -> tuple[Int64, Int64]:
        """(m,) twice: the keys of the texels so many columns and rows from those of keys (m,), and the patches that have them, or -1."""
        code = (1 << CHART_SHIFT) - 1
        beside = key & ~code
        beside |= step_codes(key & code, *step)
        patch = np.searchsorted(self.key, beside, side="right") - 1
        return beside, np.where((patch >= 0) & (beside < self.key[patch] + self.size[patch]), patch, -1)


def _number_on(first: Sequence[int], parts: Sequence[Int64]) -> Int64:
    """Numbers of parts, each counted from 0, one part after the other; from `first` of each on."""
    return np.concatenate([low + part for low, part in zip(first, parts, strict=True)])


def find_contacts(
    opened: TracedScene, texels: TexelMap, threads: int = 1, watch: Watch = unwatched, part: slice | None = None
) -> ContactMap:
    """Contacts at all texel entries, looked for by so many threads.

    watch   receives LOOKING and the finished share of the search and of cut_at_contacts; it may raise
    part    only at these entries, those of whole charts, numbered from the first of them
    """
    around = Surroundings.of(opened, _take_charts(texels, part) if part else texels)
    probes = Probes.join(  # tiles end where parts do, which are those of all entries whoever probes
        run_on_threads(around.probe, len(texels), threads, stretch(watch, LOOKING, 0.0, 0.6), part), stretch(watch, LOOKING, 0.6, 0.61)
    )
    return _join_patches(around, probes, stretch(watch, LOOKING, 0.61, 0.7))


def find_in_charts(folder: str, start: int, stop: int) -> ContactMap:
    """find_contacts at entries start ... stop - 1 of the scene and the texels in `folder`, which are not kept open: they are to be cut."""
    texels = shared_arrays.load_struct(Path(folder) / folders.TEXELS_FOLDER, TexelMap)
    return find_contacts(traced_scene.open_scene(folder), texels, part=slice(start, stop))


def _take_charts(texels: TexelMap, part: slice) -> TexelMap:
    """The map of the entries of some charts alone, in which no hits are found; nothing that lies along all entries is copied."""
    rows = slice(*np.searchsorted(texels.part_entry, (part.start, part.stop)))
    return dataclasses.replace(
        texels,
        chart_start=np.clip(texels.chart_start - part.start, 0, part.stop - part.start),
        texel_chart=texels.texel_chart[part],
        texel_xy=texels.texel_xy[part],
        texel_code=texels.texel_code[part],
        texel_area=texels.texel_area[part],
        texel_tri=texels.texel_tri[part],
        part_entry=texels.part_entry[rows] - part.start,
        part_point=texels.part_point[rows],
        part_moments=texels.part_moments[rows],
        pair_start=texels.pair_start[rows.start : rows.stop + 1],
    )


@dataclass(frozen=True)
class _Beside:
    """Patches of one texel each, and those next to them, each pair once.

    way     (m,) int64: 0 or 1 of WAYS, from the one to the other
    here    (m,) int64: rows of the patches
    other   (m,) int64: likewise
    """

    way: Int64
    here: Int64
    other: Int64

    @property
    def back(self) -> Int64:
        """(m,) int64: the way from the other to the one."""
        return np.take(OPPOSITE, self.way)

    def take(self, rows: NDArray[Any]) -> _Beside:
        """Some of them."""
        return _Beside(self.way[rows], self.here[rows], self.other[rows])

    def both_ways(self) -> _Beside:
        """Each pair from either side."""
        return _Beside(np.append(self.way, self.back), np.append(self.here, self.other), np.append(self.other, self.here))


def _join_patches(around: Surroundings, probes: Probes, say: Say) -> ContactMap:
    """Texels are of one piece where one can go from one to the next and meet nothing, nor get below something.

    say   receives the finished share of the work
    """
    say(0.0)
    texels = around.frames.texels
    is_met = (probes.distance < 1.0).any(axis=0) | contact.are_close(probes.height)
    parted = np.zeros(len(texels.chart_page), bool)
    parted[texels.texel_chart[probes.start[is_met]]] = True
    probes = probes.of_patches(np.flatnonzero(parted[texels.texel_chart[probes.start]]))
    patches = _Patches(probes.start, probes.size, texels.list_keys(probes.start))
    joined, singles = _pair_up(patches, lambda share: say(0.1 + 0.5 * share))
    say(0.6)
    is_covered = texels.are_covered()
    is_whole = is_covered[probes.start]
    between = _find_between(around, probes, singles, is_whole)
    open_ways, closed = singles.take(~between), singles.take(between)
    say(0.8)
    pair = np.concatenate([*joined, np.stack([open_ways.here, open_ways.other])], axis=1)
    log2 = int(texels.chart_log2.max(initial=0))
    whole, piece = part_in_squares(patches.key, patches.size, pair, np.stack([closed.here, closed.other]), log2)
    is_divided = is_whole[closed.here] & is_whole[closed.other]
    is_divided[is_divided] = ~_leave_room(around, probes, closed.take(is_divided))
    is_divided, closed = np.tile(is_divided, 2), closed.both_ways()
    reach = np.where(is_divided, probes.distance[closed.way, closed.here], np.float32(np.inf))
    borders = TexelBorders.of(len(probes.touched), closed.way, probes.start[closed.here], probes.start[closed.other], reach)

    def find_beside(entry: Int64, step: tuple[int, int]) -> Int64:
        beside = patches.find_entries(texels.list_keys(entry), step)
        return np.where((beside >= 0) & is_covered[beside], beside, -1)

    borders = borders.with_corners(*borders.find_corners(find_beside))
    return ContactMap(probes.touched, patches, piece, whole, borders)


def _leave_room(around: Surroundings, probes: Probes, pairs: _Beside) -> BoolArray:
    """(m,) bool: pairs of texels with two surfaces between them, and light on what lies between these, which is of neither texel's
    neighbour: below the edge of something that hovers or leans, other than below a wall.
    """
    reach, beyond = probes.distance[pairs.way, pairs.here], 1 - probes.distance[pairs.back, pairs.other]
    rows = np.flatnonzero(beyond - reach > _NARROW)
    inside = around.are_inside(probes.start[pairs.here[rows]], pairs.way[rows], (reach + beyond)[rows] / 2)
    room = np.zeros(len(pairs.here), bool)
    room[rows[~inside]] = True
    return room


def _pair_up(patches: _Patches, say: Say) -> tuple[list[Int64], _Beside]:
    """Pairs (2, m) of patches side by side of which one is a tile, between which nothing stands; and those of two texels."""
    tiles, singles = np.flatnonzero(patches.size > 1), np.flatnonzero(patches.size == 1)
    joined, beside = [], list[Int64]()
    for k, step in enumerate(WAYS):
        say(k / len(WAYS))
        rows = singles if k < 2 else singles[patches.key[singles] & _IN_TILE[k - 2] == 0]  # at the edge of where a tile would be
        pair = np.stack(patches.find_beside(rows, step))
        to_tile = patches.size[pair[1]] > 1
        joined.append(pair.compress(to_tile, axis=1))
        if k < 2:  # two texels are seen from both
            beside.append(pair.compress(~to_tile, axis=1))
    joined += [np.stack(patches.find_beside(tiles, step)) for step in ((TILE_SIDE, 0), (0, TILE_SIDE))]
    return joined, _Beside(np.repeat([0, 1], [pair.shape[1] for pair in beside]), *np.concatenate(beside, axis=1))


def _find_between(around: Surroundings, probes: Probes, pairs: _Beside, is_whole: BoolArray) -> BoolArray:
    """(m,) bool: pairs of texels between which something stands, or a cover ends.

    probes      at the patches; what is touched, and how far that is, is looked for anew where a cover ends
    is_whole   (k,) bool: patches whose texels their chart covers in full
    """
    start, height, distance = probes.start, probes.height, probes.distance
    blocked, way, back, here, other = distance < 1.0, pairs.way, pairs.back, pairs.here, pairs.other
    between = blocked[way, here] & blocked[back, other]  # what stands between two texels is met from both
    aslant = np.flatnonzero(~(is_whole[here] & is_whole[other]))  # as points of parts are beside the middles of their texels
    between[aslant] = around.are_parted(start[here[aslant]], start[other[aslant]])
    ends = np.flatnonzero(~between & contact.ends_between(height[here], height[other]))
    between[ends] = probes.touched[start[here[ends]]] = probes.touched[start[other[ends]]] = True
    distance[way[ends], here[ends]], distance[back[ends], other[ends]] = around.find_ends(
        height[here[ends]] < height[other[ends]], start[here[ends]], start[other[ends]]
    )
    return between


def cut_at_contacts(
    texels: TexelMap, atlas: ChartAtlas, found: ContactMap, watch: Watch = unwatched
) -> tuple[TexelMap, ChartAtlas, BoolArray]:
    """The map and the atlas with all but the largest piece of a chart in charts of their own, after the others; and which entries of
    that map are `touched`. Nothing moves on the pages. The map that was is used up: its arrays are filled anew.

    atlas   whose charts are the map's
    watch   as find_contacts has it
    """
    if not uses("contact_cuts"):
        return texels, atlas, found.touched
    patches = found.patches
    size = np.bincount(found.piece, patches.size)  # at the first patch of each piece
    first = np.flatnonzero(size)
    chart = texels.texel_chart[patches.start]
    by_size = first[np.lexsort((-size[first], chart[first]))]
    is_largest = np.append(True, np.diff(chart[by_size]) != 0)[: len(by_size)]
    own = by_size[~is_largest & (size[by_size] >= _LEAST_PIECE)]
    if uses("split_texels"):
        texels = share_texels(texels, found.borders, stretch(watch, LOOKING, 0.7, 0.85))
    if not len(own):
        return texels, atlas, found.touched
    whole, number = chart[own], np.full(len(patches.start), -1, np.int32)
    number[found.whole[own]] = len(texels.chart_page) + np.arange(len(own))
    number[found.whole[by_size[is_largest]]] = chart[by_size[is_largest]]
    chart_of = np.full(len(patches.start), -1)
    chart_of[own] = len(texels.chart_page) + np.arange(len(own))
    moved = np.flatnonzero(chart_of[found.piece] >= 0)
    own_chart = chart_of[found.piece[moved]]
    order = EntryOrder.of(patches.start[moved], patches.size[moved], np.argsort(own_chart, kind="stable"), len(found.touched))
    say = stretch(watch, LOOKING, 0.85, 1.0)
    texels, touched = put_in_order(texels, order, say), found.touched.copy()
    order.apply(touched)
    say(0.9)
    own_chart = np.sort(np.repeat(own_chart, patches.size[moved]))
    chart = texels.texel_chart
    chart[len(chart) - len(own_chart) :] = own_chart
    page, thing = (np.append(field, field[whole]) for field in (atlas.chart_page, atlas.chart_object))
    cut = dataclasses.replace(
        texels,
        chart_page=page,
        chart_origin=np.concatenate([texels.chart_origin, texels.chart_origin[whole]]),
        chart_log2=np.append(texels.chart_log2, texels.chart_log2[whole]),
        chart_piece=np.append(texels.chart_piece, number[found.whole[own]]),
        chart_start=np.searchsorted(chart, np.arange(len(page) + 1, dtype=np.int32)).astype(np.int64),
    )
    return cut, dataclasses.replace(atlas, chart_page=page, chart_object=thing), touched
