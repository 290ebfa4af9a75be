"""Every kind of light and of material against Cycles' own bake of the same texels: no bias, little error.

Each is a floor with a wall and a block on it under one light. Cycles bakes them twice, so that its own noise cancels (lightmap_errors.py).
"""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from bench_accuracy import MOST_BIAS, MOST_REL, bake_page
from blend_rooms import add_object
from cycles_bake import bake_cycles, set_stage
from cycles_reference import SEEDS, Reference
from cycles_texel import TEXEL, bake_step
from leaflight.core.util.job import SNAPSHOT_FILE
from leaflight.core.util.settings import Settings
from stats import PLANTED_BIAS

# The best texels are chosen with Cycles' own noise: by 400 samples a bias of 3 % came out as a rel of 2.0 to 2.4 %, by 2,500 as 2.4 %.
SIZE, SAMPLES = 64, 1600
SETTINGS = Settings(size=SIZE, share_meshes=False, even_out=False, passes=("lighting",), error=0.005, max_photons=8_000_000, workers=1)
ABOVE = (0.5, 0.3, 1.6)


def use_tree(owner):
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    return owner.node_tree


def add_lamp(kind, **properties):
    data = bpy.data.lights.new("Lamp", kind)
    for name, value in {"energy": 50.0, "color": (1.0, 0.8, 0.5), **properties}.items():
        setattr(data, name, value)
    add_object("Lamp", data, location=ABOVE, rotation_euler=(0.2, 0.3, 0.5))


def add_world(radiance):
    bpy.context.scene.world = bpy.data.worlds.new("Sky")
    background = use_tree(bpy.context.scene.world).nodes["Background"]
    background.inputs["Color"].default_value = (*radiance, 1.0)


def add_ies_lamp():
    """A lamp whose file differs by both angles, turned."""
    add_lamp("POINT", shadow_soft_size=0.05)
    data = bpy.data.lights["Lamp"]
    data.use_nodes = True  # in 5.0 lamps still have no nodes until then
    tree = data.node_tree
    profile, emission = tree.nodes.new("ShaderNodeTexIES"), next(node for node in tree.nodes if node.type == "EMISSION")
    down, around = np.arange(0, 181, 15), np.arange(0, 361, 45)
    candela = (60.0 + 50.0 * np.cos(np.radians(down)) + 40.0 * np.sin(np.radians(down)) * np.cos(np.radians(around))[:, None]).round(2)
    head = f"1 1000 0.1 {len(down)} {len(around)} 1 2 0.1 0.1 0.1"
    rows = [head, "1 1 20", *(" ".join(map(str, row)) for row in (down, around, *candela))]
    profile.ies = bpy.data.texts.new("lamp.ies")
    profile.ies.from_string("\n".join(["IESNA:LM-63-1995", "TILT=NONE", *rows, ""]))
    tree.links.new(profile.outputs[0], emission.inputs["Strength"])


def add_sky_texture(**properties):
    add_world((1.0, 1.0, 1.0))
    tree = bpy.context.scene.world.node_tree
    texture = tree.nodes.new("ShaderNodeTexSky")
    for name, value in {"sun_elevation": 0.7, "sun_rotation": 2.0, **properties}.items():
        setattr(texture, name, value)
    tree.links.new(texture.outputs["Color"], tree.nodes["Background"].inputs["Color"])


def add_panorama():
    """A picture of a dim sky with three lamps, one small and bright, two wide and of other colours, turned and half hidden."""
    add_world((1.0, 1.0, 1.0))
    tree = bpy.context.scene.world.node_tree
    height = 256
    v, u = (np.mgrid[0:height, 0 : 2 * height] + 0.5) / height
    pixels = np.ones((height, 2 * height, 4), np.float32)
    pixels[..., :3] = (0.2, 0.25, 0.4) * v[..., None]
    for place, radius, rgb in (((0.7, 0.75), 0.012, (900, 800, 600)), ((1.3, 0.7), 0.1, (8, 2, 1)), ((0.1, 0.85), 0.12, (1, 3, 8))):
        pixels[np.hypot(u - place[0], v - place[1]) < radius, :3] = rgb
    image = bpy.data.images.new("Panorama", 2 * height, height, float_buffer=True)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    texture, place, turn = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "TexCoord", "Mapping"))
    texture.image, turn.inputs["Rotation"].default_value = image, (0.1, 0.0, 0.8)
    for port, target in (
        (place.outputs["Generated"], turn.inputs["Vector"]),
        (turn.outputs["Vector"], texture.inputs["Vector"]),
        (texture.outputs["Color"], tree.nodes["Background"].inputs["Color"]),
    ):
        tree.links.new(port, target)


def add_checker():
    """An image of 4 x 4 pixels, dark or bright, no two rows or columns alike, packed into the file."""
    image = bpy.data.images.new("Checker", 4, 4, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    pixels = np.ones((16, 4), np.float32)
    pixels[:, :3] = np.where(np.random.default_rng(2).random((16, 3)) < 0.5, 0.02, 0.95)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


def map_checker(tree, socket):
    """Through a UV map and a mapping node."""
    texture, place, layer = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "Mapping", "UVMap"))
    texture.image, texture.interpolation, layer.uv_map = add_checker(), "Closest", "UVMap"
    place.inputs["Scale"].default_value, place.inputs["Location"].default_value = (2.0, 1.5, 1.0), (0.2, 0.1, 0.0)
    for port, target in (
        (layer.outputs["UV"], place.inputs["Vector"]),
        (place.outputs["Vector"], texture.inputs["Vector"]),
        (texture.outputs["Color"], socket),
    ):
        tree.links.new(port, target)


