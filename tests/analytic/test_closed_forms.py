"""Black surfaces in light that is known in closed form: of lamps, polygons, disks, textured panels and skies.

A point of intensity I brings I cos / d^2, a sun E0 cos, a Lambertian of radiance L what Lambert's polygon or the disk's closed form
says at each point, and pi L F on average, F being the published form factor; a uniform sky pi L less what hides it. Area lights
shine on one side, emitting triangles on both. The statistical tests of each kind share floors.ALPHA.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from closed_forms import (
    above_floor,
    factor_of_coaxial_disks,
    factor_of_parallel_rectangles,
    factor_of_perpendicular_rectangles,
    from_disk,
    from_point,
    from_polygon,
)
from known_light import Irradiance, bake_known, black_scene, floor_mesh, state_errors
from leaflight.core.scene.scene import Light, SceneSnapshot, TextureImage
from leaflight.core.util.settings import DIRECT_MODES
from scenes import Mesh
from stats import hold_bias_is_seen, hold_stated_error, hold_statement, hold_unbiased

QUAD = [[0, 1, 2, 3]]
RADIANCE = 2.0  # of what glows


@dataclass(frozen=True)
class Kind:
    """Scenes by name, each with its irradiance.

    subject   of claims, by the scene's name
    percent   that a mean may be off
    slow      name and way to direct light of what takes long
    rgb       channels of the light, relative to the first
    """

    scenes: dict[str, tuple[SceneSnapshot, Irradiance]]
    subject: str
    percent: float
    knobs: dict[str, float] = field(default_factory=dict)
    slow: tuple[str, str] = ("", "")
    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def n_case(self) -> int:
        return len(self.scenes) * len(DIRECT_MODES)


def by_mesh(receiver, lamp):
    return black_scene([receiver], others=[lamp], glow=RADIANCE)


def by_area_light(receiver, corner, shape="RECTANGLE"):
    """A light over a rectangle, or the ellipse in it; counter-clockwise corners for who is lit."""
    x, y = corner[3] - corner[0], corner[1] - corner[0]
    size = np.linalg.norm(x), np.linalg.norm(y)
    axes = np.array([x / size[0], y / size[1], np.cross(x, y) / size[0] / size[1]])
    area = size[0] * size[1] * (math.pi / 4 if shape == "ELLIPSE" else 1)
    power = (math.pi * RADIANCE * area,) * 3
    place = tuple(corner.mean(0))
    return black_scene([receiver], [Light("AREA", "Lamp", place, tuple(map(tuple, axes)), power, shape=shape, size_m=size)])


def from_corners(corner):
    return lambda position, normal: RADIANCE * from_polygon(corner, position, normal)


# -- lamps over an open floor: a point, with and without a radius, a sun at an angle, a spot's cone --

POWER_W = 10.0
INTENSITY = POWER_W / (4 * math.pi)
PLACE = (0.3, 0.6, 0.8)
AXIS = np.array([0.3, 0.1, -1.0]) / np.linalg.norm([0.3, 0.1, -1.0])  # of the spot
HALF_CONE, BLEND = 0.5, 0.6
SUN = np.array([2.0, -1.0, 2.0]) / 3  # from the floor


def facing(direction):
    """A light's rotation that makes it shine along `direction`."""
    z = -np.asarray(direction, float)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return tuple(map(tuple, np.array([x, np.cross(z, x), z])))


def under_lamp(kind, **options):
    lamp = Light(kind, kind.title(), **{"position_m": PLACE, "power_rgb": (POWER_W, POWER_W / 2, POWER_W / 4), **options})
    return black_scene([floor_mesh()], [lamp])


def from_spot(position, normal):
    cosine = (position - PLACE) @ AXIS / np.linalg.norm(position - PLACE, axis=1)
    t = np.clip((cosine - math.cos(HALF_CONE)) / (BLEND * (1 - math.cos(HALF_CONE))), 0, 1)
    return INTENSITY * from_point(PLACE, position, normal) * t * t * (3 - 2 * t)


