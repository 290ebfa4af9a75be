"""The shapes of the zoo, each from a few numbers, with its count of triangles known before it is built. No bpy."""

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "sample_blends"))

import shapes
from shapes import Shape

Vec = tuple[float, float, float]
Hole = tuple[float, float, float, float]  # along the wall from and to, up from and to, metres
ROUND = ("ball", "rock", "torus", "cushion", "sheet", "cylinder", "shade")  # whose count of triangles follows their detail
LEAST_DETAIL = 4


@dataclass(frozen=True)
class Place:
    """Tilted about X, then turned about Z, degrees, then shifted, metres."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    turn: float = 0.0
    tilt: float = 0.0


@dataclass(frozen=True)
class Part:
    """One shape of a thing, around its own origin: centred along x and y, standing on z = 0.

    kind     box, bevelled, cushion, cylinder, shade, ball, rock, torus, sheet, panel or wall
    size     along x, y and z, metres; a panel has no height and faces up
    paint    index into the paints of the plan
    detail   segments around, or cells along an edge; of the kinds in ROUND
    holes    of a wall, which runs along x; one of no thickness is a plane that faces -y
    """

    kind: str
    size: Vec
    paint: int
    place: Place = Place()
    detail: int = 0
    smooth: bool = False
    holes: tuple[Hole, ...] = ()


def build_shape(part: Part) -> Shape:
    """The part in the frame of its thing."""
    place = part.place
    return _BUILD[part.kind](part).moved(place.x, place.y, place.z, place.turn, place.tilt)


def count_triangles(part: Part) -> int:
    """How many the shape of the part has, without building it."""
    n = part.detail
    if part.kind == "wall":
        cuts, is_hole = _cut_wall(part)
        open_cells = [(i, k) for i in range(len(cuts[0]) - 1) for k in range(len(cuts[1]) - 1) if is_hole(i, k)]
        cells = (len(cuts[0]) - 1) * (len(cuts[1]) - 1) - len(open_cells)
        return 2 * cells if part.size[1] == 0.0 else 4 * cells + 2 * _count_rims(cuts, is_hole)
    counts = {
        "box": 12,
        "bevelled": 12 * 9,
        "panel": 2,
        "cushion": 12 * n * n,
        "cylinder": 4 * n,
        "shade": 8 * n,
        "ball": 2 * n * (n // 2 - 1),
        "rock": 2 * n * (n // 2 - 1),
        "torus": 2 * n * max(3, n // 2),
        "sheet": 2 * n * n,
    }
    return counts[part.kind]


def _cut_wall(part: Part):
    """Where the wall's grid is cut along x and z, and whether one of its cells is open."""
    length, _, height = part.size
    along = sorted({-length / 2, length / 2, *(x for hole in part.holes for x in hole[:2])})
    up = sorted({0.0, height, *(z for hole in part.holes for z in hole[2:])})

    def is_hole(i: int, k: int) -> bool:
        x, z = (along[i] + along[i + 1]) / 2, (up[k] + up[k + 1]) / 2
        return any(left < x < right and low < z < high for left, right, low, high in part.holes)

    return (along, up), is_hole


def _count_rims(cuts, is_hole) -> int:
    """Faces of the wall that look along it or up and down."""
    wide, high = len(cuts[0]) - 1, len(cuts[1]) - 1

    def is_open(i: int, k: int) -> bool:
        return not (0 <= i < wide and 0 <= k < high) or is_hole(i, k)

    beside = ((1, 0), (-1, 0), (0, 1), (0, -1))
    return sum(is_open(i + a, k + b) for i in range(wide) for k in range(high) if not is_hole(i, k) for a, b in beside)


def _build_box(part: Part) -> Shape:
    x, y, z = part.size
    return shapes.box((-x / 2, -y / 2, 0.0), (x / 2, y / 2, z))


def _build_bevelled(part: Part) -> Shape:
    x, y, z = part.size
    return shapes.rounded_box((-x / 2, -y / 2, 0.0), (x / 2, y / 2, z), 0.15 * min(part.size))


