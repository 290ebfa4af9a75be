"""A furnace with every kind of white matter: in a room whose walls glow evenly, a thing that keeps all light changes nothing."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import room_mesh
from leaflight.core.scene.scene import Material
from safe_bakes import bake_and_audit
from scenes import box_mesh, make_scene

WHITE = (1.0,) * 3
HALF = (0.5,) * 3
MATTER = {
    "paint": Material("White", WHITE),
    "mirror": Material("White", WHITE, metal_rgb=WHITE, roughness=0.0),
    "metal": Material("White", WHITE, metal_rgb=WHITE, roughness=0.4),
    "rough metal": Material("White", WHITE, metal_rgb=WHITE, roughness=1.0),
    "half metal": Material("White", WHITE, metal_rgb=HALF, metal=0.5, roughness=0.6, layer=0.5, diffuse=0.5),
    "layer": Material("White", WHITE, layer=1.0, roughness=0.3),
    "rough layer": Material("White", WHITE, layer=1.0, roughness=1.0, ior=2.0),
    "coat": Material("White", WHITE, layer=1.0, coat=1.0, coat_roughness=0.2),
    "coated metal": Material("White", WHITE, metal_rgb=WHITE, roughness=0.7, coat=0.8, coat_roughness=0.4, coat_ior=1.8),
    "sheen": Material("White", WHITE, layer=0.7, diffuse=0.7, sheen_rgb=WHITE, sheen_roughness=0.8),
    "alpha": Material("White", HALF, passing_rgb=HALF, layer=0.5, diffuse=0.5),
    "translucent": Material("White", WHITE, through_rgb=WHITE),
    "half translucent": Material("White", WHITE, through_rgb=HALF),
    "glass": Material("White", (0.0,) * 3, glass_rgb=WHITE, glass_mirror_rgb=WHITE),
    "rough glass": Material("White", (0.0,) * 3, glass_rgb=WHITE, glass_mirror_rgb=WHITE, glass_roughness=0.6),
    "coated glass": Material("White", (0.0,) * 3, glass_rgb=WHITE, glass_mirror_rgb=WHITE, coat=1.0, coat_roughness=0.0),
}


def bake_around(folder, matter: Material, direct: str, photons: int) -> np.ndarray:
    """Mean light of the walls of a grey glowing room of 2 m around a box of 1.2 m, relative to that of the empty room."""
    thing = replace(box_mesh("Thing", (1.2, 1.2, 1.2)), receives=False)
    scene = make_scene([room_mesh(size_m=(2.0, 2.0, 2.0)), thing], [], [Material("Wall", HALF, emission_rgb=WHITE), matter])
    scene = replace(scene, tri_material=np.minimum(scene.tri_object, 1))
    return bake_and_audit(folder, scene, direct=direct, max_photons=photons, error=0.006, size=32)[0] / (2 * np.pi)


@pytest.mark.slow
@pytest.mark.parametrize("name", MATTER)
@pytest.mark.parametrize(("direct", "photons", "percent"), [("photons", 1_000_000, 0.4), ("rays", 1_000_000, 1.2)])
def test_white_matter_keeps_all_light(tmp_path, name, direct, photons, percent, hold):
    """White is 0.999: 0.07 % of the light is lost by that. The rest is noise, more with rays, for specular light comes by fewer photons."""
    off = 100 * np.abs(bake_around(tmp_path, MATTER[name], direct, photons) - 1).max()
    hold(f"furnace of white matter, {direct}: light lost or made", off, high=percent, unit="%")


@pytest.mark.parametrize("name", ["half metal", "coated metal", "sheen", "half translucent", "coated glass"])
def test_some_white_matter_keeps_all_light(tmp_path, name):
    assert bake_around(tmp_path, MATTER[name], "photons", 200_000) == pytest.approx(np.ones(3), abs=0.006)