def make_material(shader="Principled", textured=False):
    material = bpy.data.materials.new(shader)
    tree = use_tree(material)
    if shader == "Principled":
        node = tree.nodes["Principled BSDF"]
        node.inputs["Roughness"].default_value, node.inputs["Specular IOR Level"].default_value = 1.0, 0.0
        colour = node.inputs["Base Color"]
    else:
        node = tree.nodes.new("ShaderNodeBsdfDiffuse")
        tree.links.new(node.outputs["BSDF"], tree.nodes["Material Output"].inputs["Surface"])
        colour = node.inputs["Color"]
    colour.default_value = (0.7, 0.4, 0.2, 1.0)
    if textured:
        map_checker(tree, colour)
    return material


def add_panel(textured):
    """A glowing sheet over the floor."""
    bpy.ops.mesh.primitive_plane_add(size=0.8, location=ABOVE, rotation=(0.2, 0.3, 0.5))
    material = make_material()
    node = material.node_tree.nodes["Principled BSDF"]
    node.inputs["Emission Strength"].default_value, node.inputs["Emission Color"].default_value = 10.0, (1.0, 0.8, 0.5, 1.0)
    if textured:
        map_checker(material.node_tree, node.inputs["Emission Color"])
    bpy.context.object.data.materials.append(material)


LIGHTS = {
    "point": lambda: add_lamp("POINT", shadow_soft_size=0.0),
    "soft point": lambda: add_lamp("POINT", shadow_soft_size=0.2),
    "sphere": lambda: add_lamp("POINT", shadow_soft_size=0.2, use_soft_falloff=False),
    "spot": lambda: add_lamp("SPOT", spot_size=1.2, spot_blend=0.5, shadow_soft_size=0.1),
    "IES file": add_ies_lamp,
    "square spot": lambda: add_lamp("SPOT", spot_size=1.2, spot_blend=0.3, shadow_soft_size=0.1, use_square=True),
    "sun": lambda: add_lamp("SUN", energy=3.0, angle=0.1),
    "square": lambda: add_lamp("AREA", shape="SQUARE", size=0.5),
    "rectangle": lambda: add_lamp("AREA", shape="RECTANGLE", size=0.8, size_y=0.3),
    "disk": lambda: add_lamp("AREA", shape="DISK", size=0.5),
    "ellipse": lambda: add_lamp("AREA", shape="ELLIPSE", size=0.8, size_y=0.3),
    "glowing mesh": lambda: add_panel(textured=False),
    "textured glowing mesh": lambda: add_panel(textured=True),
    "sky": lambda: add_world((0.6, 0.8, 1.0)),
    "sky texture": add_sky_texture,
    "sky texture without a sun": lambda: add_sky_texture(sun_disc=False),
    "panorama": add_panorama,
}
MATERIALS = {"textured Principled": ("Principled", True), "Diffuse": ("Diffuse", False), "textured Diffuse": ("Diffuse", True)}
CASES = [(light, "Principled") for light in LIGHTS] + [("soft point", material) for material in MATERIALS]


def save_scene(path, light, material):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    made = make_material(*MATERIALS.get(material, ()))
    bpy.ops.mesh.primitive_plane_add(size=2.0)
    bpy.context.object.data.materials.append(made)
    bpy.ops.mesh.primitive_plane_add(size=2.0, location=(-1.0, 0.0, 1.0), rotation=(0.0, 0.5 * np.pi, 0.0))
    bpy.context.object.data.materials.append(made)
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(-0.3, 0.1, 0.25), rotation=(0.0, 0.0, 0.4))
    bpy.context.object.data.materials.append(made)
    LIGHTS[light]()
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


@pytest.fixture(scope="module", params=CASES, ids=", ".join)
def baked(request, tmp_path_factory):
    """The scene's reference, and Leaflight's page and layout."""
    root = tmp_path_factory.mktemp("scene")
    blend, work, folder = root / "scene.blend", root / "stage", root / "bake"
    save_scene(blend, *request.param)
    work.mkdir()
    stage = set_stage(blend, SIZE, work)
    first, second = (bake_cycles(stage, SAMPLES, seed)[0] for seed in SEEDS)
    covered = (first[..., 3] > 0) & (second[..., 3] > 0)
    folder.mkdir()
    (work / SNAPSHOT_FILE).rename(folder / SNAPSHOT_FILE)
    page, tri_uv, _ = bake_page(folder, SETTINGS)
    return Reference("scene", covered, first[covered][:, :3], second[covered][:, :3], stage.tri_uv), page, tri_uv


def measure(baked, bias=1.0):
    reference, page, tri_uv = baked
    return reference.measure(page * np.float32(bias), tri_uv)


@pytest.fixture(scope="module")
def looks_at_middle():
    """Whether a texel of this Cycles is a mean over its middle, as a page of ours is: 5.0's is, 5.2's is one over the whole texel."""
    return bake_step(TEXEL + 0.2)[TEXEL, 0] == 1  # where what glows begins to the left of the middle


@pytest.mark.slow
def test_light_is_not_biased(baked, hold):
    name = "Cycles, each light and material: bias"
    hold(f"{name} against it", 100 * measure(baked).bias, low=-MOST_BIAS, high=MOST_BIAS, unit="%")
    hold(f"{name} with a planted one of 3 %", 100 * measure(baked, PLANTED_BIAS).bias, low=MOST_BIAS, unit="%")


@pytest.mark.slow
def test_light_is_that_of_cycles(looks_at_middle, baked, hold):
    if not looks_at_middle:
        pytest.skip("a texel of this Cycles is a mean over all of it")
    name = "Cycles, each light and material: rel"
    hold(f"{name} at the finest settings", 100 * measure(baked).rel, high=MOST_REL, unit="%")
    hold(f"{name} with a planted bias of 3 %", 100 * measure(baked, PLANTED_BIAS).rel, low=MOST_REL, unit="%")
