"""Specular reflection: the lobes against quadrature, and furnaces in which nothing is lost."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import room_mesh, solve_scene
from floors import lit_scene, trace_first
from leaflight.core.scene.ggx import LEAST_ALPHA, fresnel, mask, sample_visible_normals, tinted_fresnel
from leaflight.core.scene.gloss import EDGE_COSINE, Gloss, find_mean_path, reflect_conductor, reflect_schlick, tabulate_lobe
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import MAX_ALBEDO, Light, Material, SceneSnapshot, TextureImage
from leaflight.core.scene.sheen import average_sheen, evaluate_sheen, tabulate_sheen
from leaflight.core.util.settings import Settings
from safe_bakes import bake_and_audit
from scenes import Mesh, make_scene, quad_scene

# Cosine of the view, angle of the sun with the normal (> 0 on the viewer's side), radiance in Cycles 5.0; roughness 0.7.
SHEEN_UNDER_A_SUN = (0.29, 1.277, 0.1046), (0.29, 0.055, 0.0535), (0.29, -0.818, 0.0686), (0.699, 1.145, 0.0451), (0.699, -0.425, 0.0317)


def make_gloss(material: Material) -> Gloss:
    scene = replace(quad_scene(), materials=(material,))
    gloss = Gloss.of(scene, SurfaceMaterials(scene))
    assert gloss is not None
    return gloss


def evaluate_ggx(view: np.ndarray, out: np.ndarray, alpha: float) -> np.ndarray:
    """GGX reflection times the cosine, without Fresnel; Walter et al. 2007, eq. 20 and 33."""
    half = view + out
    half /= np.linalg.norm(half, axis=0)
    c2 = half[2] ** 2
    d = alpha**2 / (np.pi * c2**2 * (alpha**2 + (1 - c2) / c2) ** 2)

    def smith(cosine):
        return 0.5 * (np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1)

    return d / (1 + smith(view[2]) + smith(out[2])) / (4 * view[2])


def hemisphere(n: int) -> tuple[np.ndarray, float]:
    """Directions (3, n^2) on a grid of equal solid angles, and that angle."""
    z, phi = np.meshgrid((np.arange(n) + 0.5) / n, 2 * np.pi * (np.arange(n) + 0.5) / n)
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z]).reshape(3, -1), 2 * np.pi / n**2


@pytest.mark.parametrize("alpha", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("cosine", [0.2, 0.6, 0.95])
def test_sampled_directions_bring_what_quadrature_finds(alpha, cosine):
    view = np.array([np.sqrt(1 - cosine**2), 0, cosine])[:, None]
    numbers = np.random.default_rng(1).random((2, 400_000))
    many = np.repeat(view, numbers.shape[1], axis=1)
    half = sample_visible_normals(many, np.full(numbers.shape[1], alpha), numbers)
    facing = (many * half).sum(axis=0)
    out = 2 * facing * half - many
    weight = mask(many[2], out[2], np.full(numbers.shape[1], alpha))
    grid, angle = hemisphere(500)
    exact = evaluate_ggx(np.repeat(view, grid.shape[1], axis=1), grid, alpha)
    assert weight.mean() == pytest.approx(exact.sum() * angle, rel=3e-3)
    # Where it goes, too: the share of light in a part of the hemisphere.
    for part in (lambda w: w[0] > 0, lambda w: w[2] > 0.7):
        assert (weight * part(out)).mean() == pytest.approx((exact * part(grid)).sum() * angle, abs=4e-3)


def test_fresnel_of_glass():
    assert fresnel(np.array([1.0]), np.array([1.5])) == pytest.approx(0.04)
    cosine = (np.arange(20000) + 0.5) / 20000
    assert (2 * cosine * fresnel(cosine, np.full(20000, 1.5))).mean() == pytest.approx(0.0918, abs=1e-4)  # Walsh 1926
    assert fresnel(np.array([0.0]), np.array([1.5])) == pytest.approx(1.0)


@pytest.mark.parametrize("roughness", [0.0, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("cosine", [0.1, 0.5, 0.99])
@pytest.mark.parametrize(
    "material",
    [
        {"metal_rgb": (0.9, 0.5, 0.1), "metal_edge_rgb": (0.2, 0.9, 0.4)},
        {"metal_rgb": (0.9, 0.5, 0.1), "metal_flat": True},
        {"layer": 1.0},
        {"layer": 0.4, "metal_rgb": (0.3, 0.3, 0.3), "metal": 0.6},
        {"layer": 0.4, "metal_rgb": (0.3, 0.3, 0.3), "metal": 0.6, "multiscatter": False},
        {"layer": 1.0, "coat": 0.7, "coat_roughness": 0.0, "coat_ior": 1.8},
        {"metal_rgb": (1.0, 0.5, 0.0), "coat": 1.0, "coat_roughness": 0.0},
        {"layer": 1.0, "coat": 1.0, "sheen_rgb": (0.9, 0.5, 0.2), "sheen_roughness": 0.7},
    ],
    ids=["metal", "flat metal", "layer", "both", "both, scattered once", "coat on layer", "coat on metal", "sheen on coat"],
)
def test_weights_of_reflected_rays_have_the_stated_albedo_as_mean(roughness, cosine, material):
    gloss, n = make_gloss(Material("Shiny", (1.0,) * 3, roughness=roughness, **material)), 100_000
    tri, where = np.zeros(n, np.intp), np.full(n, 0.25, np.float32)
    direction = np.repeat(np.float32([[np.sqrt(1 - cosine**2)], [0], [-cosine]]), n, axis=1)
    normal = np.repeat(np.float32([[0], [0], [1]]), n, axis=1)
    numbers = np.random.default_rng(2).random((2, n)).astype(np.float32)
    turned, weight = gloss.reflect(tri, where, where, direction, normal, numbers)
    stated = gloss.albedo_at(tri[:1], where[:1], where[:1], np.float32([cosine]))[:, 0]
    assert weight.mean(axis=1) == pytest.approx(stated, abs=3e-3 if "sheen_rgb" in material else 2e-3)
    assert np.abs(np.linalg.norm(turned, axis=0) - 1).max() < 1e-4
    if roughness == 0 and "sheen_rgb" not in material:
        assert turned[:, 0] == pytest.approx([np.sqrt(1 - cosine**2), 0, cosine], abs=0.02)


@pytest.mark.parametrize("roughness", [0.0, 1.0])
def test_a_flat_metal_reflects_its_colour_alike_at_all_angles(roughness):
    """Rough, light that is scattered twice is tinted twice: of half of it less than half of what white gives back is left."""
    cosines = np.float32([0.05, 0.3, 1.0])
    tri, where = np.zeros(3, np.intp), np.full(3, 0.25, np.float32)
    white, half = (
        make_gloss(Material("Flat", (c,) * 3, metal_rgb=(c,) * 3, metal_flat=True, roughness=roughness)).albedo_at(
            tri, where, where, cosines
        )
        for c in (MAX_ALBEDO, MAX_ALBEDO / 2)
    )
    assert white == pytest.approx(np.full((3, 3), MAX_ALBEDO), abs=2e-3)
    if roughness == 0:
        assert half == pytest.approx(white / 2, abs=1e-3)
    else:
        assert (half < 0.49 * white).all()


@pytest.mark.parametrize("roughness", [0.0, 0.5])
def test_a_coat_leaves_glass_what_it_does_not_reflect(roughness):
    glass = Material("Glass", (0.0,) * 3, glass_rgb=(1.0,) * 3, glass_mirror_rgb=(1.0,) * 3, coat=0.7, coat_roughness=roughness)
    gloss, cosines = make_gloss(glass), np.float32([0.1, 0.4, 1.0])
    tri, where = np.zeros(3, np.intp), np.full(3, 0.25, np.float32)
    left = gloss.below_coat(tri, where, where, cosines)
    assert left == pytest.approx(1 - gloss.albedo_at(tri, where, where, cosines)[0], abs=1e-5)
    assert 0.7 > 1 - left[0] > 1 - left[2] > 0.02
    assert make_gloss(Material("Shiny", layer=1.0)).below_coat(tri, where, where, cosines) is None


def test_a_tinted_coat_colours_glass_by_the_way_through_it():
    """A sun straight above a pane, whose colours hold the tint of a mean way."""
    mean = find_mean_path(1.5)
    assert mean == pytest.approx(np.mean(1 / np.sqrt(1 - np.linspace(0, 1, 10_001) / 1.5**2)), rel=1e-4)  # of even light
    tint, rough = (0.5, 0.8, 1.0), {"glass_mirror_rgb": (1.0,) * 3, "coat": 1.0, "coat_roughness": 0.0}
    pane = Material("Pane", (0.0,) * 3, glass_rgb=tuple(one**mean for one in tint), coat_tint_rgb=tint, **rough)
    scene = replace(lit_scene([], [Light("SUN", "Sun", power_rgb=(1.0,) * 3)]), materials=(pane, pane))
    refracted = trace_first(scene, 20_000)[0].audit.refracted
    assert refracted / refracted[2] == pytest.approx(tint, rel=1e-3)
    slanted = make_gloss(pane).tint_below_coat(np.zeros(1, np.intp), np.zeros(1), np.zeros(1), np.float32([0.6]))
    assert slanted[:, 0] * np.array(tint) ** mean == pytest.approx(np.array(tint) ** (1 / np.sqrt(1 - 0.64 / 2.25)), rel=1e-4)


def test_a_black_tint_leaves_a_layer_its_edges_alone():
    """The share that it reflects of even light, beside what Cycles 5.0 renders of such a plane at 60 degrees."""
    assert tinted_fresnel(*(np.array([value]) for value in (1.0, 1.5, 0.0)))[0] == 0
    assert tinted_fresnel(*(np.array([value]) for value in (0.0, 1.5, 0.0)))[0] == pytest.approx(1)
    for ior, tint, cycles in ((1.5, 0.0, 0.050), (1.5, 0.5, 0.068), (5.0, 0.5, 0.218), (1000.0, 0.5, 0.491)):
        gloss = make_gloss(Material("Tinted", layer=1.0, layer_tint=tint, roughness=0.3, ior=ior))
        one, cosine = np.zeros(1), np.array([0.5], np.float32)
        assert gloss.albedo_at(np.zeros(1, int), one, one, cosine)[0, 0] == pytest.approx(cycles, abs=0.01)


def test_a_mirror_has_its_tint_at_the_edge():
    """At 82 degrees Schlick's share of light times the tint, and straight on the colour."""
    rgb, tint = np.array([0.9, 0.5, 0.1]), np.array([0.3, 1.0, 0.6])
    gloss = make_gloss(Material("Metal", (0.9,) * 3, metal_rgb=tuple(rgb), metal_edge_rgb=tuple(tint), roughness=0.0))
    tri, where = np.zeros(2, np.intp), np.full(2, 0.25, np.float32)
    found = gloss.albedo_at(tri, where, where, np.float32([1.0, EDGE_COSINE]))
    assert found[:, 0] == pytest.approx(rgb, abs=1e-3)
    assert found[:, 1] == pytest.approx(reflect_schlick(EDGE_COSINE, rgb) * tint, abs=2e-3)


