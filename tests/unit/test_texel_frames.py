"""Places and axes of texels, told by their triangles."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import prepare_folder
from leaflight.core.parallel import folders
from leaflight.core.scene.scene import Light
from leaflight.core.transport import traced_scene
from leaflight.core.transport.texel_frames import TexelFrames
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, quad_mesh

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


@pytest.fixture
def floor(tmp_path):
    """A floor of 4 x 2 m on a page of 16 texels, after a box that has no texels."""
    box = replace(box_mesh("Box", (1, 1, 1), (2, 1, 3)), receives=False)
    scene = make_scene([box, quad_mesh("Floor", 4.0, 2.0, SQUARE)], [Light("POINT", "Lamp", (0, 0, 2), power_rgb=(1.0,) * 3)])
    texels = prepare_folder(tmp_path, scene, Settings(size=16, margin=0))[1]
    yield TexelFrames.of(traced_scene.open_scene(str(tmp_path)), texels), texels
    folders.forget_folders()


def test_texels_lie_where_their_triangles_are(floor):
    frames, texels = floor
    entry = np.flatnonzero(texels.is_central)[::-3]
    position, normal, side = frames.find_places(entry)
    position_m = position / frames.unit_box.scale + frames.unit_box.centre_m
    np.testing.assert_allclose(position_m[:, :2], (texels.texel_xy[entry] + 0.5) * [4 / 16, 2 / 16], atol=1e-6)
    np.testing.assert_allclose(position_m[:, 2], 0.0, atol=1e-6)
    assert (normal == [0, 0, 1]).all()
    np.testing.assert_allclose(side, (4 / 16 * 2 / 16) ** 0.5 * frames.unit_box.scale)


def test_axes_go_along_columns_and_rows(floor):
    frames, texels = floor
    axes = frames.find_axes(np.arange(len(texels)))
    np.testing.assert_allclose(axes, np.broadcast_to(np.eye(3)[:2, None], axes.shape), atol=1e-7)


def test_only_triangles_with_texels_are_worked_out(floor):
    frames, _ = floor
    assert frames.corner.shape == (9, 2)
    assert frames.row[-2:].tolist() == [0, 1]
