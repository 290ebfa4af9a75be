"""Direct light is told by quads where they tell it as well, and by each texel elsewhere."""

import numpy as np
import pytest
from boxes import prepare_folder
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.parallel import executors
from leaflight.core.scene.scene import Light
from leaflight.core.util import ablation
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, moved, quad_mesh

PAGE = 2048


@pytest.fixture
def shadow(tmp_path):
    """A floor in the soft shadow of a block, 128 texels wide, on a large page."""
    floor = quad_mesh("Floor", 2.0, 2.0)
    block = moved(box_mesh("Block", (0.6, 0.6, 0.1)), (1.0, 1.0, 0.7))
    lamp = Light("AREA", "Lamp", (1.0, 1.0, 2.0), size_m=(0.8, 0.8), power_rgb=(40.0, 30.0, 20.0))
    settings = Settings(size=PAGE, density=64.0, padding=1, error=0.05)
    return tmp_path, settings, prepare_folder(tmp_path, make_scene([floor, block], [lamp]), settings)[1]


def test_rays_are_fewer_and_the_light_and_its_error_are_the_same(shadow, monkeypatch):
    folder, settings, texels = shadow
    every, fields = range(len(texels)), []
    for without, error in (("", 0.05), ("quads", 0.05), ("quads", 0.002)):
        monkeypatch.setenv(ablation.VARIABLE, without)
        field = DirectField.none(len(texels))
        field.shoot(folder, Settings(**{**vars(settings), "error": error}), executors.InlineExecutor(), every)
        fields.append(field)
    quads, plain, fine = fields
    assert quads.by_quads.mean() > 0.35
    assert quads.counters["by_quads"] == quads.by_quads.sum()
    assert not plain.by_quads.any()
    assert quads.counters["rays"] < 0.8 * plain.counters["rays"]
    assert quads.irradiance.mean() == pytest.approx(fine.irradiance.mean(), rel=3e-3)
    level = fine.irradiance.mean()
    shown = [field.show(texels, True).irradiance for field in fields]
    off = [np.sqrt(((one - fine.irradiance)[quads.by_quads] ** 2).mean()) / level for one in shown[:2]]
    assert off[0] < max(1.3 * off[1], 0.02)
    told = quads.show(texels, True)
    stated2 = told.variance_at(np.flatnonzero(quads.by_quads)).mean() + max(told.blur2_at(np.flatnonzero(quads.by_quads)).mean(), 0)
    assert 0.6 < np.sqrt(stated2) / (off[0] * level) < 1.7
