"""Light of the samples that have a closed form, at the texels of a page: what bakes that err less than Cycles are held against."""

from collections.abc import Callable

import numpy as np
from closed_forms import from_polygon
from leaflight.core.scene.scene import SceneSnapshot
from lightmap_errors import LightmapErrors, measure_errors

# Of figure2_square, in metres and watts; see sample_blends/README.md.
MIDDLE, LAMP_SIDE, LAMP_HEIGHT, LAMP_W = 0.5, 0.3, 2.0, 40.0
SHEET_BOTTOM, SHEET_TOP = 1.0, 1.01
_INSIDE = -1e-9  # barycentric: rounding on a diagonal


def furnace_light(position: np.ndarray) -> np.ndarray:
    """(n,) lighting at points (n, 3) of a closed box of radiance 1 and albedo 1/2: the geometric series."""
    return np.full(len(position), 2.0)


def square_light(position: np.ndarray) -> np.ndarray:
    """(n,) lighting at points (n, 3) of figure2_square's square: the lamp's radiance times the form factor of what is seen of it."""
    radiance = LAMP_W / (np.pi * LAMP_SIDE**2)
    left, right = MIDDLE - LAMP_SIDE / 2.0, MIDDLE + LAMP_SIDE / 2.0
    out = np.zeros(len(position))
    for x in np.unique(position[:, 0]):
        edge = SHEET_TOP if x < MIDDLE else SHEET_BOTTOM  # of the sheet's two, the one that is in the way
        seen = min(right, x + (MIDDLE - x) * LAMP_HEIGHT / edge)
        if seen > left:
            at = np.flatnonzero(position[:, 0] == x)
            corner = np.array([(u, v, LAMP_HEIGHT) for u, v in ((left, left), (seen, left), (seen, right), (left, right))])
            out[at] = radiance / np.pi * from_polygon(corner, position[at], np.tile([0.0, 0.0, 1.0], (len(at), 1)))
    return out


CLOSED_FORMS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"furnace": furnace_light, "figure2_square": square_light}


def measure_truth(name: str, page: np.ndarray, tri_uv: np.ndarray, snapshot: SceneSnapshot) -> LightmapErrors | None:
    """Errors of a baked `lighting` page against the sample's closed form at texel centres; None where it has none.

    page     (size, size, 3 or 4) float, row 0 at the bottom
    tri_uv   (n_tri, 3, 2) float, [0, 1]: the layout, 0 for what is not baked
    """
    if name not in CLOSED_FORMS:
        return None
    rows, columns, position = place_centres(tri_uv, snapshot.tri_position, len(page))
    light = CLOSED_FORMS[name](position)[:, None].repeat(3, 1)
    return measure_errors(page[rows, columns, :3], light, light)


def place_centres(tri_uv: np.ndarray, corner: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Texels whose centre a triangle covers, and the points there.

    out   rows (n,) int, columns (n,) int, positions (n, 3) float64
    """
    row, column = np.divmod(np.arange(size * size), size)
    centre = np.column_stack([column + 0.5, row + 0.5]) / size
    left = np.arange(size * size)
    found, position = [], []
    for uv, place in zip(tri_uv, corner, strict=True):
        across = np.column_stack([uv[1] - uv[0], uv[2] - uv[0]])
        if abs(np.linalg.det(across)) < 1e-15:
            continue
        second, third = np.linalg.solve(across, (centre[left] - uv[0]).T)
        weight = np.column_stack([1.0 - second - third, second, third])
        inside = (weight > _INSIDE).all(1)
        found.append(left[inside])
        position.append(weight[inside] @ place)
        left = left[~inside]
    return row[np.concatenate(found)], column[np.concatenate(found)], np.concatenate(position)
