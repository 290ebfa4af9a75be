"""Every sample opens, holds what its README says, and carries nothing of the machine that built it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest

bpy = pytest.importorskip("bpy")

FOLDER = Path(__file__).resolve().parents[2] / "sample_blends"
MAX_BYTES = 1_000_000


class Expected(NamedTuple):
    """What a sample must hold: mesh object names, light types, and the range of its triangle count as placed."""

    meshes: set[str]
    lights: list[str]
    triangles: tuple[int, int]


STEPS = {"Linked 1", "Linked 2", "Linked stretched", "Linked mirrored"}
SAMPLES = {
    "bent_quads": Expected({"Bent 0.3", "Bent 0.6", "Bent 1.5"}, ["POINT", "SUN"], (1536, 1536)),
    "cornell_box": Expected({"Floor", "Ceiling", "Back wall", "Left wall", "Right wall", "Short block", "Tall block"}, ["AREA"], (30, 30)),
    "figure2_square": Expected({"Square", "Blocker"}, ["AREA"], (14, 14)),
    "furnace": Expected({"Furnace"}, [], (12, 12)),
    "furnished_room": Expected(
        {"Walls", "Exterior", "Floor", "Ceiling", "Window frame", "Curtain left", "Curtain right", "Rug", "Table", "Bowl", "Sofa"}
        | {"Chair 1", "Chair 2", "Chair 3", "Chair 4", "Shelf", "Books", "Vase", "Ball", "Picture frame", "Picture"}
        | {"Ceiling lamp", "Floor lamp stand", "Floor lamp shade"},
        ["POINT", "SUN"],
        (1000, 5000),
    ),
    "instances": Expected(
        STEPS | {"Ground", "Subdivided", "Mirror modifier", "Array modifier", "Turntable", "Turntable child", "Turntable grandchild"},
        ["AREA", "POINT"],
        (1000, 5000),
    ),
    "two_rooms": Expected({"Walls", "Floor", "Ceiling", "Partition", "Cabinet", "Sideboard", "Bench", "Stool"}, ["AREA"], (50, 300)),
}


def open_sample(name: str):
    """The opened sample's scene."""
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{name}.blend"), load_ui=False)
    return bpy.context.scene


def placed_triangles() -> int:
    """Triangles of all evaluated instances in the view layer."""
    count = 0
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        if instance.object.type == "MESH":
            mesh = instance.object.to_mesh()
            mesh.calc_loop_triangles()
            count += len(mesh.loop_triangles)
            instance.object.to_mesh_clear()
    return count


def mesh_objects(scene) -> dict:
    """The scene's mesh objects by name."""
    return {thing.name: thing for thing in scene.objects if thing.type == "MESH"}


def principled(material):
    """The Principled node of a material."""
    return next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")


def test_every_file_is_expected_and_every_expected_file_is_there():
    assert {path.stem for path in FOLDER.glob("*.blend")} == set(SAMPLES)


@pytest.mark.parametrize("name", SAMPLES)
def test_holds_what_it_should(name):
    scene, expected = open_sample(name), SAMPLES[name]
    assert set(mesh_objects(scene)) == expected.meshes
    assert sorted(thing.data.type for thing in scene.objects if thing.type == "LIGHT") == expected.lights
    assert expected.triangles[0] <= placed_triangles() <= expected.triangles[1]
    assert expected.lights or any(principled(material).inputs["Emission Strength"].default_value > 0 for material in bpy.data.materials)


@pytest.mark.parametrize("name", SAMPLES)
def test_is_small_and_complete(name):
    scene = open_sample(name)
    path = FOLDER / f"{name}.blend"
    assert path.stat().st_size < MAX_BYTES
    assert path.read_bytes()[:4] == b"\x28\xb5\x2f\xfd", "not saved compressed"
    assert bpy.data.version[:2] == (4, 5), "built with another Blender than the oldest supported"
    assert not bpy.utils.blend_paths(absolute=True, packed=False, local=False), "refers to files outside"
    assert not bpy.data.libraries
    for image in bpy.data.images:
        if image.source in {"FILE", "GENERATED"} and image.users:
            assert image.packed_file, image.name
            assert image.size[0] * image.size[1] == len(image.pixels) / 4 > 0, image.name
    assert scene.render.filepath == "//"


@pytest.mark.parametrize("name", SAMPLES)
def test_is_ready_to_render(name):
    scene = open_sample(name)
    assert scene.camera is not None
    assert (scene.render.engine, scene.view_settings.view_transform) == ("CYCLES", "Standard")
    assert scene.cycles.sample_clamp_indirect == 0
    assert scene.unit_settings.scale_length == 1
