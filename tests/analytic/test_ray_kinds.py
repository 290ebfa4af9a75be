"""What glossy and transmission rays do not see: a mirror or a pane sends its light on to nobody, and what it hides comes through it."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import solve_scene
from leaflight.core.integrate import texel_light
from leaflight.core.scene.scene import Light, Material
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import Settings
from scenes import Mesh, make_scene

ALL, NO_GLOSSY, NO_TRANSMISSION, TRANSMISSION_ONLY = (True,) * 3, (True, False, True), (True, True, False), (False, False, True)
BLACK, MIRROR = Material("Black", (0.0,) * 3), Material("Mirror", (0.9,) * 3, metal_rgb=(0.9,) * 3, metal_flat=True, roughness=0.0)
# Glass that does not bend light.
PANE = Material("Pane", (0.0,) * 3, glass_rgb=(1.0,) * 3, glass_fresnel=False, glass_ior=1.0)
CARD = Material("Card", (0.8,) * 3)
GLOW = Material("Glow", (0.0,) * 3, emission_rgb=(2.0,) * 3)
SUN = Light("SUN", "Sun", power_rgb=(2.0,) * 3)
CARD_W_M2 = 0.8 * 2.0  # that it sends on from the sun


def square(name, z, half):
    return Mesh(
        name, np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]], float), [[0, 1, 2, 3]], None, not z
    )


def light_floor(folder, direct, things, lights=(), error=0.02, max_photons=200_000):
    """Light on a black floor of 2 m below things (height, half size, material, seen by, casts shadow), W/m^2; not straight from lights."""
    meshes = [square("Floor", 0, 1), *(square(f"Thing {k}", z, half) for k, (z, half, *_) in enumerate(things))]
    scene = make_scene(meshes, lights, [BLACK, *(material for _, _, material, _, _ in things)])
    objects = [replace(one, seen_by=seen, casts_shadow=shadow) for one, (*_, seen, shadow) in zip(scene.objects[1:], things, strict=True)]
    scene = replace(scene, tri_material=scene.tri_object, objects=(scene.objects[0], *objects))
    field = solve_scene(folder, scene, Settings(direct=direct, size=16, max_photons=max_photons, error=error, workers=1, seed=3))
    texels = traced_scene.open_tracing(str(folder)).texels
    light = texel_light.light_at_texels(field, texels)
    reflected = light.indirect if lights else light.direct + light.indirect
    audit = {name: np.array(watts) for name, watts in field.ledger.audit_w().items()}
    assert audit["absorbed"] + audit["escaped"] + audit["remainder"] == pytest.approx(audit["emitted"], rel=1e-9)
    return np.average(np.asarray(reflected)[:, 0], weights=texels.texel_area)


def light_by_mirror(n=48):
    """Mean light on the floor of 2 m, W/m^2, that a card of 1 m at 1 m sends by a mirror at 2 m; by n^2 points of each."""
    floor, card = ((np.arange(n) + 0.5) / n - 0.5) * 2, (np.arange(n) + 0.5) / n - 0.5
    step = card - floor[:, None]  # along one side; the card is seen at a height of 3 m
    hidden = np.abs(floor[:, None] + step / 3) < 0.5  # by the card itself
    distance2 = (step**2)[:, None, :, None] + (step**2)[None, :, None, :] + 9
    seen = ~(hidden[:, None, :, None] & hidden[None, :, None, :])
    return float((CARD_W_M2 / np.pi * MIRROR.metal_rgb[0] * 9 / distance2**2 * seen).sum() / n**4)


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_mirror_shows_what_glossy_rays_see(tmp_path, direct):
    """The sun shines through a mirror that casts no shadow, on a card whose light the mirror sends down to the floor."""
    mirror = (2.0, 1.5, MIRROR, ALL, False)

    knobs = {"error": 0.003, "max_photons": 1_500_000} if direct == "rays" else {}  # relative to the sun, a hundred times as bright

    def light(name, card, kinds=ALL, *more):
        return light_floor(tmp_path / name, direct, [mirror, (1.0, 0.5, card, kinds, True), *more], [SUN], **knobs)

    once = light_by_mirror()
    # The mirror shows the card to itself too, at a distance of 2 m, where it fills 0.0686 of a point's view.
    assert light("plain", CARD) == pytest.approx(once / (1 - CARD.albedo_rgb[0] * MIRROR.metal_rgb[0] * 0.0686), rel=0.04)
    without = replace(CARD, seen_rgb=((1.0,) * 3, (0.0,) * 3, (1.0,) * 3), glossy_passing_rgb=(1.0,) * 3)
    assert light("hidden", *((without,) if direct == "photons" else (CARD, NO_GLOSSY))) == pytest.approx(0, abs=2e-4)
    lid = (1.001, 0.501, BLACK)  # it takes what the card would send to itself
    assert light("lid", CARD, ALL, (*lid, ALL, False)) == pytest.approx(0, abs=2e-4)
    assert light("hidden lid", CARD, ALL, (*lid, NO_GLOSSY, False)) == pytest.approx(once, rel=0.04)


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_pane_shows_what_transmission_rays_see(tmp_path, direct):
    """A glowing card above a pane, which takes nothing from its light."""

    def light(name, glow, kinds=ALL, *more):
        return light_floor(tmp_path / name, direct, [(1.0, 1.5, PANE, ALL, True), (1.5, 0.5, glow, kinds, True), *more])

    plain = light("plain", GLOW)
    assert light("hidden", GLOW, NO_TRANSMISSION) == pytest.approx(0, abs=1e-6)
    assert light("seen by these alone", GLOW, TRANSMISSION_ONLY) == pytest.approx(plain, rel=0.08)
    twice = replace(GLOW, glow_rgb=((1.0,) * 3, (1.0,) * 3, (2.0,) * 3))
    assert light("brighter", twice) == pytest.approx(2 * plain, rel=0.05)
