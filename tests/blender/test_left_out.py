"""What of a scene no bake sees is told."""

import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object, open_room, save_scene
from leaflight.addon.read.export_scene import export_scene


@pytest.fixture(autouse=True)
def _room():
    open_room()


def told(*words):
    return [(subject, text) for subject, text in export_scene(bpy.context).warnings if any(word in text for word in words)]


def test_volumes_are_named():
    add_object("Smoke", bpy.data.volumes.new("Smoke"))
    assert told("volume") == [("Smoke", "its volume is left out: it casts neither light nor shadow")]


def test_overrides_of_the_view_layer_are_named():
    assert told("Override") == []
    view_layer = bpy.context.view_layer
    view_layer.material_override = bpy.data.materials.new("Clay")
    assert [text[:22] for _, text in told("Override")] == ["Material Override Clay"]
    if hasattr(view_layer, "world_override"):
        view_layer.world_override = bpy.data.worlds.new("Studio")
        assert [text[:21] for _, text in told("World")] == ["World Override Studio"]


def test_an_exposure_of_the_film_is_named():
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.film_exposure = "CYCLES", 2.0
    assert [subject for subject, text in told("Exposure 2 of the film")] == [""]
    scene.cycles.film_exposure = 1.0
    assert told("film") == []


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
