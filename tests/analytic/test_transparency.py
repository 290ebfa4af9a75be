"""Light through transparent surfaces: a pane that lets a share of each channel pass takes just that off, whatever the light is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from boxes import solve_scene
from leaflight.core.integrate import texel_light
from leaflight.core.integrate.texel_light import TexelLight
from leaflight.core.scene.scene import Light, Material, SceneSnapshot, TextureImage
from leaflight.core.texels.texel_map import TexelMap
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import Settings
from safe_bakes import bake_and_audit
from scenes import Mesh, box_mesh, make_scene

TINT = np.array([0.5, 0.25, 1.0])
MAP: list[Light] = []
LIGHTS = {
    "sun": [Light("SUN", "Sun", power_rgb=(2.0,) * 3, angle_rad=0.1)],
    "hard sun": [Light("SUN", "Sun", power_rgb=(2.0,) * 3)],
    "lamp": [Light("POINT", "Lamp", position_m=(0, 0, 1.8), power_rgb=(80.0,) * 3, radius_m=0.3)],
    "panel": [Light("AREA", "Panel", position_m=(0, 0, 1.8), power_rgb=(80.0,) * 3)],
    "crowd": [Light("POINT", f"Lamp {k}", position_m=(k / 4 - 3, 0, 1.8), power_rgb=(3.0,) * 3) for k in range(25)],
    "sky": [],
    "sky map": MAP,
}


def square(name: str, z: float, half: float, receives: bool = False) -> Mesh:
    vertex = half * np.array([[-1, -1, z / half], [1, -1, z / half], [1, 1, z / half], [-1, 1, z / half]])
    return Mesh(name, vertex, [[0, 1, 2, 3]], None, receives)


def floor_below(pane: Material, lights=()) -> SceneSnapshot:
    """A black floor of 2 m below a pane, a metre above; or in a box of it under a white sky where there are no lights."""
    cover = square("Pane", 1, 8) if lights else replace(box_mesh("Pane", (4, 4, 4)), receives=False)
    scene = make_scene([square("Floor", 0, 1, True), cover], lights, [Material("Floor", (0.0,) * 3), pane])
    sky = np.linspace(0.5, 2.0, 8 * 16 * 3, dtype=np.float32).reshape(8, 16, 3) if lights is MAP else None
    return replace(scene, tri_material=scene.tri_object, world_rgb=(0.0 if lights else 1.0,) * 3, world_map=sky)


def light_texels(folder, scene: SceneSnapshot, **knobs) -> tuple[TexelMap, TexelLight]:
    field = solve_scene(folder, scene, Settings(**{"size": 32, "error": 0.02, "workers": 1, "seed": 3, **knobs}))
    texels = traced_scene.open_tracing(str(folder)).texels
    return texels, texel_light.light_at_texels(field, texels)


def bake_floor(folder, scene: SceneSnapshot, direct: str, photons: int = 200_000) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Mean light of all that receives, W/m^2, and the energy audit, W."""
    return bake_and_audit(folder, scene, direct=direct, size=32, max_photons=photons, error=0.01)[:2]


@pytest.fixture(scope="module")
def bare_light(tmp_path_factory):
    """bare_light(name) is the light of LIGHTS on the floor below a pane that takes nothing off."""
    clear = Material("Pane", (0,) * 3, passing_rgb=(1,) * 3)
    return cache(lambda name: bake_floor(tmp_path_factory.mktemp("bare"), floor_below(clear, LIGHTS[name]), "rays")[0])


@pytest.mark.parametrize("direct", ["rays", "photons"])
@pytest.mark.parametrize("name", LIGHTS)
def test_a_tinted_pane_takes_its_tint_off(tmp_path, bare_light, name, direct):
    bare = bare_light(name)
    tinted, audit = bake_floor(
        tmp_path / "b", floor_below(Material("Pane", (0,) * 3, passing_rgb=tuple(TINT)), LIGHTS[name]), direct, 150_000
    )
    assert bare.min() > 0.05
    assert tinted / bare == pytest.approx(TINT, rel=5e-3 if direct == "rays" else 0.03)
    if direct == "photons":
        assert (audit["passed"] > 0).all()


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_checker_of_holes_lets_half_of_the_light_pass(tmp_path, direct):
    """Below a sun straight above, which is even over whole periods of the pane's image."""
    image = np.zeros((2, 2, 3), np.float32)
    image[0, 0] = image[1, 1] = 1
    scene = floor_below(Material("Pane", (0,) * 3), LIGHTS["hard sun"])
    pane = replace(scene.materials[1], passing_rgb=(1,) * 3, passing_image=0)
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32)
    uvs = np.concatenate([np.zeros_like(uv), 40 * uv])  # a period is 0.4 m, the floor has five
    images = (TextureImage("Holes", image, closest=True),)
    scene = replace(scene, materials=(scene.materials[0], pane), images=images, tri_passing_uv=uvs)
    light, _ = bake_floor(tmp_path, scene, direct)
    assert light == pytest.approx(np.full(3, 1.0), rel=0.01)