LAMPS = {
    "point": (under_lamp("POINT"), lambda p, n: INTENSITY * from_point(PLACE, p, n)),
    "soft point": (under_lamp("POINT", radius_m=0.2), lambda p, n: INTENSITY * from_point(PLACE, p, n, radius=0.2)),
    "sphere light": (under_lamp("POINT", radius_m=0.2, soft_falloff=False), lambda p, n: INTENSITY * from_point(PLACE, p, n)),
    "sun": (under_lamp("SUN", rotation=facing(-SUN)), lambda p, n: POWER_W * (n @ SUN)),
    "wide sun": (under_lamp("SUN", rotation=facing(-SUN), angle_rad=0.6), lambda p, n: POWER_W * (n @ SUN)),
    "spot": (under_lamp("SPOT", rotation=facing(AXIS), cone_angle_rad=2 * HALF_CONE, blend=BLEND), from_spot),
}

# -- triangles and area lights at any tilt, partly below the floor, the unit square at z = 0; counter-clockwise as seen from it --

OVER = np.array([[0.3, 0.2, 0.5], [0.4, 0.9, 0.4], [0.9, 0.5, 0.7]])
SUNK = np.array([[-0.4, 0.1, -0.5], [-0.3, 0.9, 0.2], [-0.2, 0.4, 0.9]])
EDGE = np.array([[0.6, 0.0, 0.8], [0.0, 0.8, 0.0]])  # of the area light, at right angles
TILTED = np.array([-0.5, 0.5, 0.1]) + np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) / 2 @ EDGE
POLYGONS = {
    "triangle over a plane": (by_mesh(floor_mesh(), Mesh("Lamp", OVER, [[0, 1, 2]])), from_corners(OVER)),
    "triangle through the horizon": (by_mesh(floor_mesh(), Mesh("Lamp", SUNK, [[0, 1, 2]])), from_corners(above_floor(SUNK))),
    "tilted area light": (by_area_light(floor_mesh(), TILTED), from_corners(above_floor(TILTED))),
}

# -- squares that face each other or meet at an edge, coaxial disks --

DISK_RADIUS, LAMP_RADIUS, HEIGHT = 0.5, 0.3, 0.6
ABOVE = np.array([[0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]], float)
UPRIGHT = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], float)
CIRCLE = np.stack([np.cos(phi := 2 * np.pi * np.arange(96) / 96), np.sin(phi), 0 * phi], axis=1)
CIRCLE *= math.sqrt(2 * math.pi / 96 / math.sin(2 * math.pi / 96))  # a disk's area
LAMP_SQUARE = np.array([[-1, -1, 0], [-1, 1, 0], [1, 1, 0], [1, -1, 0]]) * LAMP_RADIUS + [0.5, 0.5, HEIGHT]


def disk_mesh(name, radius, height, uv=None):
    return Mesh(name, CIRCLE * radius + [0.5, 0.5, height], [list(range(len(CIRCLE)))], uv)


def from_lamp_disk(position, normal):
    return RADIANCE * from_disk(LAMP_RADIUS, HEIGHT, np.linalg.norm(position[:, :2] - 0.5, axis=1))


DISK_FLOOR = disk_mesh("Disk", DISK_RADIUS, 0.0, [0.5 + 0.48 * CIRCLE[:, :2]])
SHAPES = {
    "parallel mesh": (by_mesh(floor_mesh(), Mesh("Lamp", ABOVE, QUAD)), from_corners(ABOVE)),
    "parallel area": (by_area_light(floor_mesh(), ABOVE), from_corners(ABOVE)),
    "perpendicular mesh": (by_mesh(floor_mesh(), Mesh("Lamp", UPRIGHT, QUAD)), from_corners(UPRIGHT)),
    "perpendicular area": (by_area_light(floor_mesh(), UPRIGHT), from_corners(UPRIGHT)),
    "disk mesh": (by_mesh(DISK_FLOOR, disk_mesh("Lamp", LAMP_RADIUS, HEIGHT)), from_lamp_disk),
    "disk area": (by_area_light(DISK_FLOOR, LAMP_SQUARE, "ELLIPSE"), from_lamp_disk),
}
FACTORS = {
    "parallel": factor_of_parallel_rectangles(1, 1, 1),
    "perpendicular": factor_of_perpendicular_rectangles(1, 1, 1),
    "disk": factor_of_coaxial_disks(DISK_RADIUS, LAMP_RADIUS, HEIGHT),
}

