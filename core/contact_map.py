"""Contacts on the texels of a scene, and charts cut along them.

Where a wall or a cupboard stands on a floor, light jumps: there is another room behind the wall, and none below the cupboard. A leaf over
both sides could hold neither, and what it says of one would leak to the other. So a piece of a chart that is parted from the rest by what
stands on it becomes a chart of its own, as the sides of a crease do. So does what lies below a rug, or behind a curtain that hangs close to
a wall and touches it nowhere.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import contact
from .charts import ChartAtlas
from .contact_parts import part_in_squares
from .entry_order import EntryOrder, put_in_order
from .loose_parts import LooseParts
from .messages import Status
from .rays import RayScene
from .scene import IntArray
from .texel_borders import OPPOSITE, WAYS, TexelBorders, share_texels
from .texel_frames import TexelFrames
from .texel_grid import interleave_bits, step_codes
from .texel_map import CHART_SHIFT, TexelMap
from .threads import run_on_threads
from .tiles import TILE_CORNERS, TILE_SIDE, TILE_TEXELS, Tiles
from .words import Say, Watch, stretch, unwatched
from .workers import TracedScene

LOOKING = Status("contacts", "Looking for contacts")
_IN_TILE = interleave_bits(np.array([TILE_SIDE - 1, 0]), np.array([0, TILE_SIDE - 1]))  # bits of a key: column and row within a tile
_LEAST_PIECE = 4  # texels; smaller ones, between books or blades of grass, would catch too few photons each for itself

_Int64 = NDArray[np.int64]


@dataclass(frozen=True)
class ContactMap:
    """Where other things meet the surface.

    touched   (n,) bool: texel entries that something touches
    rising    (n,) bool: those above which something close goes on and rises, as a ball on the floor does: light falls towards it
    patches   that tile all entries of charts that something parts
    piece     (k,) int64: the first patch of the piece that each patch is of
    whole     (k,) int64: the same of what hangs together somehow, of which a piece may be a part
    borders   of texels with something between them and the next one
    """

    touched: NDArray[np.bool_]
    rising: NDArray[np.bool_]
    patches: _Patches
    piece: _Int64
    whole: _Int64
    borders: TexelBorders


@dataclass(frozen=True)
class _Patches:
    """Entries, and tiles that nothing touches.

    start   (k,) int64, ascending: first entry of each
    size    (k,) int64: 1 or TILE_TEXELS entries, in Morton order
    key     (k,) int64, ascending, of TexelMap.list_keys
    """

    start: _Int64
    size: _Int64
    key: _Int64

    def find_beside(self, rows: _Int64, step: tuple[int, int]) -> tuple[_Int64, _Int64]:
        """Those of the patches `rows` (m,) that have a texel of their chart so many columns and rows from their first; and its patch.

        out   (j,) int64 twice
        """
        own, code = self.key[rows], (1 << CHART_SHIFT) - 1
        key = own & ~code
        key |= step_codes(own & code, *step)
        other = np.searchsorted(self.key, key, side="right") - 1
        found = np.flatnonzero((other >= 0) & (key < self.key[other] + self.size[other]))
        return rows[found], other[found]


def find_contacts(opened: TracedScene, texels: TexelMap, threads: int = 1, watch: Watch = unwatched) -> ContactMap:
    """Contacts at all texel entries, looked for by so many threads.

    watch   is told LOOKING and which share is done of that and of what cut_at_contacts does; it may raise
    """
    frames, things = TexelFrames.of(opened, texels), LooseParts(opened.snapshot)
    say = stretch(watch, LOOKING, 0.0, 0.6)
    found = run_on_threads(lambda part: _look_around(opened.scene.rays, frames, things, part), len(texels), threads, say)
    say = stretch(watch, LOOKING, 0.6, 0.7)
    joined: list[NDArray[Any]] = []
    for part in zip(*found, strict=True):
        say(0.02 * len(joined))
        joined.append(np.concatenate(part, axis=-1))
    touched, height, first, size, distance = joined
    return _join_patches(opened.scene.rays, frames, things, touched, height, first, size, distance, say)


def _look_around(
    rays: RayScene, frames: TexelFrames, things: LooseParts, part: slice
) -> tuple[NDArray[np.bool_], NDArray[np.float32], _Int64, _Int64, NDArray[np.float32]]:
    """What a chunk of entries meets.

    out   (m,) bool whether something touches them; of patches that tile them (k,) how high another thing is above them, (k,) first entries
          and (k,) sizes, and (4, k) how far it is to another thing, as in _join_patches
    """
    tiles = _find_clear_tiles(rays, frames, part) - part.start
    leads = np.ones(part.stop - part.start, bool)
    leads[tiles[:, None] + np.arange(1, TILE_TEXELS)] = False
    start = np.flatnonzero(leads)
    size = np.ones(len(start), np.int64)
    size[np.searchsorted(start, tiles)] = TILE_TEXELS
    single = np.flatnonzero(size == 1)
    rows = start[single]
    entry = part.start + rows
    places, tri = frames.find_places(entry), frames.texels.texel_tri[entry]
    met, single_distance = contact.find_contacts(rays, *places, frames.find_axes(entry))
    touched = np.zeros(len(leads), bool)
    touched[rows] = (met >= 0).any(axis=0)
    way, row = np.nonzero(met >= 0)
    own = ~things.are_apart(met[way, row], tri[row])  # a rough or hollow thing stands in its own way
    single_distance[way[own], row[own]] = np.inf
    distance = np.full((len(WAYS), len(start)), np.inf, np.float32)
    distance[:, single] = single_distance
    cover, above = contact.find_covers(rays, *places)
    row = np.flatnonzero(cover >= 0)
    row = row[things.are_apart(cover[row], tri[row])]
    height = np.full(len(start), np.inf, np.float32)
    height[single[row]] = above[row]
    return touched, height, part.start + start, size, distance


def _find_clear_tiles(rays: RayScene, frames: TexelFrames, part: slice) -> _Int64:
    """(m,) int64: first entries of the tiles within `part` that nothing touches."""
    texels = frames.texels
    tiles = Tiles.of(texels.texel_chart[part], texels.texel_code[part]).on_one_triangle(texels.texel_tri[part])
    first = part.start + tiles.start
    first = first[np.searchsorted(texels.part_entry, first) == np.searchsorted(texels.part_entry, first + TILE_TEXELS)]
    corner = first + TILE_CORNERS[:, None]
    position, normal, size = frames.find_places(corner.ravel())
    n_tile = len(first)
    clear = contact.find_clear_tiles(rays, position.reshape(3, n_tile, 3), normal[:n_tile], size[:n_tile])
    clear_tiles: _Int64 = first[clear]
    return clear_tiles


def _are_parted(rays: RayScene, frames: TexelFrames, things: LooseParts, one: IntArray, other: IntArray) -> NDArray[np.bool_]:
    """(m,) bool: whether another thing stands between the points of texel entries (m,) and (m,)."""
    pairs = np.stack([one, other])
    is_asked, place = np.zeros(len(frames.texels), bool), np.empty(len(frames.texels), np.int64)
    is_asked[pairs] = True
    entry = np.flatnonzero(is_asked)
    place[entry] = np.arange(len(entry))
    met = contact.find_between(rays, *frames.find_places(entry), place[pairs])
    parted = met >= 0
    parted[parted] = things.are_apart(met[parted], frames.texels.texel_tri[one[parted]])
    return parted


def _find_ends(
    rays: RayScene, frames: TexelFrames, is_below: NDArray[np.bool_], one: IntArray, other: IntArray
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(m,) twice, texels: from the points of entries (m,) and (m,) to the edge of what lies on the first, where is_below (m,), else on the
    other."""
    (position, normal, size), (beside, _, _) = frames.find_places(one), frames.find_places(other)
    low, high = (np.where(is_below[:, None], *ends) for ends in ((position, beside), (beside, position)))
    share = contact.find_cover_edges(rays, low, high, normal, size)
    return np.where(is_below, share, 1 - share), np.where(is_below, 1 - share, share)


