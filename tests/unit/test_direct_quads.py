"""Direct light is told by quads where they tell it as well, and by each texel elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import prepare_folder
from floors import morton_square
from leaflight.core.integrate.direct import DirectLight
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.direct_quads import find_quads, light_by_quads
from leaflight.core.parallel import executors
from leaflight.core.scene.scene import Light
from leaflight.core.texels.quads import find_misfit
from leaflight.core.texels.split_texels import TexelBorders
from leaflight.core.texels.texel_footprint import centred_strata
from leaflight.core.texels.tiles import Tiles
from leaflight.core.util import ablation
from leaflight.core.util.brightness import weigh_channels
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
    assert found.irradiance_rgb == pytest.approx((1 + x / SIDE + y / (2 * SIDE))[:, None] * [1.0, 2.0, 0.0], rel=2e-3)
    assert found.irradiance_rgb[found.by_quads, 0] == pytest.approx((1 + x / SIDE + y / (2 * SIDE))[found.by_quads], rel=1e-6)
    diagonal = x // 16 == y // 16  # which both triangles share
    np.testing.assert_array_equal(found.by_quads, ~diagonal)
    assert found.counters == {"rays": 4 * 256 + 12 * 64, "by_quads": 12 * 256}
    assert found.irradiance_rgb.dtype == found.variance_rgb.dtype == np.float32


def test_a_quad_looks_at_all_of_itself(texels):
    lamp = Lamp(lambda x, y: np.ones_like(x))
    light(texels, lamp)
    texel, place, tiles, crossed, _ = lamp.asked[0]
    assert crossed is None
    assert len(tiles) == 12
    low = texels.texel_xy[texel]
    np.testing.assert_allclose(place.min(axis=0), low + 0.25)
    np.testing.assert_allclose(place.max(axis=0), low + 1.75)


def test_a_step_is_told_by_texels(texels):
    lamp = Lamp(lambda x, y: np.where(x < 21, 1.0, 2.0))
    found = light(texels, lamp)
    x, y = texels.texel_xy.T
    stepped = x // 16 == 1
    np.testing.assert_array_equal(found.by_quads, ~stepped & (x // 16 != y // 16))
    np.testing.assert_allclose(found.irradiance_rgb[:, 0], np.where(x < 21, 1.0, 2.0), rtol=1e-6)


def test_where_some_see_through_openings_each_texel_looks_for_itself(texels):
    """Of four times as many looks smoothing leaves less, and what is noise hides a misfit."""
    one = np.flatnonzero((texels.texel_xy == (40, 2)).all(axis=1))
    found = light(texels, Lamp(lambda x, y: np.ones_like(x), few=lambda texel: np.isin(texel, one)))
    x, y = texels.texel_xy.T
    np.testing.assert_array_equal(found.by_quads, (x // 16 != y // 16) & ~((x // 16 == 2) & (y // 16 == 0)))
    np.testing.assert_array_equal(np.flatnonzero(found.by_openings), one)


def test_a_step_that_nobody_sees_beside_other_light_is_not(texels):
    """And what quads leave out of it is stated."""
    lamp = Lamp(lambda x, y: np.where(x < 21, 1.0, 1.1))
    assert light(texels, lamp, beside=100.0).by_quads.sum() == 12 * 256
    found = light(texels, lamp, beside=5.0)
    x = texels.texel_xy[:, 0]
    stepped = found.by_quads & (x // 16 == 1)
    real2 = (found.irradiance_rgb[stepped, 0] - np.where(x[stepped] < 21, 1.0, 1.1)) ** 2
    assert found.variance_rgb[stepped, 0].mean() > 0.5 * real2.mean() > 0
    assert found.variance_rgb[~stepped].max() < 1e-9


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_quads_suffice_up_to_the_error_that_is_asked_for(texels, share):
    """Of all light that is there: with a tenth less of it their misfit is seen, with a tenth more it is not."""
    column = np.arange(8)[np.newaxis] + np.zeros((8, 1), int)
    quads = np.where(column < 2, 1.0, np.where(column == 2, 1.05, 1.1))[morton_square(8)[::-1]]  # a step at 21 in the columns from 16 on
    by_channel = np.array([[1.0, 2.0, 0.0]])
    misfit = np.sqrt(find_misfit(quads, np.zeros(64))[0] * weigh_channels(by_channel**2)[0])
    beside = share * misfit / TOLERANCE - quads.mean() * weigh_channels(by_channel)[0]
    found = light(texels, Lamp(lambda x, y: np.where(x < 21, 1.0, 1.1)), beside=beside)
    x, y = texels.texel_xy.T
    stepped = (x // 16 == 1) & (y // 16 != 1)
    assert beside > 0
    assert found.by_quads[stepped].all() == (share > 1)
    assert found.by_quads[stepped].any() == (share > 1)


def test_noise_is_told_and_no_misfit(texels):
    rng, sigma = np.random.default_rng(1), 0.01
    lamp = Lamp(lambda x, y: 1 + sigma * rng.standard_normal(x.shape[1:])[None] + 0 * x, sigma**2)
    found = light(texels, lamp)
    by_quads = found.by_quads
    assert by_quads.sum() == 12 * 256
    real2 = (found.irradiance_rgb[by_quads, 0] - 1) ** 2
    assert found.variance_rgb[by_quads, 0].mean() == pytest.approx(real2.mean(), rel=0.15)
    assert (found.variance_rgb[~by_quads, 0] == np.float32(sigma**2)).all()


def test_texels_that_see_past_others_look_for_themselves(texels):
    lamp = Lamp(lambda x, y: np.ones_like(x))
    chosen = np.flatnonzero((texels.texel_xy == (40, 3)).all(axis=1))
    found = light(texels, lamp, crossed=chosen)
    x, y = texels.texel_xy.T
    np.testing.assert_array_equal(found.by_quads, (x // 16 != y // 16) & ~((x // 16 == 2) & (y // 16 == 0)))
    texel, _, _, crossed, _ = lamp.asked[1]
    assert texel[crossed].tolist() == chosen.tolist()


def test_nor_is_a_quad_made_of_one_at_the_foot_of_something(texels, monkeypatch):
    """Which its own square does not reach, but a quad's does."""
    one, other = (np.flatnonzero((texels.texel_xy == place).all(axis=1)) for place in ((40, 3), (41, 3)))
    borders = TexelBorders.of(len(texels), np.zeros(1, np.int64), one, other, np.full(1, 0.4))
    monkeypatch.setitem(texels.__dict__, "borders", borders)
    found = light(texels, Lamp(lambda x, y: np.ones_like(x)))
    x, y = texels.texel_xy.T
    np.testing.assert_array_equal(found.by_quads, (x // 16 != y // 16) & ~((x // 16 == 2) & (y // 16 == 0)))


def test_some_texels_are_told_in_their_order(texels):
    """A large tile of which some are missing is told by texels; each has its own other light."""

    def truth(x, y):
        return 1 + x / SIDE

    entry = np.arange(100, len(texels) - 70)
    found = light(texels, Lamp(truth), entry=entry)
    np.testing.assert_allclose(found.irradiance_rgb[:, 0], truth(texels.texel_xy[entry, 0] + 0.5, 0), rtol=2e-3)
    assert found.by_quads[:156].sum() == 0
    assert found.by_quads.any()
    scattered = entry[::3]
    assert not light(texels, Lamp(truth), entry=scattered).by_quads.any()


def test_small_pages_are_told_by_texels(texels):
    small = replace(texels, page_size=PAGE // 2)
    assert not light(small, Lamp(lambda x, y: np.ones_like(x))).by_quads.any()


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


def test_who_is_asked_again_looks_for_himself(shadow):
    """And is no part of a quad from then on, unless that shot is stopped."""
    folder, settings, texels = shadow
    field = DirectField.none(len(texels))
    field.shoot(folder, settings, executors.InlineExecutor(), range(len(texels)))
    again, before = np.flatnonzero(field.by_quads)[:600], field.by_quads.copy()
    assert not field.shoot(folder, settings, executors.InlineExecutor(), again, should_stop=lambda: True)
    np.testing.assert_array_equal(field.by_quads, before)
    field.shoot(folder, settings, executors.InlineExecutor(), again)
    assert not field.by_quads[again].any()
    before[again] = False
    np.testing.assert_array_equal(field.by_quads, before)
