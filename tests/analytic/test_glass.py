"""Glass: Fresnel and Snell by the book, furnaces in which it loses and makes nothing, and caustics whose energy is known."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import make_solver, room_mesh
from leaflight.core.integrate import texel_light
from leaflight.core.scene.ggx import reflectance
from leaflight.core.scene.glass import Glass
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import Light, Material, TextureImage
from leaflight.core.texels.error_metric import BEST_TEXELS, DARK_FLOOR
from leaflight.core.util.settings import Settings
from safe_bakes import bake_and_audit
from scenes import Mesh, box_mesh, make_scene, moved, quad_mesh, quad_scene, sphere_mesh

DOWN = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
BLACK = Material("Black", (0.0,) * 3)


def make_glass(roughness=0.0, tint=(1.0,) * 3, ior=1.5, **changes):
    return Material("Glass", (0.0,) * 3, glass_rgb=tint, glass_mirror_rgb=(1.0,) * 3, glass_roughness=roughness, glass_ior=ior, **changes)


def bend(matter, cosine, is_front, n=100_000, tri=0):
    """Rays on a triangle of a scene, or of a material."""
    scene = replace(quad_scene(), materials=(matter,)) if isinstance(matter, Material) else matter
    glass = Glass.of(scene, SurfaceMaterials(scene))
    tri, where = np.full(n, tri, np.intp), np.full(n, 0.25, np.float32)
    direction = np.repeat(np.float32([[np.sqrt(1 - cosine**2)], [0], [-cosine]]), n, axis=1)
    normal = np.repeat(np.float32([[0], [0], [1]]), n, axis=1)
    numbers = np.random.default_rng(4).random((3, n)).astype(np.float32)
    return glass.bend(tri, where, where, direction, normal, np.full(n, is_front), numbers)


def test_reflectance_of_an_interface():
    straight, grazing = reflectance(np.array([1.0, 0.0]), np.array([1.5, 1.5]))[0]
    assert (straight, grazing) == pytest.approx((0.04, 1.0))
    cosine = (np.arange(20000) + 0.5) / 20000
    outside, inside = (float((2 * cosine * reflectance(cosine, np.full(20000, eta))[0]).mean()) for eta in (1.5, 1 / 1.5))
    assert outside == pytest.approx(0.0918, abs=1e-4)  # Walsh 1926
    assert 1 - inside == pytest.approx((1 - outside) / 1.5**2, abs=1e-4)  # reciprocity, Duntley 1942
    brewster = np.cos(np.arctan(1.5))
    assert reflectance(np.array([brewster]), np.array([1.5]))[0] == pytest.approx(0.5 * np.cos(2 * np.arctan(1.5)) ** 2)


def test_glass_is_as_rough_as_an_image_says():
    """Its first triangle is smooth, its second as rough as other glass."""
    image = TextureImage("Rough", np.float32([[[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]]), closest=True)
    uv = np.float32([[[0.25, 0.5]] * 3, [[0.75, 0.5]] * 3])
    scene = replace(quad_scene(), materials=(make_glass(lobe_image=0),), images=(image,), tri_lobe_uv=uv)
    for tri, roughness in enumerate((0.0, 0.5)):
        one, other = bend(scene, 0.8, True, tri=tri), bend(make_glass(roughness), 0.8, True)
        np.testing.assert_allclose(one.direction, other.direction, atol=1e-6)
        np.testing.assert_allclose(one.weight, other.weight, atol=1e-6)


@pytest.mark.parametrize("is_front", [True, False])
def test_smooth_glass_bends_by_snell(is_front):
    cosine, eta = 0.8, 1.5 if is_front else 1 / 1.5
    bent = bend(make_glass(), cosine, is_front)
    out, sine = bent.direction[:, bent.crossed][:, 0], np.sqrt(1 - cosine**2) / eta
    assert out == pytest.approx([sine, 0, -np.sqrt(1 - sine**2)], abs=1e-6)
    assert bent.direction[:, ~bent.crossed][:, 0] == pytest.approx([0.6, 0, 0.8], abs=1e-6)
    expected = 1 - reflectance(np.array([cosine]), np.array([eta]))[0][0]
    assert bent.crossed.mean() == pytest.approx(expected, abs=0.003)


@pytest.mark.parametrize("roughness", [0.0, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("cosine", [0.1, 0.5, 0.95])
@pytest.mark.parametrize("is_front", [True, False])
def test_white_glass_keeps_all_light(roughness, cosine, is_front):
    bent = bend(make_glass(roughness), cosine, is_front)
    assert bent.weight.mean(axis=1) == pytest.approx(np.ones(3), abs=5e-3)
    assert np.abs(np.linalg.norm(bent.direction, axis=0) - 1).max() < 1e-5
    lost = bent.weight[0] > 0
    assert ((bent.direction[2] < 0) == bent.crossed)[lost].all()


def test_total_reflection_inside():
    assert not bend(make_glass(), 0.5, False).crossed.any()
    plain = bend(make_glass(glass_fresnel=False), 0.5, False)  # a Refraction BSDF reflects nothing
    assert not plain.weight.any()
    assert bend(make_glass(glass_fresnel=False), 0.5, True).crossed.all()


def test_tint_is_of_what_goes_through():
    bent = bend(make_glass(tint=(0.9, 0.5, 0.0)), 0.9, True)
    share = 1 - reflectance(np.array([0.9]), np.array([1.5]))[0][0]
    through = (bent.weight * bent.crossed).mean(axis=1)
    assert through == pytest.approx(share * np.array([0.9, 0.5, 0.0]), abs=5e-3)
    assert (bent.weight * ~bent.crossed).mean(axis=1) == pytest.approx(np.full(3, 1 - share), abs=5e-3)


def bake(folder, scene, direct, photons=200_000, **changes):
    return bake_and_audit(folder, scene, **{"direct": direct, "max_photons": photons, "error": 0.002, **changes})


@pytest.mark.parametrize("direct", ["rays", "photons"])
@pytest.mark.parametrize("roughness", [0.0, 0.5])
def test_a_furnace_with_white_glass_loses_nothing(tmp_path, roughness, direct):
    """Walls of 24 m^2 that absorb half get 2 W/m^2 of a lamp's 24 W, whatever the glass in the room does."""
    ball, slab = sphere_mesh("Ball", rings=8, segments=12), box_mesh("Slab", (0.6, 0.6, 0.1), (0.0, 0.0, -0.5))
    ball = replace(ball, vertex=0.4 * ball.vertex + [0.4, 0.4, 0.3], receives=False)
    scene = make_scene(
        [room_mesh(size_m=(2.0, 2.0, 2.0)), ball, replace(slab, receives=False)],
        [Light("POINT", "Lamp", (-0.6, -0.5, 0.6), power_rgb=(24.0,) * 3, radius_m=0.05)],
        [Material("Grey", (0.5,) * 3), make_glass(roughness)],
    )
    scene = replace(scene, tri_material=np.minimum(scene.tri_object, 1))
    light, audit, _ = bake(tmp_path, scene, direct, error=0.02, size=32)
    assert audit["absorbed"] == pytest.approx(audit["emitted"], rel=2e-3)
    assert (audit["refracted"] > 0).all()
    assert light == pytest.approx(np.full(3, 2.0), rel=0.01)


