"""All emitters of a scene: photon emission of meshes and of the world; lights of a kind are joined, since numpy is slow on short arrays.

The last axis of a joinable light's arrays is that of lights: 1 for a single one, k for joined ones, n for the values of n photons. With the
same random numbers, each photon is bitwise equal to that of its light alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.materials import SurfaceMaterials
from ..scene.scene import RAY_KINDS, Light, SceneSnapshot
from ..scene.scene_cover import SceneCover
from ..scene.sealed_solids import find_sealed
from ..util.arrays import BoolArray, Float32, Float64, Int64, IntArray
from ..util.geometry import (
    UnitBox,
    gather,
    locate_hits,
    offset_origin,
    rotate_to,
    stack_columns,
    take_rows,
    triangle_frames,
    triangle_normals_areas,
)
from ..util.sampling import AliasTable, square_to_cosine_hemisphere
from .emitting_cells import EmittingCells, find_emitting_cells
from .environment import Environment, EnvironmentEmitter
from .light_links import LightLinks
from .lights import AreaEmitter, EmittedPhotons, Emitter, PointEmitter, make_light_emitter, make_photons

_MOST_LOOKED_AROUND = 64  # lamps
NO_LIGHT = "the scene has no light: add a light, an emitting material or a world colour"


@dataclass(frozen=True)
class EmittingMeshes:
    """All emitting triangles of a scene, found once for photons and for shadow rays.

    by_material   (material, its cells) for every material that emits from a triangle with area
    tri_sealed    (n_tri,) bool: triangles that send no light from their backs, or whose backs are never seen, see sealed_solids
    tri_turned    (n_tri,) bool: triangles that send light from their backs alone, which count as sealed with the opposite normal
    """

    by_material: tuple[tuple[int, EmittingCells], ...]
    tri_sealed: BoolArray
    tri_turned: BoolArray

    @classmethod
    def of(cls, snapshot: SceneSnapshot, surfaces: SurfaceMaterials) -> EmittingMeshes:
        by_material = tuple(find_emitting_cells(snapshot, surfaces, LightLinks.of(snapshot)))
        shines = np.zeros(snapshot.n_tri, bool)
        for _, cells in by_material:
            shines[cells.tri] = True
        passes = np.logical_or.reduce([surfaces.find_passing(kind)[0] for kind in RAY_KINDS])
        passes |= surfaces.tri_glass | surfaces.tri_through
        dark = np.array([(one.dark_back, one.dark_front) for one in snapshot.materials], bool).reshape(-1, 2)[snapshot.tri_material]
        return cls(by_material, find_sealed(snapshot, shines, passes) | dark.any(axis=1), dark[:, 1])


@dataclass(frozen=True)
class MeshEmitter(Emitter):
    """Emitting triangles of one material, on both sides.

    sides        (n_cell,) int8                    1 if there is no light from its back, or it is never seen; else 2
    tri_frame    (3, 3, n_tri) float32, unit box   of the whole scene, see triangle_frames
    tri_normal   (3, n_tri) float32, unit           of the side that sends light, if only one does
    """

    cells: EmittingCells
    sides: NDArray[np.int8]
    table: AliasTable
    tri_frame: Float32
    tri_normal: Float32
    surfaces: SurfaceMaterials

    @cached_property
    def _is_uniform(self) -> bool:
        """Whether all cells have the same radiance."""
        rgb = self.cells.mean_rgb
        return self.cells.constant and bool((rgb == rgb[:1]).all())

    def emit(self, u: Float32) -> EmittedPhotons:
        cell, rest = self.table.sample(u[:, 0])
        tri, barycentric = self.cells.place(cell, stack_columns(rest, u[:, 1]))
        sides = self.sides.take(cell)
        back = (u[:, 2] >= 0.5) & (sides == 2)
        local = square_to_cosine_hemisphere(stack_columns(sides * u[:, 2] - back, u[:, 3]))
        normal = self.tri_normal.take(tri, axis=1)
        normal *= 1 - 2 * back.astype(np.float32)
        origin = offset_origin(locate_hits(self.tri_frame, tri, *barycentric.T), normal).T
        direction = rotate_to(local, normal.T)
        if self._is_uniform:
            return make_photons(origin, direction)
        if self.cells.constant:
            radiance = self.cells.mean_rgb[cell].astype(np.float32)
        else:
            radiance = self.surfaces.emission.at(tri, barycentric[:, 0], barycentric[:, 1])
        per_radiance = math.pi * sides * self.cells.area_m2[cell] / self.table.probability[cell]
        share = np.divide(1, self.power_rgb, out=np.zeros(3), where=self.power_rgb > 0)
        return make_photons(origin, direction, radiance * per_radiance[:, None] * share)


@dataclass(frozen=True)
class WorldEmitter(Emitter):
    """Uniform radiance from everywhere: every face of the scene's box is a Lambertian source that emits inwards."""

    cover: SceneCover

    def emit(self, u: Float32) -> EmittedPhotons:
        across, rest = self.cover.choose_faces(u[:, 0], self.cover.face_area[None])
        at_low = (u[:, 2] >= 0.5).astype(np.float32)
        local = square_to_cosine_hemisphere(stack_columns(2 * u[:, 2] - at_low, u[:, 3]))
        inward = (2 * at_low * across - across).T
        return make_photons(self.cover.place(across, 1 - at_low, rest, u[:, 1]), rotate_to(local, inward))


