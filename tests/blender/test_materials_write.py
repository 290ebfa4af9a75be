"""What baked materials show, by rendering them, and which materials they leave alone."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object, make_material
from leaflight.addon.read import uv_layer
from leaflight.addon.show import images, materials_write

PAGE = (np.arange(3 * 5 * 3, dtype=np.float32).reshape(3, 5, 3) + 1) / 8.0  # up to 5.6: light is brighter than 1


@pytest.fixture
def plane():
    """A plane that fills 5 x 3 pixels of the camera's picture, with our UV layer over it."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    mesh = bpy.data.meshes.new("Plane")
    mesh.from_pydata([(0, 0, 0), (5, 0, 0), (5, 3, 0), (0, 3, 0)], [], [(0, 1, 2, 3)])
    mesh.uv_layers.new(name="UVMap")
    uv_layer.write_layer(mesh, np.array([[0, 0], [1, 0], [1, 1], [0, 1]]))
    return add_object("Plane", mesh)


def page_image(page=PAGE):
    image = images.preview_image("page", page.shape[1], page.shape[0])
    coverage = np.full((*page.shape[:2], 1), 0.25)  # alpha must not change the light
    images.set_pixels(image, np.concatenate([page, coverage], axis=2))
    return image


def render(tmp_path):
    """(3, 5, 3) linear pixels of the plane, row 0 at the bottom."""
    camera = bpy.data.cameras.new("Camera")
    camera.type, camera.ortho_scale = "ORTHO", 5.0
    scene = bpy.context.scene
    scene.camera = add_object("Camera", camera)
    scene.camera.location = (2.5, 1.5, 2.0)
    scene.render.engine, scene.cycles.samples, scene.cycles.pixel_filter_type = "CYCLES", 1, "BOX"
    scene.cycles.filter_width = 0.01  # pixel centres only, where linear interpolation gives the texel itself
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x = scene.render.resolution_y = 5  # Blender renders no fewer than 4 rows
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(tmp_path / "render.exr")
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(str(tmp_path / "render.exr"))
    return np.array(picture.pixels[:], dtype=np.float32).reshape(5, 5, 4)[1:4, :, :3]


def test_combined_shows_the_image_alone(plane, tmp_path):
    plane.data.materials.append(make_material("Any"))
    assert materials_write.assign([(plane, page_image())]) == []
    np.testing.assert_allclose(render(tmp_path), PAGE, rtol=0.03)


def test_linked_duplicates_show_their_own_parts_of_a_page(plane, tmp_path):
    plane.data.materials.append(make_material("Any"))
    twin = add_object("Twin", plane.data)
    twin.location.y = -100  # out of the picture
    page = np.tile(PAGE, (3, 2, 1))
    page[3:6, 5:] *= 0.5
    uv_layer.write_place(plane, np.array([0.5, 1 / 3, 0.0, 0.0]))
    uv_layer.write_place(twin, np.array([0.5, 1 / 3, 0.5, 1 / 3]))
    image = page_image(page)
    assert materials_write.assign([(plane, image), (twin, image)]) == []
    assert plane.material_slots[0].material == twin.material_slots[0].material
    np.testing.assert_allclose(render(tmp_path), PAGE, rtol=0.03)
    plane.location.y, twin.location.y = 100, 0
    np.testing.assert_allclose(render(tmp_path), 0.5 * PAGE, rtol=0.03)


@pytest.mark.parametrize("mode", materials_write.MODES)
def test_solid_view_shows_no_page_that_objects_share(plane, mode):
    """It knows no place on the page, and without an active image it shows any that the tree has."""
    plane.data.materials.append(make_material("Any"))
    uv_layer.write_place(plane, np.array([0.5, 1 / 3, 0.0, 0.0]))
    materials_write.assign([(plane, page_image())], mode)
    tree = plane.material_slots[0].material.node_tree
    shown = [node for node in tree.nodes if node.show_texture]
    assert [(node.type, node.image, node.outputs["Color"].is_linked) for node in shown] == [("TEX_IMAGE", None, False)]
    assert tree.nodes.active == shown[0]
    assert "leaflight_made" in shown[0]
    materials_write.uncover(plane)
    assert [node.type for node in plane.material_slots[0].material.node_tree.nodes if node.type == "TEX_IMAGE"] == []


