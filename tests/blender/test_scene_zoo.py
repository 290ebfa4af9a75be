"""A scene of the zoo as Blender has it."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from scene_zoo import ABOUT, BAKED, LIGHTMAP_LAYER, TEXTURE_LAYER, write_scene

SMALL = (64, 1500)  # texels a side, triangles
SEPARATE, JOINED = 5, 1  # seeds: both have a layer by Smart UV Project


def read_meshes():
    found = {}
    for obj in bpy.context.scene.objects:
        if obj.type == "MESH":
            place = np.empty(3 * len(obj.data.vertices), np.float32)
            obj.data.vertices.foreach_get("co", place)
            layers = {layer.name: np.array([one.vector[:] for one in layer.uv]) for layer in obj.data.uv_layers}
            found[obj.name] = (bool(obj.get(BAKED)), place, layers)
    return found


def test_a_scene_is_built_as_it_was_drawn_and_the_same_again(tmp_path):
    plan = write_scene(SEPARATE, tmp_path / "a.blend", *SMALL)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    first = read_meshes()
    assert {name for name, (baked, *_) in first.items() if baked} == {thing.name for thing in plan.things if thing.baked}
    assert len(first) == len(plan.things)
    assert sum(len(polygon.vertices) - 2 for obj in bpy.data.meshes for polygon in obj.polygons) == plan.triangles
    assert sum(obj.type == "LIGHT" for obj in bpy.context.scene.objects) == len(plan.lamps)
    assert json.loads(bpy.context.scene[ABOUT])["size"] == SMALL[0]
    for baked, _, layers in first.values():
        assert list(layers) == [TEXTURE_LAYER, *([LIGHTMAP_LAYER] if baked else [])]
        if baked:
            assert np.ptp(layers[LIGHTMAP_LAYER], axis=0).min() > 0.0
            assert layers[LIGHTMAP_LAYER].min() >= 0.0
            assert layers[LIGHTMAP_LAYER].max() <= 1.0
    write_scene(SEPARATE, tmp_path / "b.blend", *SMALL)
    second = read_meshes()
    assert list(second) == list(first)
    for name, (_, place, layers) in first.items():
        np.testing.assert_array_equal(place, second[name][1])
        for layer, uv in layers.items():
            np.testing.assert_allclose(uv, second[name][2][layer], atol=1e-6)