@pytest.mark.parametrize("direct", ["rays", "photons"])
@pytest.mark.parametrize("name", ["hard sun", "lamp", "sky map"])
def test_a_pane_lets_pass_what_its_side_toward_the_viewer_lets_pass(tmp_path, bare_light, name, direct):
    """The floor below sees the back of the pane, or the inside of the box's; the box's faces look outwards."""
    views = ((0.25,) * 5, (1.0,) * 5)
    pane = Material("Pane", (0,) * 3, passing_rgb=(1,) * 3, passing_views=views)
    light, _ = bake_floor(tmp_path, floor_below(pane, LIGHTS[name]), direct, 150_000)
    assert light == pytest.approx(0.25 * bare_light(name), rel=5e-3 if direct == "rays" else 0.13)  # of 600 photons on the floor


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_back_reflects_and_glows_for_itself(tmp_path, direct):
    """The lamp hangs between the black floor and the back of the pane, which glows upwards only."""
    lamp = [Light("POINT", "Lamp", position_m=(0, 0, 0.5), power_rgb=(80.0,) * 3, radius_m=0.05)]

    def bake(place, *rgb, **fields):
        pane = Material("Pane", rgb or (0.8,) * 3, **fields)
        return bake_floor(tmp_path / place, floor_below(pane, lamp), direct, 150_000)[0]

    black, plain = bake("black", 0.0, 0.0, 0.0), bake("plain")
    glow = [bake(f"glow {k}", 0.0, 0.0, 0.0, emission_rgb=(5.0,) * 3, dark_front=k == 1, dark_back=k == 2) for k in range(3)]
    assert glow[1] == pytest.approx(glow[0], rel=1e-5 if direct == "rays" else 0.1)
    assert glow[2] == pytest.approx(black, rel=1e-5 if direct == "rays" else 0.1)
    assert (glow[0] - black).min() > 0.1 * black.max()
    told_apart = bake("apart", back_rgb=(0.0, 0.5, 1.0), emission_rgb=(0.2,) * 3, dark_back=True)
    assert (plain - black).min() > 0.02 * black.max()
    assert (told_apart - black) / (plain - black) == pytest.approx([0.0, 0.5, 1.0], abs=0.04 if direct == "rays" else 0.1)


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_half_clear_glass_loses_no_light(tmp_path, bare_light, direct):
    """Glass with an index of refraction of 1 on half of a surface that lets light pass on the other half."""
    pane = Material("Pane", (0,) * 3, passing_rgb=(0.5,) * 3, glass_rgb=(0.5,) * 3, glass_mirror_rgb=(0.5,) * 3, glass_ior=1.0)
    light, _ = bake_floor(tmp_path, floor_below(pane, LIGHTS["lamp"]), direct)
    assert light == pytest.approx(bare_light("lamp"), rel=0.06)


def test_half_of_a_mesh_may_be_a_pane(tmp_path):
    """The other triangle of the same object stays opaque: a sun straight above lights one half of the floor."""
    scene = floor_below(Material("Pane", (0,) * 3, passing_rgb=(1,) * 3), LIGHTS["sun"])
    light, _ = bake_floor(tmp_path, replace(scene, tri_material=np.int32([0, 0, 0, 1])), "rays")
    assert light == pytest.approx(np.full(3, 1.0), rel=0.02)


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_light_that_was_reflected_passes_a_pane_too(tmp_path, direct):
    """A white ceiling lit from below: what it sends down comes through the pane by its tint."""
    found = []
    for tint in (np.ones(3), TINT):
        lamp = Light("SPOT", "Lamp", (0, 0, 2), ((1, 0, 0), (0, -1, 0), (0, 0, -1)), (500.0,) * 3, cone_angle_rad=2.0)
        ceiling = Mesh("Ceiling", square("", 3, 2).vertex, [[3, 2, 1, 0]])
        scene = make_scene(
            [square("Floor", 0, 1, True), square("Pane", 1, 8), ceiling],
            [lamp],
            [Material("Floor", (0,) * 3), Material("Pane", (0,) * 3, passing_rgb=tuple(tint)), Material("White", (0.8,) * 3)],
        )
        scene = replace(scene, tri_material=np.int32([0, 0, 1, 1, 2, 2]))
        scene = replace(scene, objects=(*scene.objects[:2], replace(scene.objects[2], receives=True)))
        texels, light = light_texels(tmp_path / str(tint[0]), scene, direct=direct, max_photons=600_000)
        floor = scene.tri_object[texels.texel_tri] == 0
        found.append(np.asarray(light.direct + light.indirect)[floor].mean(axis=0))
    assert found[0].min() > 0.1
    assert found[1] / found[0] == pytest.approx(TINT, rel=0.03)


