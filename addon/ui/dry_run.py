"""What a bake would be, as lines for the command line; nothing is baked."""

from __future__ import annotations

import numpy as np

from ...core.scene.scene import SceneSnapshot
from ...core.util.geometry import triangle_normals_areas
from ...core.util.settings import Settings
from ...core.util.threads import count_usable
from ..app.chart_guess import guess_charts
from ..app.estimate import Measured, estimate_bake
from .panel_parts import describe_estimate, describe_evened, describe_takers


def describe_bake(snapshot: SceneSnapshot, settings: Settings) -> list[str]:
    """Objects, texels, pages, memory, a rough time, and what takes most of the texels."""
    measured = measure_snapshot(snapshot)
    layered = sum(one.has_layer for one in snapshot.objects)
    estimate = estimate_bake(measured, settings, layered, count_usable())
    if estimate is None:
        return ["nothing that can be baked has an area"]
    lines = describe_estimate(estimate) + describe_evened(estimate) + describe_takers(estimate)
    return lines + [f"{name} does not fit a page at this density and is baked less finely" for name in estimate.too_large]


def measure_snapshot(snapshot: SceneSnapshot) -> list[Measured]:
    """The objects that get a lightmap."""
    corner = snapshot.vertex_position[snapshot.tri_vertex]
    area = triangle_normals_areas(corner)[1]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    count = len(snapshot.objects)
    total = np.bincount(snapshot.tri_object, area, count)
    charts, side = guess_charts(corner, snapshot.tri_object, count)
    edge = np.zeros(count)
    np.maximum.at(edge, snapshot.tri_object, longest)
    return [
        Measured(one.name, float(total[i]), one.density_factor, float(edge[i]), int(charts[i]), float(side[i]))
        for i, one in enumerate(snapshot.objects)
        if one.receives
    ]
