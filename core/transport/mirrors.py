"""Specular reflection of photons and gather rays by metals and dielectric layers."""

from typing import Protocol

import numpy as np

from ..scene.glass import Glass
from ..scene.gloss import Gloss
from ..scene.materials import SurfaceMaterials
from ..scene.normal_maps import NormalMaps
from ..util.arrays import Float32, Int32, IntArray
from ..util.geometry import gather, locate_hits, offset_origin
from .emission import Arrivals, Photons
from .passing import Passing

_TINY = np.finfo(np.float32).tiny
_LEAST_COSINE = 0.01  # the bound of Veach's weight in photons.py
_LIFT = np.float32(0.01)
_Rows = Float32


class GlossyScene(Protocol):
    """The fields of photons.TraceScene that reflection and refraction need."""

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
    def tri_smooth(self) -> Int32: ...
    @property
    def smooth_frame(self) -> _Rows: ...
    @property
    def surfaces(self) -> SurfaceMaterials: ...
    @property
    def maps(self) -> NormalMaps | None: ...


def reflect_photons(
    scene: GlossyScene,
    arrived: Arrivals,
    tri: IntArray,
    cosine: _Rows,
    is_first: bool,
    copies: int,
    rng: np.random.Generator,
) -> Photons | None:
    """Photons that are reflected specularly, by Russian roulette; None if none is. Diffuse reflection has a roulette of its own.

    tri        (n,) int64: of `arrived`
    cosine     (n,) float32: of the incoming directions with the geometric normal
    is_first   the photons come straight from a light
    copies     number that each photon splits into, with equal shares of its flux
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
    return send_on(scene, arrived, is_first, row, gather(origin, kept), gather(turned, kept), gather(flux, kept))


def send_on(scene: GlossyScene, arrived: Arrivals, is_first: bool, row: IntArray, origin: _Rows, direction: _Rows, flux: _Rows) -> Photons:
    """The photons `arrived` in rows (k,) after a specular event, with new origins, directions and flux, each (3, k).

    is_first   as for reflect_photons
    """
    mirrored = np.ones(len(row), bool)
    if not is_first:
        mirrored = np.zeros(len(row), bool) if arrived.mirrored is None else gather(arrived.mirrored, row)
    seen = None if scene.surfaces.tri_seen is None else gather(scene.surfaces.tri_seen, gather(arrived.tri, row))
    return Photons(origin, direction, flux, power=np.add.reduce(flux, 1, np.float64), mirrored=mirrored, seen=seen)


def shade(scene: GlossyScene, tri: IntArray, u: _Rows, v: _Rows, side: _Rows, face: _Rows, direction: _Rows) -> _Rows:
    """(3, n): unit shading normals on the side that rays come from, with normal maps; the geometric ones where they face away from the
    rays.

    side        (n,) float32: 1 where rays meet the front, -1 where they meet the back
    face        (3, n) float32: geometric normals on that side
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
    """Normals (3, n) turned toward the geometric ones, face (3, n), until a mirror reflects rays of directions (3, n) above the face."""
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
    """(n,): factors on the flux of photons by the adjoint of shading normals; 0 below the face.

    arrived, turned   (3, n) float32, unit: incoming and reflected directions
    face, normal      (3, n) float32, unit: geometric and shading normals on that side
    Source: Veach 1997, section 5.3.
    """
    out = _dot(turned, face)
    least = np.float32(_LEAST_COSINE)
    factor: _Rows = _dot(arrived, normal) * out / np.minimum(_dot(arrived, face), -least) / np.maximum(_dot(turned, normal), least)
    return np.where(out > 0, np.maximum(factor, 0), 0)


def _dot(a: _Rows, b: _Rows) -> _Rows:
    return np.einsum("kn,kn->n", a, b)


def _smooth(scene: GlossyScene, tri: IntArray, u: _Rows, v: _Rows, side: _Rows, face: _Rows, direction: _Rows) -> _Rows:
    """As shade, without normal maps."""
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
    """Gather rays that triangles (n,) reflect specularly, by Russian roulette: rows (k,), origins (3, k), directions (3, k) and
    throughputs (3, k) of the reflected ones.

    direction   (3, n) float32, unit
    share       (3, n) float32: throughput before
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
