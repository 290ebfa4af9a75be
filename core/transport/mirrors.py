"""Photons that metals and dielectric layers reflect."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..scene.glass import Glass
from ..scene.gloss import Gloss
from ..scene.normal_maps import NormalMaps
from ..util.arrays import IntArray
from ..util.geometry import gather, locate_hits, offset_origin
from .emission import Arrivals, Photons
from .passing import Passing

_TINY = np.finfo(np.float32).tiny
_LEAST_COSINE = 0.01  # as where photons are deposited
_LIFT = np.float32(0.01)
_Rows = NDArray[np.float32]


class GlossyScene(Protocol):
    """What of photons.TraceScene is needed; arrays as there."""

    @property
    def gloss(self) -> Gloss | None: ...
    @property
    def glass(self) -> Glass | None: ...
    @property
    def passing(self) -> Passing | None: ...
    @property
    def tri_normal(self) -> _Rows: ...
    @property
    def tri_frame(self) -> _Rows: ...
    @property
    def tri_smooth(self) -> NDArray[np.int32]: ...
    @property
    def smooth_frame(self) -> _Rows: ...
    @property
    def maps(self) -> NormalMaps | None: ...


def reflect_photons(
    scene: GlossyScene,
    arrived: Arrivals,
    tri: IntArray,
    group: NDArray[np.int32] | None,
    cosine: _Rows,
    is_first: bool,
    copies: int,
    rng: np.random.Generator,
) -> Photons | None:
    """Photons that are reflected specularly by chance, with flux so that all of them carry what is; None where none is.

    Whether a photon is reflected diffusely has a chance of its own, as in passing.

    tri        (n,) int64: of arrived
    group      (n,) int32, None where there are none
    cosine     (n,) float32: of the way they came with the geometric normal
    is_first   they come straight from a light
    copies     that each is made of, with a share of its flux each
    """
    gloss = scene.gloss
    if gloss is None:
        return None
    place = gather(gloss.tri_glossy, tri).nonzero()[0]
    if not len(place):
        return None
    place = np.repeat(place, copies)
    tri, u, v = gather(tri, place), gather(arrived.u, place), gather(arrived.v, place)
    flux, direction = gather(arrived.flux, place) / np.float32(copies), gather(arrived.direction, place)
    side = -np.copysign(np.float32(1), gather(cosine, place))
    face = gather(scene.tri_normal, tri) * side
    normal = shade(scene, tri, u, v, side, face, direction)
    facing = -_dot(direction, normal)
    expected = flux * gloss.albedo_at(tri, u, v, facing)
    chance = np.minimum(expected.max(axis=0) / np.maximum(flux.max(axis=0), _TINY), 1)
    on = (chance > rng.random(len(chance), dtype=np.float32)).nonzero()[0]
    if not len(on):
        return None
    is_plain = normal is face
    tri, u, v, flux, direction, face, normal = (gather(values, on) for values in (tri, u, v, flux, direction, face, normal))
    turned, weight = gloss.reflect(tri, u, v, direction, normal, rng.random((2, len(on)), dtype=np.float32), of_light=True)
    weight *= _dot(turned, face) > 0 if is_plain else _weigh_shading(direction, turned, face, normal)
    flux = flux * weight / gather(chance, on)
    kept = flux.any(axis=0).nonzero()[0]
    if not len(kept):
        return None
    row = gather(gather(place, on), kept)
    origin = offset_origin(locate_hits(scene.tri_frame, tri, u, v), face)
    return send_on(arrived, group, is_first, row, gather(origin, kept), gather(turned, kept), gather(flux, kept))


def send_on(
    arrived: Arrivals, group: NDArray[np.int32] | None, is_first: bool, row: IntArray, origin: _Rows, direction: _Rows, flux: _Rows
) -> Photons:
    """Photons (k,) that go on specularly: those of `arrived` in rows (k,), with new origins, directions and flux, each (3, k).

    group, is_first   as of reflect_photons
    """
    mirrored = np.ones(len(row), bool)
    if not is_first:
        mirrored = np.zeros(len(row), bool) if arrived.mirrored is None else gather(arrived.mirrored, row)
    own = None if group is None else gather(group, row)
    return Photons(origin, direction, flux, group=own, power=np.add.reduce(flux, 1, np.float64), mirrored=mirrored)


def shade(scene: GlossyScene, tri: IntArray, u: _Rows, v: _Rows, side: _Rows, face: _Rows, direction: _Rows) -> _Rows:
    """(3, n): unit shading normals on the side that rays come from, of normal maps too; the face's own (3, n) where those look away from
    the rays.

    side        (n,) float32: 1 where rays meet the front, -1 the back
    direction   (3, n) float32 of the rays
    """
    normal = _smooth(scene, tri, u, v, side, face, direction)
    if scene.maps is not None:
        rows, bumps = scene.maps.look_up(tri, u, v, normal)
        if len(rows):
            bumps = _lift(bumps, gather(face, rows), gather(direction, rows))
            good = _dot(bumps, gather(direction, rows)) < 0
            normal = normal.copy()
            normal[:, rows[good]] = bumps[:, good]
    return normal


def _lift(normal: _Rows, face: _Rows, direction: _Rows) -> _Rows:
    """Normals (3, n) turned so far toward the face's own (3, n) that a mirror sends rays along directions (3, n) above the face."""
    out = direction - 2 * _dot(direction, normal) * normal
    low = (_dot(out, face) < _LIFT).nonzero()[0]
    if not len(low):
        return normal
    face, direction, out = gather(face, low), gather(direction, low), gather(out, low)
    out += (_LIFT - _dot(out, face)) * face
    half = out / np.sqrt(_dot(out, out)) - direction
    normal = normal.copy()
    normal[:, low] = half / np.maximum(np.sqrt(_dot(half, half)), _TINY)
    return normal


