"""Transparent materials and what rays see of objects, as they come into a snapshot."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_mesh, make_material
from leaflight.addon.read.export_scene import export_scene
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import DIFFUSE, GLOSSY, SHADOW, TRANSMISSION

SQUARE = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]


@pytest.fixture(autouse=True)
def _empty():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


class Tree:
    """A material's nodes."""

    def __init__(self, name="Leaf"):
        self.material = make_material(name)
        self.nodes, self.links = self.material.node_tree.nodes, self.material.node_tree.links
        self.nodes.clear()
        self.output = self.nodes.new("ShaderNodeOutputMaterial")

    def add(self, kind, **inputs):
        node = self.nodes.new(f"ShaderNode{kind}")
        for name, value in inputs.items():
            self.feed(node.inputs[name.replace("_", " ")], value)
        return node

    def feed(self, socket, value):
        if isinstance(value, bpy.types.NodeSocket):
            self.links.new(socket, value)
        else:
            socket.default_value = value

    def mix(self, fraction, first, second):
        node = self.nodes.new("ShaderNodeMixShader")
        self.feed(node.inputs[0], fraction)
        self.links.new(node.inputs[1], first.outputs[0])
        self.links.new(node.inputs[2], second.outputs[0])
        return node

    def image(self, alpha):
        """An image of 4 x 4 whose left half has this alpha, and the right half 1."""
        image = bpy.data.images.new("Leaf", 4, 4, alpha=True, float_buffer=True)
        pixels = np.ones((4, 4, 4), np.float32)
        pixels[:, :2, 3] = alpha
        image.pixels.foreach_set(pixels.ravel())
        node = self.nodes.new("ShaderNodeTexImage")
        node.image, node.interpolation = image, "Closest"
        return node

    def wear(self, shader, **flags):
        """The exported scene with a square of this material, in which a floor of its own keeps the bake going."""
        self.links.new(self.output.inputs[0], shader.outputs[0])
        card = add_mesh("Card", SQUARE, [(0, 1, 2, 3)])
        layer = card.data.uv_layers.new(name="UVMap")
        layer.uv.foreach_set("vector", np.float32([0, 0, 1, 0, 1, 1, 0, 1]))
        card.data.materials.append(self.material)
        for name, value in flags.items():
            setattr(card, name, value)
        add_mesh("Floor", SQUARE, [(0, 1, 2, 3)])
        bpy.context.view_layer.update()
        return export_scene(bpy.context)


def passes(exported, kind, x=0.25, view=(0.0, 0.0, 1.0)):
    """What passes the card at (x, 0.2) of its square, in its first triangle, to a viewer in a direction."""
    snapshot = exported.snapshot
    tri = next(i for i, one in enumerate(snapshot.tri_object) if snapshot.objects[one].name == "Card")
    surfaces = SurfaceMaterials(snapshot)
    # The first triangle has corners (0, 0), (1, 0), (1, 1).
    toward = np.float32([view]).T
    return surfaces.passing_at(np.array([tri]), np.float32([x - 0.2]), np.float32([0.2]), kind, toward)[0].tolist()


def test_alpha_is_a_share_that_passes_and_the_rest_reflects():
    tree = Tree()
    exported = tree.wear(tree.add("BsdfPrincipled", Alpha=0.3, Base_Color=(0.5, 0.5, 0.5, 1)))
    assert passes(exported, SHADOW) == pytest.approx([0.7] * 3)
    card = next(one for one in exported.snapshot.materials if one.name == "Leaf")
    assert card.albedo_rgb == pytest.approx((0.15,) * 3)
    assert not [text for _, text in exported.warnings if "simplified" in text]


def test_alpha_may_come_from_an_image():
    tree = Tree()
    image = tree.image(0.25)
    exported = tree.wear(tree.add("BsdfPrincipled", Alpha=image.outputs["Alpha"], Base_Color=(0.5, 0.5, 0.5, 1)))
    assert passes(exported, SHADOW, x=0.3) == pytest.approx([0.75] * 3)
    assert passes(exported, SHADOW, x=0.8) == pytest.approx([0.0] * 3)
    assert all(one.receives for one in exported.snapshot.objects)


