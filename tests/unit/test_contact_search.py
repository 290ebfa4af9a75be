"""Contacts that several processes look for are those that one finds."""

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.bake import bake
from leaflight.core.output.image_file import read_image
from leaflight.core.parallel import executors
from leaflight.core.scene.scene import Light
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.util.job import SNAPSHOT_FILE, Job
from leaflight.core.util.settings import Settings
from processes import wait_until_ready
from scenes import box_mesh, make_scene, quad_mesh

SETTINGS = Settings(size=224, direct="photons", max_photons=20_000, error=0.5, passes=("lighting",))
LAMP = Light("POINT", "Lamp", (0.2, 0.5, 0.9), power_rgb=(1.0,) * 3)


@pytest.fixture
def scene():
    """Boxes on a floor that a wall parts."""
    boxes = [box_mesh(f"Box {k}", (0.2, 0.2, 0.3), (x, y, 0.15)) for k, (x, y) in enumerate([(0.2, 0.2), (0.4, 0.2), (0.7, 0.7)])]
    wall = replace(box_mesh("Wall", (0.02, 0.7, 0.5), (0.55, 0.3, 0.25)), receives=False)
    return make_scene([quad_mesh("Floor"), *boxes, wall], [LAMP])


@pytest.fixture
def as_many(monkeypatch):
    """Has so many processes counted, of which this one does all the work."""
    return lambda count: monkeypatch.setattr(executors.LocalExecutor, "idle", count)


def test_a_bake_by_two_processes_has_the_light_of_one(tmp_path, scene, as_many, open_image_io):
    """Though they are still at the first photons, so that a bake as small as this would not ask them."""
    images = []
    for count in (1, 2):
        folder = tmp_path / str(count)
        folder.mkdir()
        save_snapshot(folder / SNAPSHOT_FILE, scene)
        Job(replace(SETTINGS, workers=count), str(folder / "images"), "room").save(folder)
        executor = executors.make_executor(count)
        if count > 1:
            wait_until_ready(executor)
            as_many(count)
        bake.run_bake(folder, lambda message: None, lambda: False, lambda settings, executor=executor: executor)
        images.append(read_image(folder / "images" / "room_0.lighting.exr")[0])
    np.testing.assert_array_equal(*images)