def test_gold_is_a_conductor():
    """Of red, green and blue light; the share straight on by n and k, and the known limits of Fresnel's equations."""
    n, k = np.array([0.18, 0.42, 1.37]), np.array([3.42, 2.35, 1.77])
    assert reflect_conductor(1.0, n, k) == pytest.approx(((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2))
    assert reflect_conductor(1e-6, n, k) == pytest.approx(np.ones(3), abs=1e-4)
    glass = np.array([1.5])
    assert reflect_conductor(0.3, glass, np.zeros(1)) == pytest.approx(fresnel(np.array([0.3]), glass))


def test_an_image_says_where_a_surface_is_metal_and_how_rough():
    """Left a rough metal, right paint below a layer: everywhere what a material of that alone reflects."""
    pixels = np.float32([[[0.75, 1.0, 0.0], [0.25, 0.0, 1.0]]])
    color = np.float32([[[0.9, 0.5, 0.1], [0.0, 0.0, 0.0]]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)[quad_scene().tri_vertex]
    mixed = Material("Mixed", (0.9,) * 3, metal_rgb=(1.0,) * 3, metal_image=1, metal=0.5, layer=0.5, diffuse=0.5, lobe_image=0)
    images = TextureImage("Lobes", pixels, closest=True), TextureImage("Metal", color, closest=True)
    scene = replace(quad_scene(), materials=(mixed,), images=images, tri_lobe_uv=uv, tri_metal_uv=uv)
    both = Gloss.of(scene, SurfaceMaterials(scene))
    left = make_gloss(Material("Metal", (0.9,) * 3, metal_rgb=(0.9, 0.5, 0.1), roughness=0.75))
    right = make_gloss(Material("Paint", (0.0,) * 3, layer=1.0, roughness=0.25))
    for cosine in np.float32([[0.2], [0.9]]):
        for gloss, place in ((left, 0.2), (right, 0.8)):
            # On the first triangle u + v is how far a point is to the right.
            at = np.zeros(1, np.intp), np.float32([place]), np.zeros(1, np.float32)
            assert both.albedo_at(*at, cosine) == pytest.approx(gloss.albedo_at(*at, cosine), abs=3e-3)
        assert both.below_layer(both.find_rows(*at), cosine) == pytest.approx(right.below_layer(np.zeros(1, int), cosine), abs=3e-3)


def test_a_white_metal_reflects_all():
    for alpha in (LEAST_ALPHA, 0.25, 1.0):
        gloss = make_gloss(Material("Metal", (1.0,) * 3, metal_rgb=(1.0,) * 3, roughness=np.sqrt(alpha)))
        cosine = np.linspace(0.01, 1, 50, dtype=np.float32)
        tri, where = np.zeros(50, np.intp), np.full(50, 0.25, np.float32)
        assert gloss.albedo_at(tri, where, where, cosine) == pytest.approx(np.ones((3, 50)), abs=2e-3)
        assert tabulate_lobe(alpha, 1.5)[0].min() > -0.01


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
def test_what_is_scattered_once_by_rough_facets_is_lost(roughness):
    """Of a white metal all but GGX's albedo E; of a layer the share 1 - E of what it covers."""
    cosine = np.linspace(0.02, 1, 40, dtype=np.float32)
    tri, where = np.zeros(40, np.intp), np.full(40, 0.25, np.float32)
    once = {"roughness": roughness, "multiscatter": False}
    grid, angle = hemisphere(1200)
    view = np.array([np.sqrt(1 - cosine[20] ** 2), 0, cosine[20]])[:, None]
    exact = (evaluate_ggx(np.repeat(view, grid.shape[1], axis=1), grid, roughness**2) * angle).sum() if roughness > 0.4 else 1.0
    metal = make_gloss(Material("Metal", (1.0,) * 3, metal_rgb=(1.0,) * 3, **once)).albedo_at(tri, where, where, cosine)[0]
    assert metal[20] == pytest.approx(exact, abs=4e-3)
    layer = make_gloss(Material("Layer", (1.0,) * 3, layer=1.0, **once))
    reflected, covered = layer.albedo_at(tri, where, where, cosine)[0], 1 - layer.below_layer(tri, cosine)
    assert reflected == pytest.approx(covered * metal, rel=2e-3)
    often = make_gloss(Material("Layer", (1.0,) * 3, layer=1.0, roughness=roughness))
    assert often.albedo_at(tri, where, where, cosine)[0] + often.below_layer(tri, cosine) == pytest.approx(np.ones(40), abs=1e-5)


def test_a_coat_takes_from_what_is_below_as_much_as_it_reflects():
    cosine = np.linspace(0.02, 1, 40, dtype=np.float32)
    tri, where = np.zeros(40, np.intp), np.full(40, 0.25, np.float32)
    coat = {"coat": 1.0, "coat_roughness": 0.4}
    white = make_gloss(Material("White", (1.0,) * 3, metal_rgb=(1.0,) * 3, roughness=0.6, **coat))
    assert white.albedo_at(tri, where, where, cosine) == pytest.approx(np.ones((3, 40)), abs=3e-3)
    paint = make_gloss(Material("Paint", (0.8,) * 3, layer=1.0, **coat))
    assert paint.albedo_at(tri, where, where, cosine)[0] + paint.below_layer(tri, cosine) == pytest.approx(np.ones(40), abs=1e-5)
    bare = make_gloss(Material("Paint", (0.8,) * 3, layer=1.0))
    alone = make_gloss(Material("Coat", (0.0,) * 3, **coat))
    assert paint.below_layer(tri, cosine) == pytest.approx(bare.below_layer(tri, cosine) * alone.below_layer(tri, cosine), abs=1e-5)
    assert alone.albedo_at(tri[-1:], where[-1:], where[-1:], cosine[-1:])[0] == pytest.approx([0.04], abs=2e-3)


@pytest.mark.parametrize("roughness", [0.2, 1.0])
def test_rays_go_on_by_the_lobes_of_the_coat_and_of_the_metal_below(roughness):
    """Everywhere as much as by the coat alone and, of what that leaves, by the metal alone."""
    coat, metal = {"coat": 0.8, "coat_roughness": roughness}, {"metal_rgb": (0.9, 0.5, 0.1), "roughness": 1.2 - roughness}
    n, cosine = 200_000, 0.6
    tri, where = np.zeros(n, np.intp), np.full(n, 0.25, np.float32)
    direction = np.repeat(np.float32([[0.8], [0], [-cosine]]), n, axis=1)
    normal = np.repeat(np.float32([[0], [0], [1]]), n, axis=1)
    found = []
    for lobes in (coat | metal, coat, metal):
        gloss = make_gloss(Material("Coated", (0.9, 0.5, 0.1), **lobes))
        turned, weight = gloss.reflect(tri, where, where, direction, normal, np.random.default_rng(5).random((2, n)).astype(np.float32))
        stated = gloss.albedo_at(tri[:1], where[:1], where[:1], np.float32([cosine]))[:, 0]
        assert weight.mean(axis=1) == pytest.approx(stated, abs=3e-3)
        near = np.float32([0.8, 0, 0.6]) @ turned > 0.97  # around where a mirror sends them
        found.append(np.stack([(weight * near).mean(axis=1), (weight * (turned[2] < 0.4)).mean(axis=1), stated]))
    both, of_coat, of_metal = found
    assert both == pytest.approx(of_coat + (1 - of_coat[2]) * of_metal, abs=4e-3)


def test_sheen_takes_from_what_is_below_as_much_as_it_reflects():
    """White paint stays white below it, from wherever it is seen; and the albedo that it has for even light is its mean."""
    cosine = np.linspace(0.02, 1, 200, dtype=np.float32)
    tri, where = np.zeros(200, np.intp), np.full(200, 0.25, np.float32)
    even = average_sheen(0.7)
    gloss = make_gloss(Material("Velvet", (1.0,) * 3, diffuse=1 - even, sheen_rgb=(1.0,) * 3, sheen_roughness=0.7))
    reflected = gloss.albedo_at(tri, where, where, cosine)[0]
    paint, rows = gloss.find_diffuse(tri, where, where, np.ones((3, 200), np.float32))
    assert reflected + paint[0] * gloss.below_layer(rows, cosine) == pytest.approx(np.ones(200), abs=2e-3)
    assert reflected[0] > 4 * reflected[-1]
    assert (2 * cosine * reflected).mean() == pytest.approx(even, rel=0.03)


def test_sheen_is_brightest_along_the_surface():
    """Beside what Cycles renders of a plane with white sheen under a sun of 1 W/m^2, seen at cosines, the sun beyond, above and behind."""
    for cosine, toward, expected in SHEEN_UNDER_A_SUN:
        view = np.array([[np.sqrt(1 - cosine**2)], [0], [cosine]])
        sun = np.array([[np.sin(toward)], [0], [np.cos(toward)]])
        a, b, r = (np.interp(np.sqrt(cosine), np.linspace(0, 1, 65), values) for values in tabulate_sheen(0.7, 65))
        assert (r * evaluate_sheen(view, sun, a, b) * sun[2])[0] == pytest.approx(expected, rel=0.05)


def test_a_layer_covers_the_diffuse_part_of_the_surface_alone():
    """Of a surface that lets six tenths of the light pass, the paint is all below the layer; of one that is half bare paint, half is."""
    cosine, tri, where = np.float32([0.3, 0.9]), np.zeros(2, np.intp), np.full(2, 0.25, np.float32)
    whole, clear, half = (
        make_gloss(Material("Paint", (0.3,) * 3, layer=layer, diffuse=diffuse)) for layer, diffuse in ((1, 1), (0.4, 0.4), (0.5, 1))
    )
    below = whole.below_layer(tri, cosine)
    assert clear.below_layer(tri, cosine) == pytest.approx(below)
    assert half.below_layer(tri, cosine) == pytest.approx((1 + below) / 2)
    assert clear.albedo_at(tri, where, where, cosine) == pytest.approx(0.4 * whole.albedo_at(tri, where, where, cosine))


@pytest.mark.parametrize(
    "lobes",
    [
        {"metal_rgb": (0.9,) * 3},
        {"metal_rgb": (0.9,) * 3, "coat": 1.0, "coat_ior": 2.5},
        {"metal_rgb": (0.9,) * 3, "sheen_rgb": (0.9,) * 3, "sheen_roughness": 0.8},
        {"diffuse": 0.0, "sheen_rgb": (0.9,) * 3, "sheen_roughness": 0.6},
    ],
    ids=["metal", "coat", "sheen on metal", "sheen"],
)
def test_photons_bring_what_rays_fetch(lobes):
    """From directions around the normal to grazing ones photons carry as much as rays the other way round."""
    gloss, n = make_gloss(Material("Metal", (0.9,) * 3, roughness=0.9, coat_roughness=0.6, **lobes)), 400_000
    rng, tri, where = np.random.default_rng(6), np.zeros(n, np.intp), np.full(n, 0.25, np.float32)
    normal = np.repeat(np.float32([[0], [0], [1]]), n, axis=1)
    carried = []
    for low, high, of_light in ((0.8, 1.0, True), (0.0, 0.3, False)):
        cosine, turn = np.sqrt(low**2 + (high**2 - low**2) * rng.random(n)), 2 * np.pi * rng.random(n)
        sine = np.sqrt(1 - cosine**2)
        direction = -np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine]).astype(np.float32)
        turned, weight = gloss.reflect(tri, where, where, direction, normal, rng.random((2, n)).astype(np.float32), of_light)
        arrived = (turned[2] > 0) & (turned[2] < 0.3) if of_light else turned[2] > 0.8
        carried.append((weight[0] * arrived).mean() * (high**2 - low**2))
    assert carried[0] == pytest.approx(carried[1], rel=0.02 if "sheen_rgb" in lobes else 0.01)