def test_backs_that_are_culled_let_light_pass():
    tree = Tree()
    image = tree.image(0.25)
    back = tree.add("NewGeometry").outputs["Backfacing"]
    leaf = tree.add("BsdfPrincipled", Alpha=image.outputs["Alpha"], Base_Color=(0.5, 0.5, 0.5, 1))
    exported = tree.wear(tree.mix(back, leaf, tree.add("BsdfTransparent")))
    below = (0.0, 0.6, -0.8)
    assert passes(exported, SHADOW, x=0.3, view=below) == passes(exported, DIFFUSE, x=0.8, view=below) == pytest.approx([1.0] * 3)
    assert passes(exported, SHADOW) == pytest.approx([0.375] * 3, abs=1e-3), "the mean of its image, which lies on the front alone"
    card = next(one for one in exported.snapshot.materials if one.name == "Leaf")
    assert card.back_rgb == pytest.approx((0.0, 0.0, 0.0))
    assert not card.dark_back


def test_a_window_of_fresnel_mirrors_by_the_angle():
    tree = Tree()
    fresnel = tree.add("Fresnel", IOR=1.5)
    exported = tree.wear(tree.mix(fresnel.outputs[0], tree.add("BsdfTransparent"), tree.add("BsdfGlossy", Roughness=0.0)))
    steep = (0.0, 0.8660254, 0.5)
    assert passes(exported, SHADOW) == pytest.approx([0.96] * 3, abs=1e-3)
    assert passes(exported, SHADOW, view=steep) == pytest.approx([1.0 - 0.0892] * 3, abs=3e-3)
    assert passes(exported, SHADOW, view=(0.0, 0.8660254, -0.5)) == pytest.approx([0.0] * 3, abs=1e-3), "seen from within, all is mirrored"


def test_alpha_may_come_through_a_node():
    tree = Tree()
    value = tree.add("Value")
    value.outputs[0].default_value = 0.0
    exported = tree.wear(tree.add("BsdfPrincipled", Alpha=value.outputs[0]))
    assert passes(exported, SHADOW) == passes(exported, DIFFUSE) == [1.0] * 3
    assert {one.name: one.receives for one in exported.snapshot.objects} == {"Card": False, "Floor": True}


@pytest.mark.parametrize("fraction", [0.25, "image"])
def test_a_transparent_shader_in_a_mix_passes_its_colour(fraction):
    tree = Tree()
    clear, leaf = tree.add("BsdfTransparent", Color=(0.2, 0.4, 0.8, 1)), tree.add("BsdfDiffuse", Color=(0.4, 0.4, 0.4, 1))
    share = tree.image(0.25).outputs["Alpha"] if fraction == "image" else fraction
    exported = tree.wear(tree.mix(share, clear, leaf))
    assert passes(exported, SHADOW, x=0.3) == pytest.approx([0.15, 0.3, 0.6])


def test_a_material_may_let_only_shadow_rays_pass():
    tree = Tree()
    path = tree.add("LightPath")
    exported = tree.wear(tree.mix(path.outputs["Is Shadow Ray"], tree.add("BsdfDiffuse"), tree.add("BsdfTransparent")))
    assert passes(exported, SHADOW) == [1.0] * 3
    assert passes(exported, DIFFUSE) == [0.0] * 3
    assert next(one for one in exported.snapshot.materials if one.name == "Leaf").albedo_rgb == pytest.approx((0.8,) * 3, abs=1e-6)


@pytest.mark.parametrize(("flags", "expected"), [({"visible_shadow": False}, (1, 0)), ({"visible_diffuse": False}, (0, 1))])
def test_objects_that_some_rays_do_not_see_let_them_pass(flags, expected):
    tree = Tree()
    exported = tree.wear(tree.add("BsdfDiffuse"), **flags)
    assert (passes(exported, SHADOW)[0], passes(exported, DIFFUSE)[0]) == expected
    assert all(one.receives for one in exported.snapshot.objects)


