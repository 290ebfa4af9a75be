"""Choice of the side of a surface that its lightmap shows.

A lightmap has one texel for both sides of a face. With Automatic it shows the front, as Cycles does, unless the front faces the dark inside
of a solid and the back is lit: such a surface has flipped normals, and is turned before the bake begins, unless its material tells its
sides apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float64, Int64, IntArray
from ..util.settings import AUTOMATIC, BOTH
from .light_probe import LightProbe, Seen
from .scene import TEXTURE_UVS, SceneSnapshot, swap_corners
from .topology import join_open_sides, join_sets, pair_sides

_MOST_PARTS = 1 << 16  # only the largest parts are examined; smaller ones show their fronts
_MOST_POINTS = 1 << 19  # on all parts
_LEAST_EACH, _MOST_EACH = 6, 64  # points on a part
_FIRST_EACH, _SURE_EACH = 16, 512  # points on a part that may have to be turned, at first and for the decision
_CLOSE = 0.15  # distance of close surfaces, relative to a part's extent
_INSIDE = 0.85  # a side faces into a solid if this share of its rays meets a close surface, the part itself or a back
_ENCLOSED = 0.98  # a side is enclosed if this share of its rays meets anything
_BOUNCES = 3
_DARK_BESIDE, _DARK_WITHIN = 0.15, 1e-3  # a front is dark below this light relative to the back's: close to a surface, or elsewhere
_LEVEL = 0.7  # a floor's unit normals have a mean height above this
_NOTHING = 0.01  # a side sees nothing if at most this share of its rays meets anything
_PERHAPS_DARK = 0.3  # as the above, for the first estimate from few points
_SEEN = 0.5  # a sheet's back may be visible if this share of its rays meets fronts
_BEHIND, _FREE = 0.5, 0.1  # a sheet looks at others' backs by this share of its rays or more, and its own back meets at most so much nearby
_LESS = 0.6  # and has less than this share of the light of its own back

TURNED = (
    "some faces look into a solid, where no light comes, so the light on their backs is kept; flip their normals, or set Sides to Front"
)
BEHIND = "some faces may look too dark: they face backs of others, and their own backs get more light; flip normals, or set Sides to Both"
OPEN = "can be seen from both sides, but its lightmap has the light of the front; give it thickness, or set Sides to Both to add both up"


@dataclass(frozen=True)
class SettledSides:
    """A snapshot whose fronts are the sides to show, with two_sided for objects that show both.

    tri_turned   (n_tri,) bool: triangles whose corners 1 and 2 were exchanged
    warnings     (subject, sentence)
    """

    snapshot: SceneSnapshot
    tri_turned: BoolArray
    warnings: tuple[tuple[str, str], ...]


def settle_sides(snapshot: SceneSnapshot, sides: str) -> SettledSides:
    """Choose the sides by the objects' own settings, and by `sides` for objects without one."""
    chosen = [one.sides or sides for one in snapshot.objects]
    objects = tuple(replace(one, two_sided=one.two_sided or side == BOTH) for one, side in zip(snapshot.objects, chosen, strict=True))
    if objects != snapshot.objects:
        snapshot = replace(snapshot, objects=objects)
    free = np.array([side == AUTOMATIC and one.receives and not one.two_sided for one, side in zip(objects, chosen, strict=True)], bool)
    turned = np.zeros(snapshot.n_tri, bool)
    is_told_apart = np.array([one.has_sides for one in snapshot.materials], bool)[snapshot.tri_material]
    tri = np.flatnonzero(free[snapshot.tri_object] & ~is_told_apart)
    if not len(tri):
        return SettledSides(snapshot, turned, ())
    parts = _Parts.of(snapshot, tri)
    probe = LightProbe(snapshot)
    is_turned, is_open, is_behind = _decide_sides(probe, parts)
    is_turned = _agree(snapshot, parts, is_turned)
    turned[tri] = is_turned[parts.tri_part]
    shows_front = (
        np.bincount(parts.tri_part, snapshot.tri_translucent[tri], len(parts)) == 0
    )  # translucent faces show the light of both sides
    is_open, is_behind = is_open & shows_front, is_behind & shows_front
    warnings = [
        *((snapshot.objects[i].name, TURNED) for i in np.unique(parts.part_object[is_turned])),
        *((snapshot.objects[i].name, BEHIND) for i in np.unique(parts.part_object[is_behind & ~is_turned])),
        *((snapshot.objects[i].name, OPEN) for i in np.unique(parts.part_object[is_open & ~is_turned])),
    ]
    return SettledSides(turn(snapshot, turned) if turned.any() else snapshot, turned, tuple(warnings))


