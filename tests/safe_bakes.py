"""Bakes that are checked all over: every page, the energy audit, and the mean light with its stated error."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from boxes import make_solver, solve_scene
from floors import sigma_limit
from leaflight.core.atlas import charts
from leaflight.core.bake.solve import LightField, Solver
from leaflight.core.integrate import texel_light
from leaflight.core.output import resolve
from leaflight.core.output.debug_passes import DebugPages
from leaflight.core.parallel import folders
from leaflight.core.scene.scene import SceneSnapshot
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import DEBUG_PASSES, PASSES, Settings

N_TEST = 90  # comparisons of means in test_stress.py, at most
Z_LIMIT = sigma_limit(N_TEST)
FLOOR = 2e-3  # of the greatest channel: what closed forms at four points of a texel may be off
AUDIT_ROUNDING = 1e-9


@dataclass(frozen=True)
class Baked:
    """A bake that has passed the checks.

    pages         pass -> (page_count, size, size, 3) float32
    mean, stderr  (3,) float64, W/m^2: over all texels by area
    """

    hold: Callable[..., None]
    light: LightField
    pages: dict[str, np.ndarray]
    mean: np.ndarray
    stderr: np.ndarray

    def off_by(self, truth: float | np.ndarray) -> tuple[float, float]:
        """How far the mean is from the truth, of the channel farthest off: in stated errors, and in percent of the greatest."""
        most = np.max(truth)
        gap = np.abs(self.mean - truth).max()
        return float(max(gap - FLOOR * most, 0.0) / max(self.stderr.max(), 1e-6 * most)), float(100 * gap / most)

    def hold_mean(self, truth: float | np.ndarray, percent: float = 2.0) -> None:
        """The mean is within its stated error, and not only because that is large; no light is none at all."""
        assert not self.mean[np.broadcast_to(truth, 3) == 0].any()
        sigmas, off = self.off_by(truth)
        self.hold("odd scenes: mean light off the truth", sigmas, high=Z_LIMIT, unit="stated errors")
        self.hold(f"odd scenes: mean light off the truth, up to {percent:g} %", off, high=percent, unit="%")


def bake_and_audit(folder: Path, scene: SceneSnapshot, **knobs: object) -> tuple[np.ndarray, dict[str, np.ndarray], LightField]:
    """Mean irradiance (3,), W/m^2, by area; the energy audit, W, which is held to be closed; and the light field of a bake.

    knobs   fields of Settings
    """
    field = solve_scene(folder, scene, Settings(**{"size": 48, "workers": 1, "seed": 3, "max_depth": 4000, **knobs}))
    texels = traced_scene.open_tracing(str(folder)).texels
    light = texel_light.light_at_texels(field, texels)
    audit = {name: np.array(watts) for name, watts in field.ledger.audit_w().items()}
    np.testing.assert_allclose(audit["absorbed"] + audit["escaped"] + audit["remainder"], audit["emitted"], rtol=AUDIT_ROUNDING)
    return np.average(light.direct + light.indirect, axis=0, weights=texels.texel_area), audit, field


def bake_safely(
    hold: Callable[..., None],
    folder: Path,
    scene: SceneSnapshot,
    direct: str = "rays",
    prepare: Callable[[Solver], None] = lambda solver: None,
    **knobs: object,
) -> Baked:
    """A bake of small pages unless `knobs`, fields of Settings, say otherwise; `prepare` may change the solver before it runs."""
    usual = {"size": 32, "padding": 1, "error": 0.04, "max_photons": 20_000, "direct": direct, "workers": 1}
    chosen = Settings(**{**usual, **knobs})
    folders.forget_folders()
    solver = make_solver(folder, scene, chosen)
    prepare(solver)
    light = solver.run(lambda message: None, lambda: False)
    atlas, texels = charts.make_charts(scene, chosen), solver.tracing.texels
    at_texels = texel_light.light_at_texels(light, texels)
    resolver = resolve.Resolver(at_texels, texels, solver.tracing.scene.surfaces, margin=4)
    debug = DebugPages(light, texels, margin=4)
    drawers = {name: debug if name in DEBUG_PASSES else resolver for name in PASSES}
    pages = {name: np.stack([drawers[name].page(name, page)[..., :3] for page in range(atlas.page_count)]) for name in PASSES}
    for name in DEBUG_PASSES:
        look = debug.look(name, 0, lambda: resolver.page("combined", 0))
        assert ((look >= 0) & (look <= 1)).all(), name
    odd = sum(np.count_nonzero(~np.isfinite(pixels) | (pixels < 0)) for pixels in pages.values())
    hold("odd scenes: values of pages that are NaN, infinite or negative", odd, high=0)
    assert 0 <= light.error < np.inf
    audit = {name: np.array(value) for name, value in light.ledger.audit_w().items()}
    open_w = np.abs(audit["absorbed"] + audit["escaped"] + audit["remainder"] - audit["emitted"])
    off = (open_w / np.maximum(audit["emitted"], 1e-300)).max()
    hold("odd scenes: energy audit off, of what is emitted in a channel", off, high=AUDIT_ROUNDING)
    weight = texels.texel_area[:, None]
    by_rays = (light.direct.irradiance * weight).sum(0, dtype=float)
    ray_noise = (light.direct.variance * weight**2).sum(0, dtype=float)
    area = light.tree.area[light.leaves]
    noise = (light.solution.variance[:, light.leaves] * area**2).sum(1) + ray_noise
    mean = (light.solution.flux[:, light.leaves].sum(1) + by_rays) / weight.sum()
    return Baked(hold, light, pages, mean, np.sqrt(noise) / weight.sum())
