"""Furniture as shapes: each stands on z = 0, its front towards -y, centred in x. No bpy."""

from __future__ import annotations

import numpy as np
from shapes import Point, Shape, box, cylinder, height_field, join, lathe, rounded_box, shell


def block(width: float, depth: float, height: float, at: Point = (0.0, 0.0, 0.0)) -> Shape:
    """A box that stands on a point."""
    x, y, z = at
    return box((x - width / 2, y - depth / 2, z), (x + width / 2, y + depth / 2, z + height))


def legs(width: float, depth: float, height: float, thickness: float) -> list[Shape]:
    """Four legs at the corners of a rectangle."""
    x, y = (width - thickness) / 2, (depth - thickness) / 2
    return [block(thickness, thickness, height, (a * x, b * y, 0.0)) for a in (-1, 1) for b in (-1, 1)]


def table(width: float, depth: float, height: float) -> Shape:
    """A board on four legs, with an apron set back under the board."""
    board = 0.04
    rail = [block(width - 0.2, 0.02, 0.08, (0.0, side * (depth / 2 - 0.07), height - board - 0.08)) for side in (-1, 1)]
    rail += [block(0.02, depth - 0.2, 0.08, (side * (width / 2 - 0.07), 0.0, height - board - 0.08)) for side in (-1, 1)]
    return join(block(width, depth, board, (0.0, 0.0, height - board)), *legs(width - 0.06, depth - 0.06, height - board, 0.07), *rail)


def chair() -> Shape:
    """A plain wooden chair; its back is at +y."""
    posts = [block(0.035, 0.035, 0.45, (side * 0.1925, 0.1925, 0.48)) for side in (-1, 1)]
    slats = [block(0.35, 0.02, 0.07, (0.0, 0.1925, z)) for z in (0.6, 0.72, 0.84)]
    return join(block(0.42, 0.42, 0.03, (0.0, 0.0, 0.45)), *legs(0.42, 0.42, 0.45, 0.04), *posts, *slats)


def sofa(width: float) -> dict[str, Shape]:
    """Body and cushions, round-edged, for smooth shading."""
    half, depth = width / 2, 0.85
    seat = (width - 0.36) / 2
    body = join(
        rounded_box((-half, -depth / 2, 0.08), (half, depth / 2, 0.30), 0.03),
        rounded_box((-half, depth / 2 - 0.2, 0.28), (half, depth / 2, 0.82), 0.05),
        *(rounded_box((x, -depth / 2, 0.28), (x + 0.18, depth / 2 - 0.18, 0.6), 0.05) for x in (-half, half - 0.18)),
    )
    cushions = join(
        *(rounded_box((x, -depth / 2 + 0.01, 0.3), (x + seat, depth / 2 - 0.2, 0.45), 0.05) for x in (-seat, 0.0)),
        *(rounded_box((x + 0.01, 0, 0), (x + seat - 0.01, 0.15, 0.4), 0.06).moved(0, 0.06, 0.45, tilt=-12) for x in (-seat, 0.0)),
    )
    return {"body": body, "cushions": cushions}


def shelf(width: float, depth: float, height: float, floors: int) -> Shape:
    """An open shelf with a back panel: one watertight mesh, its compartments open towards -y."""
    board = 0.025
    bays = [low for step in range(floors) for low in (step * (height - board) / floors, step * (height - board) / floors + board)]
    xs, ys, zs = (
        [-width / 2, board - width / 2, width / 2 - board, width / 2],
        [-depth / 2, depth / 2 - 0.01, depth / 2],
        [*bays, height - board, height],
    )
    return shell((xs, ys, zs), lambda i, j, k: not (i == 1 and j == 0 and k % 2))


def books(rng: np.random.Generator, width: float) -> list[Shape]:
    """Upright books of uneven size from x = 0 to about `width`, backs towards -y."""
    row, x = [], 0.0
    while x < width:
        thick, deep, high = rng.uniform((0.03, 0.15, 0.2), (0.06, 0.2, 0.3))
        row.append(box((x, 0.0, 0.0), (x + thick, deep, high)))
        x += thick + 0.002
    return row


def vase() -> Shape:
    """A vase with an inside, 0.3 m high."""
    outside = [(0, 0), (0.05, 0), (0.075, 0.03), (0.09, 0.08), (0.088, 0.13), (0.065, 0.19), (0.04, 0.24), (0.04, 0.27), (0.055, 0.3)]
    inside = [(0.047, 0.3), (0.033, 0.27), (0.033, 0.24), (0.058, 0.19), (0.08, 0.13), (0.08, 0.08), (0.05, 0.015), (0, 0.01)]
    return lathe(outside + inside, 18)


def bowl() -> Shape:
    """A shallow bowl, 0.3 m across."""
    return lathe([(0, 0), (0.06, 0), (0.11, 0.03), (0.15, 0.08), (0.142, 0.08), (0.105, 0.038), (0.06, 0.012), (0, 0.01)], 20)


def lamp_stand(height: float) -> Shape:
    """The foot and the rod of a floor lamp."""
    return join(cylinder(0.14, 0.0, 0.025), cylinder(0.012, 0.025, height, 12))


def lamp_shade(bottom: float) -> Shape:
    """A conical shade with thickness, open above and below."""
    return lathe([(0.19, 0), (0.2, 0), (0.13, 0.26), (0.12, 0.26), (0.19, 0)], 24).moved(z=bottom)


def frame(width: float, height: float, rim: float, depth: float) -> Shape:
    """An upright frame round an opening, for windows and pictures; y from 0 to `depth`, centred in x and z."""
    xs, zs = ([-size / 2 - rim, -size / 2, size / 2, size / 2 + rim] for size in (width, height))
    return shell((xs, (0.0, depth), zs), lambda i, j, k: not (i == k == 1))


def window_frame(width: float, height: float, rim: float, depth: float) -> Shape:
    """A frame that fills an opening of that size, with a cross bar."""
    xs, zs = ([-size / 2, rim - size / 2, -rim / 2, rim / 2, size / 2 - rim, size / 2] for size in (width, height))
    return shell((xs, (-depth / 2, depth / 2), zs), lambda i, j, k: not (i in (1, 3) and k in (1, 3)))


def curtain(width: float, height: float, waves: int) -> Shape:
    """A wavy cloth with two sides 1 cm apart, closed all round; y is its thickness, x from 0."""
    steps = 6 * waves
    x = np.linspace(0.0, width, steps + 1)
    sway = 0.04 * np.sin(2 * np.pi * waves * x / width)
    flat = shell((x, (0.0, 0.01), (0.0, height)), lambda i, j, k: True)
    points = flat.points.copy()
    points[:, 1] += np.interp(points[:, 0], x, sway)
    return Shape(points, flat.faces)


def bent_grid(rng: np.random.Generator, cells: int, edge: float, noise: float) -> Shape:
    """Quads whose corners are lifted by normal noise, its deviation `noise` edges, so that none is planar."""
    return height_field(cells * edge, rng.normal(size=(cells + 1, cells + 1)) * noise * edge)
