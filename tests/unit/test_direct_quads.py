"""Direct light is told by quads where they tell it as well, and by each texel elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import prepare_folder
from leaflight.core.integrate.direct import DirectLight
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.direct_quads import find_quads, light_by_quads
from leaflight.core.parallel import executors
from leaflight.core.scene.scene import Light
from leaflight.core.texels.texel_footprint import centred_strata
from leaflight.core.texels.tiles import Tiles
from leaflight.core.util import ablation
from leaflight.core.util.coverage import as_slice
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, moved, quad_mesh
from trees import make_square_map

SIDE = 64
PAGE = 2048
CORNERS = SIDE * np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])  # of make_square_map
TOLERANCE = 0.01


@pytest.fixture(scope="module")
def texels():
    """Few of them, on a large page."""
    return replace(make_square_map(SIDE, 1), page_size=PAGE)


class Lamp:
    """Stands in for direct_irradiance: the mean of truth(x, y) over what is looked at, `few` through openings, and what it was asked."""

    def __init__(self, truth, noise2=0.0, few=lambda texel: texel < 0):
        self._truth, self._noise2, self._few = truth, noise2, few
        self.asked = []

    def __call__(self, look_at, texel, *, tiles, crossed, beside):
        tri, weight = look_at(texel).points(centred_strata(16))
        corner = CORNERS[tri]
        place = corner[..., 0, :] + (weight[..., None] * (corner[..., 1:, :] - corner[..., :1, :])).sum(axis=-2)
        value = self._truth(*np.moveaxis(place, -1, 0)).mean(axis=0)
        self.asked.append((texel, place, tiles, crossed, beside))
        variance = np.full((len(value), 1), self._noise2) * [1.0, 4.0, 0.0]
        return DirectLight(value[:, None] * [1.0, 2.0, 0.0], variance, {"rays": len(value)}, by_openings=self._few(texel))


def light(texels, lamp, beside=0.0, crossed=(), entry=None):
    entry = np.arange(len(texels)) if entry is None else entry
    rows = as_slice(entry)
    is_crossed = np.isin(entry, crossed)
    tiles = Tiles.of(texels.texel_chart[rows], texels.texel_code[rows])
    quads = find_quads(texels, entry, tiles, is_crossed)
    return light_by_quads(lamp, texels, entry, TOLERANCE, tiles, is_crossed, np.full(len(entry), beside, np.float32), quads)


def test_gentle_light_is_told_by_a_quarter_of_the_looks(texels):
    lamp = Lamp(lambda x, y: 1 + x / SIDE + y / (2 * SIDE))
    found = light(texels, lamp)
    x, y = texels.texel_xy.T + 0.5
    np.testing.assert_allclose(found.irradiance_rgb, (1 + x / SIDE + y / (2 * SIDE))[:, None] * [1.0, 2.0, 0.0], rtol=2e-3, atol=1e-12)
    np.testing.assert_allclose(
        found.irradiance_rgb[found.by_quads, 0], (1 + x / SIDE + y / (2 * SIDE))[found.by_quads], rtol=1e-6, atol=1e-12
    )
    diagonal = x // 16 == y // 16  # which both triangles share
    np.testing.assert_array_equal(found.by_quads, ~diagonal)
    assert found.counters == {"rays": 4 * 256 + 12 * 64, "by_quads": 12 * 256}
    assert found.irradiance_rgb.dtype == found.variance_rgb.dtype == np.float32


def test_a_step_is_told_by_texels(texels):
    lamp = Lamp(lambda x, y: np.where(x < 21, 1.0, 2.0))
    found = light(texels, lamp)
    x, y = texels.texel_xy.T
    stepped = x // 16 == 1
    np.testing.assert_array_equal(found.by_quads, ~stepped & (x // 16 != y // 16))
    np.testing.assert_allclose(found.irradiance_rgb[:, 0], np.where(x < 21, 1.0, 2.0), rtol=1e-6)


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