@pytest.mark.parametrize(("output", "expected"), [("Is Reflection Ray", (1, 0)), ("Is Camera Ray", (0, 0))])
def test_diffuse_rays_are_reflected_and_come_from_no_camera(output, expected):
    tree = Tree()
    path = tree.add("LightPath")
    exported = tree.wear(tree.mix(path.outputs[output], tree.add("BsdfDiffuse"), tree.add("BsdfTransparent")))
    assert (passes(exported, DIFFUSE)[0], passes(exported, SHADOW)[0]) == expected


@pytest.mark.parametrize(
    ("shader", "flag", "kind"), [("Glossy", "visible_glossy", GLOSSY), ("Glass", "visible_transmission", TRANSMISSION)]
)
def test_objects_may_be_hidden_from_mirrors_or_glass_where_there_are_some(shader, flag, kind):
    tree = Tree()
    exported = tree.wear(tree.add("BsdfDiffuse"), **{flag: False})
    assert not SurfaceMaterials(exported.snapshot).by_kind
    add_floor_of(shader)
    exported = export_scene(bpy.context)
    assert [passes(exported, one)[0] for one in (DIFFUSE, kind, SHADOW)] == [0, 1, 0]
    assert not [text for subject, text in exported.warnings if subject == "Card"]


@pytest.mark.parametrize("is_hidden", [True, False])
def test_a_material_may_be_hidden_from_glossy_rays_or_seen_by_them_alone(is_hidden):
    tree = Tree()
    add_floor_of("Glossy")
    path, leaf, clear = tree.add("LightPath"), tree.add("BsdfDiffuse", Color=(0.4, 0.2, 0.6, 1)), tree.add("BsdfTransparent")
    shaders = (leaf, clear) if is_hidden else (clear, leaf)
    exported = tree.wear(tree.mix(path.outputs["Is Glossy Ray"], *shaders))
    seen = [1 - passes(exported, kind)[0] for kind in (DIFFUSE, GLOSSY, SHADOW)]
    assert seen == ([1, 0, 1] if is_hidden else [0, 1, 0])
    material = next(one for one in exported.snapshot.materials if one.name == "Leaf")
    assert material.albedo_rgb == pytest.approx((0.4, 0.2, 0.6))
    assert [rgb[0] for rgb in material.seen_rgb[:2]] == seen[:2]
    assert not [text for _, text in exported.warnings if "simplified" in text]
    assert next(one for one in exported.snapshot.objects if one.name == "Card").receives == is_hidden


def test_glossy_rays_may_see_another_colour_and_glow():
    tree = Tree()
    add_floor_of("Glossy")
    path = tree.add("LightPath")
    colours = tree.mix(path.outputs["Is Glossy Ray"], tree.add("BsdfDiffuse", Color=(0.4, 0.2, 0.6, 1)), tree.add("BsdfDiffuse"))
    glows = tree.mix(path.outputs["Is Glossy Ray"], tree.add("Emission", Strength=2.0), tree.add("Emission", Strength=6.0))
    add = tree.add("AddShader")
    for number, shader in enumerate((colours, glows)):
        tree.links.new(shader.outputs[0], add.inputs[number])
    material = next(one for one in tree.wear(add).snapshot.materials if one.name == "Leaf")
    assert material.seen_rgb[GLOSSY] == pytest.approx((2, 4, 0.8 / 0.6))
    assert material.glow_rgb[GLOSSY] == pytest.approx((3, 3, 3))


def add_floor_of(shader):
    """A floor that mirrors or bends light."""
    other = Tree("Shiny")
    floor = bpy.data.objects.get("Floor") or add_mesh("Shiny floor", SQUARE, [(0, 1, 2, 3)])
    floor.data.materials.append(other.material)
    other.links.new(other.add(f"Bsdf{shader}").outputs[0], other.output.inputs["Surface"])
