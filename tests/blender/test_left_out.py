"""What of a scene no bake sees is told."""

import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import open_room, save_scene
from leaflight.addon.read.export_scene import export_scene


@pytest.fixture(autouse=True)
def _room():
    open_room()


def told(*words):
    return [(subject, text) for subject, text in export_scene(bpy.context).warnings if any(word in text for word in words)]


@pytest.mark.parametrize("change", ["", "as objects", "hidden modifier", "hidden object", "none"])
def test_particle_hair_is_told_where_it_renders(change):
    cube = bpy.data.objects["Cube"]
    cube.modifiers.new("Fur", "PARTICLE_SYSTEM")
    settings = cube.particle_systems[0].settings
    settings.type, settings.count = "HAIR", 0 if change == "none" else 5
    settings.render_type = "OBJECT" if change == "as objects" else "PATH"
    cube.modifiers["Fur"].show_render = change != "hidden modifier"
    cube.hide_render = change == "hidden object"
    found = told("hair")
    assert [subject for subject, _ in found] == ([] if change else ["Cube"])
    assert change or "convert it to a mesh" in found[0][1]


@pytest.mark.parametrize(("kind", "what"), [("hair_curves", "strands of hair"), ("pointclouds", "points")])
def test_objects_of_strands_and_points_are_told(kind, what):
    data = getattr(bpy.data, kind).new("Grass")
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Grass", data))
    assert told("left out") == [("Grass", f"{what} are left out: they cast neither light nor shadow; convert them to a mesh")]


def test_what_is_missing_in_a_linked_file_is_named(tmp_path):
    for number in range(4):
        bpy.data.objects.new(f"Prop{number}", bpy.data.meshes.new(f"Prop{number}"))
    library = save_scene(tmp_path / "props.blend")
    bpy.data.libraries.write(str(library), set(bpy.data.objects))
    open_room()
    with bpy.data.libraries.load(str(library), link=True, relative=False) as (_, wanted):
        wanted.objects = [f"Prop{number}" for number in range(4)]
    for obj in wanted.objects:
        bpy.context.scene.collection.objects.link(obj)
    scene = save_scene(tmp_path / "scene.blend")
    assert told("not found") == []
    library.unlink()
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    [(subject, text)] = told("not found")
    assert (subject, "props.blend" in text) == ("", True)
    assert text.startswith("Prop0, Prop1, Prop2 and more: not found in the linked file")