def principled(material):
    node = material.node_tree.nodes["Principled BSDF"]
    node.inputs["Base Color"].default_value = (0.5, 0.25, 0.125, 1)


def principled_glowing(material):
    principled(material)
    node = material.node_tree.nodes["Principled BSDF"]
    node.inputs["Emission Color"].default_value = (0.0, 1.0, 0.0, 1)
    node.inputs["Emission Strength"].default_value = 2.0


def linked_color_behind_mix_and_reroute(material):
    tree = material.node_tree
    tree.nodes.remove(tree.nodes["Principled BSDF"])
    color, diffuse = tree.nodes.new("ShaderNodeRGB"), tree.nodes.new("ShaderNodeBsdfDiffuse")
    color.outputs[0].default_value = (0.5, 0.25, 0.125, 1)
    mix, reroute = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("NodeReroute")
    tree.links.new(diffuse.inputs["Color"], color.outputs[0])
    tree.links.new(mix.inputs[1], tree.nodes.new("ShaderNodeBsdfTransparent").outputs[0])
    tree.links.new(reroute.inputs[0], diffuse.outputs[0])
    tree.links.new(mix.inputs[2], reroute.outputs[0])
    tree.links.new(tree.nodes["Material Output"].inputs["Surface"], mix.outputs[0])


def emission_only(material):
    tree = material.node_tree
    tree.nodes.remove(tree.nodes["Principled BSDF"])
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value, emission.inputs["Strength"].default_value = (1, 0.5, 0.25, 1), 4.0
    tree.links.new(tree.nodes["Material Output"].inputs["Surface"], emission.outputs[0])


BASE = np.array([0.5, 0.25, 0.125])


@pytest.mark.parametrize(
    ("build", "expected"),
    [
        (principled, PAGE * BASE),
        (principled_glowing, PAGE * BASE + [0, 2, 0]),
        (linked_color_behind_mix_and_reroute, PAGE * BASE),
        (emission_only, np.broadcast_to([4.0, 2.0, 1.0], PAGE.shape)),
    ],
)
def test_lighting_shows_light_times_base_color_plus_emission(plane, tmp_path, build, expected):
    material = make_material("Any")
    build(material)
    plane.data.materials.append(material)
    assert materials_write.assign([(plane, page_image())], "lighting") == []
    np.testing.assert_allclose(render(tmp_path), expected, rtol=0.03)


MASK = np.array([1.0, 0.0, 1.0, 1.0, 0.0], np.float32)  # of columns