def turn(snapshot: SceneSnapshot, tri_turned: BoolArray) -> SceneSnapshot:
    """The snapshot with triangles tri_turned (n_tri,) bool turned over."""
    changed: dict[str, Any] = {}
    of_maps = ("tri_tangents",) if len(snapshot.tri_tangents) else ()
    for name in ("tri_vertex", "tri_corner", "tri_normal", "tri_uv", *TEXTURE_UVS, *of_maps):
        changed[name] = swap_corners(getattr(snapshot, name), tri_turned)
    changed["tri_normal"][tri_turned] *= -1
    return replace(snapshot, **changed)


@dataclass(frozen=True)
class _Parts:
    """Parts are connected surfaces of one object with consistent winding.

    tri            (n,) int, ascending   the triangles
    tri_part       (n,) int              part of each
    part_object    (n_part,) int
    part_first     (n_part,) int         first triangle in the snapshot
    extent_m       (n_part,) float64     diagonal of the bounding box
    closed         (n_part,) bool        whether it has no border
    """

    tri: IntArray
    tri_part: IntArray
    part_object: IntArray
    part_first: IntArray
    extent_m: Float64
    closed: BoolArray

    @classmethod
    def of(cls, snapshot: SceneSnapshot, tri: IntArray) -> _Parts:
        thing = snapshot.tri_object[tri]
        vertex = join_open_sides(snapshot.vertex_position, snapshot.tri_vertex[tri], thing)
        _, one, other = pair_sides(vertex, thing)
        start = vertex.ravel()
        end = np.roll(vertex, -1, axis=1).ravel()
        alike = (start[one] == end[other]) & (end[one] == start[other])
        one, other = one[alike] // 3, other[alike] // 3
        first, part = np.unique(join_sets(len(tri), one, other), return_inverse=True)
        order = np.argsort(part, kind="stable")
        begin = np.flatnonzero(np.diff(part[order], prepend=-1))
        corner = snapshot.tri_position[tri][order]
        low = np.minimum.reduceat(corner.min(axis=1), begin)
        high = np.maximum.reduceat(corner.max(axis=1), begin)
        shared = np.bincount(part[one], minlength=len(first)) + np.bincount(part[other], minlength=len(first))
        closed = shared >= 3 * np.bincount(part, minlength=len(first))
        lowest = tri[order][begin]
        return cls(tri, part, snapshot.tri_object[lowest], lowest, np.linalg.norm(high - low, axis=1), closed)

    def __len__(self) -> int:
        return len(self.part_first)


class _Samples:
    """Stratified points, uniform by area, `each` on every one of the chosen parts."""

    def __init__(self, probe: LightProbe, parts: _Parts, chosen: IntArray, each: int) -> None:
        self._n, self._each, self._probe, self._parts, self._chosen = len(chosen), each, probe, parts, chosen
        row = np.full(len(parts), -1)
        row[chosen] = np.arange(len(chosen))
        ours = np.flatnonzero(row[parts.tri_part] >= 0)
        ours = ours[np.argsort(row[parts.tri_part[ours]], kind="stable")]
        self.point, self.front = probe.spread_evenly(parts.tri[ours], row[parts.tri_part[ours]], each)

    def mean(self, values: NDArray[Any]) -> Float64:
        """(n_chosen,): means of values (n_point,) over the points of each part."""
        return values.reshape(self._n, self._each).mean(axis=1, dtype=np.float64)

    def trace(self, sign: int) -> tuple[Float64, ...]:
        """Shares of rays, (n_chosen,) each, that meet: a close surface; a close surface, the part itself or a back; the front of another
        part; anything; a close back of another part.
        """
        seen: Seen = self._probe.trace(self.point, np.float32(sign) * self.front)
        own = np.zeros(len(seen.tri), bool)
        met = seen.tri >= 0
        place = np.searchsorted(self._parts.tri, seen.tri).clip(0, len(self._parts.tri) - 1)
        part = np.where(self._parts.tri[place] == seen.tri, self._parts.tri_part[place], -1)
        own[met] = part[met] == np.repeat(self._chosen, self._each)[met]
        close = met & (seen.distance < _CLOSE * np.repeat(self._parts.extent_m[self._chosen], self._each))
        back = met & ~seen.is_front
        met_by_kind = close, close | own | back, seen.is_front & ~own, met, close & back & ~own
        return tuple(map(self.mean, met_by_kind))

    def light(self, sign: int) -> Float64:
        """(n_chosen,) mean irradiance, W/m^2."""
        return self.mean(self._probe.find_irradiance(self.point, np.float32(sign) * self.front, _BOUNCES))