def _build_cushion(part: Part) -> Shape:
    """A box whose sides bulge: a grid of cells on each side, pushed half the way to an ellipsoid."""
    n = part.detail
    line = np.linspace(-1.0, 1.0, n + 1)
    a, b = (grid.ravel() for grid in np.meshgrid(line, line, indexing="ij"))
    points, quads = [], []
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    for axis in range(3):
        for side in (1.0, -1.0):
            face = np.empty((len(a), 3))
            face[:, axis], face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = side, a, b
            corners = np.stack([first, first + n + 1, first + n + 2, first + 1], axis=1)
            quads.append((corners if side > 0.0 else corners[:, ::-1]) + len(a) * len(points))
            points.append(face)
    cube = np.concatenate(points)
    _, kept, welded = np.unique(np.round(cube, 6), axis=0, return_index=True, return_inverse=True)
    cube = cube[kept]
    ball = cube / np.linalg.norm(cube, axis=1, keepdims=True)
    shaped = (cube + ball) / 2.0 * (np.array(part.size) / 2.0)
    faces = welded.ravel()[np.concatenate(quads)]
    return Shape(shaped + np.array((0.0, 0.0, part.size[2] / 2.0)), [tuple(face) for face in faces.tolist()])


def _scale(shape: Shape, part: Part, bottom: float) -> Shape:
    """A shape of radius 1 around the z axis, brought to the part's size and stood on z = 0."""
    return Shape((shape.points + np.array((0.0, 0.0, bottom))) * (np.array(part.size) / (2.0, 2.0, 2.0)), shape.faces)


def _build_ball(part: Part) -> Shape:
    return _scale(shapes.ball(1.0, part.detail), part, 1.0)


def _build_rock(part: Part) -> Shape:
    ball = shapes.ball(1.0, part.detail)
    x, y, z = ball.points.T
    bumps = 1.0 + 0.12 * np.sin(5.1 * x + 1.0) * np.sin(4.3 * y) + 0.06 * np.sin(11.0 * z + 7.0 * x) * np.cos(9.0 * y)
    return _scale(Shape(ball.points * bumps[:, None], ball.faces), part, 1.0)


def _build_torus(part: Part) -> Shape:
    count = max(3, part.detail // 2)
    turns = [2.0 * math.pi * step / count for step in range(count)]
    rim = [(0.72 + 0.28 * math.cos(turn), 0.28 * math.sin(turn)) for turn in turns]
    ring = shapes.lathe([*rim, rim[0]], part.detail)
    x, y, z = part.size
    return Shape((ring.points + np.array((0.0, 0.0, 0.28))) * (x / 2.0, y / 2.0, z / 0.56), ring.faces)


def _build_cylinder(part: Part) -> Shape:
    return _scale(shapes.cylinder(1.0, -1.0, 1.0, part.detail), part, 1.0)


def _build_shade(part: Part) -> Shape:
    """An open ring with a wall, as of a lampshade or a pot without a bottom."""
    profile = [(1.0, -1.0), (0.8, 1.0), (0.76, 1.0), (0.96, -1.0), (1.0, -1.0)]
    return _scale(shapes.lathe(profile, part.detail), part, 1.0)


def _build_sheet(part: Part) -> Shape:
    """Cloth, or uneven ground: faces up."""
    n = part.detail + 1
    y, x = np.meshgrid(*[np.linspace(-1.0, 1.0, n)] * 2, indexing="ij")
    waves = 0.5 + 0.3 * np.sin(9.0 * x + 1.3 * y) + 0.2 * np.sin(5.0 * y - 2.0 * x)
    return Shape(shapes.height_field(1.0, waves).points * part.size, shapes.height_field(1.0, waves).faces)


def _build_panel(part: Part) -> Shape:
    x, y, _ = part.size
    return shapes.floor_quad((-x / 2, -y / 2), (x / 2, y / 2))


def _build_wall(part: Part) -> Shape:
    (along, up), is_hole = _cut_wall(part)
    depth = part.size[1]
    thick = (-(depth or 1.0) / 2, (depth or 1.0) / 2)

    def keep(centre: np.ndarray, normal: np.ndarray) -> bool:
        return depth > 0.0 or normal[1] < 0.0

    shape = shapes.shell((along, thick, up), lambda i, j, k: not is_hole(i, k), keep)
    return Shape(shape.points * (1.0, float(depth > 0.0), 1.0), shape.faces)


_BUILD = {
    "box": _build_box,
    "bevelled": _build_bevelled,
    "cushion": _build_cushion,
    "cylinder": _build_cylinder,
    "shade": _build_shade,
    "ball": _build_ball,
    "rock": _build_rock,
    "torus": _build_torus,
    "sheet": _build_sheet,
    "panel": _build_panel,
    "wall": _build_wall,
}