def furnace(material: Material, lamp_w: float = 24.0) -> SceneSnapshot:
    """A closed room of one material with a lamp in its middle."""
    lamp = Light("POINT", "Lamp", power_rgb=(lamp_w,) * 3, radius_m=0.05)
    return make_scene([room_mesh(size_m=(2.0, 2.0, 2.0))], [lamp], [material])


def bake(folder, scene, direct="rays", photons=200_000):
    return bake_and_audit(folder, scene, direct=direct, max_photons=photons, error=0.01)


@pytest.mark.parametrize("direct", ["rays", "photons"])
@pytest.mark.parametrize("roughness", [0.05, 0.5, 1.0])
def test_a_room_of_half_metal_keeps_its_energy(tmp_path, roughness, direct):
    """Half of what arrives is reflected, some of it as a mirror does: walls that glow evenly get twice their own light.

    A lamp in its middle would lose some on rough metal, which gives back less of what comes straight on than at an angle, as in Cycles.
    """
    material = Material("Half", (0.5,) * 3, emission_rgb=(1.0,) * 3, metal_rgb=(0.25,) * 3, metal=0.25, roughness=roughness)
    light, audit, _ = bake(tmp_path, make_scene([room_mesh()], [], [material]), direct)
    # Schlick's edges reflect a little more than the colour: of 0.25 of metal 0.25 at all angles, for it is white there.
    assert light == pytest.approx(np.full(3, 2 * np.pi), rel=0.005)
    assert (audit["mirrored"] > 0).all()


