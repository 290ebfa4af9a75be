"""The estimate of the panel, the checker of texels and the buttons of warnings, on a small room."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_copy, add_mesh, add_object, ask_quick_bake, open_room
from leaflight.addon.ui import checker_arrays
from leaflight.addon.ui.select_operator import is_known


@pytest.fixture(autouse=True)
def _room(addon):
    open_room()


@pytest.fixture
def meter():
    return bpy.context.window_manager.leaflight_meter


def make_checker(density, fitting=None):
    return checker_arrays.CheckerMaker(density, fitting or {}).work(bpy.context)


def measure(meter):
    bpy.context.view_layer.update()
    assert meter.measure(bpy.context)
    return meter.estimate


def test_areas_are_the_worlds(meter):
    cube = bpy.data.objects["Cube"]
    found = measure(meter)
    assert (found.objects, found.area_m2) == (2, pytest.approx(16.0 + 6.0))
    cube.scale = (1.0, 1.0, 3.0)
    assert measure(meter).area_m2 == pytest.approx(16.0 + 2.0 + 12.0)
    cube.modifiers.new("Array", "ARRAY").count = 3
    assert measure(meter).area_m2 == pytest.approx(16.0 + 3 * 14.0)


def test_what_has_no_area_is_not_counted(meter):
    before = measure(meter)
    add_mesh("Wire", [(0, 0, 0), (1, 0, 0)], [])
    assert measure(meter) == before
    bpy.context.scene.leaflight.atlas = False
    assert measure(meter).pages == 2
    for obj in (bpy.data.objects["Cube"], bpy.data.objects["Floor"]):
        obj.scale = (0.0, 0.0, 0.0)
    assert measure(meter) is None


def test_what_materials_cannot_show_is_told_before_the_bake(meter):
    measure(meter)
    bpy.context.scene.leaflight.formats = {"rgbm"}
    assert measure(meter) is None
    assert "cannot show RGBM" in meter.problem
    bpy.context.scene.leaflight.formats = {"exr"}
    meter.watch(bpy.context)
    assert meter.stale


def test_what_changes_is_stale_at_once_and_only_that_is_measured_again(meter, monkeypatch):
    from leaflight.addon.app import scene_meter

    measure(meter)
    assert not meter.stale
    measured, original = [], scene_meter.measure_object
    monkeypatch.setattr(scene_meter, "measure_object", lambda obj, graph: measured.append(obj.name) or original(obj, graph))
    version = meter.version
    bpy.data.objects["Cube"].location.x = 1.0
    bpy.context.view_layer.update()
    assert meter.stale
    assert not meter.is_calm()
    measure(meter)
    assert measured == ["Cube"]
    assert meter.version > version


def test_settings_and_choices_make_it_stale(meter):
    before = measure(meter)
    chosen = bpy.context.scene.leaflight
    chosen.density = 10.0
    meter.watch(bpy.context)
    assert meter.stale
    assert measure(meter).density == 10.0
    assert before.density != 10.0
    bpy.data.objects["Cube"].leaflight.role = "CAST"
    assert measure(meter).objects == 1
    chosen.formats = set()
    assert measure(meter) is None
    assert "no file format" in meter.problem


def test_measuring_is_done_in_steps(meter):
    bpy.context.view_layer.update()
    assert not meter.measure(bpy.context, seconds=-1.0)
    assert meter.stale
    assert measure(meter)


def test_an_instance_has_the_area_of_what_it_shows(meter):
    shown = bpy.data.collections.new("Shown")
    cube = bpy.data.objects["Cube"]
    shown.objects.link(cube)
    bpy.context.scene.collection.objects.unlink(cube)
    add_object("Two", None, instance_type="COLLECTION", instance_collection=shown, scale=(2.0, 2.0, 2.0))
    assert measure(meter).area_m2 == pytest.approx(16.0 + 4 * 6.0)


def test_checker_lies_on_instances_of_a_collection_with_an_offset(meter):
    shown = bpy.data.collections.new("Shown")
    cube = bpy.data.objects["Cube"]
    shown.objects.link(cube)
    shown.instance_offset = (1.0, 2.0, 3.0)
    add_object("Two", None, instance_type="COLLECTION", instance_collection=shown, location=(0.0, 0.0, 9.0))
    bpy.context.view_layer.update()
    drawn = make_checker(10.0).position
    depsgraph = bpy.context.evaluated_depsgraph_get()
    [matrix] = [instance.matrix_world.copy() for instance in depsgraph.object_instances if instance.is_instance]
    for corner in np.array([matrix @ vertex.co for vertex in cube.data.vertices], np.float32):
        assert np.abs(drawn - corner).max(axis=1).min() < 1e-5


def test_instances_within_instances_are_measured_and_drawn_where_a_render_shows_them(meter):
    collections = [bpy.data.collections.new(name) for name in ("Cubes", "Pairs", "Hidden")]
    cubes, pairs, hidden = collections
    bpy.context.scene.collection.objects.unlink(bpy.data.objects["Cube"])
    cubes.objects.link(bpy.data.objects["Cube"])
    pairs.children.link(hidden)
    hidden.hide_render = True
    pairs.instance_offset = (0.0, 0.0, 5.0)
    places = {"Left": (pairs, cubes, -4.0), "Right": (pairs, cubes, 4.0), "Unseen": (hidden, cubes, 9.0), "All": (None, pairs, 100.0)}
    for name, (holder, shown, x) in places.items():
        empty = bpy.data.objects.new(name, None)
        empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", shown, (x, 0.0, 0.0)
        (holder or bpy.context.scene.collection).objects.link(empty)
    bpy.context.view_layer.update()
    assert measure(meter).area_m2 == pytest.approx(16.0 + 2 * 6.0)
    drawn = make_checker(10.0).position
    far = drawn[drawn[:, 0] > 50.0]
    corners = {(x, z) for x, _, z in (far * 2.0).round().astype(int).tolist()}
    assert corners == {(x, z) for x in (191, 193, 207, 209) for z in (-10, -8)}  # halves of a metre


def edit(name):
    bpy.context.view_layer.objects.active = bpy.data.objects[name]
    bpy.ops.object.mode_set(mode="EDIT")


def test_an_object_in_edit_mode_is_measured_as_it_is_edited(meter):
    add_copy(bpy.data.objects["Cube"], scale=(2.0, 2.0, 2.0))
    before, arrays = measure(meter), make_checker(10.0)
    edit("Cube")
    assert measure(meter) == before
    np.testing.assert_array_equal(np.sort(make_checker(10.0).position, axis=0), np.sort(arrays.position, axis=0))
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.resize(value=(2.0, 2.0, 2.0))
    assert measure(meter).area_m2 == pytest.approx(16.0 + 4 * 6.0 + 16 * 6.0)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert measure(meter).area_m2 == pytest.approx(16.0 + 4 * 6.0 + 16 * 6.0)


def test_checker_shows_the_layer_in_edit_mode():
    bpy.context.scene.leaflight.uv_layer = "UVMap"
    before = make_checker(32.0)
    edit("Floor")
    np.testing.assert_array_equal(make_checker(32.0).ratio, before.ratio)
    bpy.ops.object.mode_set(mode="OBJECT")


def test_another_file_is_measured_anew(meter):
    measure(meter)
    bpy.ops.wm.read_homefile(use_empty=True)
    assert meter.estimate is None
    assert meter.stale
    assert measure(meter) is None


def test_undo_and_another_frame_are_measured_anew(meter):
    cube = bpy.data.objects["Cube"]
    cube.keyframe_insert("scale", frame=1)
    cube.scale = (2.0, 2.0, 2.0)
    cube.keyframe_insert("scale", frame=2)
    bpy.context.scene.frame_set(1)
    bpy.ops.ed.undo_push(message="before")
    assert measure(meter).area_m2 == pytest.approx(16.0 + 6.0)
    bpy.context.scene.frame_set(2)
    assert meter.stale
    assert measure(meter).area_m2 == pytest.approx(16.0 + 24.0)
    bpy.data.objects["Floor"].scale = (2.0, 1.0, 1.0)
    assert measure(meter).area_m2 == pytest.approx(32.0 + 24.0)
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    assert meter.stale
    assert measure(meter).area_m2 == pytest.approx(16.0 + 6.0)


def test_resolution_is_a_page_or_a_density():
    chosen = bpy.context.scene.leaflight
    assert chosen.resolution == "PAGE"
    chosen.resolution = "DENSITY"
    assert chosen.density > 0.0
    chosen.density = 33.0
    chosen.resolution = "PAGE"
    assert chosen.density == 0.0
    chosen.resolution = "DENSITY"
    assert chosen.density == 33.0


def test_checker_has_texels_of_the_wanted_size_before_there_are_charts():
    cube = bpy.data.objects["Cube"]
    cube.rotation_euler, cube.scale = (0.3, 0.5, 0.7), (1.0, 2.0, 3.0)
    cube.leaflight.density_factor = 2.0
    bpy.context.view_layer.update()
    arrays = make_checker(10.0)
    corner, texel = arrays.position.reshape(-1, 3, 3), arrays.texel.reshape(-1, 3, 2)
    length_m = np.linalg.norm(corner[:, 1] - corner[:, 0], axis=1)
    texels = np.linalg.norm(texel[:, 1] - texel[:, 0], axis=1)
    finer = arrays.ratio[::3] > 1.5
    np.testing.assert_allclose(texels[finer], 20.0 * length_m[finer], rtol=1e-4)
    np.testing.assert_allclose(texels[~finer], 10.0 * length_m[~finer], rtol=1e-4)
    assert (finer.sum(), (~finer).sum()) == (12, 2)


def test_checker_is_as_coarse_as_what_does_not_fit_a_page_will_be(meter, tmp_path):
    chosen = bpy.context.scene.leaflight
    chosen.size, chosen.density, chosen.workers, chosen.output = 512, 150.0, 1, str(tmp_path)
    chosen.direct, chosen.max_photons = "photons", 1000  # of a bake whose layout alone counts
    estimate = measure(meter)
    assert estimate.too_large == ("Floor",)
    told = make_checker(estimate.density, dict(zip(estimate.too_large, estimate.fitting, strict=True)))
    ratio = told.ratio[::3]
    np.testing.assert_allclose(ratio[ratio > 0.9], 1.0, rtol=1e-5)
    assert ((ratio > 0.9).sum(), (ratio < 0.75).sum()) == (12, 2)
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    np.testing.assert_allclose(ratio, make_checker(150.0).ratio[::3], rtol=0.2)


def test_checker_shows_the_layer_once_there_is_one():
    floor = bpy.data.objects["Floor"]
    bpy.context.scene.leaflight.uv_layer = "UVMap"  # the plane's fills the page
    bpy.context.scene.leaflight.size = 256
    bpy.data.objects["Cube"].leaflight.role = "IGNORE"
    arrays = make_checker(32.0)
    assert arrays.texel.max() == 256.0
    np.testing.assert_allclose(arrays.ratio, 2.0, rtol=1e-5)  # 256 texels over 4 m, where 32 are wanted
    floor.leaflight.role = "IGNORE"
    assert len(make_checker(32.0).position) == 0


def test_checker_shows_the_texels_of_duplicates_that_share_a_layer(tmp_path):
    cube = bpy.data.objects["Cube"]
    twin = add_copy(cube)
    twin.location.x = 3.0
    chosen = bpy.context.scene.leaflight
    chosen.size, chosen.error, chosen.workers, chosen.output = 64, 0.5, 1, str(tmp_path)
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    assert "leaflight_uv" in cube
    texels = sum(row["texels"] for row in bpy.context.window_manager.leaflight_state.result["objects"])
    density = (texels / (16.0 + 2 * 6.0)) ** 0.5
    np.testing.assert_allclose(make_checker(density).ratio, 1.0, atol=0.15)


@pytest.mark.parametrize(
    ("names", "selected"), [("Cube", ["Cube"]), ("Floor\nCube", ["Cube", "Floor"]), ("Cube.piece.003", ["Cube"]), ("Grey", ["Floor"])]
)
def test_button_selects_what_a_warning_is_about(names, selected):
    floor = bpy.data.objects["Floor"]
    floor.data.materials.append(bpy.data.materials.new("Grey"))
    floor.hide_set(True)
    bpy.data.objects["Lamp"].select_set(True)
    assert bpy.ops.leaflight.select(names=names) == {"FINISHED"}
    assert sorted(obj.name for obj in bpy.context.selected_objects) == selected
    assert bpy.context.view_layer.objects.active.name in selected


def test_button_selects_what_wears_the_bake_of_a_material(tmp_path):
    bpy.data.objects["Floor"].data.materials.append(bpy.data.materials.new("Grey"))
    ask_quick_bake(tmp_path)
    bpy.ops.leaflight.bake()
    assert bpy.ops.leaflight.select(names="Grey") == {"FINISHED"}
    assert [obj.name for obj in bpy.context.selected_objects] == ["Floor"]


def test_there_is_a_button_only_beside_what_is_there():
    """A deleted object leaves its mesh, of the same name, for the file to forget; and one that something points to stays itself."""
    bpy.data.objects["Floor"].data.materials.append(bpy.data.materials.new("Grey"))
    for name in ("Floor", "Floor.piece.003", "Grey", "Cube"):
        assert is_known(bpy.context, name)
    bpy.context.scene["keeps"] = bpy.data.objects["Cube"]
    for name in ("Floor", "Cube"):
        bpy.context.view_layer.objects.active = bpy.data.objects[name]
        bpy.ops.object.select_all(action="DESELECT")
        bpy.data.objects[name].select_set(True)
        bpy.ops.object.delete()
    assert ("Floor" in bpy.data.objects, "Floor" in bpy.data.meshes, "Cube" in bpy.data.objects) == (False, True, True)
    for name in ("Floor", "Floor.piece.003", "Cube"):
        assert not is_known(bpy.context, name)


def test_button_tells_what_it_cannot_select():
    assert bpy.ops.leaflight.select(names="Gone") == {"CANCELLED"}
    bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
    bpy.ops.object.mode_set(mode="EDIT")
    assert not bpy.ops.leaflight.select.poll()
    bpy.ops.object.mode_set(mode="OBJECT")
