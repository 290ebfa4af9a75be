"""docs/leaves.png: the furnished room through its camera, and the leaves that carry its light.

All of the light is by photons here, as in the paper: by default the leaves carry indirect light alone, and there is less to see.

PYTHONPATH=tests python tests/bench/draw_wireframe.py     needs pip's bpy; a few minutes
"""

import json
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from boxes import prepare_folder
from draw_leaves import light_view, look_through, shade_view
from export_samples import export_samples
from leaflight.core.bake import solve
from leaflight.core.integrate import texel_light
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.output.image_file import write_image
from leaflight.core.parallel import executors
from leaflight.core.radiosity import quadtree
from leaflight.core.scene.snapshot import load_snapshot
from leaflight.core.transport import contact_map, traced_scene
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=1024, direct="photons", error=0.02, max_photons=24_000_000)
OUT = Path(__file__).resolve().parents[2] / "docs" / "leaves.png"
SCENE = "furnished_room"
WIDTH, HEIGHT, FINER = 960, 600, 3  # lines are smooth because a pixel is a mean of FINER^2
WIPE_LEFT, WIPE_RIGHT = 0.5, 0.3  # of the width: where the picture turns into its leaves, at the top and at the bottom
LINE_RGB = (0.02, 0.05, 0.09)
PAPER = 0.12  # how far the light under the lines is lifted towards white


def main() -> None:
    """Export, bake, draw."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export_samples(folder, SCENE)
        camera = json.loads((folder / f"{SCENE}.camera.json").read_text(encoding="utf-8"))
        stage, light = bake_light(folder / "bake", folder / f"{SCENE}.npz")
        picture = draw_picture(stage, light, camera)
    import bpy  # not before: workers of the bake would load it too
    from leaflight.addon.app.job import library_paths

    sys.path += library_paths()
    write_image(OUT, np.ascontiguousarray(picture[::-1], np.float32), {}, "png")
    print(f"{OUT.name}: {len(light.leaves):,} leaves, {light.photons / 1e6:.2f} M photons, Blender {bpy.app.version_string}")


def bake_light(folder: Path, snapshot: Path) -> tuple[SimpleNamespace, solve.LightField]:
    """What core.bake does, without files; gives what draw_leaves wants to know of the scene, and the light."""
    scene = load_snapshot(snapshot)
    _atlas, texels = prepare_folder(folder, scene, SETTINGS)
    executor = executors.make_executor(SETTINGS.workers)
    try:
        tracing = traced_scene.open_tracing(str(folder))
        direct = DirectField.none(len(texels.texel_area))
        touched = contact_map.find_contacts(tracing, texels).touched
        solver = solve.Solver(folder, SETTINGS, executor, direct, touched)
        light = solver.run(lambda message: None, lambda: False)
    finally:
        executor.shutdown()
    return SimpleNamespace(tracing=tracing, texels=texels), light


def draw_picture(stage: SimpleNamespace, light: solve.LightField, camera: dict) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) linear, row 0 on top: light and colour on the left, light and leaves on the right."""
    at_texels = texel_light.light_at_texels(light, stage.texels)
    irradiance = at_texels.direct + at_texels.indirect
    leaf = quadtree.node_of_texel(light.tree, light.leaves, len(stage.texels.texel_area))
    view = look_through(stage, np.array(camera["matrix"]), camera["angle_rad"], WIDTH * FINER, HEIGHT * FINER)
    shaded, bare = shade_view(stage, view, irradiance), light_view(view, irradiance)
    place = np.where(view.entry >= 0, leaf[view.entry], -1 - view.tri)
    lines = find_lines(place)[..., None]
    left = tone(shaded, np.quantile(shaded, 0.95))
    right = np.where(lines, LINE_RGB, PAPER + (1 - PAPER) * tone(bare, np.quantile(bare, 0.95)))
    down, across = np.mgrid[0 : HEIGHT * FINER, 0 : WIDTH * FINER] / np.array([HEIGHT, WIDTH])[:, None, None] / FINER
    wipe = WIPE_LEFT + (WIPE_RIGHT - WIPE_LEFT) * down
    picture = np.where((across < wipe)[..., None], left, right)
    return picture.reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean((1, 3))


def find_lines(place: np.ndarray) -> np.ndarray:
    """(h, w) bool: two pixels wide where neighbours belong to different leaves."""
    line = np.zeros(place.shape, bool)
    across, down = place[:, 1:] != place[:, :-1], place[1:] != place[:-1]
    line[:, 1:] |= across
    line[:, :-1] |= across
    line[1:] |= down
    line[:-1] |= down
    return line


def tone(linear: np.ndarray, exposure: float) -> np.ndarray:
    """Light with a soft shoulder, in [0, 1]."""
    return 1.0 - np.exp(-linear / exposure)


if __name__ == "__main__":
    main()