def test_a_white_layered_room_loses_only_what_the_clamp_takes(tmp_path):
    """White paint below a layer: what the layer does not reflect, the paint does."""
    light, audit, _ = bake(tmp_path, furnace(Material("White", (0.9,) * 3, layer=1.0, roughness=0.5)))
    assert MAX_ALBEDO > 0.99
    mean = audit["mirrored"] / (light * 24.0)
    assert mean == pytest.approx(np.full(3, 0.062), abs=0.012)  # the layer's albedo, between straight on and from everywhere
    assert light.mean() == pytest.approx(10.0 * (1 + 0.03), rel=0.03)
    assert light.mean() > 10.05


def test_photons_do_not_grow_in_number_on_white_layered_walls(tmp_path):
    """What the layer may mirror and the paint may scatter is one photon in the mean; a tenth more at each wall is 45 times as many."""
    scene = furnace(Material("White", (1.0,) * 3, layer=1.0, roughness=0.5))
    settings = Settings(direct="photons", size=48, max_photons=4000, error=1e-4, workers=1, max_depth=40)
    ledger = solve_scene(tmp_path, scene, settings).ledger
    assert ledger.rays == pytest.approx(40 * ledger.photons, rel=0.2)


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_mirror_throws_a_caustic(tmp_path, direct):
    """A spot on a mirror at 45 degrees lights a black wall that sees nothing of the spot: all its light comes there, once."""
    mirror = Mesh("Mirror", np.array([[-0.5, 0, -0.5], [0.5, 0, -0.5], [0.5, 1, 0.5], [-0.5, 1, 0.5]], float), [[0, 1, 2, 3]], None, False)
    wall = Mesh("Wall", np.array([[-1, -2, -1], [1, -2, -1], [1, -2, 1], [-1, -2, 1]], float), [[0, 3, 2, 1]])
    spot = Light("SPOT", "Spot", (0, 0.5, 3), ((1, 0, 0), (0, 1, 0), (0, 0, 1)), (100.0,) * 3, cone_angle_rad=0.1)
    scene = make_scene(
        [wall, mirror], [spot], [Material("Black", (0,) * 3), Material("Mirror", (0.8,) * 3, metal_rgb=(0.8,) * 3, roughness=0)]
    )
    scene = replace(scene, tri_material=scene.tri_object)
    light, audit, field = bake(tmp_path, scene, direct, photons=100_000)
    emitted = audit["emitted"][0]
    assert light[0] * 4.0 == pytest.approx(0.8 * emitted, rel=0.03)
    assert audit["mirrored"][0] == pytest.approx(0.8 * emitted, rel=0.03)
    if direct == "rays":
        assert not field.direct.irradiance.any()


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_mirror_with_a_normal_map_throws_light_aside(tmp_path, direct):
    """A level mirror whose map leans by 22.5 degrees sends a beam from above to a wall at 45 degrees.

    What looks into it sees as bright a lamp as in a mirror, in the same solid angle, of which it shows the cosine of 45 degrees only.
    """
    mirror = Mesh("Mirror", np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]], float), [[0, 1, 2, 3]], None, False)
    wall = Mesh("Wall", np.array([[-1, -2, 1], [1, -2, 1], [1, -2, 3], [-1, -2, 3]], float), [[0, 3, 2, 1]])
    spot = Light("SPOT", "Spot", (0, 0, 3), ((1, 0, 0), (0, 1, 0), (0, 0, 1)), (100.0,) * 3, cone_angle_rad=0.1)
    lean = np.deg2rad(22.5)
    bumps = TextureImage("Normals", np.float32([[[0, -np.sin(lean), np.cos(lean)]]]))
    black = Material("Black", (0,) * 3)
    leaning = Material("Mirror", (0.8,) * 3, metal_rgb=(0.8,) * 3, roughness=0, normal_image=0)
    scene = make_scene([wall, mirror], [spot])
    scene = replace(scene, materials=(black, leaning), tri_material=scene.tri_object, images=(bumps,))
    light, audit, _ = bake(tmp_path, scene, direct, photons=100_000)
    assert light[0] * 4.0 == pytest.approx(0.8 * np.sqrt(0.5) * audit["emitted"][0], rel=0.03)


