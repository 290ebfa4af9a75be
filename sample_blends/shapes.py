"""Meshes as plain points and faces, in metres, seen from the front when their corners run counter-clockwise. No bpy."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

Point = tuple[float, float, float]


class Shape(NamedTuple):
    """A polygon mesh.

    points  (n, 3) float64, m
    faces   tuples of point indices, counter-clockwise from the front
    """

    points: np.ndarray
    faces: list[tuple[int, ...]]

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: float = 0.0, tilt: float = 0.0) -> Shape:
        """Tilted about X, then turned about Z (both in degrees, through the origin), then shifted."""
        cos, sin = math.cos(math.radians(tilt)), math.sin(math.radians(tilt))
        about_x = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
        cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
        about_z = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        return Shape(self.points @ (about_z @ about_x).T + (x, y, z), self.faces)

    def flipped(self) -> Shape:
        """The same mesh seen from the other side."""
        return Shape(self.points, [face[::-1] for face in self.faces])


def join(*shapes: Shape) -> Shape:
    """All shapes in one, nothing welded."""
    starts = itertools.accumulate((len(shape.points) for shape in shapes), initial=0)
    faces = [tuple(start + corner for corner in face) for start, shape in zip(starts, shapes, strict=False) for face in shape.faces]
    return Shape(np.concatenate([shape.points for shape in shapes]), faces)


def polygon(*corners: Point) -> Shape:
    """One face."""
    return Shape(np.array(corners, float), [tuple(range(len(corners)))])


def floor_quad(low: tuple[float, float], high: tuple[float, float], z: float = 0.0) -> Shape:
    """A level rectangle that faces up."""
    return polygon((low[0], low[1], z), (high[0], low[1], z), (high[0], high[1], z), (low[0], high[1], z))


def shell(
    grid: Sequence[Sequence[float]],
    is_solid: Callable[[int, int, int], bool],
    keep: Callable[[np.ndarray, np.ndarray], bool] = lambda centre, normal: True,
) -> Shape:
    """The watertight surface of some cells of a grid of boxes: rooms with openings, boxes, whatever has square corners.

    grid      three rising sequences of coordinates, m
    is_solid  by cell index (i, j, k)
    keep      by a face's centre (3,) and normal (3,); False leaves the face out
    """
    counts = [len(line) - 1 for line in grid]
    point_of: dict[tuple[int, ...], int] = {}
    faces = []
    for cell in itertools.product(*map(range, counts)):
        if not is_solid(*cell):
            continue
        for axis, side in itertools.product(range(3), (0, 1)):
            beside = list(cell)
            beside[axis] += 2 * side - 1
            if 0 <= beside[axis] < counts[axis] and is_solid(*beside):
                continue
            corners = []
            for turn_b, turn_c in ((0, 0), (1, 0), (1, 1), (0, 1))[:: 2 * side - 1]:
                corner = list(cell)
                corner[axis] += side
                corner[(axis + 1) % 3] += turn_b
                corner[(axis + 2) % 3] += turn_c
                corners.append(tuple(corner))
            centre = np.mean([[grid[a][corner[a]] for a in range(3)] for corner in corners], axis=0)
            normal = np.eye(3)[axis] * (2 * side - 1)
            if keep(centre, normal):
                faces.append(tuple(point_of.setdefault(corner, len(point_of)) for corner in corners))
    return Shape(np.array([[grid[a][corner[a]] for a in range(3)] for corner in point_of], float), faces)


def box(low: Point, high: Point) -> Shape:
    """A closed box between two corners."""
    return shell(list(zip(low, high, strict=True)), lambda i, j, k: True)


def rounded_box(low: Point, high: Point, radius: float) -> Shape:
    """A closed box with round edges, two faces to the quarter turn; for smooth shading."""
    grid = [(a, a + radius, b - radius, b) for a, b in zip(low, high, strict=True)]
    shape = shell(grid, lambda i, j, k: True)
    core = np.clip(shape.points, np.array(low) + radius, np.array(high) - radius)
    out = shape.points - core
    return Shape(core + radius * out / np.linalg.norm(out, axis=1, keepdims=True), shape.faces)


def lathe(profile: Sequence[tuple[float, float]], segments: int) -> Shape:
    """A profile of (radius, height) turned about Z; faces outward when it runs from the bottom up outside. Radius 0 is a pole."""
    points: list[Point] = []
    rings = []
    is_ring = profile[0] == profile[-1]
    for radius, z in profile[: len(profile) - is_ring]:
        around = 1 if radius == 0 else segments
        rings.append([len(points) + step % around for step in range(segments + 1)])
        for step in range(around):
            phi = 2 * math.pi * step / segments
            points.append((radius * math.cos(phi), radius * math.sin(phi), z))
    faces = []
    for lower, upper in itertools.pairwise([*rings, rings[0]] if is_ring else rings):
        for step in range(segments):
            corners = (lower[step], lower[step + 1], upper[step + 1], upper[step])
            faces.append(tuple(dict.fromkeys(corners)))
    return Shape(np.array(points), faces)


def cylinder(radius: float, low: float, high: float, segments: int = 24) -> Shape:
    """A closed cylinder about Z."""
    return lathe([(0, low), (radius, low), (radius, high), (0, high)], segments)


def ball(radius: float, segments: int = 32) -> Shape:
    """A sphere about the origin."""
    turns = [math.pi * step / (segments // 2) for step in range(segments // 2 + 1)]
    rims = [0.0 if step in (0, segments // 2) else radius * math.sin(turn) for step, turn in enumerate(turns)]
    return lathe([(rim, -radius * math.cos(turn)) for rim, turn in zip(rims, turns, strict=True)], segments)


def height_field(side: float, heights: np.ndarray) -> Shape:
    """A square grid of quads that faces up, centred on the origin.

    heights  (n, n) float, m
    """
    count = len(heights)
    y, x = np.meshgrid(*[np.linspace(-side / 2, side / 2, count)] * 2, indexing="ij")
    corners = [(row * count + col, count) for row in range(count - 1) for col in range(count - 1)]
    return Shape(
        np.stack([x, y, heights], axis=-1).reshape(-1, 3),
        [(first, first + 1, first + up + 1, first + up) for first, up in corners],
    )
