"""Meshes that scenes of other people's making are full of: needles, faces without area, coincident, crossing and open ones."""

import numpy as np
from scenes import Mesh, box_mesh, grid_mesh, moved, quad_mesh


def needle_mesh() -> Mesh:
    """Triangles of aspect 1e6 that fan across the room."""
    tip = np.array([[-0.4, y, -0.2] for y in np.linspace(-0.4, 0.4, 30)])
    far = np.array([[0.4, y, 0.1] for y in np.linspace(0.4, -0.4, 30)])
    return Mesh("Needles", np.concatenate([tip, far, np.add(far, [0, 0, 8e-7])]), [[i, i + 30, i + 60] for i in range(30)])


def flat_mesh() -> Mesh:
    """500 faces without area: points, and three corners on a line; and one that has some."""
    corner = np.repeat(np.linspace(-0.4, 0.4, 250)[:, None], 3, axis=1)
    vertex = np.concatenate([np.add(corner, [step, 0, 0]) for step in (0.0, 0.1, 0.2)])
    points, lines = [[i, i, i] for i in range(250)], [[i, i + 250, i + 500] for i in range(250)]
    return Mesh("Flat", vertex, [*points, *lines, [0, 250, 251, 1]])


def open_mesh() -> Mesh:
    """Three sheets on one edge."""
    vertex = np.array(
        [[0, 0, -0.3], [0, 0, 0.3], [0.3, 0, -0.3], [0.3, 0, 0.3], [-0.3, 0.1, -0.3], [-0.3, 0.1, 0.3], [0, 0.3, -0.3], [0, 0.3, 0.3]]
    )
    return Mesh("Sheets", vertex, [[0, 2, 3, 1], [0, 4, 5, 1], [0, 6, 7, 1]])


def knotted_mesh() -> Mesh:
    """One object that goes through itself: two crossing boxes, a quad that is a bow, a strip with a half twist."""
    one, other = box_mesh("", (0.2, 0.2, 0.2)), box_mesh("", (0.3, 0.1, 0.1), (0.05, 0.02, 0.03))
    bow = [[-0.3, -0.3, -0.3], [-0.1, -0.3, -0.3], [-0.3, -0.1, -0.3], [-0.1, -0.1, -0.3]]
    turn = 2 * np.pi * np.arange(12) / 12
    middle = np.stack([0.35 * np.cos(turn), 0.35 * np.sin(turn), 0 * turn], axis=1)
    across = np.stack([np.cos(turn / 2) * np.cos(turn), np.cos(turn / 2) * np.sin(turn), np.sin(turn / 2)], axis=1)
    strip = [[k, 12 + k, 12 + k + 1, k + 1] for k in range(11)] + [[11, 23, 0, 12]]
    parts = [(one.vertex, one.polygons), (other.vertex, other.polygons), (np.array(bow), [[0, 1, 2, 3]])]
    parts.append((np.concatenate([middle - 0.05 * across, middle + 0.05 * across]), strip))
    starts = np.cumsum([0, *[len(vertex) for vertex, _ in parts]])
    polygons = [[int(start) + k for k in polygon] for start, (_, some) in zip(starts, parts, strict=False) for polygon in some]
    return Mesh("Knot", np.concatenate([vertex for vertex, _ in parts]), polygons)


COINCIDENT = ("coplanar", "twice", "on the floor")  # rays light both faces, photons land on one of them
FURNITURE = {
    "needles": [needle_mesh()],
    "faces without area": [flat_mesh()],
    "coplanar": [moved(quad_mesh("A", 0.4, 0.4), (-0.2, -0.2, -0.1)), moved(quad_mesh("B", 0.4, 0.4), (-0.1, -0.1, -0.1))],
    "twice": [quad_mesh("A", 0.3, 0.3), quad_mesh("B", 0.3, 0.3)],
    "on the floor": [moved(quad_mesh("Rug", 0.4, 0.4), (-0.2, -0.2, -0.5))],
    "intersecting": [box_mesh("A", (0.3, 0.3, 0.3)), moved(box_mesh("B", (0.3, 0.3, 0.3)), (0.1, 0.1, -0.1))],
    "through the wall": [box_mesh("A", (0.4, 0.4, 0.4), (0.5, 0.5, 0.5))],
    "open": [open_mesh()],
    "through itself": [knotted_mesh()],
    "bent": [moved(grid_mesh("Sheet", 6, noise=0.4), (-0.3, -0.3, -0.2), 0.1)],
}