def test_rough_metal_is_tinted_at_each_scattering():
    """What leaves after k scatterings more than one was tinted k times: a share (1 - E)^(k - 1) E of it, with the lobe's mean albedo E."""
    roughness, rho, cosine = 0.9, 0.5, np.float32([0.3, 0.6, 0.9])
    tri, where = np.zeros(3, np.intp), np.full(3, 0.25, np.float32)
    gloss = make_gloss(Material("Metal", (rho,) * 3, metal_rgb=(rho,) * 3, roughness=roughness))
    lost, edge = tabulate_lobe(roughness**2, 1.5)[:2]
    place, fine = np.linspace(0, 1, 65) ** 2, (np.arange(4000) + 0.5) / 4000
    mean = (2 * fine / (1 + np.interp(np.sqrt(fine), np.sqrt(place), lost))).mean()
    tint = rho + (1 - rho) / 21
    several = sum(tint**k * (1 - mean) ** (k - 1) * mean for k in range(1, 60))
    own_lost, own_edge = (np.interp(np.sqrt(cosine), np.sqrt(place), table) for table in (lost, edge))
    single = rho / (1 + own_lost) + (1 - rho) * own_edge
    assert gloss.albedo_at(tri, where, where, cosine)[0] == pytest.approx(single * (1 + several * own_lost), rel=2e-3)