def _decide_sides(probe: LightProbe, parts: _Parts) -> tuple[BoolArray, BoolArray, BoolArray]:
    """(n_part,) bool each: parts to turn, thin sheets that are visible from both sides, and sheets that look at backs of others."""
    is_turned, is_open, is_behind = np.zeros((3, len(parts)), bool)
    area = np.bincount(parts.tri_part, probe.area[parts.tri], minlength=len(parts))
    chosen = np.argsort(-area, kind="stable")[:_MOST_PARTS]
    chosen = np.sort(chosen[area[chosen] > 0.0])
    if not len(chosen):
        return is_turned, is_open, is_behind
    samples = _Samples(probe, parts, chosen, min(max(_MOST_POINTS // len(chosen), _LEAST_EACH), _MOST_EACH))
    close, within, _, met_before, backs = samples.trace(1)
    near, behind, back_sees, met, _ = samples.trace(-1)
    floor = samples.mean(samples.front[:, 2]) > _LEVEL  # the ground is not seen from below
    below = floor & (met < _NOTHING)
    perhaps = ((within >= _INSIDE) | (met_before >= _ENCLOSED)) & (behind < _INSIDE) & ~below
    in_sight = (np.maximum(close, near) < _SEEN) & (back_sees >= _SEEN)
    sheet = ~parts.closed[chosen] & in_sight
    dark = np.where(close >= _INSIDE, _DARK_BESIDE, _DARK_WITHIN)
    rows = np.flatnonzero(perhaps)
    rows = _keep_dark(probe, parts, chosen, rows, np.full_like(dark, _PERHAPS_DARK), _FIRST_EACH)
    rows = _keep_dark(probe, parts, chosen, rows, dark, _SURE_EACH)
    is_turned[chosen[rows]] = True
    is_open[chosen[sheet]] = True
    rows = np.flatnonzero(~parts.closed[chosen] & (backs >= _BEHIND) & (np.maximum(near, behind) <= _FREE) & ~below)
    is_behind[chosen[_keep_dark(probe, parts, chosen, rows, np.full_like(dark, _LESS), _SURE_EACH)]] = True
    return is_turned, is_open, is_behind


def _keep_dark(probe: LightProbe, parts: _Parts, chosen: IntArray, rows: IntArray, dark: Float64, each: int) -> Int64:
    """Those of `rows` of chosen parts whose front is dark relative to the back, estimated from `each` points on every part."""
    at_once = max(_MOST_POINTS // each, 1)
    kept = [np.zeros(0, np.int64)]
    for some in np.split(rows, range(at_once, len(rows), at_once)):
        if len(some):
            samples = _Samples(probe, parts, chosen[some], each)
            front, back = samples.light(1), samples.light(-1)
            kept.append(some[(back > 0.0) & (front <= dark[some] * back)])
    return np.concatenate(kept)


def _agree(snapshot: SceneSnapshot, parts: _Parts, is_turned: BoolArray) -> BoolArray:
    """is_turned, changed so that a part is turned in all objects that share its mesh, or in none, since these share their charts."""
    mesh = np.array([one.mesh for one in snapshot.objects])[parts.part_object]
    shared = np.flatnonzero(mesh >= 0)
    if not len(shared):
        return is_turned
    start = np.searchsorted(snapshot.tri_object, parts.part_object[shared])
    key = mesh[shared].astype(np.int64) * snapshot.n_tri + parts.part_first[shared] - start
    _, group = np.unique(key, return_inverse=True)
    votes = np.bincount(group, is_turned[shared]) / np.bincount(group)
    out = is_turned.copy()
    out[shared] = votes[group] == 1.0
    return out