def add_mask(tree):
    """A socket of MASK over the user's own layer."""
    image = bpy.data.images.new("mask", 5, 1, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(np.repeat(MASK, 4))
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation = image, "Closest"
    return node.outputs[0]


def alpha_of_principled(tree, surface):
    tree.links.new(tree.nodes["Principled BSDF"].inputs["Alpha"], add_mask(tree))


def mix_with_gaps(tree, surface, first=False):
    mix, gap, bend = (tree.nodes.new(kind) for kind in ("ShaderNodeMixShader", "ShaderNodeBsdfTransparent", "NodeReroute"))
    inside = [gap.outputs[0], tree.nodes["Principled BSDF"].outputs[0]]
    if first:
        invert = tree.nodes.new("ShaderNodeInvert")
        tree.links.new(invert.inputs["Color"], add_mask(tree))
        inside.reverse()
    tree.links.new(mix.inputs[0], invert.outputs[0] if first else add_mask(tree))
    for number, source in enumerate(inside):
        tree.links.new(mix.inputs[1 + number], source)
    tree.links.new(bend.inputs[0], mix.outputs[0])
    tree.links.new(surface, bend.outputs[0])


def mix_with_gaps_turned(tree, surface):
    mix_with_gaps(tree, surface, first=True)


def constant_alpha(tree, surface):
    tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.7  # what is baked is already less for it


@pytest.mark.parametrize("mode", ["combined", "lighting"])
@pytest.mark.parametrize("build", [alpha_of_principled, mix_with_gaps, mix_with_gaps_turned, constant_alpha])
def test_gaps_of_leaves_stay_gaps(plane, tmp_path, build, mode):
    plane.data.uv_layers["UVMap"].uv.foreach_set("vector", np.array([0, 0, 1, 0, 1, 1, 0, 1], np.float32))
    material = make_material("Leaf")
    tree = material.node_tree
    tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    build(tree, tree.get_output_node("CYCLES").inputs["Surface"])
    plane.data.materials.append(material)
    assert materials_write.assign([(plane, page_image())], mode) == []
    mask = np.ones_like(MASK) if build is constant_alpha else MASK
    np.testing.assert_allclose(render(tmp_path), PAGE * mask[None, :, None], rtol=0.03)


def put_into_group(material, depth=1):
    """What feeds the material's output moves into a group, that one into another, and so on; the mask's layer stays outside."""
    tree, tree_below = material.node_tree, None
    for level in range(depth):
        group = bpy.data.node_groups.new(f"Leaf {level}", "ShaderNodeTree")
        group.interface.new_socket("Surface", in_out="OUTPUT", socket_type="NodeSocketShader")
        end = group.nodes.new("NodeGroupOutput")
        if level:
            inner = group.nodes.new("ShaderNodeGroup")
            inner.node_tree = tree_below
        else:
            inner = group.nodes.new("ShaderNodeMixShader")
            glow, gap = group.nodes.new("ShaderNodeBsdfDiffuse"), group.nodes.new("ShaderNodeBsdfTransparent")
            color = group.nodes.new("ShaderNodeRGB")
            color.outputs[0].default_value = (*BASE, 1)
            for socket, source in zip(inner.inputs, (add_mask(group), gap.outputs[0], glow.outputs[0]), strict=True):
                group.links.new(socket, source)
            group.links.new(glow.inputs["Color"], color.outputs[0])
        group.links.new(end.inputs[0], inner.outputs[0])
        tree_below = group
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = tree_below
    tree.links.new(tree.get_output_node("CYCLES").inputs["Surface"], node.outputs[0])


@pytest.mark.parametrize("depth", [1, 2])
@pytest.mark.parametrize("mode", ["combined", "lighting"])
def test_a_grouped_shader_keeps_its_gaps_and_color(plane, tmp_path, mode, depth):
    plane.data.uv_layers["UVMap"].uv.foreach_set("vector", np.array([0, 0, 1, 0, 1, 1, 0, 1], np.float32))
    material = make_material("Leaf")
    put_into_group(material, depth)
    plane.data.materials.append(material)
    before = {group.name: (len(group.nodes), len(group.interface.items_tree)) for group in bpy.data.node_groups}
    assert materials_write.assign([(plane, page_image())], mode) == []
    expected = PAGE * MASK[None, :, None] * (BASE if mode == "lighting" else 1.0)
    np.testing.assert_allclose(render(tmp_path), expected, rtol=0.03)
    materials_write.hide([plane])
    after = {group.name: (len(group.nodes), len(group.interface.items_tree)) for group in bpy.data.node_groups}
    assert after == before


def test_lighting_without_a_material_is_on_blenders_default_grey(plane, tmp_path):
    assert materials_write.assign([(plane, page_image())], "lighting") == []
    np.testing.assert_allclose(render(tmp_path), 0.8 * PAGE, rtol=0.03)


@pytest.mark.skipif(bpy.app.version >= (5, 0, 0), reason="materials always have nodes from 5.0 on")
def test_material_without_nodes_uses_its_viewport_color(plane, tmp_path):
    material = bpy.data.materials.new("No nodes")
    material.diffuse_color = (*BASE, 1)
    plane.data.materials.append(material)
    materials_write.assign([(plane, page_image())], "lighting")
    np.testing.assert_allclose(render(tmp_path), PAGE * BASE, rtol=0.03)
    assert not material.use_nodes


def test_color_in_a_group_is_said(plane):
    material = make_material("Grouped")
    tree = material.node_tree
    tree.nodes.remove(tree.nodes["Principled BSDF"])
    group = bpy.data.node_groups.new("Inside", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    tree.links.new(tree.nodes["Material Output"].inputs["Surface"], node.outputs[0])
    plane.data.materials.append(material)
    ((subject, sentence),) = materials_write.assign([(plane, page_image())], "lighting")
    assert subject == "Grouped"
    assert sentence.startswith("Grouped: no diffuse base colour was found")


def test_nodes_mode_places_marked_nodes_and_links_nothing(plane):
    material = make_material("Any")
    plane.data.materials.append(material)
    image = page_image()
    materials_write.assign([(plane, image)], "nodes")
    tree = plane.material_slots[0].material.node_tree
    assert tree.nodes["Material Output"].inputs["Surface"].links[0].from_node.type == "BSDF_PRINCIPLED"
    ours = {node.type: node for node in tree.nodes if "leaflight_made" in node}
    assert sorted(ours) == ["FRAME", "TEX_IMAGE", "UVMAP"]
    texture = ours["TEX_IMAGE"]
    assert (ours["UVMAP"].uv_map, texture.image, texture.interpolation, texture.extension) == ("Leaflight", image, "Linear", "EXTEND")
    assert ours["FRAME"].label == "Leaflight"


def test_objects_that_share_mesh_or_material_but_are_not_baked_keep_theirs(plane):
    material = make_material("Shared")
    plane.data.materials.append(material)
    twin = add_object("Twin", plane.data)
    other = add_object("Other", bpy.data.meshes.new("Other"))
    other.data.materials.append(material)
    materials_write.assign([(plane, page_image())])
    assert plane.material_slots[0].material != material
    assert [twin.material_slots[0].material, other.material_slots[0].material, plane.data.materials[0]] == [material] * 3
    assert "leaflight_made" not in material
    assert [node.name for node in material.node_tree.nodes if node.label == "Leaflight"] == []


def test_linked_duplicates_can_show_different_images(plane):
    plane.data.materials.append(make_material("Shared"))
    twin = add_object("Twin", plane.data)
    first, second = page_image(), page_image()
    materials_write.assign([(plane, first), (twin, second)])
    shown = [next(n for n in obj.material_slots[0].material.node_tree.nodes if n.type == "TEX_IMAGE").image for obj in (plane, twin)]
    assert shown == [first, second]


def test_what_cannot_be_edited_is_skipped_with_a_sentence(plane, tmp_path):
    curve = add_object("Wire", bpy.data.curves.new("Wire", "CURVE"))
    no_layer = add_object("Plain", bpy.data.meshes.new("Plain"))
    library = tmp_path / "library.blend"
    bpy.data.libraries.write(str(library), {plane})
    with bpy.data.libraries.load(str(library), link=True) as (_, target):
        target.objects = ["Plane"]
    linked = target.objects[0]
    image = page_image()
    warnings = dict(materials_write.assign([(obj, image) for obj in (curve, no_layer, linked)]))
    assert "is not a mesh" in warnings["Wire"]
    assert "has no UV layer" in warnings["Plain"]
    assert "is linked from another file" in warnings["Plane"]
    with pytest.raises(ValueError, match="mode: expected one of combined"):
        materials_write.assign([], "unlit")


def test_material_copies_are_no_assets_and_have_no_fake_user(plane):
    material = make_material("Asset")
    material.use_fake_user = True
    material.asset_mark()
    plane.data.materials.append(material)
    materials_write.assign([(plane, page_image())])
    copy = plane.material_slots[0].material
    assert (copy.asset_data, copy.use_fake_user, copy.users) == (None, False, 1)
    assert material.asset_data
    assert material.use_fake_user
