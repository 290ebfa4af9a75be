"""One object's own choices, and that they reach the snapshot."""

import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object, open_room
from leaflight.addon.read import object_settings
from leaflight.addon.read.export_scene import export_scene


@pytest.fixture(autouse=True)
def _room():
    open_room()
    with object_settings.registered():
        yield


def choose(name, **values):
    for key, value in values.items():
        setattr(bpy.data.objects[name].leaflight, key, value)


def export(*names):
    found = export_scene(bpy.context, list(names) or None)
    return {one.name: one for one in found.snapshot.objects}, found


def test_untouched_objects_are_baked_alike():
    objects, _ = export()
    assert {(one.receives, one.sides, one.density_factor) for one in objects.values()} == {(True, "", 1.0)}


def test_choices_reach_the_snapshot():
    choose("Floor", sides="BOTH", density_factor=0.3)
    choose("Cube", role="CAST")
    objects, _ = export()
    assert objects["Floor"].sides == "both"
    assert objects["Floor"].density_factor == 0.3
    assert not objects["Cube"].receives
    assert objects["Cube"].sides == ""
    assert objects["Cube"].casts_shadow


def test_ignored_objects_are_not_there():
    choose("Cube", role="IGNORE")
    choose("Lamp", role="IGNORE")
    objects, found = export()
    assert list(objects) == ["Floor"]
    assert not found.snapshot.lights


@pytest.mark.parametrize("role", ["CAST", "IGNORE"])
def test_nothing_left_to_bake_is_told(role):
    choose("Floor", role=role)
    choose("Cube", role=role)
    with pytest.raises(ValueError, match="nothing to bake"):
        export()
    with pytest.raises(ValueError, match=r"Cube: its Role \(Object properties, Leaflight\) is not Bake"):
        export("Cube")


def test_an_instance_has_its_own_choice_and_that_of_what_it_shows():
    shown = bpy.data.collections.new("Shown")
    shown.objects.link(bpy.data.objects["Cube"])
    bpy.context.scene.collection.objects.unlink(bpy.data.objects["Cube"])
    for name in ("One", "Two"):
        add_object(name, None, instance_type="COLLECTION", instance_collection=shown)
    choose("Cube", density_factor=0.5)
    choose("Two", density_factor=4.0, role="CAST")
    objects, _ = export()
    assert (objects["One.Cube"].receives, objects["One.Cube"].density_factor) == (True, 0.5)
    assert (objects["Two.Cube"].receives, objects["Two.Cube"].density_factor) == (False, 2.0)


def test_choices_of_a_file_hold_where_the_add_on_is_not_enabled(tmp_path):
    choose("Cube", role="CAST")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    object_settings.unregister()
    try:
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
        objects, _ = export()
        assert not objects["Cube"].receives
        assert not hasattr(bpy.types.Object, "leaflight")
    finally:
        object_settings.register()