@pytest.mark.parametrize("direct", ["rays", "photons"])
@pytest.mark.parametrize(("lamp", "flags", "expected"), [
    ("sun", {"casts_shadow": False}, 1.0),
    ("sun", {"seen_by": (False,) * 3}, 0.0),
    ("sky", {"seen_by": (False,) * 3}, 1.0),  # Cycles finds an even sky by diffuse rays
    ("sky", {"casts_shadow": False}, 0.0),
    ("sky map", {"casts_shadow": False}, 1.0),
])  # fmt: skip
def test_a_lid_hides_lamps_from_the_rays_that_see_it(tmp_path, bare_light, lamp, flags, expected, direct):
    """A black lid, or box, over a floor."""
    bare = bare_light(lamp)
    scene = floor_below(Material("Lid", (0,) * 3), LIGHTS[lamp])
    scene = replace(scene, objects=(scene.objects[0], replace(scene.objects[1], **flags)))
    light, _ = bake_floor(tmp_path / "b", scene, direct)
    assert light / bare == pytest.approx(np.full(3, expected), rel=0.02, abs=1e-6)


def test_an_object_that_others_do_not_see_sends_them_no_light(tmp_path):
    """A white wall beside a floor: its light on the floor is gone when the wall reflects for nobody, and its own stays."""
    found = []
    for seen in (True, False):
        wall = Mesh("Wall", np.array([[-1, 1, 0], [1, 1, 0], [1, 1, 2], [-1, 1, 2]], float), [[0, 1, 2, 3]])
        lamp = Light("SPOT", "Lamp", (0, -3, 1), ((1, 0, 0), (0, 0, 1), (0, -1, 0)), (500.0,) * 3, cone_angle_rad=0.5)
        scene = make_scene([square("Floor", 0, 1, True), wall], [lamp], [Material("Black", (0,) * 3), Material("White", (0.8,) * 3)])
        scene = replace(scene, tri_material=scene.tri_object)
        scene = replace(scene, objects=(scene.objects[0], replace(scene.objects[1], seen_by=(seen,) * 3)))
        texels, light = light_texels(tmp_path / str(seen), scene, max_photons=100_000)
        is_wall = scene.tri_object[texels.texel_tri] == 1
        found.append([light.indirect[~is_wall].mean(), light.direct[is_wall].mean()])
    (shown, lit), (unseen, still_lit) = found
    assert shown > 0
    assert unseen == 0
    assert still_lit == pytest.approx(lit, rel=0.02)


def test_half_clear_panes_are_not_too_bright(tmp_path):
    """Under an even sky, beside what a square of 1.6 m, 0.8 m above, hides: texels do not stop because their first rays pass it by."""
    pane = Material("Pane", (0,) * 3, passing_rgb=(0.5,) * 3)
    scene = make_scene([square("Floor", 0, 2, True), square("Pane", 0.8, 0.8)], [], [Material("Floor", (0,) * 3), pane])
    scene = replace(scene, tri_material=scene.tri_object, world_rgb=(1.0,) * 3)
    texels, light = light_texels(tmp_path, scene, size=64, max_photons=1000, error=0.01)
    found = np.average(light.direct[:, 0], weights=texels.texel_area)
    x, y = np.meshgrid(*[(np.arange(200) + 0.5) / 50 - 2] * 2)

    def corner(a, b):
        """Form factor of a rectangle above a corner of its, sides a and b by the height; odd in both. Source: Howell, B-3."""
        p, q = np.hypot(1, a), np.hypot(1, b)
        return (a / p * np.arctan(b / p) + b / q * np.arctan(a / q)) / (2 * np.pi)

    low, high = [(-0.8 - axis) / 0.8 for axis in (x, y)], [(0.8 - axis) / 0.8 for axis in (x, y)]
    hidden = corner(high[0], high[1]) - corner(low[0], high[1]) - corner(high[0], low[1]) + corner(low[0], low[1])
    assert found == pytest.approx(np.pi * (1 - 0.5 * hidden.mean()), rel=0.003)
