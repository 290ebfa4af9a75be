"""Our UV layer beside the user's layers."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from leaflight.addon.read import uv_layer


@pytest.fixture
def mesh():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    mesh = bpy.data.meshes.new("Plate")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
    for name in ("First", "Second", "Third"):
        mesh.uv_layers.new(name=name)
    mesh.uv_layers.active_index = 0
    mesh.uv_layers["Second"].active_render = True
    return mesh


CORNER_UV = np.array([[0.0, 0.25], [0.5, 0.25], [0.5, 1.0], [0.0, 1.0]])


def read(layer):
    values = np.empty(2 * len(layer.uv), dtype=np.float32)
    layer.uv.foreach_get("vector", values)
    return values.reshape(-1, 2)


def state(mesh):
    return [(layer.name, layer.active, layer.active_render) for layer in mesh.uv_layers]


def test_writes_corner_by_corner_and_keeps_active_layers(mesh):
    before = state(mesh)
    assert uv_layer.write_layer(mesh, CORNER_UV) == "Leaflight"
    np.testing.assert_array_equal(read(mesh.uv_layers["Leaflight"]), CORNER_UV)
    assert state(mesh)[:3] == before
    uv_layer.remove_layer(mesh)
    assert state(mesh) == before
    assert list(mesh.keys()) == []


def test_second_write_overwrites(mesh):
    uv_layer.write_layer(mesh, CORNER_UV)
    uv_layer.write_layer(mesh, CORNER_UV / 2)
    assert len(mesh.uv_layers) == 4
    np.testing.assert_array_equal(read(mesh.uv_layers["Leaflight"]), CORNER_UV / 2)


def test_layer_of_the_users_with_our_name_is_not_touched(mesh):
    theirs = mesh.uv_layers.new(name="Leaflight")
    content = read(theirs)
    assert uv_layer.write_layer(mesh, CORNER_UV + 3) != "Leaflight"
    uv_layer.remove_layer(mesh)
    np.testing.assert_array_equal(read(mesh.uv_layers["Leaflight"]), content)
    assert len(mesh.uv_layers) == 4


def test_ours_is_found_after_a_rename_and_removed_when_active(mesh):
    before = state(mesh)
    uv_layer.write_layer(mesh, CORNER_UV)
    mesh.uv_layers["Leaflight"].name = "Mine now"
    mesh.uv_layers["Mine now"].active_render = True
    mesh.uv_layers.active = mesh.uv_layers["Mine now"]
    assert uv_layer.layer_name(mesh) == "Mine now"
    uv_layer.remove_layer(mesh)
    assert state(mesh) == before


def test_layer_the_user_deleted_is_written_anew(mesh):
    before = state(mesh)
    uv_layer.write_layer(mesh, CORNER_UV)
    mesh.uv_layers.remove(mesh.uv_layers["Leaflight"])
    assert uv_layer.layer_name(mesh) == ""
    uv_layer.write_layer(mesh, CORNER_UV)
    uv_layer.remove_layer(mesh)
    assert state(mesh) == before


def test_full_mesh_and_wrong_shape_are_refused_with_a_sentence(mesh):
    with pytest.raises(ValueError, match=r"Plate: expected lightmap UVs of shape \(4, 2\), got \(3, 2\)"):
        uv_layer.write_layer(mesh, CORNER_UV[:3])
    for _ in range(5):
        mesh.uv_layers.new()
    with pytest.raises(ValueError, match=r"Plate: has 8 UV layers.*remove one"):
        uv_layer.write_layer(mesh, CORNER_UV)
    assert not uv_layer.has_room(mesh)
    assert list(mesh.keys()) == []


def test_a_mesh_that_ours_filled_takes_it_again(mesh):
    uv_layer.write_layer(mesh, CORNER_UV)
    while len(mesh.uv_layers) < uv_layer.MAX_LAYERS:
        mesh.uv_layers.new()
    assert uv_layer.has_room(mesh)
    uv_layer.write_layer(mesh, CORNER_UV / 2)
    assert len(mesh.uv_layers) == uv_layer.MAX_LAYERS


def test_a_copy_of_the_mesh_keeps_its_uvs(mesh):
    """Copies, undo steps and evaluated meshes share a mesh's arrays until they are written."""
    before = np.full((len(mesh.loops), 2), 0.25, np.float32)
    name = uv_layer.write_layer(mesh, before)
    copy = mesh.copy()
    uv_layer.write_layer(copy, before + 0.5)
    found = np.empty_like(before)
    mesh.uv_layers[name].uv.foreach_get("vector", found.reshape(-1))
    np.testing.assert_array_equal(found, before)