def throw_spot(folder, direct, pane, glass):
    """A narrow spot on a black floor, straight through a pane: the share of its power that arrives, per channel; and the light field."""
    floor = Mesh("Floor", np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float), [[0, 1, 2, 3]])
    spot = Light("SPOT", "Spot", (0.1, 0.2, 3.0), DOWN, (100.0,) * 3, cone_angle_rad=0.15)
    scene = make_scene([floor, replace(pane, receives=False)], [spot], [BLACK, glass])
    light, audit, field = bake(folder, replace(scene, tri_material=scene.tri_object), direct, photons=100_000)
    return light * 4.0 / audit["emitted"], field


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_pane_lets_a_caustic_through(tmp_path, direct):
    """Of a thick pane straight on there is seen (1 - R)^2 (1 + R^2 + R^4 ...), and of each way through, twice the tint's root."""
    tint = (1.0, 0.5, 0.2)
    share, field = throw_spot(tmp_path, direct, box_mesh("Pane", (1.0, 1.0, 0.2), (0.0, 0.0, 1.0)), make_glass(tint=tint))
    t = 0.96 * np.array(tint)
    assert share == pytest.approx(t * t / (1 - 0.04**2 * np.array(tint) ** 2), rel=0.02)
    if direct == "rays":
        assert not field.direct.irradiance.any()


