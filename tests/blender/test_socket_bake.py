"""Colours that only Blender can evaluate are evaluated by it, on the very mesh, and nothing of the file changes."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_mesh, add_object, make_material
from leaflight.addon.nodes import socket_bake
from leaflight.addon.nodes.object_attributes import find_random
from leaflight.addon.read.export_scene import export_scene
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.normal_maps import NormalMaps

pytestmark = pytest.mark.usefixtures("empty_file")


def add_floor(name="Floor", size=4.0):
    half = size / 2
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    floor = add_mesh(name, corners, [(0, 1, 2, 3)])
    layer = floor.data.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", np.float32([0, 0, 1, 0, 1, 1, 0, 1]))
    return floor


def add_material(obj, name="Paint"):
    material = make_material(name)
    obj.data.materials.append(material)
    tree = material.node_tree
    return material, tree, tree.nodes["Principled BSDF"]


def checker_color(tree, source, scale):
    """Output of a checker of black and white squares, mapped by a coordinate."""
    checker, coordinates = tree.nodes.new("ShaderNodeTexChecker"), tree.nodes.new("ShaderNodeTexCoord")
    checker.inputs["Color1"].default_value, checker.inputs["Color2"].default_value = (0.9, 0.6, 0.3, 1.0), (0.1, 0.1, 0.1, 1.0)
    checker.inputs["Scale"].default_value = scale
    tree.links.new(coordinates.outputs[source], checker.inputs["Vector"])
    return checker.outputs["Color"]


def probe(result, name, places, emission=False):
    """(n, 3) albedo, or emission, at places (n, 2) of a level object of two triangles, seen from above."""
    snapshot = result.snapshot
    number = [one.name for one in snapshot.objects].index(name)
    tri = np.flatnonzero(snapshot.tri_object == number)
    surfaces = SurfaceMaterials(snapshot)
    read = surfaces.emission.at if emission else surfaces.albedo.at
    out = []
    for place in places:
        for one in tri:
            a, b, c = snapshot.vertex_position[snapshot.tri_vertex[one]][:, :2]
            u, v = np.linalg.solve(np.stack([b - a, c - a], axis=1), np.asarray(place) - a)
            if min(u, v, 1 - u - v) >= -1e-9:
                out.append(read(np.array([one]), np.float32([u]), np.float32([v]))[0])
                break
    return np.array(out)


def list_blocks():
    kinds = ("objects", "meshes", "materials", "images", "scenes", "node_groups")
    return {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in kinds}


SQUARES = np.array([(x + 0.5, y + 0.5) for x in (-2, -1, 0, 1) for y in (-2, -1, 0, 1)])
IS_LIGHT = (np.floor(SQUARES[:, 0]) + np.floor(SQUARES[:, 1])) % 2 == 0


def assert_squares(rgb, light=(0.9, 0.6, 0.3), dark=(0.1, 0.1, 0.1)):
    """The height of the plane decides which squares are the light ones."""
    is_light = (np.abs(rgb[IS_LIGHT] - light).max() < 0.1) == IS_LIGHT
    assert rgb[is_light] == pytest.approx(np.tile(light, (8, 1)), abs=0.005)
    assert rgb[~is_light] == pytest.approx(np.tile(dark, (8, 1)), abs=0.005)


@pytest.mark.parametrize("source", ["Object", "UV", "Generated"])
def test_a_checker_floor_has_its_squares(source):
    _, tree, shader = add_material(add_floor())
    scale = 1.0 if source == "Object" else 4.0
    tree.links.new(checker_color(tree, source, scale), shader.inputs["Base Color"])
    before = list_blocks()
    result = export_scene(bpy.context)
    assert_squares(probe(result, "Floor", SQUARES))
    assert not [text for _, text in result.warnings if "simplified" in text]
    assert list_blocks() == before


def test_colours_in_groups_and_behind_other_nodes_are_evaluated():
    _, tree, shader = add_material(add_floor())
    group = bpy.data.node_groups.new("Tiles", "ShaderNodeTree")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    end, invert = group.nodes.new("NodeGroupOutput"), group.nodes.new("ShaderNodeInvert")
    group.links.new(checker_color(group, "Object", 1.0), invert.inputs["Color"])
    group.links.new(invert.outputs[0], end.inputs[0])
    holder = tree.nodes.new("ShaderNodeGroup")
    holder.node_tree = group
    tree.links.new(holder.outputs[0], shader.inputs["Base Color"])
    before = list_blocks(), [(node.name, len(node.outputs)) for node in tree.nodes], len(group.nodes)
    assert_squares(probe(export_scene(bpy.context), "Floor", SQUARES), (0.1, 0.4, 0.7), (0.9, 0.9, 0.9))
    assert (list_blocks(), [(node.name, len(node.outputs)) for node in tree.nodes], len(group.nodes)) == before


def test_a_shader_in_a_group_has_its_colour_evaluated():
    _, tree, _ = add_material(add_floor())
    group = bpy.data.node_groups.new("Shader", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    end, diffuse = group.nodes.new("NodeGroupOutput"), group.nodes.new("ShaderNodeBsdfDiffuse")
    group.links.new(checker_color(group, "Object", 1.0), diffuse.inputs["Color"])
    group.links.new(diffuse.outputs[0], end.inputs[0])
    holder = tree.nodes.new("ShaderNodeGroup")
    holder.node_tree = group
    tree.links.new(holder.outputs[0], tree.get_output_node("ALL").inputs["Surface"])
    assert_squares(probe(export_scene(bpy.context), "Floor", SQUARES))


def test_emission_keeps_what_is_brighter_than_white():
    _, tree, shader = add_material(add_floor())
    tree.links.new(checker_color(tree, "Object", 1.0), shader.inputs["Emission Color"])
    shader.inputs["Emission Strength"].default_value = 20.0
    assert_squares(probe(export_scene(bpy.context), "Floor", SQUARES, emission=True) / 20.0)


def test_an_evaluated_number_mixes_with_an_evaluated_colour():
    _, tree, shader = add_material(add_floor())
    metal = tree.nodes.new("ShaderNodeTexChecker")
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    metal.inputs["Scale"].default_value = 1.0
    tree.links.new(coordinates.outputs["Object"], metal.inputs["Vector"])
    ramp = tree.nodes.new("ShaderNodeMapRange")
    ramp.inputs["To Max"].default_value = 0.5
    tree.links.new(metal.outputs["Fac"], ramp.inputs["Value"])
    tree.links.new(ramp.outputs[0], shader.inputs["Metallic"])
    tree.links.new(checker_color(tree, "Object", 1.0), shader.inputs["Base Color"])
    rgb = probe(export_scene(bpy.context), "Floor", SQUARES)
    assert len(np.unique(rgb[:, 0].round(2))) == 2
    assert rgb[:, 0].max() < 0.91


def test_without_cycles_the_reader_s_own_colour_is_taken(monkeypatch):
    _, tree, shader = add_material(add_floor())
    tree.links.new(checker_color(tree, "Object", 1.0), shader.inputs["Base Color"])
    before = list_blocks()
    monkeypatch.setattr(socket_bake, "bake_socket", lambda *_, **__: None)
    result = export_scene(bpy.context)
    assert probe(result, "Floor", [(0.5, 0.5)])[0] == pytest.approx((0.5, 0.35, 0.2), abs=1e-3)
    assert any("is approximated" in text for _, text in result.warnings)
    assert list_blocks() == before


def test_each_object_has_the_colour_of_its_place():
    first = add_floor("First")
    _, tree, shader = add_material(first)
    add_object("Second", first.data, location=(10.0, 0.0, 1.0))
    geometry, split, scale = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("NewGeometry", "SeparateXYZ", "Math"))
    scale.operation, scale.inputs[1].default_value = "MULTIPLY", 0.05
    tree.links.new(geometry.outputs["Position"], split.inputs[0])
    tree.links.new(split.outputs["X"], scale.inputs[0])
    tree.links.new(scale.outputs[0], shader.inputs["Base Color"])
    result = export_scene(bpy.context)
    assert probe(result, "First", [(1.0, 0.3)])[0, 0] == pytest.approx(0.05, abs=0.002)
    assert probe(result, "Second", [(11.0, 0.3)])[0, 0] == pytest.approx(0.55, abs=0.002)


def test_coordinates_of_the_camera_are_those_of_the_scenes_own():
    _, tree, shader = add_material(add_floor())
    camera = add_object("Camera", bpy.data.cameras.new("Camera"), location=(-8.0, 0.0, 5.0))
    bpy.context.scene.camera = camera
    coordinates, split, scale = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "SeparateXYZ", "Math"))
    scale.operation, scale.inputs[1].default_value = "MULTIPLY", 0.05
    tree.links.new(coordinates.outputs["Camera"], split.inputs[0])
    tree.links.new(split.outputs["X"], scale.inputs[0])
    tree.links.new(scale.outputs[0], shader.inputs["Base Color"])
    assert probe(export_scene(bpy.context), "Floor", [(1.0, 0.3)])[0, 0] == pytest.approx(0.45, abs=0.002)


def test_what_is_made_of_an_objects_random_number_has_it():
    _, tree, shader = add_material(add_floor("Chair"))
    info, wires, total = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("ObjectInfo", "Wireframe", "Math"))
    total.operation = "ADD"
    tree.links.new(info.outputs["Random"], total.inputs[0])
    tree.links.new(wires.outputs[0], total.inputs[1])
    tree.links.new(total.outputs[0], shader.inputs["Base Color"])
    result = export_scene(bpy.context)
    assert probe(result, "Chair", [(1.0, 0.3)])[0, 0] == pytest.approx(find_random("Chair"), abs=1 / 128)
    assert not [text for _, text in result.warnings if "simplified" in text]


def test_colours_beside_an_alpha_that_is_used_are_not_multiplied_by_it():
    _, tree, shader = add_material(add_floor())
    node, wires, total = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "Wireframe", "VectorMath"))
    node.image = bpy.data.images.new("Leaf", 2, 2, alpha=True)
    node.image.pixels.foreach_set(np.tile(np.float32([0.8, 0.8, 0.8, 0.5]), 4))
    node.image.pack()
    tree.links.new(node.outputs["Color"], total.inputs[0])
    tree.links.new(wires.outputs[0], total.inputs[1])
    tree.links.new(total.outputs[0], shader.inputs["Base Color"])
    tree.links.new(node.outputs["Alpha"], shader.inputs["Alpha"])
    rgb = probe(export_scene(bpy.context), "Floor", [(1.0, 0.3)])[0]
    assert rgb == pytest.approx(np.full(3, 0.5 * 0.604), abs=0.01)  # 0.07 where it is multiplied


def test_what_eevee_alone_evaluates_is_named():
    _, tree, shader = add_material(add_floor())
    tree.links.new(tree.nodes.new("ShaderNodeShaderToRGB").outputs["Color"], shader.inputs["Base Color"])
    result = export_scene(bpy.context)
    assert probe(result, "Floor", [(1.0, 0.3)])[0] == pytest.approx((0.5, 0.5, 0.5), abs=1e-3)
    assert any("node Shader to RGB is replaced by a grey of 0.5" in text for _, text in result.warnings)


def test_modifiers_and_bent_faces_are_where_they_are():
    floor = add_floor()
    _, tree, shader = add_material(floor)
    tree.links.new(checker_color(tree, "Object", 1.0), shader.inputs["Base Color"])
    array = floor.modifiers.new("Array", "ARRAY")
    array.use_relative_offset, array.use_constant_offset, array.constant_offset_displace = False, True, (4.0, 0.0, 0.0)
    result = export_scene(bpy.context)
    assert_squares(probe(result, "Floor", SQUARES))
    assert_squares(probe(result, "Floor", SQUARES + np.array([4.0, 0.0])))


def test_what_only_a_camera_sees_is_left_to_the_reader():
    _, tree, shader = add_material(add_floor())
    mix, path = tree.nodes.new("ShaderNodeMix"), tree.nodes.new("ShaderNodeLightPath")
    mix.data_type = "RGBA"
    colors = [socket for socket in mix.inputs if socket.type == "RGBA"]
    colors[0].default_value = (0.2, 0.4, 0.6, 1.0)
    tree.links.new(checker_color(tree, "Object", 1.0), colors[1])
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(next(socket for socket in mix.outputs if socket.type == "RGBA"), shader.inputs["Base Color"])
    result = export_scene(bpy.context)
    assert probe(result, "Floor", [(0.5, 0.5)])[0] == pytest.approx((0.2, 0.4, 0.6), abs=1e-3)


def read_normals(result, name="Floor"):
    snapshot = result.snapshot
    number = [one.name for one in snapshot.objects].index(name)
    tri = np.flatnonzero(snapshot.tri_object == number)
    maps = NormalMaps.of(snapshot)
    third = np.full(len(tri), 1.0 / 3.0, np.float32)
    side = snapshot.tri_normal[tri, 0].T
    return maps.look_up(tri, third, third, side)[1].T


@pytest.mark.parametrize("flipped", [False, True])
def test_a_normal_map_is_read_in_the_world(flipped):
    floor = add_floor()
    floor.rotation_euler.z = np.pi / 2
    if flipped:
        floor.data.flip_normals()
    _, tree, shader = add_material(floor)
    node = tree.nodes.new("ShaderNodeNormalMap")
    node.inputs["Color"].default_value = (0.8, 0.5, 0.9, 1.0)  # 0.6 along u, 0.8 ahead
    tree.links.new(node.outputs[0], shader.inputs["Normal"])
    result = export_scene(bpy.context)
    ahead = -0.8 if flipped else 0.8
    assert read_normals(result) == pytest.approx(np.tile((0.0, 0.6, ahead), (2, 1)), abs=1e-3)
    assert not [text for _, text in result.warnings if "simplified" in text]


def test_a_displacement_is_read_as_the_bump_that_cycles_shades():
    """A slope of 0.5 along x, by twice the height of half a ramp."""
    floor = add_floor()
    floor.data.materials.clear()
    material, tree, _ = add_material(floor)
    material.displacement_method = "BUMP"
    place, part, height = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "SeparateXYZ", "Displacement"))
    tree.links.new(place.outputs["Object"], part.inputs[0])
    tree.links.new(part.outputs["X"], height.inputs["Height"])
    height.inputs["Scale"].default_value = 0.5
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    tree.links.new(height.outputs[0], output.inputs["Displacement"])
    result = export_scene(bpy.context)
    assert read_normals(result) == pytest.approx(np.tile(np.array([-0.5, 0.0, 1.0]) / np.sqrt(1.25), (2, 1)), abs=1e-2)
    assert not [text for _, text in result.warnings if "simplified" in text]
    material.displacement_method = "BOTH"
    result = export_scene(bpy.context)
    assert [text for _, text in result.warnings if text.endswith("simplified: displacement is left out")]
    assert any(one.normal_image >= 0 for one in result.snapshot.materials)
    tree.links.new(part.outputs["X"], output.inputs["Displacement"])
    assert any("its bump by displacement is left out" in text for _, text in export_scene(bpy.context).warnings)


def test_occlusion_by_other_objects_is_named():
    _, tree, shader = add_material(add_floor())
    node = tree.nodes.new("ShaderNodeAmbientOcclusion")
    node.samples = 1
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    for node.only_local in (False, True):
        told = [text for _, text in export_scene(bpy.context).warnings if "Ambient Occlusion" in text]
        assert len(told) == (not node.only_local)


def test_colours_by_reflection_are_left_to_the_reader():
    _, tree, shader = add_material(add_floor())
    place, checker = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexChecker")
    tree.links.new(place.outputs["Reflection"], checker.inputs["Vector"])
    tree.links.new(checker.outputs["Color"], shader.inputs["Base Color"])
    assert any("simplified" in text for _, text in export_scene(bpy.context).warnings)


def test_of_objects_that_only_cast_light_no_normals_are_read():
    floor, other = add_floor(), add_floor("Other")
    _, tree, shader = add_material(floor)
    other.data.materials.append(floor.data.materials[0])
    tree.links.new(tree.nodes.new("ShaderNodeBump").outputs[0], shader.inputs["Normal"])
    result = export_scene(bpy.context, objects=["Floor"])
    shown = {m.normal_image >= 0 for m in result.snapshot.materials}
    assert shown == {True, False}
    assert not [text for _, text in result.warnings if "simplified" in text]


def write_movie(folder, colors):
    """A movie of frames of one colour each, (n, 3) of sRGB, without loss."""
    names, side = [], 16
    for number, rgb in enumerate(colors):
        image = bpy.data.images.new("Frame", side, side)
        image.pixels.foreach_set(np.tile(np.float32([*rgb, 1.0]), side * side))
        names.append(f"frame{number}.png")
        image.filepath_raw, image.file_format = str(folder / names[-1]), "PNG"
        image.save()
        bpy.data.images.remove(image)
    scene = bpy.data.scenes.new("Movie")
    strip = scene.sequence_editor_create().strips.new_image("Frames", str(folder / names[0]), 1, 1)
    for name in names[1:]:
        strip.elements.append(name)
    scene.frame_start, scene.frame_end = 1, len(names)
    scene.render.resolution_x = scene.render.resolution_y = side
    scene.view_settings.view_transform = "Standard"
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # since Blender 5.0
        settings.media_type = "VIDEO"
    settings.file_format = "FFMPEG"
    scene.render.ffmpeg.format, scene.render.ffmpeg.codec = "AVI", "HUFFYUV"
    scene.render.filepath, scene.render.use_file_extension = str(folder / "movie.avi"), False
    bpy.ops.render.render(animation=True, scene=scene.name)
    bpy.data.scenes.remove(scene)
    return folder / "movie.avi"


def add_movie(path):
    """A floor that shows a movie of three frames."""
    floor = add_floor()
    _, tree, shader = add_material(floor)
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.load(str(path))
    node.image.source = "MOVIE"
    node.image_user.frame_duration, node.image_user.use_auto_refresh = 3, True
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])


def test_a_movie_shows_the_scenes_frame(tmp_path):
    rgb = np.array([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
    add_movie(write_movie(tmp_path, 0.8 * rgb))
    for frame in (1, 2, 3):
        bpy.context.scene.frame_set(frame)
        result = export_scene(bpy.context)
        assert not result.warnings
        assert probe(result, "Floor", [(0.3, 0.4)])[0] == pytest.approx(0.6038 * rgb[frame - 1], abs=0.01)


def test_without_cycles_a_movie_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(socket_bake, "_bake_emission", lambda *_: False)
    add_movie(write_movie(tmp_path, np.ones((3, 3))))
    result = export_scene(bpy.context)
    assert any("image movie.avi is a movie, a constant is used" in text for _, text in result.warnings)
