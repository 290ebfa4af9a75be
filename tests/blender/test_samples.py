"""Every sample opens, holds what its README says, and carries nothing of the machine that built it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
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


def triangles_of(mesh) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a mesh.

    out  (n, 3) float64, m;  (m, 3) int32
    """
    mesh.calc_loop_triangles()
    points, corners = np.empty(len(mesh.vertices) * 3), np.empty(len(mesh.loop_triangles) * 3, np.int32)
    mesh.vertices.foreach_get("co", points)
    mesh.loop_triangles.foreach_get("vertices", corners)
    return points.reshape(-1, 3), corners.reshape(-1, 3)


def signed_volume(mesh) -> float:
    """Enclosed volume, m^3, positive where a closed mesh faces outward."""
    points, corners = triangles_of(mesh)
    a, b, c = points[corners].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def open_edges(mesh) -> int:
    """How many edges do not have exactly one face on either side, run through in opposite directions."""
    directed = [edge for face in mesh.polygons for edge in zip(face.vertices, [*face.vertices[1:], face.vertices[0]], strict=True)]
    return len(directed) - len(set(directed)) + sum((b, a) not in set(directed) for a, b in set(directed))


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


@pytest.mark.parametrize("name", SAMPLES)
def test_materials_are_purely_diffuse(name):
    open_sample(name)
    for thing in bpy.data.objects:
        if thing.type != "MESH":
            continue
        assert thing.data.materials, thing.name
        for material in thing.data.materials:
            inputs = principled(material).inputs
            found = [inputs[key].default_value for key in ("Roughness", "Specular IOR Level", "Metallic", "Transmission Weight")]
            assert found == [1, 0, 0, 0], material.name


def test_furnace_encloses_its_camera_and_faces_it():
    scene = open_sample("furnace")
    mesh = scene.objects["Furnace"].data
    assert open_edges(mesh) == 0
    assert signed_volume(mesh) == pytest.approx(-8)
    inputs = principled(mesh.materials[0]).inputs
    assert list(inputs["Base Color"].default_value)[:3] == [0.5, 0.5, 0.5]
    assert list(inputs["Emission Color"].default_value)[:3] == [1, 1, 1]
    assert inputs["Emission Strength"].default_value == 1


def test_cornell_box_faces_its_middle():
    scene = open_sample("cornell_box")
    middle = np.array([0, 2.8, 2.7])
    for name in ("Floor", "Ceiling", "Back wall", "Left wall", "Right wall"):
        face = scene.objects[name].data.polygons[0]
        assert np.dot(face.normal, middle - face.center) > 2, name
    for name in ("Short block", "Tall block"):
        mesh = scene.objects[name].data
        centre = np.mean([vertex.co for vertex in mesh.vertices], axis=0)
        assert all(np.dot(face.normal, np.array(face.center) - centre) > 0 for face in mesh.polygons), name


def test_furniture_is_closed_and_faces_outward():
    for sample, names in (
        ("furnished_room", SAMPLES["furnished_room"].meshes - {"Walls", "Exterior", "Floor", "Ceiling", "Picture"}),
        ("two_rooms", {"Cabinet", "Sideboard", "Bench", "Stool"}),
        ("instances", STEPS | {"Subdivided", "Array modifier", "Turntable", "Turntable child", "Turntable grandchild"}),
        ("figure2_square", {"Blocker"}),
    ):
        scene = open_sample(sample)
        for name in names:
            mesh = scene.objects[name].data
            assert open_edges(mesh) == 0, name
            assert signed_volume(mesh) > 0, name


@pytest.mark.parametrize("name", ["cornell_box", "furnace", "furnished_room", "two_rooms"])
def test_interior_faces_the_camera(name):
    scene = open_sample(name)
    graph, eye = bpy.context.evaluated_depsgraph_get(), scene.camera.location
    hits = 0
    for direction in np.random.default_rng(6).normal(size=(2000, 3)):
        hit, _, normal, _, thing, _ = scene.ray_cast(graph, eye, direction)
        if hit:
            hits += 1
            assert np.dot(normal, direction) < 0, thing.name
    assert hits > (50 if name == "cornell_box" else 1900)


def test_room_texture_is_mapped():
    scene = open_sample("furnished_room")
    floor = scene.objects["Floor"].data
    kinds = {node.type for node in floor.materials[0].node_tree.nodes}
    assert {"TEX_IMAGE", "MAPPING", "UVMAP"} <= kinds
    assert [layer.name for layer in floor.uv_layers] == ["UVMap"]
    assert principled(floor.materials[0]).inputs["Base Color"].is_linked
    pixels = np.array(next(node.image for node in floor.materials[0].node_tree.nodes if node.type == "TEX_IMAGE").pixels)
    assert pixels.reshape(256, 256, 4)[..., :3].std() > 0.02


