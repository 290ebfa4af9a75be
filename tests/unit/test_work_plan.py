"""What a bake does not need is not done, the images are the same, and the report counts it."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import bake_folder, lamp_scene
from leaflight.core.lights.emitters import SceneCover
from leaflight.core.lights.lights import make_light_emitter
from leaflight.core.output.image_file import read_image
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.pruning import can_reach, prune_scene
from leaflight.core.scene.rays import RayScene
from leaflight.core.scene.scene import Light, Material, TextureImage
from leaflight.core.texels.error_metric import BEST_TEXELS, DARK_FLOOR
from leaflight.core.util.geometry import UnitBox
from leaflight.core.util.messages import Status
from leaflight.core.util.settings import Settings

pytestmark = pytest.mark.usefixtures("open_image_io")


# What a bake does not need is not done, the images are the same, and the report counts it.
QUICK = Settings(size=32, padding=1, workers=1, error=0.3, max_photons=20_000)
GREY, BLACK = lamp_scene(), lamp_scene(rho=0.0)


def bake_scene(folder, scene, **knobs):
    """Result, stages and pictures of a bake by pass."""
    messages, result = bake_folder(folder, scene, replace(QUICK, **knobs))
    stages = [message.stage for message in messages if isinstance(message, Status)]
    return result, list(dict.fromkeys(stages)), {file["pass_name"]: read_image(file["path"])[0] for file in result["files"]}


def test_direct_light_alone_traces_no_photon_and_is_the_same(tmp_path):
    """Byte for byte on the same charts: contacts, which cut them, are looked for where light is reflected only."""
    knobs = {"error": 0.05, "denoise": False, "contact": False}
    full, _, pictures = bake_scene(tmp_path / "a", GREY, passes=("direct", "indirect"), **knobs)
    result, stages, alone = bake_scene(tmp_path / "b", GREY, passes=("direct",), **knobs)
    assert stages == ["load", "charts", "texels", "scene", "direct", "write"] == list(result["seconds"])
    assert (result["photons"], result["stopped_by"], result["skipped"]["indirect_light"]) == (0, "error", 1)
    assert result["skipped"]["photons"] == QUICK.max_photons
    assert full["skipped"]["indirect_light"] == 0
    assert np.array_equal(alone["direct"], pictures["direct"])


def test_indirect_light_leaves_direct_light_as_sharp_as_it_is_alone(tmp_path):
    """Judged over the best texels against finely traced direct light, relative to its brightness."""
    _, _, fine = bake_scene(tmp_path / "fine", GREY, passes=("direct",), error=1e-3, denoise=False)
    covered = fine["direct"][..., 3] > 0
    truth = fine["direct"][covered][:, :3]
    errors = []
    for name, passes in (("alone", ("direct",)), ("both", ("direct", "indirect"))):
        found = bake_scene(tmp_path / name, GREY, passes=passes, error=0.05)[2]["direct"][covered][:, :3]
        squares = (found - truth) ** 2 / (truth**2 + (DARK_FLOOR * truth.mean()) ** 2)
        errors.append(np.sqrt(np.sort(squares, axis=None)[: int(BEST_TEXELS * squares.size)].mean()))
    assert errors[1] < 1.2 * errors[0]


def test_direct_light_by_photons_traces_first_hits_only(tmp_path):
    result, _, _ = bake_scene(tmp_path / "a", GREY, passes=("direct",), direct="photons")
    assert result["rays"] == result["photons"] > 0


def test_surfaces_alone_trace_nothing_and_need_no_light(tmp_path):
    dark = replace(GREY, lights=())
    result, stages, pictures = bake_scene(tmp_path / "a", dark, passes=("albedo", "emission"))
    assert stages == ["load", "charts", "texels", "write"]
    assert (result["photons"], result["rays"], result["estimated_error"], result["stopped_by"]) == (0, 0, 0.0, "error")
    assert (result["skipped"]["direct_light"], result["skipped"]["indirect_light"]) == (1, 1)
    covered = pictures["albedo"][..., 3] > 0
    assert pictures["albedo"][covered][:, :3] == pytest.approx(0.5, abs=1e-3)


def test_black_surfaces_reflect_no_photon(tmp_path):
    """By rays and by photons of one hit: the same light."""
    result, stages, pictures = bake_scene(tmp_path / "a", BLACK, passes=("lighting", "indirect"), error=0.02)
    assert "photons" not in stages
    assert (result["photons"], result["skipped"]["indirect_light"]) == (0, 1)
    assert not pictures["indirect"][..., :3].any()
    by_photons, _, _ = bake_scene(tmp_path / "b", BLACK, direct="photons")
    assert by_photons["rays"] == by_photons["photons"]


def test_what_gives_no_light_is_counted_and_changes_nothing(tmp_path):
    lamp = GREY.lights[0]
    idle = (
        replace(lamp, name="Off", power_rgb=(0.0,) * 3),
        Light("AREA", "Away", (0.0, 0.0, 9.0), ((1, 0, 0), (0, 1, 0), (0, 0, -1)), (5.0, 5.0, 5.0)),
    )
    paint = TextureImage("Paint", np.full((2, 2, 3), 0.5, np.float32))
    scene = replace(GREY, lights=(lamp, *idle), materials=(Material("Grey", (1.0, 1.0, 1.0), 0),), images=(paint,))
    plain, _, expected = bake_scene(tmp_path / "a", GREY)
    result, _, pictures = bake_scene(tmp_path / "b", scene)
    assert np.array_equal(pictures["combined"], expected["combined"])
    names = ("lights_without_power", "lights_out_of_reach", "textures_of_one_colour")
    assert [result["skipped"][name] for name in names] == [1, 1, 1]
    assert [plain["skipped"][name] for name in names] == [0, 0, 0]


def test_objects_that_need_nothing_are_counted(tmp_path):
    """The block is neither baked nor seen by light; the floor has a layer that is used."""
    floor, block = GREY.objects
    layer = np.where(GREY.tri_object[:, None, None] == 0, GREY.vertex_position[GREY.tri_vertex][..., :2] + 0.5, 0.0)
    scene = replace(GREY, tri_uv=layer, objects=(replace(floor, has_layer=True), replace(block, receives=False, casts_shadow=False)))
    result, _, _ = bake_scene(tmp_path / "a", scene)
    assert (result["skipped"]["objects_without_effect"], result["skipped"]["objects_not_unwrapped"]) == (1, 1)
    glowing = replace(scene, materials=(replace(scene.materials[0], emission_rgb=(1.0, 1.0, 1.0)),))
    assert bake_scene(tmp_path / "b", glowing)[0]["skipped"]["objects_without_effect"] == 0


def test_photons_that_the_time_limit_cost_are_not_counted_as_spared(tmp_path):
    result, _, _ = bake_scene(tmp_path / "a", GREY, max_photons=10**9, error=1e-4, time_limit=0.001)
    assert result["stopped_by"] == "time_limit"
    assert (result["photons"] < 10**9, result["skipped"]["photons"]) == (True, 0)


def test_rays_that_are_spared_are_counted(tmp_path):
    result, _, _ = bake_scene(tmp_path / "a", GREY)
    assert result["skipped"]["pairs_out_of_reach"] == result["direct"]["out_of_reach"] > 0
    assert result["skipped"]["pairs_settled_early"] == result["direct"]["settled"] > 0
    assert result["skipped"]["photons"] == QUICK.max_photons - result["photons"] >= 0


def test_lamps_that_give_little_are_sampled_together_and_counted(tmp_path):
    lamp = GREY.lights[0]
    many = tuple(replace(lamp, name=str(k), position_m=(0.1 * (k % 5), 0.1 * (k // 5), lamp.position_m[2])) for k in range(20))
    result, _, _ = bake_scene(tmp_path / "a", replace(GREY, lights=many))
    assert result["skipped"]["pairs_sampled_together"] == result["direct"]["sampled"] > 0
    assert bake_scene(tmp_path / "b", GREY)[0]["skipped"]["pairs_sampled_together"] == 0


# Pruned scenes bake alike: what is left out reaches nothing, and what is folded was the same everywhere.
SCENE = lamp_scene()
POINTS = SCENE.vertex_position


def random_light(kind, rng):
    """A light somewhere around the scene, turned somewhere."""
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return Light(
        kind,
        kind,
        tuple(rng.uniform(-2, 2, 3)),
        tuple(map(tuple, axes)),
        (1.0, 1.0, 1.0),
        radius_m=float(rng.choice([0.0, 0.3])),
        soft_falloff=bool(rng.integers(2)),
        cone_angle_rad=float(rng.uniform(0.05, np.pi)),
        blend=0.5,
        size_m=(0.5, 0.2),
    )


def count_hits(light, rng):
    """How many of 500 photons of a light meet the scene."""
    box = UnitBox.from_points(np.concatenate([POINTS, [light.position_m]]))
    emitter = make_light_emitter(light, np.ones(3), box, SceneCover.around(box.to_unit(POINTS)))
    births = emitter.emit(rng.random((500, 4), np.float32))
    return int((RayScene(box.to_unit(SCENE.tri_position)).closest(births.origin, births.direction).tri >= 0).sum())


@pytest.mark.parametrize("kind", ["SPOT", "AREA"])
def test_lights_out_of_reach_send_no_photon_to_the_scene(kind):
    rng = np.random.default_rng(5)
    lights = [random_light(kind, rng) for _ in range(300)]
    reach = np.array([can_reach(light, POINTS) for light in lights])
    hits = np.array([count_hits(light, rng) for light in lights])
    assert not hits[~reach].any()
    assert (~reach).sum() > 0.6 * (hits == 0).sum() > 20  # and few that send none are kept


def test_a_wide_lamp_reaches_beside_its_cone():
    """A spot whose cone passes the scene, but not the rim of whose sphere."""
    beside = Light("SPOT", "Beside", (1.2, 0.0, 2.0), power_rgb=(1.0,) * 3, cone_angle_rad=0.02, radius_m=0.8, soft_falloff=False)
    assert can_reach(beside, POINTS)
    assert count_hits(beside, np.random.default_rng(8)) > 0
    assert not can_reach(replace(beside, radius_m=0.0), POINTS)


@pytest.mark.parametrize("kind", ["POINT", "SUN"])
def test_lights_that_shine_everywhere_are_kept(kind):
    rng = np.random.default_rng(6)
    assert all(can_reach(random_light(kind, rng), POINTS) for _ in range(20))


@pytest.mark.parametrize(
    "change", [{"position_m": (np.nan, 0.0, 0.0)}, {"cone_angle_rad": np.inf}, {"rotation": ((1, 0, 0), (0, 1, 0), (0, 0, np.nan))}]
)
def test_where_in_doubt_a_light_is_kept(change):
    away = Light("SPOT", "Away", (0.0, 0.0, 9.0), ((1, 0, 0), (0, 1, 0), (0, 0, -1)), (1.0, 1.0, 1.0), cone_angle_rad=0.1)
    assert not can_reach(away, POINTS)
    assert can_reach(replace(away, **change), POINTS)


def test_idle_lights_are_left_out_and_counted():
    lamp = SCENE.lights[0]
    off = replace(lamp, name="Off", power_rgb=(0.0, 0.0, 0.0))
    away = Light("AREA", "Away", (0.0, 0.0, 9.0), ((1, 0, 0), (0, 1, 0), (0, 0, -1)), (1.0, 1.0, 1.0))
    pruned, counts = prune_scene(replace(SCENE, lights=(off, lamp, away)))
    assert pruned.lights == (lamp,)
    assert (counts["lights_without_power"], counts["lights_out_of_reach"]) == (1, 1)
    assert prune_scene(replace(SCENE, lights=(away,)))[0].lights == (away,)  # it has light, though nothing sees it


def picture(pixels, extension="REPEAT"):
    return TextureImage("Picture", np.asarray(pixels, np.float32), extension)


ONE_COLOUR = np.broadcast_to(np.float32([0.5, 0.25, 1.0]), (4, 3, 3))
TWO_COLOURS = ONE_COLOUR * np.float32([[[1.0]], [[1.0]], [[0.5]], [[1.0]]])


@pytest.mark.parametrize(
    ("pixels", "extension", "rgb", "folded"),
    [
        (ONE_COLOUR, "REPEAT", (0.8, 0.8, 0.8), True),
        (ONE_COLOUR, "MIRROR", (3.0, 0.8, 0.8), True),  # clamped alike
        (ONE_COLOUR, "CLIP", (0.8, 0.8, 0.8), False),  # black around it
        (TWO_COLOURS, "REPEAT", (0.8, 0.8, 0.8), False),
        (TWO_COLOURS, "REPEAT", (0.0, 0.0, 0.0), True),
        (ONE_COLOUR * np.nan, "REPEAT", (0.8, 0.8, 0.8), False),
        (np.zeros((0, 0, 3)), "REPEAT", (0.8, 0.8, 0.8), False),
    ],
)
def test_a_texture_of_one_colour_is_no_texture(pixels, extension, rgb, folded):
    material = Material("Painted", rgb, 0, rgb, 0)
    scene = replace(SCENE, materials=(material,), images=(picture(pixels, extension),))
    pruned, counts = prune_scene(scene)
    assert counts["textures_of_one_colour"] == (2 if folded else 0)
    before, after = SurfaceMaterials(scene), SurfaceMaterials(pruned)
    assert before.albedo.has_images
    assert after.albedo.has_images is after.emission.has_images is not folded
    rng = np.random.default_rng(7)
    tri, (u, v) = rng.integers(0, scene.n_tri, 50), rng.random((2, 50), np.float32) / 2
    assert after.albedo.at(tri, u, v) == pytest.approx(before.albedo.at(tri, u, v), rel=1e-6)
    assert after.emission.at(tri, u, v) == pytest.approx(before.emission.at(tri, u, v), rel=1e-6)
