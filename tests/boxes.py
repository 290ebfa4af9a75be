"""Small rooms and whole solves of them, without Blender and without image files."""

import json
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from leaflight.core.atlas import charts
from leaflight.core.bake import bake, solve
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.light_field import LightField
from leaflight.core.parallel import executors, folders, shared_arrays
from leaflight.core.radiosity import basis
from leaflight.core.scene.scene import Light, Material, SceneSnapshot
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.texels import creases, texels
from leaflight.core.texels.texel_map import TexelMap
from leaflight.core.util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.messages import Message
from leaflight.core.util.settings import Settings
from scenes import Mesh, box_mesh, make_scene, quad_mesh, sphere_mesh


def room_mesh(name: str = "Room", size_m: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Mesh:
    """A box whose six quads face inwards."""
    box = box_mesh(name, size_m)
    return replace(box, polygons=[polygon[::-1] for polygon in box.polygons])


def ball_room_mesh(name: str = "Ball") -> Mesh:
    """A sphere of few flat faces that face inwards, of radius 1 m."""
    ball = sphere_mesh(name, rings=8, segments=12)
    return replace(ball, polygons=[polygon[::-1] for polygon in ball.polygons])


def furnace_scene(*rho: float, radiance: float = 1.0, room: Mesh | None = None) -> SceneSnapshot:
    """A closed room whose walls all reflect and glow alike: E = pi e (1 + rho + rho^2 ...) = pi e / (1 - rho) everywhere.

    rho   one for all channels, or three
    """
    wall = Material("Wall", (rho * 3)[:3], emission_rgb=(radiance,) * 3)
    return make_scene([room or room_mesh()], materials=[wall])


def lamp_scene(rho: float = 0.5) -> SceneSnapshot:
    """A floor with a block on it, under a lamp; light escapes."""
    floor = replace(quad_mesh("Floor"), vertex=quad_mesh().vertex - [0.5, 0.5, 0.0])
    block = box_mesh("Block", (0.2, 0.2, 0.3), (0.1, 0.0, 0.15))
    lamp = Light("POINT", "Lamp", (-0.2, 0.1, 0.8), power_rgb=(10.0, 5.0, 2.5), radius_m=0.02)
    return make_scene([floor, block], [lamp], [Material("Grey", (rho,) * 3)])


def prepare_folder(folder: Path, scene: SceneSnapshot, settings: Settings) -> tuple[charts.ChartAtlas, TexelMap]:
    """What bake.run_bake puts into a folder before light is sought."""
    folder.mkdir(exist_ok=True)
    save_snapshot(folder / SNAPSHOT_FILE, scene)
    atlas = creases.cut_at_creases(scene, charts.make_charts(scene, settings))
    texel_map = texels.build_texel_map(scene, atlas, 2 * basis.DEGREES[settings.basis])
    shared_arrays.save_struct(folder / folders.TEXELS_FOLDER, texel_map)
    return atlas, texel_map


def bake_folder(
    folder: Path,
    scene: SceneSnapshot,
    settings: Settings,
    should_stop: Callable[[], bool] = lambda: False,
    name: str = "room",
    tell: Callable[[Message], object] = lambda message: None,
    **job: Any,
) -> tuple[list[Message], dict[str, Any]]:
    """Messages and result of a bake in `folder`; its images go into `images` there unless the job names another output."""
    folder.mkdir(parents=True, exist_ok=True)
    save_snapshot(folder / SNAPSHOT_FILE, scene)
    Job(settings, job.pop("output", str(folder / "images")), name, **job).save(folder)
    messages: list[Message] = []
    bake.run_bake(folder, lambda message: (messages.append(message), tell(message)), should_stop)
    return messages, json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))


def list_files(folder: Path) -> list[str]:
    """Names of all that lies below a folder but for the note of a kept bake."""
    return sorted(path.name for path in folder.rglob("*") if not path.name.startswith(".leaflight_"))


def make_solver(
    folder: Path,
    scene: SceneSnapshot,
    settings: Settings,
    executor: Executor | None = None,
    forced: np.ndarray | bool = False,
    begun: bool = True,
) -> solve.Solver:
    """A solver in an empty folder; `begun` has found direct light by rays already."""
    executor = executor or executors.InlineExecutor()
    texel_map = prepare_folder(folder, scene, settings)[1]
    n_texel = len(texel_map)
    forced = np.broadcast_to(forced, n_texel).copy()
    solver = solve.Solver(folder, settings, executor, DirectField.none(n_texel), forced)
    if begun and settings.direct == "rays":
        solver.begin()
        solver.shoot_direct(lambda message: None, lambda: False)
    return solver


def solve_scene(
    folder: Path,
    scene: SceneSnapshot,
    settings: Settings,
    executor: Executor | None = None,
    should_stop: Callable[[], bool] = lambda: False,
) -> solve.LightField:
    """The light of a scene."""
    return make_solver(folder, scene, settings, executor).run(lambda message: None, should_stop)


def solution_bytes(light: LightField) -> bytes:
    """What two bakes that are the same have alike."""
    arrays = [light.solution.coefficient, light.solution.variance, light.leaves, light.direct.irradiance, light.direct.variance]
    return b"".join(array.tobytes() for array in arrays)


def to_bytes(result):
    """All numbers of a result of dataclasses of arrays."""
    if isinstance(result, np.ndarray):
        return result.tobytes()
    if isinstance(result, dict | int | None):
        return repr(result).encode()
    return b"".join(to_bytes(getattr(result, field.name)) for field in fields(result))
