"""Light that surfaces send to texels, gathered by rays from each texel: what a ray meets sends its albedo times the light there.

Most of that light is direct, which is known; what photons tell of the rest is averaged over all that a texel sees, so that few
photons are enough. A lightmap holds the light on the front of surfaces: rays that meet another side are kept apart.

Source: Reichert 1992, "A two-pass radiosity method driven by lights and viewer position"; Jensen 2001, "Realistic image synthesis
using photon mapping", 9.2 (final gathering).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..lights.direct_points import (
    LIGHT_PLACE,
    MOST_TEXELS,
    STAGES,
    Receivers,
    ReceivingSurfaces,
    TexelChunk,
    each_chunk,
    light_points,
    random_shift,
)
from ..lights.stratified_choice import Demand, Span, draw_strata, sample_adaptively
from ..scene.coincident_faces import CoincidentFaces
from ..scene.materials import SurfaceMaterials
from ..scene.rays import RayScene
from ..scene.scene import DIFFUSE, GLOSSY
from ..scene.shadow_rays import MOST_LAYERS
from ..scene.surface_cells import SurfaceCells
from ..texels.texel_map import TexelMap
from ..transport.mirrors import GlossyScene, follow_mirrors
from ..transport.passing import Passing
from ..transport.refraction import follow_glass
from ..util.ablation import uses
from ..util.arrays import Float32, Float64, IntArray
from ..util.geometry import dot_rows, offset_origin, rotate_to, take_rows
from ..util.sampling import square_to_cosine_hemisphere
from .bright_places import BrightPlaces, Targets
from .direct import DirectScene
from .hit_light import HitLight

SIGNS = 4  # of the noise of each leaf and cell: by one alone, the noise of a few bright leaves may cancel by chance
# Width over distance of a cell that covers as much as one ray represents, of the most rays that a texel sends in one pass.
_WIDE_RAD = math.sqrt(2.0 * math.pi / STAGES[-1][1])
# Width of a texel over the distance of a ray's origin, and over that texel's width, beyond which its mean light does not stand for what
# the ray met: it fills a right angle.
_COARSE = 2.0

_Hit: TypeAlias = tuple[IntArray, Float32, Float32, Float32]  # triangle, u, v and distance in the unit box, (m,) each


@dataclass(frozen=True)
class KnownLight:
    """Light at all n texel entries that rays may meet, W/m^2.

    light           (3, n) float32: direct, and indirect by photons so far
    direct          (3, n) float32: what of it is by shadow rays
    doubt           (k, n) float32: half of what one half of the photons tells more than the other, mean of channels; k times, each with
                    random signs for leaves: gathered light has the variance that is the mean square of what it gathers of these
    on_cells        (2, 3, n_cell) float32: light on sides without a lightmap by photons, indirect and straight from lamps
    cell_doubt      (k, 2, n_cell) float32: as doubt
    bright          places that send much of this light
    """

    light: Float32
    direct: Float32
    doubt: Float32
    on_cells: Float32
    cell_doubt: Float32
    bright: BrightPlaces


def give_signs(doubt: Float32, leaf: IntArray | None = None) -> Float32:
    """(SIGNS, ..., n) float32: noise (..., n) with random signs, the same for all that is on one leaf (n,) int; None for a sign each.

    Source: Hutchinson 1990, "A stochastic estimator of the trace of the influence matrix for Laplacian smoothing splines" (the mean square
    of a sum with random signs is the sum of the squares).
    """
    count = doubt.shape[-1] if leaf is None else int(leaf.max(initial=-1)) + 1
    sign = np.random.default_rng(1).choice(np.array([-1, 1], np.float32), (SIGNS, count))
    sign = sign if leaf is None else sign.take(leaf, axis=1)
    return doubt * sign.reshape(SIGNS, *[1] * (doubt.ndim - 1), -1)


@dataclass(frozen=True)
class GatherScene:
    """What rays meet.

    coincident      faces in one place, among which hits are shared out
    lights          those of direct light where rays meet a side without a lightmap
    passing         what they go on through, with what it lets pass
    mirrors         what reflects them specularly, or bends them: light that comes from lamps that way alone is not gathered, but deposited
                    by photons
    texel_width     (n,) float32, unit box: of whole texels of its object, for each texel entry
    cell_width      (n_cell,) float32, unit box
    tri_two_sided   (n_tri,) bool: texels hold light of both sides
    tri_mapped      (n_tri,) bool: texels hold the light on its front alone
    """

    rays: RayScene
    coincident: CoincidentFaces | None
    lights: DirectScene
    passing: Passing | None
    mirrors: GlossyScene | None
    receiving: ReceivingSurfaces
    surfaces: SurfaceMaterials
    texels: TexelMap
    cells: SurfaceCells
    texel_width: Float32
    cell_width: Float32
    tri_two_sided: NDArray[np.bool_]
    tri_mapped: NDArray[np.bool_]


@dataclass(frozen=True)
class GatheredLight:
    """Light of texels that comes from surfaces.

    irradiance_rgb   (n, 3) float32, W/m^2, as of DirectLight, as are the variance and the counters
    variance_rgb     (n, 3) float32, (W/m^2)^2, of the choice of rays
    doubt            (n, k) float32, W/m^2: what comes of KnownLight.doubt
    by_openings      each texel has rays of its own
    """

    irradiance_rgb: Float32
    variance_rgb: Float32
    doubt: Float32
    counters: dict[str, int]
    by_openings: bool = False


def gather_light(
    scene: GatherScene, known: KnownLight, targets: Targets, texel: IntArray, rng: np.random.Generator, n_ray: int
) -> GatheredLight:
    """Light from surfaces at texels (n,) int, by n_ray rays from each, the end of a stage of STAGES, and as many again to targets."""
    irradiance, variance = np.zeros((2, len(texel), 3), np.float32)
    doubt, traced = np.zeros((len(texel), len(known.doubt)), np.float32), 0
    for part, chunk in each_chunk(scene.receiving, scene.texels.footprints_at, texel, scene.tri_two_sided, rng, MOST_TEXELS // 2):
        gathering = _Gathering(scene, known, targets, chunk, scene.texel_width[texel[part]], rng, n_ray)
        every, nothing, all_rays = np.arange(len(chunk)), np.zeros((len(chunk), 3)), ((0, 2 * n_ray if len(targets) else n_ray),)
        # No texel stops early: by its own rays alone it would where they happen to meet nothing bright, which loses up to 1 % of the light.
        light, error, n = sample_adaptively(gathering.sample, every, Demand(0.0), nothing, all_rays)
        carried, share = (gathering.doubt / np.maximum(gathering.rays, 1)).T, chunk.find_side_share()
        if share is not None:
            light, error, carried = light * share, error * share**2, carried * share.mean(axis=1, keepdims=True)
        irradiance[part] += light
        variance[part] += error
        doubt[part] += carried
        traced += n
    return GatheredLight(irradiance, variance, doubt, {"rays": traced})


@dataclass(frozen=True)
class _Rays:
    """Rays (k * n,) from texels `rows` (n,) of a chunk, of which `origin` says where they begin.

    target   (k * n,) int: the number of the place each is aimed at, -1 for none
    place    (k * n,) int: where what each brings goes in (k, n) estimates in the order of strata
    """

    rows: IntArray
    origin: Receivers
    direction: Float32
    target: IntArray
    place: IntArray


class _Gathering:
    """Rays of a chunk's texels, and what they met so far.

    doubt   (k, n) float64, W/m^2: sum over rays
    rays    (n,) int64
    """

    def __init__(
        self,
        scene: GatherScene,
        known: KnownLight,
        targets: Targets,
        chunk: TexelChunk,
        width: Float32,
        rng: np.random.Generator,
        n_ray: int,
    ) -> None:
        self._scene, self._known, self._targets, self._chunk, self._width = scene, known, targets, chunk, width
        self._rng, self._n_ray = rng, n_ray
        self._shift = random_shift(rng, len(chunk))
        self._on_hits = HitLight(scene.lights, rng)
        self._chances = targets.find_chances(chunk) if len(targets) else np.zeros((0, 0))
        self.doubt, self.rays = np.zeros((len(known.doubt), len(chunk))), np.zeros(len(chunk), np.int64)

    def _choose_rays(self, rows: IntArray) -> _Rays:
        """Rays of cosine-distributed directions from each of the texels, and as many to targets if there are any."""
        count, every = self._n_ray, np.arange(len(rows))
        span = (0, count)
        origin, shift = self._chunk.receivers(rows, *span), take_rows(self._shift, rows)
        direction = rotate_to(square_to_cosine_hemisphere(light_points(shift, *span)), origin.normal).astype(np.float32)
        place = (LIGHT_PLACE[span][:, None] * len(rows) + every).ravel()
        if not len(self._targets):
            return _Rays(rows, origin, direction, np.full(len(direction), -1), place)
        step, pick = draw_strata(shift[:, 0], count, self._rng)
        target, point = self._targets.choose(self._chances, rows, pick, self._rng)
        aimed = point - origin.position
        aimed /= np.sqrt(np.maximum(dot_rows(aimed, aimed), np.float32(1e-20)))[:, None]
        return _Rays(
            rows,
            origin.rows(np.tile(np.arange(len(direction)), 2)),
            np.concatenate([direction.T, aimed.T], axis=1).T,
            np.append(np.full(len(direction), -1), target),
            np.append(place, (count + step) * len(rows) + every),
        )

    def sample(self, rows: IntArray, span: Span) -> tuple[Float64, int]:
        """(k, len(rows), 3) float64: what each ray says of all light from surfaces, W/m^2, in the order of strata; and rays traced.

        span   all rays
        """
        scene, rays = self._scene, self._choose_rays(rows)
        receivers, direction = rays.origin, rays.direction
        count = span[1]
        self.rays[rows] += count
        sent, traced = np.zeros((3, len(direction))), 0
        # By a shading normal some rays go below the face: what comes from there is not seen, as with the sky.
        ray = np.flatnonzero((direction * receivers.side).sum(axis=1) > 0)
        origin, aimed, direction = take_rows(receivers.position, ray), direction, take_rows(direction, ray)
        share, kind = np.ones((3, len(ray)), np.float32), np.full(len(ray), DIFFUSE)
        shade = receivers.shade_bumps(aimed)
        if shade is not None:
            share *= shade[ray]
        for _ in range(MOST_LAYERS):
            found = scene.rays.closest(origin, direction)
            if scene.coincident:
                found, _ = scene.coincident.share_out(found, direction.T)
            traced += len(ray)
            hit = np.flatnonzero(found.tri >= 0)
            tri, u, v, distance = found.tri[hit], found.u[hit], found.v[hit], found.distance[hit]
            ray, direction, share, kind = ray[hit], take_rows(direction, hit), share[:, hit], kind[hit]
            tri_seen = scene.surfaces.tri_seen
            seen = share if tri_seen is None else share * tri_seen[kind, :, tri].T
            back = scene.surfaces.dim_back(tri, (direction * take_rows(scene.receiving.normal, tri)).sum(axis=1) < 0)
            seen = seen if back is None else seen * back
            traced += self._add(sent, rays, ray, direction, seen, kind == DIFFUSE, (tri, u, v, distance))
            onward = []
            if scene.passing is not None:
                on, start, left = scene.passing.follow(direction.T, share, tri, u, v, kind)
                onward.append((ray[on], start, direction.T[:, on], left, kind[on]))
            if scene.mirrors is not None:
                on, start, turned, left = follow_mirrors(scene.mirrors, direction.T, seen, tri, u, v, self._rng)
                onward.append((ray[on], start, turned, left, np.full(len(on), GLOSSY)))
                on, start, turned, left, kinds = follow_glass(scene.mirrors, direction.T, seen, tri, u, v, self._rng)
                onward.append((ray[on], start, turned, left, kinds))
            if not sum(len(part[0]) for part in onward):
                break
            ray, kind = (np.concatenate([part[k] for part in onward]) for k in (0, 4))
            origin, direction, share = (np.concatenate([part[k] for part in onward], axis=1) for k in (1, 2, 3))
            origin, direction = origin.T, direction.T
        return np.moveaxis(sent.reshape(3, count, len(rows)), 0, -1), traced

    def _find_albedo(self, tri: IntArray, u: Float32, v: Float32, direction: Float32) -> tuple[Float32, Float32 | None]:
        """(3, n) each: share of the light on the side that rays (n, 3) meet which triangles send against them diffusely; and of the light
        on the other side, None where all is 0.
        """
        surfaces, mirrors = self._scene.surfaces, self._scene.mirrors
        albedo, through = surfaces.reflectance.at(tri, u, v).T, None
        if surfaces.has_through:
            through = surfaces.through.at(tri, u, v).T
            albedo = np.maximum(albedo - through, 0)
        if mirrors is None or mirrors.gloss is None:
            return albedo, through
        cosine = (direction * take_rows(self._scene.receiving.normal, tri)).sum(axis=1)
        albedo, rows = mirrors.gloss.find_diffuse(tri, u, v, albedo)
        return albedo * mirrors.gloss.below_layer(rows, cosine), through

    def _add(
        self,
        sent: Float64,
        rays: _Rays,
        ray: IntArray,
        direction: Float32,
        share: Float32,
        is_straight: NDArray[np.bool_],
        hit: _Hit,
    ) -> int:
        """Adds what rays (m,) of `rays` bring from the triangles they met; a share (3, m) of it comes to the texels.

        Returns how many shadow rays were traced.
        """
        scene, rows, traced = self._scene, rays.rows, 0
        tri, u, v, _ = hit
        x, y = scene.texels.hit_texel_xy(tri, u, v)
        entry = scene.texels.entry_of(tri, x, y)
        is_front = (direction * take_rows(scene.receiving.normal, tri)).sum(axis=1) < 0
        has_texel = scene.tri_mapped[tri] & (entry >= 0)
        if len(self._targets):
            cell = scene.cells.find(tri, is_front, u, v)
            number = np.where(is_front & has_texel, self._targets.of_texel[entry], self._targets.of_cell[cell])
            point, normal = scene.receiving.place(tri, u, v), take_rows(scene.receiving.normal, tri)
            share = share * self._weigh(rays, ray, direction, np.where(is_straight, number, -1), point, normal)
        albedo, through = self._find_albedo(tri, u, v, direction)
        place, entry = rays.place[ray], scene.texels.owner_of(entry, x, y)
        for facing, seen in ((is_front, albedo), (~is_front, through)):
            if seen is None:
                continue
            is_mapped, own_share = facing & has_texel, seen * share
            mapped, bare = np.flatnonzero(is_mapped), np.flatnonzero(~is_mapped & own_share.any(axis=0))
            on_texels = self._light_texels(_take_hit(hit, mapped), entry[mapped], self._width[rows[ray[mapped] % len(rows)]])
            on_cells = self._light_cells(_take_hit(hit, bare), facing[bare])
            for sides, (light, doubt, n_ray) in ((mapped, on_texels), (bare, on_cells)):
                traced += n_ray
                own, to = own_share[:, sides], place[sides]
                carried, row = own.mean(axis=0) * doubt, ray[sides] % len(rows)
                self.doubt[:, rows] += np.stack([np.bincount(row, one, len(rows)) for one in carried])
                for channel, row in enumerate(sent):
                    brought = own[channel] * light[channel]
                    if scene.mirrors is None:
                        row[to] += brought
                    else:  # a ray may be there twice, mirrored and passed
                        row += np.bincount(to, brought, len(row))
        return traced

    def _weigh(self, rays: _Rays, ray: IntArray, direction: Float32, number: IntArray, point: Float32, normal: Float32) -> Float32:
        """(m,) float32: weights of rays (m,) that met the places `number` (m,), -1 for none, by the balance heuristic.

        point, normal   (m, 3): where they met them, unit box, and the normals there
        """
        target = rays.target[ray]
        weight = np.where(target < 0, np.float32(2), np.float32(0))
        both = np.flatnonzero((number >= 0) & ((target < 0) | (target == number)))
        ray, point, normal = ray[both], take_rows(point, both), take_rows(normal, both)
        row = rays.rows[ray % len(rays.rows)]
        by_aim = self._targets.find_pdf(self._chances, row, number[both], point - take_rows(rays.origin.position, ray), normal)
        cosine = dot_rows(take_rows(direction, both), take_rows(rays.origin.normal, ray))
        by_cosine = np.maximum(cosine, 0) / math.pi
        weight[both] = 2 * by_cosine / np.maximum(by_cosine + by_aim, 1e-20)
        return weight

    def _light_texels(self, hit: _Hit, entry: IntArray, own_width: Float32) -> tuple[Float32, Float32, int]:
        """Light (3, m) of texel entries (m,) that rays met, its doubt (k, m), W/m^2, and the number of shadow rays.

        Texels of coarse ground have no shadow of what is small and near it. So where a texel is wider than the distance, and than the
        texels from which the rays come, own_width (m,), direct light comes from shadow rays.
        """
        known, width = self._known, self._scene.texel_width[entry]
        light, doubt = known.light.take(entry, axis=1), known.doubt.take(entry, axis=1)
        near = np.flatnonzero((width > _COARSE * np.maximum(hit[3], own_width)) & uses("hit_light"))
        direct, traced = self._light_directly(_take_hit(hit, near), np.ones(len(near), bool))
        light[:, near] += direct - known.direct.take(entry[near], axis=1)
        return light, doubt, traced

    def _light_cells(self, hit: _Hit, is_front: NDArray[np.bool_]) -> tuple[Float32, Float32, int]:
        """As _light_texels, on fronts or backs (m,) of triangles without a lightmap.

        Direct light comes from shadow rays where a cell covers a larger part of the texel's view than one ray represents: such a cell
        would blur shadows, and several rays would meet the same noise.
        """
        known, (tri, u, v, distance) = self._known, hit
        cell = self._scene.cells.find(tri, is_front, u, v)
        light, doubt = known.on_cells[0].take(cell, axis=1), known.cell_doubt[:, 0].take(cell, axis=1)
        is_near = (self._scene.cell_width[cell] > _WIDE_RAD * distance) & uses("hit_light")
        near, far = np.flatnonzero(is_near), np.flatnonzero(~is_near)
        light[:, far] += known.on_cells[1].take(cell[far], axis=1)
        doubt[:, far] += known.cell_doubt[:, 1].take(cell[far], axis=1)
        direct, traced = self._light_directly(_take_hit(hit, near), is_front[near])
        light[:, near] += direct
        return light, doubt, traced

    def _light_directly(self, hit: _Hit, is_front: NDArray[np.bool_]) -> tuple[Float64, int]:
        """Direct light (3, m), W/m^2, by shadow rays from fronts or backs (m,) of triangles, and the number of rays."""
        (tri, u, v, _), receiving = hit, self._scene.receiving
        if not len(tri):
            return np.zeros((3, 0)), 0
        normal = (take_rows(receiving.normal, tri).T * np.where(is_front, np.float32(1), np.float32(-1))).T
        position = offset_origin(receiving.place(tri, u, v), normal).astype(np.float32)
        direct, traced = self._on_hits.find_light(Receivers(position, normal, normal), tri)
        return direct.T, traced


def _take_hit(hit: _Hit, rows: IntArray) -> _Hit:
    tri, u, v, distance = hit
    return tri[rows], u[rows], v[rows], distance[rows]
