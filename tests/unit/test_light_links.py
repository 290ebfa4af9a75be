"""Photons of lamps that some rays do not see, or that are linked to objects."""

from dataclasses import replace

import numpy as np
import pytest
from floors import floor_footprints, lit_scene, prepare, trace_first
from leaflight.core.integrate.direct import direct_irradiance
from leaflight.core.scene.scene import Light, Material
from leaflight.core.transport.photon_log import ShardHits
from scenes import box_mesh, moved, quad_mesh

BLOCK = box_mesh("Block", (0.3, 0.3, 0.2), (0.5, 0.5, 0.4))
METAL = Material("Metal", albedo_rgb=(0.8,) * 3, metal_rgb=(0.8,) * 3, roughness=0.3)
GLASS = Material("Glass", albedo_rgb=(0.0,) * 3, glass_rgb=(1.0,) * 3, glass_mirror_rgb=(1.0,) * 3)


def trace(material: Material, **choices) -> ShardHits:
    """10,000 photons of a sun that shines on a floor and a block, up to the first surface."""
    sun = Light("SUN", "Sun", power_rgb=(3.0,) * 3, angle_rad=0.1, **choices)
    scene = replace(lit_scene([BLOCK], [sun]), materials=(material, material))
    return trace_first(scene, 10_000)[0]


def test_metal_sees_what_glossy_rays_see():
    alike, unseen = trace(METAL), trace(METAL, seen_by=(True, False, True))
    assert alike.audit.mirrored.sum() > 0
    assert unseen.audit.mirrored.sum() == 0
    assert unseen.flux_rgb.sum() == pytest.approx(alike.flux_rgb.sum())
    assert trace(METAL, seen_by=(False, True, False)).audit.mirrored == pytest.approx(alike.audit.mirrored, rel=0.05)


def test_glass_reflects_and_refracts_what_rays_of_each_kind_see():
    alike, unreflected, unbent = (trace(GLASS, seen_by=(True, *kinds)) for kinds in ((True, True), (False, True), (True, False)))
    assert unreflected.audit.mirrored.sum() == unbent.audit.refracted.sum() == 0
    assert unreflected.audit.refracted == pytest.approx(alike.audit.refracted, rel=0.05)
    assert unbent.audit.mirrored == pytest.approx(alike.audit.mirrored, rel=0.2)


def test_what_a_lamp_does_not_light_stops_its_photons_where_it_casts_its_shadows():
    plain, unlit, clear = trace(Material("Grey")), trace(Material("Grey"), lights=(0,)), trace(Material("Grey"), blocked_by=(0,))
    on_floor = [one.flux_rgb[:, one.tri < 2].sum(dtype=float) for one in (plain, unlit, clear)]
    on_block = [one.flux_rgb[:, one.tri >= 2].sum(dtype=float) for one in (plain, unlit, clear)]
    assert on_block[1] == 0
    assert on_block[0] > 0
    assert on_block[2] == pytest.approx(on_block[0], rel=0.3)  # its lower side, too
    assert on_floor[1] == pytest.approx(on_floor[0])
    assert on_floor[2] == pytest.approx(on_floor[0] + on_block[0], rel=0.02)


def test_what_glows_is_linked_as_a_lamp_is():
    """A glowing square above a floor and a block: as shadow rays and as photons find its light on the floor."""
    scene = lit_scene([BLOCK], emission=[moved(quad_mesh("Glow"), (0.0, 0.0, 1.0))])
    *others, glow = scene.objects

    def light(**choices) -> tuple[float, float, float]:
        linked = replace(scene, objects=(*others, replace(glow, **choices)))
        prepared = prepare(linked)[0]
        direct = direct_irradiance(prepared, floor_footprints(16), np.arange(256), np.random.default_rng(1)).irradiance_rgb[:, 0].mean()
        hits, _ = trace_first(linked, 40_000)
        on_floor = hits.tri < 2
        return float(direct), float(hits.flux_rgb[0, on_floor].sum()), float(hits.flux_rgb[0, ~on_floor].sum())

    plain, unlit, clear, whole = light(), light(lights=(1,)), light(blocked_by=(0,)), light(blocked_by=(0, 1, 2))
    assert unlit == (0, 0, plain[2])
    assert clear[0] > 1.05 * plain[0]
    assert clear[:2] == pytest.approx((clear[1], clear[1]), rel=0.03)  # on a floor of 1 m^2
    assert whole[:2] == pytest.approx(plain[:2], rel=0.02)