def _join_patches(
    rays: RayScene,
    frames: TexelFrames,
    things: LooseParts,
    touched: NDArray[np.bool_],
    height: NDArray[np.float32],
    start: _Int64,
    size: _Int64,
    distance: NDArray[np.float32],
    say: Say,
) -> ContactMap:
    """Texels are of one piece where one can go from one to the next and meet nothing, nor get below something.

    height        (k,) float32, texels: of another thing above patches of one texel; inf of tiles, within which none ends
    start, size   (k,) int64, of patches that tile all entries
    distance      (4, k) float32, texels: to another thing, towards each of WAYS
    say           is told the share of the work that is done
    """
    say(0.1)
    texels, blocked = frames.texels, distance < 1.0
    parted = np.zeros(len(texels.chart_page), bool)
    parted[texels.texel_chart[start[blocked.any(axis=0) | contact.are_close(height)]]] = True
    kept = np.flatnonzero(parted[texels.texel_chart[start]])
    start, size, height, distance, blocked = start[kept], size[kept], height[kept], distance[:, kept], blocked[:, kept]
    patches = _Patches(start, size, texels.list_keys(start))
    joined: list[_Int64] = []
    beside: list[_Int64] = []  # single texels
    single = np.flatnonzero(size == 1)
    for k, step in enumerate(WAYS):
        say(0.2 + 0.1 * k)
        rows = single if k < 2 else single[patches.key[single] & _IN_TILE[k - 2] == 0]  # at the edge of where a tile would be
        pair = np.stack(patches.find_beside(rows, step))
        to_tile = size[pair[1]] > 1
        joined.append(pair.compress(to_tile, axis=1))
        if k < 2:  # two texels are seen from both
            beside.append(pair.compress(~to_tile, axis=1))
    here, other = np.concatenate(beside, axis=1)
    way = np.repeat([0, 1], [pair.shape[1] for pair in beside])
    between = blocked[way, here]
    between[between] = blocked[np.take(OPPOSITE, way[between]), other[between]]  # what stands between two texels is met from both
    say(0.6)
    is_whole = np.ones(len(touched), bool)
    is_whole[texels.part_entry] = False
    is_whole = is_whole[start]
    aslant = np.flatnonzero(~(is_whole[here] & is_whole[other]))  # as points of parts are beside the middles of their texels
    between[aslant] = _are_parted(rays, frames, things, start[here[aslant]], start[other[aslant]])
    ends = np.flatnonzero(~between & contact.ends_between(height[here], height[other]))
    between[ends] = touched[start[here[ends]]] = touched[start[other[ends]]] = True
    distance[way[ends], here[ends]], distance[np.take(OPPOSITE, way[ends]), other[ends]] = _find_ends(
        rays, frames, height[here[ends]] < height[other[ends]], start[here[ends]], start[other[ends]]
    )
    rises = np.flatnonzero(~between & contact.rises_between(height[here], height[other]))
    rising = np.zeros(len(touched), bool)
    rising[start[here[rises]]] = rising[start[other[rises]]] = True
    joined.append(np.stack([here, other]).compress(~between, axis=1))
    way, here, other = way[between], here[between], other[between]
    for step in ((TILE_SIDE, 0), (0, TILE_SIDE)):
        joined.append(np.stack(patches.find_beside(np.flatnonzero(size > 1), step)))
    say(0.8)
    log2 = int(texels.chart_log2.max(initial=0))
    whole, piece = part_in_squares(patches.key, size, np.concatenate(joined, axis=1), np.stack([here, other]), log2)
    way, here, other = np.append(way, np.take(OPPOSITE, way)), np.append(here, other), np.append(other, here)
    reach = np.where(is_whole[here] & is_whole[other], distance[way, here], np.float32(np.inf))
    borders = TexelBorders.of(len(touched), way, start[here], start[other], reach)
    return ContactMap(touched, rising, patches, piece, whole, borders)


