"""Search for geometry that texels nearly touch, along the surface and above it; clear tiles are tested as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from ..scene.rays import RayScene
from ..scene.topology import LooseParts
from ..texels import contact
from ..texels.split_texels import WAYS
from ..texels.texel_map import TexelMap
from ..texels.tiles import TILE_CORNERS, TILE_TEXELS, Tiles
from ..util.arrays import BoolArray, Float32, Int64, IntArray
from ..util.geometry import gather, offset_origin
from ..util.progress import Say
from .texel_frames import TexelFrames
from .traced_scene import TracedScene


@dataclass(frozen=True)
class Probes:
    """Results of the search at n texel entries. k patches tile them: single entries, and tiles that nothing touches.

    touched    (n,) bool: whether something touches the entry
    start      (k,) int64, ascending: first entry of each patch
    size       (k,) int64: 1 or TILE_TEXELS entries, in Morton order
    height     (k,) float32, texels: of another thing above the patch; inf for none, and for tiles, within which no cover ends
    distance   (4, k) float32, texels: to another thing, towards each of WAYS; inf for none
    """

    touched: BoolArray
    start: Int64
    size: Int64
    height: Float32
    distance: Float32

    @classmethod
    def join(cls, parts: Sequence[Probes], say: Say) -> Probes:
        """The results at consecutive ranges of entries, joined; `say` receives the finished share of the work."""
        names = [field.name for field in fields(cls)]
        joined = []
        for k, name in enumerate(names):
            say(k / len(names))
            joined.append(np.concatenate([getattr(part, name) for part in parts], axis=-1))
        return cls(*joined)

    def of_patches(self, rows: IntArray) -> Probes:
        """Only the patches in rows (j,), ascending; `touched` stays whole."""
        return Probes(self.touched, self.start[rows], self.size[rows], self.height[rows], self.distance[:, rows])


@dataclass(frozen=True)
class Surroundings:
    """The scene in which contacts are searched: rays, places of the texels, which triangles belong together, and normals (3, n_tri)."""

    rays: RayScene
    frames: TexelFrames
    things: LooseParts
    tri_normal: Float32

    @classmethod
    def of(cls, opened: TracedScene, texels: TexelMap) -> Surroundings:
        return cls(opened.scene.rays, TexelFrames.of(opened, texels), LooseParts(opened.snapshot), opened.scene.tri_normal)

    def probe(self, part: slice) -> Probes:
        """Search at a range of entries."""
        frames, things = self.frames, self.things
        tiles = self._find_clear_tiles(part) - part.start
        leads = np.ones(part.stop - part.start, bool)
        leads[tiles[:, None] + np.arange(1, TILE_TEXELS)] = False
        start = np.flatnonzero(leads)
        size = np.ones(len(start), np.int64)
        size[np.searchsorted(start, tiles)] = TILE_TEXELS
        single = np.flatnonzero(size == 1)
        rows = start[single]
        entry = part.start + rows
        places, tri = frames.find_places(entry), frames.texels.texel_tri[entry]
        met, single_distance = contact.find_contacts(self.rays, *places, frames.find_axes(entry))
        touched = np.zeros(len(leads), bool)
        touched[rows] = (met >= 0).any(axis=0)
        way, row = np.nonzero(met >= 0)
        own = ~things.are_apart(met[way, row], tri[row])  # the texel's own thing is no contact, as where it is rough or hollow
        single_distance[way[own], row[own]] = np.inf
        distance = np.full((len(WAYS), len(start)), np.inf, np.float32)
        distance[:, single] = single_distance
        cover, above = contact.find_covers(self.rays, *places)
        row = np.flatnonzero(cover >= 0)
        row = row[things.are_apart(cover[row], tri[row])]
        height = np.full(len(start), np.inf, np.float32)
        height[single[row]] = above[row]
        return Probes(touched, part.start + start, size, height, distance)

    def _find_clear_tiles(self, part: slice) -> Int64:
        """(m,) int64: first entries of the tiles within `part` that nothing touches."""
        texels = self.frames.texels
        tiles = Tiles.of(texels.texel_chart[part], texels.texel_code[part]).on_one_triangle(texels.texel_tri[part])
        first = part.start + tiles.start
        first = first[np.searchsorted(texels.part_entry, first) == np.searchsorted(texels.part_entry, first + TILE_TEXELS)]
        corner = first + TILE_CORNERS[:, None]
        position, normal, size = self.frames.find_places(corner.ravel())
        n_tile = len(first)
        clear = contact.find_clear_tiles(self.rays, position.reshape(3, n_tile, 3), normal[:n_tile], size[:n_tile])
        return first[clear]

    def are_parted(self, one: IntArray, other: IntArray) -> BoolArray:
        """(m,) bool: whether another thing stands between the points of texel entries one (m,) and other (m,)."""
        frames = self.frames
        pairs = np.stack([one, other])
        is_asked, place = np.zeros(len(frames.texels), bool), np.empty(len(frames.texels), np.int64)
        is_asked[pairs] = True
        entry = np.flatnonzero(is_asked)
        place[entry] = np.arange(len(entry))
        met = contact.find_between(self.rays, *frames.find_places(entry), place[pairs])
        parted = met >= 0
        parted[parted] = self.things.are_apart(met[parted], frames.texels.texel_tri[one[parted]])
        return parted

    def are_inside(self, entry: IntArray, way: IntArray, away: Float32) -> BoolArray:
        """(m,) bool: whether the surface lies within a solid, as a floor does below a wall, at places away (m,) texels from the points of
        entries (m,) towards `way` (m,) of WAYS: what is met above them is met from behind.
        """
        position, normal, size = self.frames.find_places(entry)
        axes = self.frames.find_axes(entry)
        step = np.concatenate([axes, -axes])[way, np.arange(len(entry))] * (away * size).astype(np.float32)[:, None]
        tri = self.rays.closest(offset_origin(position + step, normal), normal).tri
        return (tri >= 0) & ((gather(self.tri_normal, tri).T * normal).sum(axis=1) > 0)

    def find_ends(self, is_below: BoolArray, one: IntArray, other: IntArray) -> tuple[Float32, Float32]:
        """(m,) twice, texels: distance of the cover's edge from the points of entries one (m,) and other (m,).

        is_below   (m,) bool: whether the cover lies on `one`, else on `other`
        """
        (position, normal, size), (beside, _, _) = self.frames.find_places(one), self.frames.find_places(other)
        low, high = (np.where(is_below[:, None], *ends) for ends in ((position, beside), (beside, position)))
        share = contact.find_cover_edges(self.rays, low, high, normal, size)
        return np.where(is_below, share, 1 - share), np.where(is_below, 1 - share, share)
