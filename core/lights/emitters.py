"""Photon emission of meshes and of the world; all emitters of a scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from ..scene.materials import SurfaceMaterials
from ..scene.scene import RAY_KINDS, Light, SceneSnapshot
from ..scene.scene_cover import SceneCover
from ..scene.sealed_solids import find_sealed
from ..util.arrays import BoolArray, Float32, Float64
from ..util.geometry import UnitBox, locate_hits, offset_origin, rotate_to, stack_columns, triangle_frames, triangle_normals_areas
from ..util.sampling import AliasTable, square_to_cosine_hemisphere
from .emitting_cells import EmittingCells, find_emitting_cells
from .environment import Environment, EnvironmentEmitter
from .light_links import LightLinks
from .lights import EmittedPhotons, Emitter, PointEmitter, make_light_emitter, make_photons

_MOST_LOOKED_AROUND = 64  # lamps
NO_LIGHT = "the scene has no light: add a light, an emitting material or a world colour"


@dataclass(frozen=True)
class EmittingMeshes:
    """All emitting triangles of a scene, found once for photons and for shadow rays.

    by_material   (material, its cells) for every material that emits from a triangle with area
    tri_sealed    (n_tri,) bool: triangles of closed solids whose inside is never seen, see sealed_solids
    """

    by_material: tuple[tuple[int, EmittingCells], ...]
    tri_sealed: BoolArray

    @classmethod
    def of(cls, snapshot: SceneSnapshot, surfaces: SurfaceMaterials) -> EmittingMeshes:
        by_material = tuple(find_emitting_cells(snapshot, surfaces, LightLinks.of(snapshot)))
        shines = np.zeros(snapshot.n_tri, bool)
        for _, cells in by_material:
            shines[cells.tri] = True
        passes = np.logical_or.reduce([surfaces.find_passing(kind)[0] for kind in RAY_KINDS])
        passes |= surfaces.find_glass() | surfaces.find_through()
        return cls(by_material, find_sealed(snapshot, shines, passes))


@dataclass(frozen=True)
class MeshEmitter(Emitter):
    """Emitting triangles of one material, on both sides.

    sides        (n_cell,) int8                    1 if light from its back is never seen, see sealed_solids; else 2
    tri_frame    (3, 3, n_tri) float32, unit box   of the whole scene, see triangle_frames
    tri_normal   (3, n_tri) float32, unit
    """

    name: str
    power_rgb: Float64
    cells: EmittingCells
    sides: NDArray[np.int8]
    table: AliasTable
    tri_frame: Float32
    tri_normal: Float32
    surfaces: SurfaceMaterials
    casts_shadow: bool = True
    link: int = -1

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
            radiance = self.surfaces.emission_at(tri, barycentric[:, 0], barycentric[:, 1])
        per_radiance = math.pi * sides * self.cells.area_m2[cell] / self.table.probability[cell]
        share = np.divide(1, self.power_rgb, out=np.zeros(3), where=self.power_rgb > 0)
        return make_photons(origin, direction, radiance * per_radiance[:, None] * share)


@dataclass(frozen=True)
class WorldEmitter(Emitter):
    """Uniform radiance from everywhere: every face of the scene's box is a Lambertian source that emits inwards."""

    name: str
    power_rgb: Float64
    cover: SceneCover
    casts_shadow: bool = True

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
    sides_of = np.where(meshes.tri_sealed, 1, 2).astype(np.int8)
    emitters = []
    for index, parts in meshes.by_material:
        cells = parts.join_parts()
        sides = sides_of[cells.tri]
        power = math.pi * ((sides * cells.area_m2)[:, None] * cells.mean_rgb).sum(axis=0)
        table = AliasTable(cells.importance * sides)
        emitters.append(MeshEmitter(snapshot.materials[index].name, power, cells, sides, table, frame, normal, surfaces, link=cells.link))
    return emitters