def cut_at_contacts(
    texels: TexelMap, atlas: ChartAtlas, found: ContactMap, watch: Watch = unwatched
) -> tuple[TexelMap, ChartAtlas, NDArray[np.bool_], NDArray[np.bool_]]:
    """The map and the atlas with all but the largest piece of a chart in charts of their own, after the others; and which entries of
    that map are `touched` and `rising`. Nothing moves on the pages. The map that was is used up: its arrays are filled anew.

    atlas   whose charts are the map's
    watch   as find_contacts has it
    """
    patches = found.patches
    size = np.bincount(found.piece, patches.size)  # at the first patch of each piece
    first = np.flatnonzero(size)
    chart = texels.texel_chart[patches.start]
    by_size = first[np.lexsort((-size[first], chart[first]))]
    is_largest = np.append(True, np.diff(chart[by_size]) != 0)[: len(by_size)]
    own = by_size[~is_largest & (size[by_size] >= _LEAST_PIECE)]
    texels = share_texels(texels, found.borders, stretch(watch, LOOKING, 0.7, 0.85))
    if not len(own):
        return texels, atlas, found.touched, found.rising
    whole, number = chart[own], np.full(len(patches.start), -1, np.int32)
    number[found.whole[own]] = len(texels.chart_page) + np.arange(len(own))
    number[found.whole[by_size[is_largest]]] = chart[by_size[is_largest]]
    chart_of = np.full(len(patches.start), -1)
    chart_of[own] = len(texels.chart_page) + np.arange(len(own))
    moved = np.flatnonzero(chart_of[found.piece] >= 0)
    own_chart = chart_of[found.piece[moved]]
    order = EntryOrder.of(patches.start[moved], patches.size[moved], np.argsort(own_chart, kind="stable"), len(found.touched))
    say = stretch(watch, LOOKING, 0.85, 1.0)
    texels, touched, rising = put_in_order(texels, order, say), found.touched.copy(), found.rising.copy()
    order.apply(touched)
    order.apply(rising)
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
    return cut, dataclasses.replace(atlas, chart_page=page, chart_object=thing), touched, rising