def build_emitters(
    snapshot: SceneSnapshot, unit_box: UnitBox, surfaces: SurfaceMaterials, meshes: EmittingMeshes
) -> tuple[tuple[Emitter, ...], list[tuple[str, str]]]:
    """All emitters of a snapshot, and (name, sentence) for every light that had to be changed or left out.

    Raises ValueError if nothing emits.
    """
    emitters: list[Emitter] = []
    warnings: list[tuple[str, str]] = []
    cover = SceneCover.around(unit_box.to_unit(snapshot.vertex_position[np.unique(snapshot.tri_vertex)]))
    links = LightLinks.of(snapshot)
    for light, link in zip(snapshot.lights, links.of_light.tolist(), strict=True):
        power, sentence = usable_power(light)
        if sentence:
            warnings.append((light.name, sentence))
        if power.any():
            emitters.append(make_light_emitter(light, power, unit_box, cover, snapshot.profiles, link))
    emitters = _mark_crowded(emitters, unit_box.to_unit(snapshot.tri_position))
    emitters += _mesh_emitters(snapshot, unit_box, surfaces, meshes)
    world = usable_world(snapshot)
    if not np.array_equal(world, snapshot.world_rgb) and snapshot.world_map is None:
        warnings.append(("World", "World: its colour is negative or not a finite number and counts as 0 there; correct it."))
    environment = usable_environment(snapshot)
    if environment:
        emitters.append(EnvironmentEmitter.of("World", environment, cover, 1 / unit_box.scale**2))
    elif world.any():
        power = math.pi * world * 2 * cover.face_area.sum() / unit_box.scale**2
        emitters.append(WorldEmitter("World", power, cover))
    emitters = [emitter for emitter in emitters if emitter.power_rgb.any() and np.isfinite(emitter.power_rgb).all()]
    if not emitters:
        raise ValueError(NO_LIGHT)
    return tuple(emitters), warnings


def usable_power(light: Light) -> tuple[Float64, str]:
    """The light's power with only finite numbers >= 0, all 0 if the light is left out; and a sentence if that changed it."""
    power = np.array(light.power_rgb, np.float64)
    placement = (*light.position_m, *chain(*light.rotation), *light.size_m)
    numbers = (light.radius_m, light.cone_angle_rad, light.blend, light.angle_rad, light.spread_rad)
    if not all(map(math.isfinite, light.power_rgb)):
        return np.zeros(3), f"{light.name}: its power is not a finite number, so the light is left out; correct its strength or colour."
    if not all(map(math.isfinite, (*placement, *numbers))):
        return np.zeros(3), f"{light.name}: its position or size is not a finite number, so the light is left out; correct its transform."
    if min(light.power_rgb) < 0:
        what = "the light is left out" if (power <= 0).all() else "its negative channels count as 0"
        return np.maximum(power, 0), f"{light.name}: its power is negative, so {what}; make its strength and colour positive."
    return power, ""