def test_room_lets_the_sun_in_only_by_the_window():
    """Seen from the sun through every point of floor and ceiling, the room's shell is hit first unless the window is there."""
    scene = open_sample("furnished_room")
    graph = bpy.context.evaluated_depsgraph_get()
    to_sun = scene.objects["Sun"].matrix_world.to_3x3().col[2]
    lit = 0
    for x, y in np.random.default_rng(5).uniform((0.01, 0.01), (4.99, 3.99), (2000, 2)):
        hit, *_ = scene.ray_cast(graph, (x, y, 0.001), to_sun)
        if not hit:
            at_wall = np.array([x, y, 0.001]) - np.array(to_sun) * x / to_sun[0]
            assert 1.1 < at_wall[1] < 2.9
            assert 0.9 < at_wall[2] < 2.2
            lit += 1
    assert lit > 50


def test_two_rooms_share_one_floor_beneath_a_thin_wall():
    scene = open_sample("two_rooms")
    assert len(scene.objects["Floor"].data.polygons) == 1
    partition = np.array([vertex.co for vertex in scene.objects["Partition"].data.vertices])
    assert np.ptp(partition[:, 0]) == pytest.approx(0.1, abs=1e-6)
    floor = np.array([vertex.co for vertex in scene.objects["Floor"].data.vertices])
    assert floor[:, 0].min() < partition[:, 0].min() < partition[:, 0].max() < floor[:, 0].max()
    for name, x in (("Cabinet", 3.1), ("Sideboard", 3.0)):
        thing = scene.objects[name]
        edges = np.array([(thing.matrix_world @ vertex.co)[0] for vertex in thing.data.vertices])
        assert np.abs(edges - x).min() < 1e-6, name
    assert scene.objects["Ceiling light"].location.x < 3


def test_bent_quads_are_bent():
    scene = open_sample("bent_quads")
    twists = []
    for name in ("Bent 0.3", "Bent 0.6", "Bent 1.5"):
        mesh = scene.objects[name].data
        points = np.array([vertex.co for vertex in mesh.vertices])
        a, b, c, d = points[np.array([face.vertices for face in mesh.polygons])].transpose(1, 0, 2)
        assert len(a) == 256
        twists.append(np.abs(a - b + c - d)[:, 2].mean() / 0.125)
    assert np.array(twists) / twists[0] == pytest.approx([1, 2, 5], rel=1e-4)
    # Four independent deviations: twice the noise times the mean of a half-normal.
    assert twists[0] == pytest.approx(2 * 0.3 * np.sqrt(2 / np.pi), rel=0.15)


def test_instances_use_every_way_to_repeat_a_mesh():
    scene = open_sample("instances")
    objects = scene.objects
    assert len({objects[name].data.name for name in STEPS}) == 1
    assert {modifier.type for thing in objects for modifier in thing.modifiers} == {"SUBSURF", "MIRROR", "ARRAY"}
    subdivision = objects["Subdivided"].modifiers[0]
    assert subdivision.levels < subdivision.render_levels
    assert objects["Turntable grandchild"].parent.parent == objects["Turntable"]
    assert {objects[name].instance_collection.name for name in ("Stool instance", "Stool mirrored")} == {"Stool"}
    mirrored, total = 0, 0
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        if instance.object.type == "MESH":
            total += 1
            mirrored += instance.matrix_world.determinant() < 0
    assert (total, mirrored) == (len(SAMPLES["instances"].meshes) + 6, 1 + 3)


def test_figure2_edge_is_above_the_middle_of_the_square():
    """Half the lamp is seen from the middle, and the penumbra is as wide as the lamp: blocker halfway up."""
    scene = open_sample("figure2_square")
    blocker = np.array([vertex.co for vertex in scene.objects["Blocker"].data.vertices])
    lamp = scene.objects["Lamp"]
    assert blocker[:, 0].min() == 0.5
    assert blocker[:, 2].min() * 2 == lamp.location.z == 2
    assert lamp.data.size == pytest.approx(0.3)
    square = np.array([vertex.co for vertex in scene.objects["Square"].data.vertices])
    assert (square.min(axis=0).tolist(), square.max(axis=0).tolist()) == ([0, 0, 0], [1, 1, 0])
