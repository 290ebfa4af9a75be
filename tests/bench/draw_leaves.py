"""Pictures of baked light with its leaves: charts as they lie on the page, and views through a camera."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from leaflight.core.output.image_file import linear_to_srgb
from paper_bakes import Bake, Stage

MOST_COLOURS = 256  # of a picture's palette: noise does not compress otherwise


@dataclass(frozen=True)
class View:
    """What a camera sees: per pixel the triangle, its barycentrics and the texel entry; row 0 on top.

    tri, entry   (h, w) int, -1 for nothing and for surfaces without lightmap
    """

    tri: np.ndarray
    u: np.ndarray
    v: np.ndarray
    entry: np.ndarray


def look_through(stage: Stage, matrix: np.ndarray, angle_rad: float, width: int, height: int) -> View:
    """The view of a camera; `matrix` (4, 4) is Blender's, `angle_rad` the horizontal field of view."""
    across = np.tan(angle_rad / 2.0) * (2.0 * (np.arange(width) + 0.5) / width - 1.0)
    up = np.tan(angle_rad / 2.0) * (height - 2.0 * (np.arange(height) + 0.5)) / width
    plane = np.stack([*np.meshgrid(across, up), np.full((height, width), -1.0)], -1).reshape(-1, 3)
    direction = (plane @ np.asarray(matrix)[:3, :3].T).astype(np.float32)
    origin = np.broadcast_to(stage.tracing.unit_box.to_unit(np.asarray(matrix)[:3, 3]), direction.shape)
    hits = stage.tracing.scene.rays.closest(np.ascontiguousarray(origin), direction)
    x, y = stage.texels.hit_texel_xy(hits.tri, hits.u, hits.v)
    entry = stage.texels.entry_of(hits.tri, x, y)
    return View(*(part.reshape(height, width) for part in (hits.tri, hits.u, hits.v, entry)))


def shade_view(stage: Stage, view: View, irradiance: np.ndarray) -> np.ndarray:
    """Outgoing radiance (h, w, 3) of the baked light (n, 3) under the surfaces' own colours."""
    surfaces, seen = stage.tracing.scene.surfaces, view.entry >= 0
    tri, u, v = view.tri[seen], view.u[seen], view.v[seen]
    picture = np.zeros((*view.tri.shape, 3))
    picture[seen] = surfaces.albedo.at(tri, u, v) * irradiance[view.entry[seen]] / np.pi + surfaces.emission.at(tri, u, v)
    return picture


def light_view(view: View, irradiance: np.ndarray) -> np.ndarray:
    """Irradiance over pi (h, w, 3), without the surfaces' colours."""
    return np.where(view.entry[..., None] >= 0, irradiance[view.entry] / np.pi, 0.0)


def draw_edges(picture: np.ndarray, leaf: np.ndarray, colour: tuple[float, float, float]) -> np.ndarray:
    """The picture (h, w, 3) with a line wherever neighbouring pixels belong to different leaves (h, w)."""
    edge = np.zeros(leaf.shape, bool)
    edge[:, 1:] |= leaf[:, 1:] != leaf[:, :-1]
    edge[1:] |= leaf[1:] != leaf[:-1]
    return np.where(edge[..., None], colour, picture)


def to_display(linear: np.ndarray, exposure: float) -> np.ndarray:
    """sRGB values in [0, 1]; `exposure` is the radiance shown as white."""
    return linear_to_srgb(np.clip(linear / exposure, 0.0, 1.0))


def chart_picture(bake: Bake, values: np.ndarray, leaf: np.ndarray, chart: int, zoom: int) -> tuple[np.ndarray, np.ndarray]:
    """A chart seen from above, (h, w, 3) values and (h, w) leaves, each texel `zoom` pixels wide; row 0 on top."""
    texels = bake.stage.texels
    rows = np.flatnonzero(texels.texel_chart == chart)
    xy = texels.texel_xy[rows] - texels.texel_xy[rows].min(0)
    width, height = xy.max(0) + 1
    picture, owner = np.zeros((height, width, 3)), np.full((height, width), -1)
    picture[xy[:, 1], xy[:, 0]], owner[xy[:, 1], xy[:, 0]] = values[rows], leaf[rows]
    return tuple(np.repeat(np.repeat(part[::-1], zoom, 0), zoom, 1) for part in (picture, owner))


def save_figure(figure: object, path: Path) -> None:
    """Write a figure of matplotlib as a PNG with few colours."""
    import matplotlib.pyplot as plt
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3]
    Image.fromarray(np.ascontiguousarray(pixels)).quantize(MOST_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    plt.close(figure)
