"""Closed forms of irradiance against sums, rays of every source against them, and texels that are wider than their light is far."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floors import floor_footprints, lit_scene, morton_square, prepare
from leaflight.core.integrate.near_field_quadrature import average_peaks, find_peaks
from leaflight.core.lights.direct_lights import Source, TriangleSource, WorldSource, join_sources, make_lamps, make_suns
from leaflight.core.lights.direct_points import GAUSS_POINTS, TexelChunk, random_shift
from leaflight.core.lights.irradiance import cap_irradiance, ellipse_irradiance, point_irradiance, polygon_irradiance, sun_irradiance
from leaflight.core.scene.scene import Light
from leaflight.core.texels.texel_footprint import centred_strata
from leaflight.core.util.geometry import ORIGIN_OFFSET, UnitBox

# Closed forms of irradiance against sums over the lights, and limits known by thought.
UP = np.array([[0.0, 0.0, 1.0]])
ORIGIN = np.zeros((1, 3))


def random_directions(count: int, seed: int) -> np.ndarray:
    vector = np.random.default_rng(seed).normal(size=(count, 3))
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)


def sum_over_parallelogram(corners: np.ndarray, position: np.ndarray, normal: np.ndarray, steps: int = 300) -> float:
    """Irradiance from the front of corners 0, 1, 2, 3, summed over a grid of its points."""
    line = (np.arange(steps) + 0.5) / steps
    s, t = (grid.reshape(-1, 1) for grid in np.meshgrid(line, line))
    along, up = corners[1] - corners[0], corners[3] - corners[0]
    front = np.cross(along, up)
    area = np.linalg.norm(front)
    vector = corners[0] + s * along + t * up - position
    square = (vector**2).sum(axis=1)
    cosines = np.maximum(vector @ normal, 0) * np.maximum(-(vector @ front) / area, 0) / square
    return float((cosines / square).mean() * area)


def test_polygons_equal_the_sum_over_their_points():
    generator = np.random.default_rng(1)
    checked = cut = 0
    for normal in random_directions(100, 2):
        start, along, up = generator.normal(size=(3, 3))
        corners = np.stack([start, start + along, start + along + up, start + up])
        position = 2 * generator.normal(size=3)
        heights = (corners - position) @ normal
        expected = sum_over_parallelogram(corners, position, normal)
        found = polygon_irradiance(corners, position[None], normal[None])[0]
        assert max(found, 0) == pytest.approx(expected, rel=2e-3, abs=2e-4)
        assert polygon_irradiance(corners[::-1], position[None], normal[None])[0] == pytest.approx(-found, abs=1e-12)
        checked += expected > 1e-3
        cut += expected > 1e-3 and heights.min() < 0
    assert checked >= 10
    assert cut >= 4


def test_a_huge_ceiling_is_half_the_world():
    corners = np.array([[-1, -1, 1e-4], [-1, 1, 1e-4], [1, 1, 1e-4], [1, -1, 1e-4]])
    assert polygon_irradiance(corners, ORIGIN, UP)[0] == pytest.approx(math.pi, rel=1e-3)
    sideways = np.array([[1.0, 0.0, 0.0]])
    assert polygon_irradiance(corners, ORIGIN, sideways)[0] == pytest.approx(math.pi / 2, rel=1e-3)


def test_a_small_far_polygon_keeps_its_digits():
    corners = np.array([[0, 0, 1000], [0, 1e-3, 1000], [1e-3, 1e-3, 1000], [1e-3, 0, 1000]])
    assert polygon_irradiance(corners, ORIGIN, UP)[0] == pytest.approx(1e-12, rel=1e-3)


def test_a_polygon_below_the_horizon_gives_nothing():
    corners = np.array([[0, 0, -1], [0, 1, -1], [1, 1, -2.0]])
    assert polygon_irradiance(corners, ORIGIN, UP)[0] == 0


def test_polygons_with_the_receiver_in_their_plane_are_finite():
    corners = np.array([[0, 0, 0], [0, 1, 0], [1, 1, 0.0]])
    for position in ([0.3, 0.5, 0], [0, 0, 0], [0, 0.5, 0], [3, 3, 0]):
        for normal in (UP, np.array([[1.0, 0, 0]])):
            assert np.isfinite(polygon_irradiance(corners, np.array([position], float), normal)).all()


@pytest.mark.parametrize(("cosine", "share"), [(0.9, 0.1), (0.1, 0.3), (-0.3, 0.4), (0.5, 1.0), (0.01, 4e-4), (-0.2, 0.9999)])
def test_caps_equal_the_sum_over_their_directions(cosine, share):
    z = 1 - (1 - math.sqrt(1 - share)) * (np.arange(500) + 0.5)[:, None] / 500
    phi = 2 * math.pi * (np.arange(1000) + 0.5) / 1000
    facing = np.maximum(z * cosine + np.sqrt(1 - z * z) * np.cos(phi) * math.sqrt(1 - cosine**2), 0)
    expected = facing.mean() * 2 * math.pi * (1 - math.sqrt(1 - share))
    assert cap_irradiance(np.array([cosine]), np.array([share]))[0] == pytest.approx(expected, rel=1e-4)


def test_caps_are_continuous_where_the_horizon_meets_them():
    share = 0.25  # 30 degrees
    for edge in (math.sqrt(share), -math.sqrt(share)):
        below, above = cap_irradiance(np.array([edge - 1e-9, edge + 1e-9]), np.full(2, share))
        assert below == pytest.approx(above, abs=1e-7)
    assert cap_irradiance(np.array([-0.6]), np.array([share]))[0] == 0


def test_point_lights():
    to_light = np.array([[0, 3.0, 4.0]])
    assert point_irradiance(to_light, UP, 0.0, True)[0] == pytest.approx(0.8 / 25)
    assert point_irradiance(to_light, UP, 2.0, True)[0] == pytest.approx(0.8 / (25 + 4))  # a disk of radius 2 that turns to the receiver
    assert point_irradiance(to_light, UP, 2.0, False)[0] == pytest.approx(0.8 / 25)  # a sphere wholly above the horizon
    inside = point_irradiance(np.array([[0, 0.1, 0.1]]), UP, 2.0, False)[0]
    assert inside == pytest.approx(math.pi / (math.pi * 4))  # radiance 1 / (pi r^2) from all around
    for radius in (0.0, 2.0):
        for soft in (True, False):
            assert np.isfinite(point_irradiance(ORIGIN, UP, radius, soft)).all()


def test_a_light_behind_is_seen_by_what_rises_over_the_horizon():
    to_light = np.array([[0, 3.0, -0.5]])
    assert point_irradiance(to_light, UP, 0.0, True)[0] == 0
    assert 0 < point_irradiance(to_light, UP, 1.0, False)[0] < 0.01


def test_suns():
    cosine = np.array([1.0, 0.6, -0.2])
    assert sun_irradiance(cosine, 0.0) == pytest.approx([1, 0.6, 0])
    assert sun_irradiance(cosine, 0.3)[:2] == pytest.approx([1, 0.6])
    assert sun_irradiance(cosine, 0.3)[2] > 0
    assert sun_irradiance(np.array([0.0]), math.pi / 2)[0] == pytest.approx(0.5)  # half of a hemisphere of radiance 1 / pi


def test_ellipses():
    """Against a polygon of 2,000 corners; the disk on its axis also against pi r^2 / (r^2 + d^2)."""
    axes = np.array([[1.0, 0, 0], [0, 0.6, 0]])
    phi = 2 * math.pi * np.arange(2000) / 2000
    fine = np.stack([np.cos(phi), np.sin(phi)], axis=1) @ axes
    for distance in (1.2, 2.0, 2.9, 3.1, 5.9, 6.1, 20.0):
        position, normal = distance * random_directions(300, 6), random_directions(300, 7)
        found, expected = ellipse_irradiance(np.zeros(3), axes, position, normal), polygon_irradiance(fine, position, normal)
        assert np.abs(found - expected).max() < (1e-3 if distance < 3.0 else 3e-4) * np.abs(expected).max()
    disk = ellipse_irradiance(np.array([0, 0, 2.0]), np.array([[0, 1.0, 0], [1.0, 0, 0]]), ORIGIN, UP)
    assert disk[0] == pytest.approx(math.pi / 5, rel=1e-3)


# Every source: its rays, weighted by their shares, sum up to its closed form; and it agrees with photon birth.
UNIT_BOX = UnitBox(np.array([1.0, 2.0, 3.0]), 0.25)
AXES = ((1.0, 0.0, 0.0), (0.0, math.cos(0.4), math.sin(0.4)), (0.0, -math.sin(0.4), math.cos(0.4)))
DOWN = -np.array(AXES[2])
AT = {"position_m": (1.0, 2.0, 3.0), "rotation": AXES, "power_rgb": (8.0, 4.0, 0.0)}
LIGHTS = {
    "point": Light("POINT", "L", **AT),
    "soft": Light("POINT", "L", radius_m=0.5, **AT),
    "sphere": Light("POINT", "L", radius_m=0.5, soft_falloff=False, **AT),
    "spot": Light("SPOT", "L", cone_angle_rad=1.6, blend=0.8, **AT),
    "soft_spot": Light("SPOT", "L", cone_angle_rad=1.6, blend=0.8, radius_m=0.2, **AT),
    "sun": Light("SUN", "L", rotation=AXES, power_rgb=(8.0, 4.0, 0.0)),
    "sun_disk": Light("SUN", "L", angle_rad=0.6, rotation=AXES, power_rgb=(8.0, 4.0, 0.0)),
    "rectangle": Light("AREA", "L", size_m=(0.8, 0.5), **AT),
    "ellipse": Light("AREA", "L", shape="ELLIPSE", size_m=(0.8, 0.5), **AT),
    "spread": Light("AREA", "L", size_m=(0.8, 0.5), spread_rad=1.6, **AT),
}


def source_of(light: Light):
    return (make_lamps([light], UNIT_BOX, ()) + make_suns([light]))[0]


def grid_numbers(side: int) -> np.ndarray:
    line = (np.arange(side, dtype=np.float32) + 0.5) / side
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2).astype(np.float32)


@pytest.mark.parametrize("kind", LIGHTS)
def test_mean_shares_are_the_closed_form_beyond_the_horizon_too(kind):
    """Two receivers, one of them tilted so that its horizon cuts the light."""
    source = source_of(LIGHTS[kind])
    away = -DOWN
    position = np.tile((DOWN * 0.3).astype(np.float32), (1, 1))
    across = np.array(AXES[0])
    normals = [away, 0.15 * away + math.sqrt(1 - 0.15**2) * across]
    u = grid_numbers(128)
    shares = [source.aim(np.tile(position, (len(u), 1)), np.tile(n.astype(np.float32), (len(u), 1)), u).share.mean() for n in normals]
    closed = [source.irradiance(position, n[None].astype(np.float32))[0] for n in normals]
    assert shares == pytest.approx(closed, rel=0.02)


def make_triangle(front_only):
    corners, up = np.array([[[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0]]], np.float32), np.array([[0, 0, 1]], np.float32)
    return TriangleSource(np.ones((1, 3)), True, corners, up, np.array([0.02], np.float32), np.array([front_only]))


def test_triangles_shine_both_ways():
    source = make_triangle(False)
    for height in (0.3, -0.3):
        position, normal = np.array([[0.05, 0.05, height]], np.float32), np.array([[0, 0, -np.sign(height)]], np.float32)
        assert source.irradiance(position, normal)[0] == pytest.approx(0.02 / 0.3**2, rel=0.1)
        aim = source.aim(np.tile(position, (256, 1)), np.tile(normal, (256, 1)), grid_numbers(16))
        end_height = (np.tile(position, (256, 1)) + aim.direction)[:, 2]
        assert (end_height * np.sign(height) > 0).all(), "rays end before the triangle, not behind it"
        assert aim.share.mean() == pytest.approx(source.irradiance(position, normal)[0], rel=0.01)


def test_world():
    source = WorldSource(np.ones((1, 3)))
    normal = np.tile(np.array([0, 0, 1], np.float32), (256, 1))
    assert source.irradiance(normal, normal) == pytest.approx(math.pi)
    aim = source.aim(normal, normal, grid_numbers(16))
    assert aim.share == pytest.approx(math.pi)
    assert aim.direction[:, 2].mean() == pytest.approx(2 / 3, rel=0.02)
    assert aim.distance.min() > 1e20


@pytest.mark.parametrize("kind", LIGHTS)
def test_a_row_for_each_receiver_is_the_light_by_itself(kind):
    """Two lights in turn, of one source, at the receivers of each."""
    light = LIGHTS[kind]
    sizes = {"radius_m": 1.5 * light.radius_m, "angle_rad": 1.5 * light.angle_rad, "size_m": (0.5, 0.4), "blend": 0.5 * light.blend}
    other = replace(light, position_m=(1.2, 1.9, 3.3), rotation=np.eye(3).tolist(), **sizes)
    here, there = source_of(light), source_of(other)
    ((both, _),) = join_sources([here, there])
    which = np.arange(40) % 2
    rng = np.random.default_rng(3)
    position = rng.uniform(-0.5, 0.1, (40, 3)).astype(np.float32)
    normal = np.tile(np.array([[0, 0.6, 0.8]], np.float32), (40, 1))
    u = rng.random((40, 2), np.float32)
    mixed = both.rows(which)
    for lamp, source in enumerate((here, there)):
        own = which == lamp
        assert (mixed.rgb[own] == source.rgb).all()
        assert mixed.irradiance(position, normal)[own] == pytest.approx(source.irradiance(position[own], normal[own]), rel=1e-5)
        aim, alone = mixed.aim(position, normal, u), source.aim(position[own], normal[own], u[own])
        for name in ("direction", "distance", "share", "weight"):
            assert getattr(aim, name)[own] == pytest.approx(getattr(alone, name), rel=1e-4, abs=1e-6), name


# Mean irradiance of texels whose light is nearer than they are wide: the solid angle they fill, and sums over fine strata.
SIDE = 8
TEXELS = np.arange(SIDE * SIDE)
LAMP = Light("POINT", "Lamp", (0.43, 0.55, 0.01), power_rgb=(1.0, 1.0, 1.0))
BALL = replace(LAMP, radius_m=0.02)
# A small panel seen from its edge, so that the horizon of its back runs through texels.
TILE = replace(
    LAMP, kind="AREA", size_m=(0.03, 0.02), rotation=((0.8, 0.0, -0.6), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)), position_m=(0.43, 0.55, 0.03)
)
# A wide panel just above the floor: even below it, and dark a few millimetres beside it.
PANEL = replace(LAMP, kind="AREA", size_m=(0.5, 0.3), position_m=(0.45, 0.6, 0.005))


@pytest.fixture(scope="module")
def chunk():
    return TexelChunk(floor_footprints(SIDE)(TEXELS), np.zeros((len(TEXELS), 2), np.uint32), prepare(lit_scene())[0].surfaces, False)


def join_lamps(*lights: Light) -> Source:
    return join_sources(make_lamps(lights, UnitBox.from_points(lit_scene().vertex_position), ()))[0][0]


def sum_finely(source: Source, chunk: TexelChunk, strata: int = 72) -> np.ndarray:
    receivers = chunk.receivers_at(TEXELS, centred_strata(strata**2))
    return source.irradiance(receivers.position, receivers.normal).reshape(-1, len(TEXELS)).mean(axis=0)


def solid_angle(x: np.ndarray, y: np.ndarray, side: float, height: float) -> np.ndarray:
    """Of squares (n,) whose lower corners lie at x, y, seen from `height` over the origin."""

    def cornered(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.arctan(a * b / (height * np.sqrt(a * a + b * b + height**2)))

    return cornered(x + side, y + side) - cornered(x, y + side) - cornered(x + side, y) + cornered(x, y)


@pytest.mark.parametrize("gap_m", [0.3, 0.03, 1e-3, 1e-4])
def test_a_point_lamp_fills_the_texels_solid_angle(chunk, gap_m):
    mean, variance = average_peaks(join_lamps(replace(LAMP, position_m=(0.43, 0.55, gap_m))), None, chunk, TEXELS)
    scale = UnitBox.from_points(lit_scene().vertex_position).scale
    column, row = morton_square(SIDE)
    truth = solid_angle(column / SIDE - 0.43, row / SIDE - 0.55, 1 / SIDE, gap_m - ORIGIN_OFFSET / scale) / (scale / SIDE) ** 2
    assert mean == pytest.approx(truth, rel=2e-3)
    assert (np.sqrt(variance) < 0.02 * truth).all()


@pytest.mark.parametrize(
    "light", [LAMP, BALL, replace(BALL, soft_falloff=False), TILE, replace(TILE, shape="ELLIPSE"), PANEL, replace(PANEL, shape="ELLIPSE")]
)
def test_lamps_are_within_their_stated_error_of_a_fine_sum(chunk, light):
    source = join_lamps(light)
    mean, variance = average_peaks(source, None, chunk, TEXELS)
    truth = sum_finely(source, chunk)
    assert (np.abs(mean - truth) <= 2 * np.sqrt(variance) + 2e-3 * truth).all()
    assert np.sqrt(variance.sum()) < 0.02 * truth.sum()


def test_many_lamps_come_to_the_same_as_each_by_itself(chunk):
    """They are looked at together as far as they fit; to the bit, for squares of a pair stay together."""
    lamps = [replace(LAMP, position_m=(0.1 + 0.8 * (k % 16) / 15, 0.1 + 0.8 * (k // 16) / 7, 0.01)) for k in range(128)]
    found = average_peaks(join_lamps(*lamps), np.repeat(np.arange(128), len(TEXELS)), chunk, np.tile(TEXELS, 128))
    for k in range(0, 128, 9):
        alone = average_peaks(join_lamps(lamps[k]), None, chunk, TEXELS)
        of_lamp = slice(k * len(TEXELS), (k + 1) * len(TEXELS))
        for one, same in zip(found, alone, strict=True):
            np.testing.assert_array_equal(one[of_lamp], same)


def test_only_texels_near_a_lamp_hold_a_peak(chunk):
    receivers = chunk.receivers_at(TEXELS, GAUSS_POINTS)
    near = find_peaks(join_lamps(LAMP), receivers, 4)
    column, row = morton_square(SIDE)
    distance = np.hypot((column + 0.5) / SIDE - 0.43, (row + 0.5) / SIDE - 0.55) * SIDE
    assert near[distance < 4].all()
    assert not near[distance > 6].any()
    assert not find_peaks(join_lamps(replace(LAMP, position_m=(0.43, 0.55, 1.0))), receivers, 4).any()
    assert not find_peaks(join_lamps(replace(TILE, size_m=(2.0, 2.0))), receivers, 4).any(), "a panel of many texels is even"
    under_edge = find_peaks(join_lamps(replace(PANEL, size_m=(4.0, 4.0), position_m=(-1.55, 0.5, 0.005))), receivers, 4)
    assert (under_edge == np.isin(column, (3, 4))).all(), "its edge is at 0.45 m, in the fourth column"
    assert not find_peaks(make_suns([Light("SUN", "Sun", power_rgb=(1.0,) * 3)])[0], receivers, 4).any()


def find_strata(points: np.ndarray, columns: int, rows: int) -> list[int]:
    """Sorted cells of a grid that points (n, 2) of the unit square fall in."""
    return sorted((np.floor(points[:, 0] * columns) * rows + np.floor(points[:, 1] * rows)).astype(int).tolist())


@pytest.mark.parametrize("count", [4, 16, 64])
def test_first_rays_start_one_in_each_stratum_of_the_texel(count):
    scene, _, _ = prepare(lit_scene())
    chunk = TexelChunk(floor_footprints(1)(np.array([0])), random_shift(np.random.default_rng(2), 1), scene.surfaces, False)
    start = chunk.receivers(np.array([0]), 0, count).position
    side = round(count**0.5)
    assert find_strata(start[:, :2] + 0.5, side, side) == list(range(count))