def usable_world(snapshot: SceneSnapshot) -> Float64:
    """(3,) float64, W/m^2/sr: the radiance of a uniform world, 0 where it is negative or not finite."""
    if snapshot.world_map is not None:
        return np.zeros(3)
    world = np.array(snapshot.world_rgb, np.float64)
    return np.where(np.isfinite(world) & (world > 0), world, 0.0)


def usable_environment(snapshot: SceneSnapshot) -> Environment | None:
    """The world if its radiance varies with direction, 0 where that is negative or not finite; None if there is none, or it is black."""
    if snapshot.world_map is None:
        return None
    radiance = snapshot.world_map
    usable = np.isfinite(radiance) & (radiance >= 0)
    environment = Environment(radiance if usable.all() else np.where(usable, radiance, np.float32(0)))
    return environment if environment.shines else None


def _mark_crowded(emitters: Sequence[Emitter], corner_unit: Float32) -> list[Emitter]:
    """The emitters, where point lights are marked as crowded if a surface is within their radius, by the bounding boxes of triangles
    corner_unit (n_tri, 3, 3), unit box.

    If there are very many lamps, all of them are marked, which costs a short ray for each of their photons.
    """
    out = list(emitters)
    wide = [i for i, one in enumerate(out) if isinstance(one, PointEmitter) and one.radius.any() and (one.casts_shadow or not one.soft)]
    low, high = corner_unit.min(axis=1), corner_unit.max(axis=1)
    for i in wide:
        lamp = out[i]
        assert isinstance(lamp, PointEmitter)
        centre = lamp.centre[:, 0]
        apart = np.maximum(np.maximum(low - centre, centre - high), 0) if len(wide) <= _MOST_LOOKED_AROUND else np.zeros((1, 3))
        out[i] = replace(lamp, crowded=bool(((apart * apart).sum(axis=1) < lamp.radius**2).any()))
    return out


def _mesh_emitters(snapshot: SceneSnapshot, unit_box: UnitBox, surfaces: SurfaceMaterials, meshes: EmittingMeshes) -> list[MeshEmitter]:
    if not meshes.by_material:
        return []
    corner_unit = unit_box.to_unit(snapshot.tri_position)
    frame = triangle_frames(corner_unit)
    normal = np.ascontiguousarray(triangle_normals_areas(corner_unit)[0].T, np.float32)
    normal[:, meshes.tri_turned] *= -1
    sides_of = np.where(meshes.tri_sealed, 1, 2).astype(np.int8)
    emitters = []
    for index, parts in meshes.by_material:
        cells = parts.join_parts()
        sides = sides_of[cells.tri]
        power = math.pi * ((sides * cells.area_m2)[:, None] * cells.mean_rgb).sum(axis=0)
        table = AliasTable(cells.importance * sides)
        emitters.append(MeshEmitter(snapshot.materials[index].name, power, cells, sides, table, frame, normal, surfaces, link=cells.link))
    return emitters


_OWN = ("name", "power_rgb", "casts_shadow", "link")  # fields that do not affect positions and directions of emitted photons


@dataclass(frozen=True)
class _Kind:
    """Joined lights, which differ only in arrays; or a single emitter."""

    first: Any  # Emitter
    arrays: dict[str, NDArray[Any]]  # (..., k), by field; empty for a single emitter

    @classmethod
    def of(cls, emitters: Sequence[Emitter]) -> _Kind:
        if len(emitters) == 1:
            return cls(emitters[0], {})
        of_each = [_arrays(emitter) for emitter in emitters]
        return cls(emitters[0], {name: np.concatenate([arrays[name] for arrays in of_each], axis=-1) for name in of_each[0]})

    def emit(self, light: IntArray, u: Float32) -> EmittedPhotons:
        """Photons of lights (n,) of this kind, ascending, for numbers (n, 4)."""
        own = light[:1] if light[0] == light[-1] else light
        joined: Emitter = replace(self.first, **{name: gather(values, own) for name, values in self.arrays.items()})
        return joined.emit(u)