# -- a sky of one radiance over an open floor, and beside a wall --

SKY_RADIANCE = 0.5
WALL = np.array([[0, -0.5, 0], [0, 1.5, 0], [0, 1.5, 1.5], [0, -0.5, 1.5]])


def beside_wall(position, normal):
    return SKY_RADIANCE * (math.pi - from_polygon(WALL, position, normal))


def sky_scene(*others, **changes):
    return replace(black_scene([floor_mesh()], others=others), **(changes or {"world_rgb": (SKY_RADIANCE,) * 3}))


WALL_MESH = Mesh("Wall", WALL, QUAD)
SKIES = {
    "open": (sky_scene(), lambda p, n: np.full(len(p), math.pi * SKY_RADIANCE)),
    "wall": (sky_scene(WALL_MESH), beside_wall),
    "map": (sky_scene(WALL_MESH, world_map=np.full((16, 32, 3), SKY_RADIANCE, np.float32)), beside_wall),
}

# -- a panel that glows by a texture over a floor: the sum of its pixels --

PANEL_M = 0.5  # its height
PANEL = np.array([[0, 0, PANEL_M], [1, 0, PANEL_M], [1, 1, PANEL_M], [0, 1, PANEL_M]])
# One dark half, one hot spot of a twelfth of the area, and a ramp: 3 rows by 4 columns, so that axes cannot be swapped unseen.
PIXELS = np.array([[0, 0, 0.1, 0.2], [0, 0, 8.0, 0.3], [0, 0.5, 0.2, 0.4]], np.float32)


def from_panel(position, normal):
    shape = np.array([PIXELS.shape[1], PIXELS.shape[0], 1])
    corners = {at: (PANEL + np.array([at[1], at[0], 0])) / shape for at, value in np.ndenumerate(PIXELS) if value}
    return sum(RADIANCE * PIXELS[at] * from_polygon(corner, position, normal) for at, corner in corners.items())


def panel_scene():
    scene = by_mesh(floor_mesh(), Mesh("Panel", PANEL, QUAD))
    image = TextureImage("Panel", np.repeat(PIXELS[..., None], 3, axis=2), closest=True)
    lamp, uv = replace(scene.materials[1], emission_image=0), scene.tri_position[..., :2].astype(np.float32)
    return replace(scene, materials=(scene.materials[0], lamp), images=(image,), tri_emission_uv=uv)


KINDS = {
    "lamps over a plane": Kind(LAMPS, "plane under a {}", 0.2, rgb=(1.0, 0.5, 0.25)),
    "tilted polygons": Kind(POLYGONS, "{}", 0.3),
    "form factors": Kind(SHAPES, "form factor, {}", 0.3, slow=("disk mesh", "rays")),  # of ninety-four lamps
    "sky": Kind(SKIES, "sky, {}", 0.5, {"error": 0.01, "max_photons": 1_500_000}),
    "textured emitter": Kind({"panel": (panel_scene(), from_panel)}, "textured emitter", 0.3, {"error": 0.05}, ("panel", "photons")),
}
CASES = [(kind, name, direct) for kind, of in KINDS.items() for name in of.scenes for direct in DIRECT_MODES]
ADAPTIVE = {
    "perpendicular squares": SHAPES["perpendicular mesh"],
    "sky, wall": SKIES["wall"],
    "textured emitter": (panel_scene(), from_panel),
}


