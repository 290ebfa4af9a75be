"""Closed forms of irradiance against sums over the lights, and limits known by thought."""

import math

import numpy as np
import pytest
from leaflight.core.lights.irradiance import cap_irradiance, ellipse_irradiance, point_irradiance, polygon_irradiance, sun_irradiance

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
