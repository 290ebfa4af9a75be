"""Bakes of scenes whose light is known in closed form: found beside truth, on a mesh of equal leaves or as the adaptive bake states it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from boxes import solve_scene
from leaflight.core.bake.solve import LightField
from leaflight.core.integrate import texel_light
from leaflight.core.scene.scene import Light, Material, SceneSnapshot
from leaflight.core.texels.error_metric import BEST_TEXELS, DARK_FLOOR
from leaflight.core.texels.texel_footprint import centred_strata
from leaflight.core.texels.texel_map import FOOTPRINT_SIDE, TexelMap
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import Settings
from scenes import Mesh, make_scene, quad_mesh
from stats import Estimates

BLACK = Material("Black", (0.0, 0.0, 0.0))
PAGE_UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)  # a quad that fills its page: whole texels only
SUB_POINTS = centred_strata(16)
SIZE_TEXELS, LEAF_TEXELS = 32, 4
# Direct light by rays is the mean of a closed form over four points of a texel: so much it may be off beyond its stated error, of
# itself, and so much where edges of triangles cut the texel, which warps the four points. Measured: 0.06 % and 0.5 % (root mean square).
WHOLE_DOUBT, CUT_DOUBT = 1e-3, 5e-3
STATEMENTS = 12  # bakes whose stated errors are judged, one by one and together: of fewer, chance decides
FEW_PHOTONS, PHOTONS = 2_000, 600_000  # rays need no photons where nothing reflects

Irradiance = Callable[[np.ndarray, np.ndarray], np.ndarray]


def floor_mesh(width_m: float = 1.0, depth_m: float = 1.0) -> Mesh:
    """A level quad that faces up and fills a page."""
    return quad_mesh("Floor", width_m, depth_m, PAGE_UV)


def black_scene(receivers: Sequence[Mesh], lights: Sequence[Light] = (), others: Sequence[Mesh] = (), glow: float = 0.0) -> SceneSnapshot:
    """Meshes that reflect nothing; the `others` get no lightmap and have radiance `glow` on both sides."""
    meshes = [*receivers, *(replace(mesh, receives=False) for mesh in others)]
    scene = make_scene(meshes, lights, [BLACK, Material("Glow", (0.0, 0.0, 0.0), emission_rgb=(glow,) * 3)])
    return replace(scene, tri_material=(scene.tri_object >= len(receivers)).astype(np.int32))


@dataclass(frozen=True)
class KnownLight:
    """A bake and its truth.

    truth   (n,) float64, W/m^2: mean over each texel
    """

    light: LightField
    texels: TexelMap
    truth: np.ndarray

    def on_leaves(self) -> Estimates:
        """Irradiance of the leaves, first channel."""
        tree, direct = self.light.tree, self.light.direct
        leaves = self.light.leaves[np.argsort(tree.start[self.light.leaves])]
        area, start = self.texels.texel_area, tree.start[leaves]
        assert np.array_equal(start[1:], tree.end[leaves][:-1])

        doubt = np.full(len(area), WHOLE_DOUBT)
        doubt[self.texels.part_entry] = CUT_DOUBT

        def mean(values: np.ndarray) -> np.ndarray:
            return np.add.reduceat(values * area, start) / np.add.reduceat(area, start)

        of_photons = self.light.solution.variance[0, leaves]
        of_rays = np.add.reduceat(direct.variance[:, 0] * area**2, start) / np.add.reduceat(area, start) ** 2
        return Estimates(
            value=self.light.solution.flux[0, leaves] / tree.area[leaves] + mean(direct.irradiance[:, 0]),
            truth=mean(self.truth),
            noise=np.sqrt(of_photons + of_rays),
            doubt=mean(doubt * direct.irradiance[:, 0]),
            weight=tree.area[leaves],
        )

    def at_texels(self) -> np.ndarray:
        """(n,) float64, W/m^2: what pages show, first channel."""
        light = texel_light.light_at_texels(self.light, self.texels)
        return np.asarray(light.direct + light.indirect, float)[:, 0]

    def real_error(self) -> float:
        """Measured as the stated error is: over the best texels, relative to local brightness."""
        square = ((self.at_texels() - self.truth) ** 2) / (self.truth**2 + (DARK_FLOOR * self.truth.mean()) ** 2)
        return float(np.sqrt(np.sort(square)[: int(BEST_TEXELS * len(square))].mean()))


def mean_over_texels(
    scene: SceneSnapshot, texels: TexelMap, irradiance: Irradiance, look: float, points: np.ndarray = SUB_POINTS
) -> np.ndarray:
    """(n,) float64: mean of irradiance(position (m, 3), shading normal (m, 3)) over what each texel looks at.

    look     side of the square, texels: rays look at the middle, photons fall everywhere
    points   (k, 1, 2) float64, of the square
    """
    entry = np.arange(len(texels.texel_area))
    tri, uv = texels.sub_points(entry, points, look)
    flat = tri.ravel(), uv[..., 0].ravel().astype(float), uv[..., 1].ravel().astype(float)
    position = interpolate_corners(scene.tri_position[flat[0]], *flat[1:])
    normal = interpolate_corners(scene.tri_normal[flat[0]].astype(float), *flat[1:])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return irradiance(position, normal).reshape(tri.shape).mean(0)


def bake_known(folder: Path, scene: SceneSnapshot, irradiance: Irradiance, direct: str, **knobs: object) -> KnownLight:
    """The scene's light on a mesh of equal leaves, and what it should be."""
    photons = PHOTONS if direct == "photons" else FEW_PHOTONS
    usual = {"size": SIZE_TEXELS, "hierarchical": False, "finest_texels": LEAF_TEXELS, "max_photons": photons, "error": 1e-3, "seed": 5}
    light = solve_scene(folder, scene, Settings(direct=direct, **{**usual, **knobs}))
    texels = traced_scene.open_tracing(str(folder)).texels
    return KnownLight(light, texels, mean_over_texels(scene, texels, irradiance, FOOTPRINT_SIDE if direct == "rays" else 1.0))


def bake_adaptive(folder: Path, scene: SceneSnapshot, irradiance: Irradiance, direct: str, size: int = 64, seed: int = 5) -> KnownLight:
    """As a user gets it: leaves where light wants them, until the stated error is small enough."""
    photons = 2_000_000 if direct == "photons" else FEW_PHOTONS
    knobs = {"hierarchical": True, "finest_texels": 1, "max_photons": photons, "error": 0.03, "size": size, "seed": seed}
    return bake_known(folder, scene, irradiance, direct, **knobs)


def state_errors(folder: Path, scene: SceneSnapshot, irradiance: Irradiance, direct: str) -> np.ndarray:
    """(STATEMENTS, 2) float64: the error that each of some adaptive bakes states, and how far it is off."""
    bakes = [bake_adaptive(folder / str(seed), scene, irradiance, direct, seed=seed) for seed in range(STATEMENTS)]
    return np.array([(bake.light.error, bake.real_error()) for bake in bakes])


def interpolate_corners(values: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n, k): values at corners (n, 3, k), weighed by u (n,) for corner 1 and v (n,) for corner 2."""
    return values[:, 0] * (1 - u - v)[:, None] + values[:, 1] * u[:, None] + values[:, 2] * v[:, None]