def mark_slow(case, name, is_slow):
    return pytest.param(case, id=name, marks=[pytest.mark.slow] * is_slow)


@pytest.fixture(scope="module", params=[mark_slow(case, "-".join(case[1:]), KINDS[case[0]].slow == case[1:]) for case in CASES])
def known(request, tmp_path_factory):
    kind, name, direct = request.param
    return bake_known(tmp_path_factory.mktemp("known"), *KINDS[kind].scenes[name], direct, **KINDS[kind].knobs)


@pytest.fixture
def case(request):
    """Names of the scene's kind and of the scene."""
    return request.node.callspec.params["known"][:2]


def test_closed_forms_are_those_of_tables():
    """Of unit squares: Howell's C-11 and C-14; of disks: seen from far away, area over pi d^2. And what the horizon cuts off."""
    assert pytest.approx((0.199825, 0.200044), abs=1e-6) == (FACTORS["parallel"], FACTORS["perpendicular"])
    assert factor_of_coaxial_disks(0.01, 0.2, 10.0) == pytest.approx(0.04 / 100.04, rel=1e-5)
    assert [len(above_floor(corner)) for corner in (OVER, SUNK)] == [3, 4]
    assert above_floor(TILTED)[:, 2].min() == pytest.approx(0.0, abs=1e-15)
    at_its_foot = np.array([[1e-3, 0.5, 0.0]])
    assert beside_wall(at_its_foot, np.array([[0.0, 0.0, 1.0]]))[0] == pytest.approx(math.pi * SKY_RADIANCE / 2, rel=0.01)


def test_every_leaf_is_within_its_stated_error(known, case, hold):
    """And means of shapes are their form factors."""
    kind, name = KINDS[case[0]], case[1]
    subject, found = kind.subject.format(name), known.on_leaves()
    hold_unbiased(hold, subject, found, kind.n_case, kind.percent)
    if kind.scenes is SHAPES:
        off = found.mean / (math.pi * RADIANCE * FACTORS[name.split()[0]]) - 1
        hold(f"{subject}: off the published one", 100 * abs(off), high=0.3, unit="%")


def test_a_planted_bias_is_rejected(known, case, hold):
    hold_bias_is_seen(hold, case[0], known.on_leaves(), KINDS[case[0]].n_case)


def test_channels_differ_as_the_light_says(known, case):
    light = known.light.solution.flux[:, known.light.leaves].sum(1) + known.light.direct.irradiance.sum(0)
    assert light / light[0] == pytest.approx(KINDS[case[0]].rgb, rel=1e-5)


ADAPTIVE_CASES = [(subject, direct) for subject in ADAPTIVE for direct in DIRECT_MODES]


@pytest.fixture(
    scope="module", params=[mark_slow(case, "-".join(case), case != ("perpendicular squares", "rays")) for case in ADAPTIVE_CASES]
)
def errors(request, tmp_path_factory):
    subject, direct = request.param
    return subject, direct, state_errors(tmp_path_factory.mktemp("adaptive"), *ADAPTIVE[subject], direct)


def test_adaptive_bakes_state_their_error(errors, hold):
    """Each by itself, and all together."""
    subject, direct, found = errors
    for stated, real in found:
        hold_stated_error(hold, subject, real, stated)
    hold_statement(hold, subject, found, direct)


def test_the_other_one_is_lit_alike(tmp_path):
    """Reciprocity: the lamp and the floor in each other's places."""
    lamp = replace(floor_mesh(), name="Lamp")
    wall = Mesh("Wall", UPRIGHT, QUAD, floor_mesh().uv)
    found = bake_known(tmp_path, by_mesh(wall, lamp), from_corners(lamp.vertex), "rays")
    assert found.on_leaves().mean == pytest.approx(math.pi * RADIANCE * FACTORS["perpendicular"], rel=3e-3)
