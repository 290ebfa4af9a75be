"""What tests of light share: a floor of texels, patches that count photons, and bounds for statistics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from leaflight.core.integrate.direct import DirectLight, DirectScene, direct_irradiance
from leaflight.core.lights.emitters import EmittingMeshes, build_emitters
from leaflight.core.lights.lights import Emitter
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.rays import RayScene
from leaflight.core.scene.scene import Light, Material, SceneSnapshot
from leaflight.core.scene.shadow_rays import ShadowRays
from leaflight.core.texels.texel_footprint import TexelFootprints
from leaflight.core.texels.tiles import Tiles
from leaflight.core.transport import photons
from leaflight.core.transport.photon_log import ShardHits
from leaflight.core.util.geometry import UnitBox, orthonormal_basis, triangle_normals_areas
from scenes import Mesh, make_scene, quad_mesh

ALPHA = 1e-3  # of a file's statistical tests together


def sigma_limit(n_test: int) -> float:
    """Standard deviations that none of n_test tests exceeds but with chance ALPHA. Source: Sidak 1967."""
    return NormalDist().inv_cdf(1 - (1 - (1 - ALPHA) ** (1 / n_test)) / 2)


def chi_square_sigmas(observed: np.ndarray, expected: np.ndarray) -> float:
    """How many standard deviations a chi-square lies above its mean. Source: Wilson & Hilferty 1931."""
    freedom = len(observed) - 1
    value = ((observed - expected) ** 2 / expected).sum() / freedom
    return float((np.cbrt(value) - (1 - 2 / (9 * freedom))) / np.sqrt(2 / (9 * freedom)))


@dataclass(frozen=True)
class Patch:
    """A square that counts photons; lengths of the unit box, side along the normal's tangents."""

    centre: Sequence[float]
    normal: Sequence[float]
    side: float

    def frame(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        normal = np.asarray(self.normal, float) / np.linalg.norm(self.normal)
        tangent, bitangent = orthonormal_basis(normal[None])
        return tangent[0], bitangent[0], normal

    def mean(self, function: Callable[[np.ndarray, np.ndarray], np.ndarray], steps: int = 24) -> float:
        """Mean of function(position (n, 3), normal (n, 3)) over the patch."""
        tangent, bitangent, normal = self.frame()
        line = ((np.arange(steps) + 0.5) / steps - 0.5) * self.side
        x, y = (grid.reshape(-1, 1) for grid in np.meshgrid(line, line))
        position = (np.asarray(self.centre) + x * tangent + y * bitangent).astype(np.float32)
        return float(function(position, np.broadcast_to(normal, position.shape).astype(np.float32)).mean())

    def count(self, emitter: Emitter, n_photon: int, seed: int, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """Irradiance (3,), W/m^2, of photons that nothing else stops, and its standard error; the soft falloff is the tracer's."""
        births = emitter.emit(np.random.default_rng(seed).random((n_photon, 4), np.float32))
        tangent, bitangent, normal = self.frame()
        cosine = births.direction @ normal
        distance = (np.asarray(self.centre) - births.origin) @ normal / np.where(cosine == 0, 1, cosine)
        offset = births.origin + distance[:, None] * births.direction - np.asarray(self.centre)
        inside = np.maximum(np.abs(offset @ tangent), np.abs(offset @ bitangent)) < self.side / 2
        hit = (cosine < 0) & (distance > 0) & inside
        radius, offset = births.soft_radius, births.soft_offset
        seen = offset * np.sqrt(distance**2 + offset**2) <= radius * distance  # of the disk that turns to the patch
        soft = np.where(radius < 0, distance <= -radius, seen | (radius == 0))
        weight = np.broadcast_to(births.relative_rgb * (hit * soft)[:, None], (n_photon, 3))
        per_unit = np.asarray(emitter.power_rgb) * scale**2 / self.side**2
        return weight.mean(axis=0) * per_unit, weight.std(axis=0) / np.sqrt(n_photon) * per_unit


def morton_square(side: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the texels of a square whose side is a power of two, in Morton order."""
    code = np.arange(side * side)
    x, y = np.zeros_like(code), np.zeros_like(code)
    for bit in range(side.bit_length()):
        x |= ((code >> (2 * bit)) & 1) << bit
        y |= ((code >> (2 * bit + 1)) & 1) << bit
    return x, y


def floor_footprints(side: int, first_tri: int = 0) -> Callable[[np.ndarray], TexelFootprints]:
    """As TexelMap.footprints_at, of whole texels, for a quad_mesh of side * side texels in Morton order, from triangle first_tri on."""
    column, row = morton_square(side)

    def footprints_at(texel: np.ndarray) -> TexelFootprints:
        x, y, step = column[texel] / side, row[texel] / side, np.full(len(texel), 1 / side)
        lower = column[texel] >= row[texel]  # quad_mesh is fanned from (0, 0) over (1, 0), (1, 1), (0, 1)
        weight = np.zeros((3, 2, len(texel)))
        weight[0] = np.where(lower, x - y, x), np.where(lower, y, y - x)
        weight[1] = step, np.where(lower, 0, -step)
        weight[2] = np.where(lower, -step, 0), step
        return TexelFootprints.of_squares(np.where(lower, first_tri, first_tri + 1), weight)

    return footprints_at


def floor_tiles(side: int) -> Tiles:
    """Tiles of such a floor."""
    return Tiles.of(np.zeros(side * side, np.int32), np.arange(side * side))


def to_grid(values: np.ndarray, side: int) -> np.ndarray:
    """(side, side, ...) image, row 0 at y = 0, of values in Morton order."""
    column, row = morton_square(side)
    out = np.empty((side, side, *values.shape[1:]))
    out[row, column] = values
    return out


def lit_scene(
    meshes: Sequence[Mesh] = (),
    lights: Sequence[Light] = (),
    emission: Sequence[Mesh] = (),
    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> SceneSnapshot:
    """A quad_mesh floor, triangles 0 and 1, with other grey meshes, lights, and meshes that emit."""
    scene = make_scene([quad_mesh("Floor"), *meshes, *emission], lights)
    emits = scene.tri_object > len(meshes)
    materials = (Material("Grey"), Material("Lamp", emission_rgb=rgb))
    return replace(scene, materials=materials, tri_material=emits.astype(np.int32))


def prepare(scene: SceneSnapshot) -> tuple[DirectScene, UnitBox, SurfaceMaterials]:
    unit_box, surfaces = UnitBox.from_points(scene.vertex_position), SurfaceMaterials(scene)
    rays = RayScene(unit_box.to_unit(scene.tri_position))
    normal = triangle_normals_areas(scene.tri_position)[0].T.astype(np.float32)
    shadows = ShadowRays.of(rays, surfaces, unit_box.to_unit(scene.tri_position), normal)
    return DirectScene.of(shadows, scene, unit_box, surfaces, EmittingMeshes.of(scene, surfaces)), unit_box, surfaces


def trace_first(scene: SceneSnapshot, n_photon: int) -> tuple[ShardHits, np.ndarray]:
    """Photons up to the first surface that they meet, and the places there, m (n, 3)."""
    _, box, surfaces = prepare(scene)
    emitters, _ = build_emitters(scene, box, surfaces, EmittingMeshes.of(scene, surfaces))
    trace = photons.build_trace_scene(scene, box, surfaces, emitters)
    (hits,) = photons.trace_shard(trace, n_photon, 1.0, np.random.default_rng(5), max_depth=1, skip_first=False)
    corner, u, v = scene.tri_position[hits.tri], hits.u[:, None], hits.v[:, None]
    return hits, corner[:, 0] * (1 - u - v) + corner[:, 1] * u + corner[:, 2] * v


def light_floor(scene: SceneSnapshot, side: int, seed: int = 1, **options: Any) -> DirectLight:
    """Direct light of the floor's side * side texels, in Morton order."""
    return direct_irradiance(prepare(scene)[0], floor_footprints(side), np.arange(side * side), np.random.default_rng(seed), **options)


def assert_photons_agree(scene: SceneSnapshot, light: DirectLight, side: int, n_test: int, parts: int = 8, n_photon: int = 300_000) -> None:
    """Photons bring what light_floor found, over parts * parts squares of the floor, within their Poisson noise and 2 % of the brightest.

    n_test   how many such tests share ALPHA
    """
    hits, place = trace_first(scene, n_photon)
    on_floor = hits.tri < 2
    part = np.minimum((place[on_floor, :2] * parts).astype(int), parts - 1) @ [1, parts]
    flux = hits.flux_rgb[:, on_floor].astype(float)
    sums = np.array([[np.bincount(part, channel**power, parts**2) for channel in flux] for power in (1, 2)]).transpose(0, 2, 1)
    counted, noise = parts**2 * sums[0], parts**2 * np.sqrt(sums[1])
    found = to_grid(light.irradiance_rgb, side).reshape(parts, side // parts, parts, -1, 3).mean(axis=(1, 3)).reshape(-1, 3)
    assert (np.abs(counted - found) < sigma_limit(parts**2 * n_test) * noise + 0.02 * found.max()).all()
    assert counted.mean(axis=0) == pytest.approx(found.mean(axis=0), rel=0.01)