def test_behind_a_single_face_light_is_what_cycles_has(tmp_path):
    """Rays carry radiance over unscaled: a beam that a face has narrowed once brings 1 / n^2 of it."""
    pane = Mesh("Pane", np.array([[-0.5, -0.5, 1], [0.5, -0.5, 1], [0.5, 0.5, 1], [-0.5, 0.5, 1]], float), [[0, 1, 2, 3]])
    share, _ = throw_spot(tmp_path, "rays", pane, make_glass())
    assert share == pytest.approx(np.full(3, 0.96 / 1.5**2), rel=0.02)


def test_light_is_not_bent_besides_where_shadow_rays_pass(tmp_path):
    """The usual trick, Transparent for shadow rays and glass for all others, makes no light twice."""
    share, field = throw_spot(
        tmp_path, "rays", box_mesh("Pane", (1.0, 1.0, 0.2), (0.0, 0.0, 1.0)), make_glass(shadow_passing_rgb=(1.0,) * 3)
    )
    assert share == pytest.approx(np.ones(3), rel=0.02)
    assert field.direct.irradiance.any()


def test_a_floor_inside_of_glass_is_lit(tmp_path):
    block = replace(box_mesh("Pane", (3.0, 3.0, 2.0), (0.0, 0.0, 0.5)), receives=False)
    share, _ = throw_spot(tmp_path, "rays", block, make_glass())
    assert share == pytest.approx(np.full(3, 0.96 / 1.5**2), rel=0.02)


@pytest.mark.parametrize("roughness", [0.0, 0.6])
def test_white_glass_makes_and_loses_no_energy(tmp_path, roughness):
    """All of a lamp's 24 W arrives on black walls, past and through a ball and a slab of glass."""
    ball, slab = sphere_mesh("Ball", rings=8, segments=12, radius_m=0.4), box_mesh("Slab", (0.6, 0.6, 0.1), (0.0, 0.0, -0.5))
    solids = [replace(ball, vertex=ball.vertex + np.array([0.4, 0.4, 0.3]), receives=False), replace(slab, receives=False)]
    lamp = Light("POINT", "Lamp", (-0.1, -0.1, 0.3), power_rgb=(24.0,) * 3, radius_m=0.02)
    scene = make_scene([room_mesh(size_m=(2.0, 2.0, 2.0)), *solids], [lamp], [BLACK, make_glass(roughness)])
    _, audit, field = bake(tmp_path, replace(scene, tri_material=np.minimum(scene.tri_object, 1)), "photons")
    arrived = field.solution.flux[:, field.leaves].sum(axis=1)
    assert arrived == pytest.approx(audit["emitted"], rel=2e-3)
    assert audit["refracted"].min() > 0.1 * audit["emitted"].min()


def test_the_noise_of_a_caustic_is_stated(tmp_path):
    """On a floor below a glass ball: two bakes differ by about as much as both state."""
    ball = replace(moved(sphere_mesh("Ball", radius_m=0.3), (0.0, 0.0, 0.4)), receives=False)
    floor = moved(quad_mesh("Floor", 0.8, 0.8), (-0.4, -0.4, 0.0))
    lamp = Light("POINT", "Lamp", (0.2, 0.1, 2.0), power_rgb=(5.0,) * 3, radius_m=0.2)
    scene = make_scene([floor, ball], [lamp], [Material("White", (0.5,) * 3), make_glass(0.3)])
    scene = replace(scene, tri_material=scene.tri_object.copy())
    bakes = []
    for seed in (1, 2):
        solver = make_solver(tmp_path / str(seed), scene, Settings(size=24, padding=1, error=0.2, seed=seed))
        light = solver.run(lambda message: None, lambda: False)
        found = texel_light.light_at_texels(light, solver.tracing.texels)
        assert light.ledger.gathered < 2.5 * light.gathered.counters["rays"]  # not anew after every round
        bakes.append((light.error, found.direct + found.indirect))
    (one, first), (other, second) = bakes
    mean = (first + second) / 2
    relative = ((first - second) ** 2 / (mean**2 + (DARK_FLOOR * mean.mean()) ** 2)).mean(axis=1)
    real = np.sqrt(np.sort(relative)[: int(BEST_TEXELS * len(relative))].mean())
    assert 0.5 < real / np.hypot(one, other) < 1.3  # without it 1.5
