"""Wavefront particle tracing: emission, hits, deposit records, roulette, diffuse scattering.

Arrays of photons are (3, n), one contiguous row per axis or channel. Source: Pattanaik & Mudur 1992.

Where shadow rays find the direct light, the first segment of a path only finds a point that scatters light. So each photon splits into
SPLIT photons there, each with its share of the flux and its own direction. Source: Arvo & Kirk 1990, "Particle transport and image
synthesis" (splitting).
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..lights.emitters import JoinedEmitters
from ..lights.light_links import LightLinks
from ..lights.lights import Emitter
from ..scene.coincident_faces import CoincidentFaces
from ..scene.glass import Glass
from ..scene.gloss import Gloss
from ..scene.materials import SurfaceMaterials
from ..scene.normal_maps import NormalMaps
from ..scene.rays import RayScene
from ..scene.scene import DIFFUSE, GLOSSY, MAX_ALBEDO, SceneSnapshot
from ..scene.shadow_rays import MOST_LAYERS, ShadowRays, collapse
from ..util.ablation import uses
from ..util.arrays import BoolArray, Float32, Float64, Int32
from ..util.geometry import UnitBox, gather, locate_hits, offset_origin, triangle_frames, triangle_normals_areas
from ..util.sampling import grouped_points
from .emission import BATCH, Arrivals, Photons, emit_photons, find_hidden, join_photons, join_waves, light_every_surface, soften
from .mirrors import reflect_photons
from .passing import Passing
from .photon_log import PhotonLog, ShardHits, SideHits
from .refraction import bend_photons

_SMOOTH_DEVIATION = 1e-3  # a corner normal nearer to the face's own than this is flat shading
# Bounds Veach's weight at grazing incidence. The mean weight loses less than _LEAST_COSINE * sin(angle between the normals) / pi.
_LEAST_COSINE = 0.01
# Measured on the samples: the same error as without splitting, with a third to two thirds fewer rays; 16 gain hardly more.
SPLIT = 8
_DEPTHS_TOGETHER = 2  # the surviving photons of all waves are joined every so many surfaces
# A shard hands over its deposits, 25 bytes each, when there are so many: in a closed white room a photon makes hundreds.
MOST_HITS = 1 << 23
_TINY = np.finfo(np.float32).tiny
_GREATEST_POWER_W = 1e30  # leaves float32 room for photons brighter than the mean

_Rows = Float32
_Ints = Int32


@dataclass(frozen=True)
class TraceScene:
    """A scene prepared for photons; None for what it does not have.

    rays            closest hits of photons
    shadows         the same scene for shadow rays
    passing         transparent surfaces
    gloss           specular reflection
    glass           reflection and refraction by glass
    emitter_share   (n_emitter,) float64     probability of each emitter, proportional to its mean power; all 0 without any power
    tri_normal      (3, n_tri) float32       geometric, unit; 0 for triangles without area
    tri_frame       (3, 3, n_tri) float32    of triangle_frames, unit box
    tri_lit_below   (n_tri,) float32         a photon is deposited where the cosine of its direction with the normal is less than this:
                                             0 for one-sided receivers, inf where texels hold light of both sides, -inf without a lightmap
    tri_smooth      (n_tri,) int32           column of smooth_frame, -1 for flat shading
    smooth_frame    (3, 3, n_smooth) float32 of triangle_frames, of the corners' unit shading normals
    maps            normal maps
    links           lamps that are linked to some surfaces only
    coincident      faces in one place, among which hits are shared out
    """

    rays: RayScene
    shadows: ShadowRays
    passing: Passing | None
    gloss: Gloss | None
    glass: Glass | None
    emitters: JoinedEmitters
    emitter_share: Float64
    surfaces: SurfaceMaterials
    tri_normal: Float32
    tri_frame: Float32
    tri_lit_below: Float32
    tri_smooth: Int32
    smooth_frame: Float32
    maps: NormalMaps | None = None
    links: LightLinks | None = None
    coincident: CoincidentFaces | None = None

    @property
    def has_caustics(self) -> bool:
        """Whether light may reach surfaces by specular bounces alone, on paths that shadow rays do not find."""
        return self.gloss is not None or self.glass is not None


def build_trace_scene(snapshot: SceneSnapshot, unit_box: UnitBox, surfaces: SurfaceMaterials, emitters: Sequence[Emitter]) -> TraceScene:
    """Prepare a snapshot for photons, with the unit_box and surfaces that the emitters were built with.

    Raises ValueError for an emitter whose power is negative, not finite or too large.
    """
    corners_m = snapshot.tri_position
    normal = triangle_normals_areas(corners_m)[0].astype(np.float32)
    deviation = np.abs(snapshot.tri_normal - normal[:, None]).max(axis=(1, 2), initial=0)
    smooth = np.isfinite(deviation) & (deviation > _SMOOTH_DEVIATION) & normal.any(axis=1)
    tri_smooth = np.where(smooth, np.cumsum(smooth) - 1, -1).astype(np.int32)
    joined = JoinedEmitters.of(emitters)
    traceable = ((joined.power_rgb >= 0) & (joined.power_rgb <= _GREATEST_POWER_W)).all(axis=1)
    if not traceable.all():
        bad = emitters[int(traceable.argmin())]
        raise ValueError(f"{bad.name}: its power is {bad.power_rgb} W; choose one between 0 and {_GREATEST_POWER_W:g} W.")
    power = joined.power_rgb.mean(axis=1)
    total = power.sum()
    corners = unit_box.to_unit(corners_m)
    lit_below = np.array([(math.inf if thing.two_sided else 0) if thing.receives else -math.inf for thing in snapshot.objects], np.float32)
    receives = np.array([thing.receives for thing in snapshot.objects], bool)[snapshot.tri_object]
    tri_lit_below = np.where(surfaces.tri_both & receives, np.float32(math.inf), lit_below[snapshot.tri_object])
    rays = RayScene(collapse(corners, receives | ~surfaces.find_void()))
    tri_normal, tri_frame = np.ascontiguousarray(normal.T), triangle_frames(corners)
    links = LightLinks.of(snapshot)
    passing, glass = Passing.of(surfaces, tri_frame, tri_normal, links), Glass.of(snapshot, surfaces)
    clear = np.zeros(len(corners), bool) if glass is None else glass.tri_glass
    if passing:
        clear = clear | passing.tri_passes.any(axis=0)
    return TraceScene(
        rays=rays,
        shadows=ShadowRays.of(rays, surfaces, corners, tri_normal),
        passing=passing,
        gloss=Gloss.of(snapshot, surfaces),
        glass=glass,
        emitters=joined,
        emitter_share=power / total if total > 0 else np.zeros(len(power)),
        surfaces=surfaces,
        tri_normal=tri_normal,
        tri_frame=tri_frame,
        tri_lit_below=tri_lit_below,
        tri_smooth=tri_smooth,
        smooth_frame=triangle_frames(snapshot.tri_normal[smooth].astype(np.float32)),
        maps=NormalMaps.of(snapshot),
        links=links if len(links) else None,
        coincident=CoincidentFaces.find(rays, corners, tri_normal, clear) if uses("coincident_faces") else None,
    )


def trace_shard(
    scene: TraceScene,
    n_photons: int,
    total_flux_share: float,
    rng: np.random.Generator,
    max_depth: int,
    skip_first: bool,
) -> Iterator[ShardHits]:
    """Trace photons until they escape, are absorbed or have met `max_depth` surfaces; yields their deposits whenever there are MOST_HITS,
    and at the end.

    total_flux_share   the photons' share of the scene's power: n_photons / all photons of a bake
    skip_first         direct light is computed elsewhere: first hits scatter but are not deposited, and photons split there
    """
    log = PhotonLog()
    waves: Iterable[Photons] = _emit(scene, n_photons, total_flux_share, rng, _count_parts(skip_first), log)
    for depth in range(0, max_depth, _DEPTHS_TOGETHER):
        depths = range(depth, min(depth + _DEPTHS_TOGETHER, max_depth))
        left = [after for photons in waves if (after := _bounce(scene, photons, rng, depths, skip_first, log))]
        waves = join_waves(left)
        if not left:
            break
        if log.n_hit >= MOST_HITS:
            yield log.take()
    for photons in waves:
        log.remainder += photons.power
    yield log.take()


def _count_parts(splits: bool) -> int:
    """Number of photons that one splits into at its first surface; 1 if it does not."""
    return SPLIT if splits and uses("splitting") else 1


def _bounce(
    scene: TraceScene, photons: Photons, rng: np.random.Generator, depths: range, skip_first: bool, log: PhotonLog
) -> Photons | None:
    """The photons after a reflection at each of the depths; None when none is left."""
    for depth in depths:
        reflected: list[Photons] = []
        under_way = photons
        for _ in range(MOST_LAYERS):
            after, passed = _meet(scene, under_way, rng, depth, skip_first, log)
            reflected += [after] if after else []
            if passed is None:
                break
            under_way = passed
        else:
            log.remainder += under_way.power
        if not reflected:
            return None
        photons = reflected[0] if len(reflected) == 1 else join_photons(reflected)
    return photons


def _meet(
    scene: TraceScene, photons: Photons, rng: np.random.Generator, depth: int, skip_first: bool, log: PhotonLog
) -> tuple[Photons | None, Photons | None]:
    """The photons that the next surface reflects, and those that pass straight through it and stay at this depth; None for none."""
    found = scene.rays.closest(photons.origin.T, photons.direction.T)
    log.rays += len(found.tri)
    flux, faces = photons.flux, None
    if scene.coincident:
        found, faces = scene.coincident.share_out(found, photons.direction)
    if depth == 0:
        flux = soften(photons, found.distance)
        passes = None if scene.passing is None else scene.passing.tri_passes[1]
        hidden, n_ray = find_hidden(replace(photons, flux=flux), found.distance, scene.rays, passes)
        if n_ray:
            log.rays += n_ray
            flux = flux * ~hidden
        power = np.add.reduce(flux, 1, np.float64)
        log.emitted += power - photons.power  # photons that passed through a surface are softened anew for their longer way
        photons.power = power
    landed = photons.power
    hit = (found.tri >= 0).nonzero()[0]
    arrived = Arrivals(found.tri, found.u, found.v, photons.direction, flux, photons.mirrored).only(hit)
    tri, u, v, flux = arrived.tri, arrived.u, arrived.v, arrived.flux
    if len(hit) < len(found.tri):
        landed = _total(flux)
        log.escaped += photons.power - landed
    if not len(hit):
        return None, None
    index = tri.astype(np.intp)  # converted once, not in every gather
    linked, whole, glossy = None, arrived, arrived
    seen = None if photons.seen is None else gather(photons.seen, hit)
    if scene.links and not depth and photons.link is not None:
        linked = scene.links.look_up(gather(photons.link, hit), index)
        seen = linked.seen if seen is None else seen * linked.seen
    if seen is not None:
        flux = whole.flux * seen[DIFFUSE]
        arrived, glossy = replace(whole, flux=flux), replace(whole, flux=whole.flux * seen[GLOSSY])
    normal = gather(scene.tri_normal, index)
    cosine = _dot(arrived.direction, normal)  # < 0 on the front
    lit = cosine < gather(scene.tri_lit_below, index)
    is_front = cosine < 0
    worth = _weigh_bumps(scene, arrived, index, cosine)
    received = worth  # factors of what is deposited: a photon stands for those on the other faces in one place too
    if faces is not None:
        received = gather(faces, hit) if worth is None else gather(faces, hit) * worth
    elsewhere = (~(is_front & (gather(scene.tri_lit_below, index) == 0))).nonzero()[0]
    if len(elsewhere):
        own = arrived.only(elsewhere)
        brought = own.flux if received is None else own.flux * gather(received, elsewhere)
        straight = np.full(len(elsewhere), depth == 0)
        log.light_elsewhere(SideHits(own.tri, own.u, own.v, gather(is_front, elsewhere), straight, brought))
    if depth or not skip_first:
        is_first = np.full(len(tri), depth == 0)
        if skip_first and arrived.mirrored is not None:
            is_first |= arrived.mirrored
        if not depth:
            lit |= _find_lit_behind(scene, arrived, cosine, None if photons.sky is None else gather(photons.sky, hit))
        _deposit(scene, arrived, cosine, lit, is_first, received, log)
    passed = None
    if scene.passing:
        is_open = linked.open if linked else None
        passed = scene.passing.go_on(photons, hit, index, u, v, found.distance, depth == 0, is_open, rng)
    if passed:
        log.passed += passed.power
        landed = landed - passed.power
    back = scene.surfaces.dim_back(index, is_front)
    if back is not None:
        whole, glossy = replace(whole, flux=whole.flux * back), replace(glossy, flux=glossy.flux * back)
    splits = skip_first and not depth
    copies = _count_parts(splits)
    albedo, mirrored, row = scene.surfaces.reflectance.at(index, u, v).T, None, None
    if scene.gloss:
        mirrored = reflect_photons(scene, glossy, index, cosine, depth == 0, copies, rng)
        albedo, row = scene.gloss.find_diffuse(index, u, v, albedo)
        if mirrored:
            log.mirrored += mirrored.power
            landed = landed - mirrored.power
    specular = [mirrored] if mirrored else []
    if scene.glass:
        from_lamp = None if depth else np.ones(len(tri), bool) if photons.sky is None else ~gather(photons.sky, hit)
        bent, refracted = bend_photons(scene, whole, index, cosine, depth == 0, from_lamp, seen, copies, rng)
        if bent:
            specular.append(bent)
            log.mirrored += bent.power - refracted
            log.refracted += refracted
            landed = landed - bent.power
    through = scene.surfaces.through.at(index, u, v).T / np.maximum(albedo, _TINY) if scene.surfaces.has_through else None
    if worth is not None:
        albedo = albedo * worth
    if back is not None:
        albedo = np.minimum(albedo * back, np.float32(MAX_ALBEDO))
    alive, count, flux = _play_roulette(flux, albedo, copies if splits else None, rng)
    normal = gather(normal, alive)
    normal *= -np.copysign(np.float32(1), gather(cosine, alive))  # the side that was hit
    origin = offset_origin(locate_hits(scene.tri_frame, gather(index, alive), gather(u, alive), gather(v, alive)), normal)
    parent = alive  # those of arrived that each goes on from
    row = None if row is None else gather(row, alive)
    through = None if through is None else gather(through, alive)
    if count is not None:
        copy = np.repeat(np.arange(len(alive)), count)
        origin, normal, flux = gather(origin, copy), gather(normal, copy), gather(flux, copy)
        row = None if row is None else gather(row, copy)
        parent = gather(alive, copy)
        through = None if through is None else gather(through, copy)
        numbers = grouped_points(count, copy, rng)
    else:
        numbers = rng.random((2, len(alive)), dtype=np.float32)
    crossed = np.zeros(0, bool) if through is None else _choose_side(origin, normal, flux, through, rng)
    if scene.gloss and row is not None:
        facing = normal.copy()
        direction = _scatter(normal, numbers)
        # By roulette too: with weights instead, white surfaces would mirror some photons and scatter all, so their number would grow.
        below = scene.gloss.below_layer(row, _dot(direction, facing))
        below = np.broadcast_to(np.where(crossed, np.float32(1), below) if len(crossed) else below, flux.shape)
        chance = np.minimum(below.max(axis=0), 1)
        kept = (chance > rng.random(len(chance), dtype=np.float32)).nonzero()[0]
        flux = gather(flux * below, kept) / gather(chance, kept)
        origin, direction = gather(origin, kept), gather(direction, kept)
        parent = gather(parent, kept)
    else:
        direction = _scatter(normal, numbers)
    power = _total(flux)
    log.absorbed += landed - power
    seen = None if scene.surfaces.tri_seen is None else gather(scene.surfaces.tri_seen, gather(index, parent))
    diffuse = Photons(origin, direction, flux, power=power, seen=seen) if flux.shape[1] else None
    on = [diffuse, *specular] if diffuse else specular
    return (join_photons(on) if len(on) > 1 else on[0] if on else None), passed


def _emit(
    scene: TraceScene,
    n_photons: int,
    total_flux_share: float,
    rng: np.random.Generator,
    together: int,
    log: PhotonLog,
) -> Iterator[Photons]:
    """Batches of emitted photons, each of which stands for `together` until it splits."""
    log.photons += n_photons if scene.emitter_share.any() else 0
    count = -(-n_photons // together)
    batch = BATCH if together == 1 else max(2 * BATCH // together, 1)  # about half survive the first surface: BATCH photons after the split
    for photons, shadowless in emit_photons(scene.emitters, scene.emitter_share, count, total_flux_share, rng, batch):
        if shadowless.any():
            log.rays += light_every_surface(photons, shadowless, scene.rays, scene.tri_normal, scene.tri_frame)
        yield photons


def _total(flux: _Rows) -> Float64:
    return np.add.reduce(flux, 1).astype(np.float64)  # numpy sums pairwise: as exact as the float32 flux


def _dot(a: _Rows, b: _Rows) -> Float32:
    return np.einsum("kn,kn->n", a, b)


def _weigh_bumps(scene: TraceScene, arrived: Arrivals, index: NDArray[np.intp], cosine: _Rows) -> Float32 | None:
    """(n,): factors of normal maps on the arriving light; None if no surface has a map."""
    if scene.maps is None:
        return None
    sign = -np.copysign(np.float32(1), cosine)
    side = gather(scene.tri_normal, index) * sign
    smooth, column = side, gather(scene.tri_smooth, index)
    curved = ((column >= 0) & scene.maps.has(index)).nonzero()[0]
    if len(curved):
        between = locate_hits(scene.smooth_frame, column[curved], gather(arrived.u, curved), gather(arrived.v, curved))
        smooth = side.copy()
        smooth[:, curved] = between * (sign[curved] / np.maximum(np.sqrt(_dot(between, between)), np.float32(1e-6)))
    rows, of_bumps = scene.maps.weigh(index, arrived.u, arrived.v, side, smooth, arrived.direction)
    worth = np.ones(len(index), np.float32)
    worth[rows] = of_bumps
    return worth


def _find_lit_behind(scene: TraceScene, arrived: Arrivals, cosine: _Rows, sky: BoolArray | None) -> BoolArray:
    """(n,): photons straight from lamps that meet the backs of one-sided faces whose corners' normals face the lamp, see Receivers.see.

    cosine   (n,) float32: of their directions with the geometric normal
    sky      (n,) bool: photons of an even sky, None for none
    """
    behind = np.zeros(len(cosine), bool)
    if not scene.smooth_frame.size:
        return behind
    rows = ((cosine > 0) & (gather(scene.tri_smooth, arrived.tri) >= 0) & (gather(scene.tri_lit_below, arrived.tri) == 0)).nonzero()[0]
    if scene.maps is not None:
        rows = rows[~scene.maps.has(gather(arrived.tri, rows))]
    if sky is not None:
        rows = rows[~gather(sky, rows)]
    column = gather(scene.tri_smooth, gather(arrived.tri, rows))
    # Where the normals differ, rays start on the smooth surface over the face, which then hides what is behind it.
    is_even = np.abs(scene.smooth_frame[1:].take(column, axis=2)).max(axis=(0, 1)) < _SMOOTH_DEVIATION
    rows, column = rows[is_even], column[is_even]
    shading = locate_hits(scene.smooth_frame, column, gather(arrived.u, rows), gather(arrived.v, rows))
    behind[rows] = _dot(shading, gather(arrived.direction, rows)) < 0
    return behind


def _deposit(
    scene: TraceScene, arrived: Arrivals, cosine: _Rows, lit: BoolArray, is_first: BoolArray, received: Float32 | None, log: PhotonLog
) -> None:
    """Log the photons that are lit, (n,) bool.

    cosine     (n,) float32: of their directions with the geometric normal
    received   (n,) float32: factors of their flux; None for 1
    """
    kept = lit.nonzero()[0]
    own = arrived.only(kept)
    flux = own.flux
    if scene.smooth_frame.size:
        column = gather(scene.tri_smooth, own.tri)
        smooth = (column >= 0).nonzero()[0]
        if len(smooth):
            shading = locate_hits(scene.smooth_frame, gather(column, smooth), gather(own.u, smooth), gather(own.v, smooth))
            incoming, face = gather(own.direction, smooth), gather(cosine, gather(kept, smooth))
            facing = _dot(shading, incoming) / np.maximum(np.sqrt(_dot(shading, shading)), np.float32(1e-6))
            one_sided = gather(scene.tri_lit_below, gather(own.tri, smooth)) == 0  # they show the side of their shading normals
            facing /= np.maximum(np.abs(face), np.float32(_LEAST_COSINE)) * np.where(
                one_sided, np.float32(-1), np.copysign(np.float32(1), face)
            )
            # The adjoint of shading normals scales the flux: Veach 1997, section 5.3.
            factor = np.ones(len(own.tri), np.float32)
            factor[smooth] = np.maximum(facing, 0)
            if scene.maps is not None:  # a map's normal replaces the corners'
                factor[scene.maps.has(own.tri)] = 1
            flux = flux * factor
    if received is not None:
        flux = flux * gather(received, kept)
    both = gather(scene.surfaces.tri_both, own.tri).nonzero()[0] if scene.surfaces.has_through else np.zeros(0, np.intp)
    if len(both):
        flux, is_back = flux.copy(), gather(cosine, gather(kept, both)) > 0
        front, back = scene.surfaces.share_sides(own.tri[both], own.u[both], own.v[both])
        flux[:, both] *= np.where(is_back, back, front)
    log.deposit(own.tri, own.u, own.v, flux, gather(is_first, kept))


def _play_roulette(
    flux: _Rows, albedo: _Rows, split: int | None, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp] | None, _Rows]:
    """Russian roulette: the surviving photons and their flux. They survive with q = max(flux * albedo) / max(flux), which keeps the
    greatest channel of the flux as it is.

    split   number of copies of each photon, with equal shares of its flux; split * q of them survive, rounded up or down by chance.
            None for no splitting
    alive   (k,) int, ascending: photons that survive
    count   (k,) int: surviving copies of each; None without `split`
    flux    (3, k) float32, W, of each copy
    """
    reflected = flux * albedo
    survivors = np.maximum(np.maximum(reflected[0], reflected[1]), reflected[2])
    survivors /= np.maximum(np.maximum(np.maximum(flux[0], flux[1]), flux[2]), _TINY)
    if split is not None:
        survivors *= np.float32(split)
    expected = survivors.copy()
    survivors += rng.random(len(survivors), dtype=np.float32)  # stochastic rounding: the floor has the expected mean
    alive = (survivors >= 1).nonzero()[0]
    count = None if split is None else gather(survivors, alive).astype(np.intp)
    chance = expected if split is not None else np.minimum(expected, 1)  # beyond 1 a photon gains flux
    return alive, count, gather(reflected, alive) / gather(chance, alive)


def _choose_side(origin: _Rows, normal: _Rows, flux: _Rows, share: _Rows, rng: np.random.Generator) -> BoolArray:
    """(n,): photons that leave on the other side of their surface, by chance; changes origin, normal and flux in place.

    share   (3, n) float32: share of the leaving light that leaves there
    """
    there, here = flux * share, flux * np.maximum(1 - share, 0)
    most_there, most_here = there.max(axis=0), here.max(axis=0)
    chance = most_there / np.maximum(most_there + most_here, _TINY)
    crossed: BoolArray = chance > rng.random(len(chance), dtype=np.float32)
    flux[:] = np.where(crossed, there, here) / np.where(crossed, chance, 1 - chance)
    place = crossed.nonzero()[0]
    normal[:, place] *= -1
    origin[:, place] = offset_origin(gather(origin, place), 2 * gather(normal, place))
    return crossed


def _scatter(normal: _Rows, numbers: _Rows) -> _Rows:
    """Cosine-distributed unit directions around the normals: the normal plus a point of the unit sphere.

    normal    (3, n) float32; overwritten with the directions
    numbers   (2, n) float32, uniform in [0, 1); overwritten
    """
    height, turn = numbers
    radius = np.sqrt(height * (1 - height))
    radius *= np.float32(2)
    turn *= np.float32(2 * np.pi)
    # A hair longer than 1, so that rounding never points a grazing ray below its surface.
    normal *= np.float32(1 + 1e-5)
    normal[0] += radius * np.cos(turn)
    normal[1] += radius * np.sin(turn)
    normal[2] += 1 - 2 * height
    normal /= np.sqrt(_dot(normal, normal))
    return normal
