"""A panel that glows by a texture over a floor: the sum of Lambert's polygons of its pixels.

The statistical tests of this file share floors.ALPHA.
"""

from dataclasses import replace

import numpy as np
import pytest
from closed_forms import from_polygon
from known_light import bake_known, black_scene, floor_mesh, state_errors
from leaflight.core.scene.scene import TextureImage
from leaflight.core.util.settings import DIRECT_MODES
from scenes import Mesh
from stats import hold_bias_is_seen, hold_stated_error, hold_statement, hold_unbiased

HEIGHT_M, RADIANCE = 0.5, 3.0
PANEL = np.array([[0, 0, HEIGHT_M], [1, 0, HEIGHT_M], [1, 1, HEIGHT_M], [0, 1, HEIGHT_M]])
# One dark half, one hot spot of a twelfth of the area, and a ramp: 3 rows by 4 columns, so that axes cannot be swapped unseen.
PIXELS = np.array([[0, 0, 0.1, 0.2], [0, 0, 8.0, 0.3], [0, 0.5, 0.2, 0.4]], np.float32)


def pixel_corners(row, column):
    x, y = np.array([column, column + 1]) / PIXELS.shape[1], np.array([row, row + 1]) / PIXELS.shape[0]
    return np.array([[x[0], y[0], HEIGHT_M], [x[1], y[0], HEIGHT_M], [x[1], y[1], HEIGHT_M], [x[0], y[1], HEIGHT_M]])


def irradiance(position, normal):
    return sum(RADIANCE * value * from_polygon(pixel_corners(*at), position, normal) for at, value in np.ndenumerate(PIXELS) if value)


def panel_scene():
    scene = black_scene([floor_mesh()], others=[Mesh("Panel", PANEL, [[0, 1, 2, 3]])], glow=RADIANCE)
    image = TextureImage("Panel", np.repeat(PIXELS[..., None], 3, axis=2), closest=True)
    lamp = replace(scene.materials[1], emission_image=0)
    return replace(
        scene, materials=(scene.materials[0], lamp), images=(image,), tri_emission_uv=scene.tri_position[..., :2].astype(np.float32)
    )


@pytest.fixture(scope="module", params=["rays", pytest.param("photons", marks=pytest.mark.slow)])
def known(request, tmp_path_factory):
    return bake_known(tmp_path_factory.mktemp("panel"), panel_scene(), irradiance, request.param, error=0.05)


def test_every_leaf_is_within_its_stated_error(known, hold):
    hold_unbiased(hold, "textured emitter", known.on_leaves(), len(DIRECT_MODES), 0.3)


def test_a_planted_bias_is_rejected(known, hold):
    hold_bias_is_seen(hold, "textured emitter", known.on_leaves(), len(DIRECT_MODES))


@pytest.fixture(scope="module", params=[pytest.param(direct, marks=pytest.mark.slow) for direct in DIRECT_MODES])
def errors(request, tmp_path_factory):
    return request.param, state_errors(tmp_path_factory.mktemp("adaptive"), panel_scene(), irradiance, request.param)


def test_each_adaptive_bake_is_within_its_stated_error(errors, hold):
    for stated, real in errors[1]:
        hold_stated_error(hold, "textured emitter", real, stated)


def test_adaptive_bakes_together_state_their_error(errors, hold):
    hold_statement(hold, "textured emitter", errors[1], errors[0])
