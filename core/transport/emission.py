"""Emission of photons, and the rules of their first segment: lamps without shadow, soft falloff, lamps close to a surface."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..lights.emitters import JoinedEmitters
from ..scene.rays import RayScene
from ..util.arrays import BoolArray, Float32, Float64, Int32, Int64
from ..util.geometry import gather, locate_hits, offset_origin
from ..util.sampling import low_discrepancy_points

BATCH = 131_072  # photons in flight; measured with textures and a sky: 16 k is a tenth slower, 128 k a twentieth quicker at most
_MOST_SURFACES = 1000  # along one ray; ends a photon that rounding keeps at one surface
_FARTHEST = np.float32(1e6)  # its square is still finite in float32

Bools: TypeAlias = BoolArray
_Rows = Float32


@dataclass
class Photons:
    """Photons under way; origin, direction and flux are (3, n) float32, one row per axis or channel.

    soft, stops, sky and link hold until the first hit; each optional field is None where it holds for no photon.

    soft       (4, n) float32   unit box: soft_radius, soft_offset, distance covered so far, and 1 for a crowded lamp, else 0
    power      (3,) float64, W  sum of the flux, from the first hit on
    stops      (n,) bool        does not pass through surfaces, since light_every_surface made another photon behind the next one
    sky        (n,) bool        comes from an even sky
    mirrored   (n,) bool        has met specular surfaces only
    link       (n,) int16       row of LightLinks of the photon's light, -1 for none
    seen       (3, 3, n) float32   share of the flux that diffuse, glossy and transmission rays would see, by channel

    Cycles traces rays from the receiver, and what a ray meets depends on how it left the last surface. A photon goes the same way in
    reverse: what it left, and all that it passed since, is seen by the kind of ray that leaves the next surface toward it. That is known
    only there, where the photon is deposited or scattered (diffusely, glossily, or by refraction), so until then it carries all three.
    """

    origin: _Rows
    direction: _Rows
    flux: _Rows
    soft: _Rows | None = None
    power: Float64 = field(default_factory=lambda: np.zeros(3))
    stops: Bools | None = None
    sky: Bools | None = None
    mirrored: Bools | None = None
    link: NDArray[np.int16] | None = None
    seen: _Rows | None = None


@dataclass(frozen=True)
class Arrivals:
    """Photons at the surfaces that they have met, if any.

    tri, u, v                   (n,), as in rays.Hits
    direction, flux, mirrored   as in Photons
    """

    tri: Int32
    u: _Rows
    v: _Rows
    direction: _Rows
    flux: _Rows
    mirrored: Bools | None

    def only(self, rows: NDArray[np.intp]) -> Arrivals:
        """The arrivals in rows (k,), ascending."""
        if len(rows) == len(self.tri):
            return self
        tri, u, v = gather(self.tri, rows), gather(self.u, rows), gather(self.v, rows)
        mirrored = None if self.mirrored is None else gather(self.mirrored, rows)
        return Arrivals(tri, u, v, gather(self.direction, rows), gather(self.flux, rows), mirrored)


def emit_photons(
    emitters: JoinedEmitters,
    share: Float64,
    n_photons: int,
    total_flux_share: float,
    rng: np.random.Generator,
    batch: int = BATCH,
) -> Iterator[tuple[Photons, Bools]]:
    """Batches of new photons, and which of them (n,) come from a lamp without shadow.

    share   (n_emitter,) float64, probability of each emitter
    batch   greatest number of photons in a batch
    """
    if n_photons <= 0 or not share.any():
        return
    shift = rng.integers(0, 2**32, (len(emitters), 4), np.uint32)
    start = _share_out(share, n_photons, rng.random())
    per_power = np.divide(total_flux_share / n_photons, share, out=np.zeros(len(emitters)), where=share > 0)
    power = (emitters.power_rgb * per_power[:, None]).T.astype(np.float32)
    for first in range(0, n_photons, batch):
        last = min(first + batch, n_photons)
        within = start.clip(first, last)
        count = np.diff(within)
        bearing = np.flatnonzero(count)
        count = count[bearing]
        emitter = np.repeat(bearing, count)
        births = emitters.emit(emitter, low_discrepancy_points(shift[bearing], within[bearing] - start[bearing], count))
        flux = gather(power, emitter)
        flux *= births.relative_rgb.T
        soft = None
        if births.soft_radius.any():
            crowded = emitters.crowded.take(emitter).astype(np.float32)
            soft = np.stack([births.soft_radius, births.soft_offset, np.zeros(last - first, np.float32), crowded])
        origin, direction = (np.ascontiguousarray(vectors.T) for vectors in (births.origin, births.direction))
        sky = emitters.is_even_sky.take(emitter) if emitters.is_even_sky.any() else None
        link = emitters.link.take(emitter) if (emitters.link >= 0).any() else None
        yield Photons(origin, direction, flux, soft, sky=sky, link=link), ~emitters.casts_shadow.take(emitter)


def _share_out(share: Float64, number: int, shift: float) -> Int64:
    """(n_emitter + 1,) int64: index of each emitter's first photon among `number` photons in their order, and the end of the last.

    By systematic sampling each emitter gets number * share to within one, and exactly so in the mean over shifts uniform in [0, 1).
    """
    end = np.ceil(np.cumsum(share) * number - shift).astype(np.int64).clip(0, number)
    end[np.flatnonzero(share)[-1] :] = number  # a sum of shares may round to just below 1
    return np.concatenate([[0], end])


def light_every_surface(photons: Photons, shadowless: Bools, rays: RayScene, tri_normal: _Rows, tri_frame: _Rows) -> int:
    """For shadowless photons, add a photon for each further surface along the ray, starting just before it. Returns the number of rays.

    Blender lights every surface that faces such a lamp, and each of them scatters light.

    tri_normal   (3, n_tri) float32
    tri_frame    (3, 3, n_tri) float32   as in photons.TraceScene
    """
    place = np.flatnonzero(shadowless)
    stops = [shadowless]
    origin, direction = gather(photons.origin, place), gather(photons.direction, place)
    covered = np.zeros(len(place), np.float32)
    parts, traced = [photons], 0
    for number in range(_MOST_SURFACES):
        found = rays.closest(origin.T, direction.T)
        traced += len(place)
        hit = np.flatnonzero(found.tri >= 0)
        place, origin, direction, covered = place[hit], gather(origin, hit), gather(direction, hit), covered[hit]
        if number:
            soft = None if photons.soft is None else gather(photons.soft, place)
            if soft is not None:
                soft[2] = covered
            stops.append(np.ones(len(place), bool))
            link = None if photons.link is None else gather(photons.link, place)
            parts.append(Photons(origin, direction, gather(photons.flux, place), soft, link=link))
        if not len(hit):
            break
        tri = found.tri[hit]
        normal = gather(tri_normal, tri)
        normal = normal * np.copysign(np.float32(1), (direction * normal).sum(axis=0))  # on the side that the ray leaves by
        origin = offset_origin(locate_hits(tri_frame, tri, found.u[hit], found.v[hit]), normal)
        covered = covered + found.distance[hit]
    photons.stops = np.concatenate(stops)
    if photons.sky is not None:
        photons.sky = np.concatenate([photons.sky, np.zeros(len(photons.stops) - len(photons.sky), bool)])
    photons.origin, photons.direction, photons.flux = (
        np.concatenate([getattr(part, name) for part in parts], axis=1) for name in ("origin", "direction", "flux")
    )
    if photons.soft is not None:
        photons.soft = np.concatenate([part.soft for part in parts if part.soft is not None], axis=1)
    if photons.link is not None:
        photons.link = np.concatenate([part.link for part in parts if part.link is not None])
    return traced


def soften(photons: Photons, distance: _Rows) -> _Rows:
    """Flux (3, n) at the first hit with Blender's soft falloff: 0 for photons that would miss the lamp's disk, seen from the hit.

    distance   (n,) float32, unit box

    Photons fill the cone under which a receiver sees a sphere, sin = r / d. The disk that faces the receiver fills a narrower cone of the
    same radiance, tan = r / d. So the irradiance falls from 1 / d^2 to 1 / (d^2 + r^2), and near the lamp the horizon cuts the disk.
    """
    flux = photons.flux
    if photons.soft is not None:
        radius, offset, covered, _ = photons.soft
        along = np.minimum(distance + covered, _FARTHEST)
        # tan = offset / along; photons of a light that is not soft are all kept, however near.
        kept = offset * np.sqrt(along * along + offset * offset) <= np.abs(radius) * along
        flux = flux * np.where(radius < 0, along <= -radius, kept)
    return flux


def find_hidden(photons: Photons, distance: _Rows, rays: RayScene, passes: Bools | None = None) -> tuple[Bools, int]:
    """Photons (n,) of crowded lamps for which a surface hides the point of the lamp's disk that they stand for; and the number of rays.

    distance   (n,) float32, unit box: to the first hit
    passes     (n_tri,) bool: triangles that let light of lamps pass, so that they hide nothing; None for none

    A photon starts on the disk perpendicular to its own direction. The disk that faces the receiver lies offset^2 / distance behind that
    point, and a wall that is nearer to the lamp than its radius may stand between both.
    """
    hidden = np.zeros(len(distance), bool)
    if photons.soft is None or not photons.soft[3].any():
        return hidden, 0
    row = np.flatnonzero((photons.soft[3] > 0) & (photons.soft[1] > 0) & photons.flux.any(axis=0))
    _, offset, covered, _ = gather(photons.soft, row)
    back = offset * offset / np.maximum(gather(distance, row) + covered, np.finfo(np.float32).tiny)
    direction = gather(photons.direction, row)
    origin = gather(photons.origin, row) - covered * direction
    hidden[row] = rays.occluded(origin.T, -direction.T, np.minimum(back, _FARTHEST))
    if passes is not None:
        blocked = hidden[row].nonzero()[0]
        tri = rays.closest(gather(origin, blocked).T, -gather(direction, blocked).T).tri
        hidden[row[blocked]] = (tri < 0) | ~passes[tri]
    return hidden, len(row)


def join_waves(waves: list[Photons]) -> list[Photons]:
    """The same photons in fewer waves, since numpy is slow on short arrays; all of them have met a surface."""
    if len(waves) < 2:
        return waves
    ends = np.cumsum([photons.flux.shape[1] for photons in waves]) // BATCH
    groups = [[photons for photons, own in zip(waves, ends, strict=True) if own == end] for end in np.unique(ends)]
    return [join_photons(group) for group in groups]


def join_photons(waves: list[Photons]) -> Photons:
    """The photons of several waves in one; all of them have met a surface."""
    origin, direction, flux = (np.concatenate([getattr(one, name) for one in waves], axis=1) for name in ("origin", "direction", "flux"))
    power = np.sum([one.power for one in waves], axis=0)
    mirrored = None
    if any(one.mirrored is not None for one in waves):
        none = [np.zeros(one.flux.shape[1], bool) for one in waves]
        mirrored = np.concatenate([no if one.mirrored is None else one.mirrored for no, one in zip(none, waves, strict=True)])
    seen = None
    if any(one.seen is not None for one in waves):
        all_seen = [np.ones((3, 3, one.flux.shape[1]), np.float32) if one.seen is None else one.seen for one in waves]
        seen = np.concatenate(all_seen, axis=2)
    return Photons(origin, direction, flux, power=power, mirrored=mirrored, seen=seen)