def _weigh_shading(arrived: _Rows, turned: _Rows, face: _Rows, normal: _Rows) -> _Rows:
    """(n,): by what a shading normal changes the flux that photons carry on, where rays that look for light keep its radiance; 0 below the
    face.

    arrived, turned   (3, n) float32, unit: along which photons came and go on
    face, normal      (3, n) float32, unit: the geometric normal and the shading normal on that side
    Source: Veach 1997, section 5.3.
    """
    out = _dot(turned, face)
    least = np.float32(_LEAST_COSINE)
    factor: _Rows = _dot(arrived, normal) * out / np.minimum(_dot(arrived, face), -least) / np.maximum(_dot(turned, normal), least)
    return np.where(out > 0, np.maximum(factor, 0), 0)


def _dot(a: _Rows, b: _Rows) -> _Rows:
    product: _Rows = np.einsum("kn,kn->n", a, b)
    return product


def _smooth(scene: GlossyScene, tri: IntArray, u: _Rows, v: _Rows, side: _Rows, face: _Rows, direction: _Rows) -> _Rows:
    """As shade, by the corners' normals alone."""
    if not scene.smooth_frame.size:
        return face
    column = gather(scene.tri_smooth, tri)
    smooth = (column >= 0).nonzero()[0]
    if not len(smooth):
        return face
    shading = locate_hits(scene.smooth_frame, gather(column, smooth), gather(u, smooth), gather(v, smooth)) * gather(side, smooth)
    length = np.sqrt(_dot(shading, shading))
    shading /= np.maximum(length, np.float32(1e-6))
    good = (_dot(shading, gather(direction, smooth)) < 0) & (length > np.float32(1e-6))
    normal: _Rows = face.copy()
    normal[:, smooth[good]] = shading[:, good]
    return normal


def follow_mirrors(
    scene: GlossyScene, direction: _Rows, share: _Rows, tri: IntArray, u: _Rows, v: _Rows, rng: np.random.Generator
) -> tuple[IntArray, _Rows, _Rows, _Rows]:
    """Rays that gather light and are reflected specularly where they met triangles (n,), by chance: which (k,), from where (3, k), along
    which directions (3, k), and the share of light (3, k) that still comes along them.

    direction   (3, n) float32, unit
    share       (3, n) float32, before
    """
    gloss = scene.gloss
    place = np.zeros(0, np.intp) if gloss is None else gather(gloss.tri_glossy, tri).nonzero()[0]
    nothing = np.zeros((3, 0), np.float32)
    if gloss is None or not len(place):
        return place, nothing, nothing, nothing
    tri, u, v = gather(tri, place).astype(np.intp), gather(u, place), gather(v, place)
    direction, share = gather(direction, place), gather(share, place)
    normal = gather(scene.tri_normal, tri)
    side = -np.copysign(np.float32(1), _dot(direction, normal))
    face = normal * side
    normal = shade(scene, tri, u, v, side, face, direction)
    chance = gloss.albedo_at(tri, u, v, -_dot(direction, normal)).max(axis=0)
    on = (chance > rng.random(len(chance), dtype=np.float32)).nonzero()[0]
    tri, u, v, direction, face, normal = (gather(values, on) for values in (tri, u, v, direction, face, normal))
    turned, weight = gloss.reflect(tri, u, v, direction, normal, rng.random((2, len(on)), dtype=np.float32))
    weight *= _dot(turned, face) > 0
    share = gather(share, on) * weight / np.minimum(gather(chance, on), 1)
    origin = offset_origin(locate_hits(scene.tri_frame, tri, u, v), face)
    return gather(place, on), origin, turned, share