@dataclass(frozen=True)
class JoinedEmitters:
    """All emitters of a scene.

    power_rgb      (n_emitter, 3) float64, W
    casts_shadow   (n_emitter,) bool
    is_even_sky    (n_emitter,) bool    whether it is an even sky, whose light passes surfaces as diffuse rays do
    crowded        (n_emitter,) bool    see PointEmitter
    kind           (n_emitter,) int64   index into kinds
    light          (n_emitter,) int64   index within the kind
    link           (n_emitter,) int16   row of LightLinks, -1 for none
    """

    power_rgb: Float64
    casts_shadow: BoolArray
    is_even_sky: BoolArray
    crowded: BoolArray
    kinds: tuple[_Kind, ...]
    kind: Int64
    light: Int64
    link: NDArray[np.int16]

    @classmethod
    def of(cls, emitters: Sequence[Emitter]) -> JoinedEmitters:
        groups: dict[tuple[object, ...], list[int]] = {}
        for number, emitter in enumerate(emitters):
            groups.setdefault(_name_kind(emitter) or (number,), []).append(number)
        kind, light = np.empty((2, len(emitters)), np.int64)
        for k, numbers in enumerate(groups.values()):
            kind[numbers], light[numbers] = k, np.arange(len(numbers))
        power = np.array([emitter.power_rgb for emitter in emitters], np.float64).reshape(-1, 3)
        casts_shadow = np.array([emitter.casts_shadow for emitter in emitters], bool)
        sky = np.array([isinstance(emitter, WorldEmitter) for emitter in emitters], bool)
        crowded = np.array([isinstance(emitter, PointEmitter) and emitter.crowded for emitter in emitters], bool)
        kinds = tuple(_Kind.of([emitters[i] for i in numbers]) for numbers in groups.values())
        link = np.array([getattr(emitter, "link", -1) for emitter in emitters], np.int16)
        return cls(power, casts_shadow, sky, crowded, kinds, kind, light, link)

    def __len__(self) -> int:
        return len(self.kind)

    def emit(self, emitter: IntArray, u: Float32) -> EmittedPhotons:
        """Photons of emitters (n,), n > 0, ascending, for numbers u (n, 4) float32, see Emitter.emit."""
        kind, light = self.kind.take(emitter), self.light.take(emitter)
        found: list[int] = np.flatnonzero(np.bincount(kind)).tolist()
        if len(found) == 1:
            return self.kinds[found[0]].emit(light, u)
        origin, direction, relative = np.empty((3, 3, len(emitter)), np.float32)
        soft_radius, soft_offset = np.empty((2, len(emitter)), np.float32)
        cuts = np.flatnonzero(kind[1:] != kind[:-1]) + 1
        own: slice | IntArray
        for k in found:
            own = np.flatnonzero(kind == k)
            if len(cuts) < len(found):  # those of a kind follow each other: a range is sooner read and written than rows
                own = slice(int(own[0]), int(own[-1]) + 1)
            photons = self.kinds[k].emit(light[own], u[own] if isinstance(own, slice) else take_rows(u, own))
            origin[:, own], direction[:, own], relative[:, own] = photons.origin.T, photons.direction.T, photons.relative_rgb.T
            soft_radius[own], soft_offset[own] = photons.soft_radius, photons.soft_offset
        return EmittedPhotons(origin.T, direction.T, relative.T, soft_radius, soft_offset)


def _name_kind(emitter: Emitter) -> tuple[object, ...]:
    """Key that is equal for lights that can be joined; () for other emitters."""
    if type(emitter) not in (PointEmitter, AreaEmitter):
        return ()
    return type(emitter), *(value for name, value in vars(emitter).items() if name not in _OWN and not isinstance(value, np.ndarray))


def _arrays(emitter: Emitter) -> dict[str, NDArray[Any]]:
    """The fields of an emitter that have an axis of lights."""
    return {name: value for name, value in vars(emitter).items() if name not in _OWN and isinstance(value, np.ndarray)}
