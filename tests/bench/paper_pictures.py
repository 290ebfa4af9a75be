"""The pictures of docs/paper.md."""

from pathlib import Path

import draw_leaves
import numpy as np
from paper_bakes import Bake, Reference
from paper_tables import Point, square_irradiance, texel_positions

INK, RED = (0.1, 0.1, 0.1), (0.85, 0.1, 0.05)


def draw_square(bakes: dict[str, Bake], path: Path) -> None:
    """Figure 2: the square in constant and linear basis with its leaves, and a cut through the ramp."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(11, 4), dpi=90, layout="constrained", width_ratios=(1, 1, 1.15))
    for axis, name in zip(axes, ("constant", "linear"), strict=False):
        bake = bakes[name]
        values = bake.values()
        picture, leaf = draw_leaves.chart_picture(bake, values, bake.leaf, 0, _zoom_of(bake))
        shown = draw_leaves.to_display(picture, 1.05 * values.max())
        axis.imshow(draw_leaves.draw_edges(shown, leaf, RED), interpolation="nearest")
        axis.set_title(f"{name}: {len(bake.light.leaves):,} leaves", fontsize=11)
        axis.set_axis_off()
    stage = bake.stage
    position = texel_positions(stage)
    row = np.flatnonzero(np.abs(position[:, 1] - 0.5) <= 0.51 * np.sqrt(stage.texels.texel_area.max()))
    row = row[np.argsort(position[row, 0])]
    for name, colour in (("constant", "#c0504d"), ("linear", "#3465a4")):
        axes[2].plot(position[row, 0], bakes[name].values()[row, 0], color=colour, lw=1.2, label=name)
    axes[2].plot(position[row, 0], square_irradiance(position[row]), color="k", lw=0.8, ls="--", label="closed form")
    axes[2].set_xlabel("x [m], at y = 0.5 m")
    axes[2].set_ylabel("irradiance [W/m²]")
    axes[2].legend(frameon=False)
    draw_leaves.save_figure(figure, path)


def _zoom_of(bake: Bake) -> int:
    return max(1, round(640 / bake.stage.texels.page_size))


def draw_room(bakes: dict[str, Bake], camera: dict, folder: Path) -> None:
    """Figure 3: the room by the fixed mesh and by the hierarchy, and the two meshes."""
    import matplotlib.pyplot as plt

    stage, pair = bakes["flat"].stage, [("flat", "fixed mesh"), ("constant", "hierarchical")]
    view = draw_leaves.look_through(stage, np.array(camera["matrix"]), camera["angle_rad"], 560, 420)
    exposure = np.quantile(draw_leaves.shade_view(stage, view, bakes["constant"].values()), 0.97)
    light_exposure = np.quantile(draw_leaves.light_view(view, bakes["constant"].values()), 0.97)
    for kind in ("solution", "mesh"):
        figure, axes = plt.subplots(1, 2, figsize=(11, 4.45), dpi=102, layout="constrained")
        for axis, (name, title) in zip(axes, pair, strict=True):
            bake = bakes[name]
            if kind == "solution":
                picture = draw_leaves.to_display(draw_leaves.shade_view(stage, view, bake.values()), exposure)
            else:
                light = draw_leaves.to_display(draw_leaves.light_view(view, bake.values()), light_exposure)
                leaf = np.where(view.entry >= 0, bake.leaf[view.entry], -1)
                picture = draw_leaves.draw_edges(0.35 + 0.65 * light, leaf, INK)
            axis.imshow(picture, interpolation="nearest")
            axis.set_title(f"{title}: {len(bake.light.leaves):,} leaves, {bake.light.photons / 1e6:g} M photons", fontsize=11)
            axis.set_axis_off()
        draw_leaves.save_figure(figure, folder / f"figure3_{kind}.png")


def draw_curves(curves: dict[str, list[Point]], path: Path) -> None:
    """Error over photons, and over leaves."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter, PercentFormatter

    figure, axes = plt.subplots(1, 2, figsize=(10, 4), dpi=90, layout="constrained", sharey=True)
    colours = {"flat": "0.45", "constant": "#c0504d", "linear": "#3465a4", "quadratic": "#4e9a06"}
    for axis, of in zip(axes, ("photons", "leaves"), strict=True):
        for name, points in curves.items():
            axis.loglog([getattr(p, of) for p in points], [p.rel for p in points], "o-", ms=4, color=colours[name], label=name)
        axis.set_xlabel(of)
        axis.grid(True, which="both", lw=0.3)
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(EngFormatter(sep=" "))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        axis.yaxis.set_minor_formatter(PercentFormatter(1.0, decimals=0))
    axes[0].set_ylabel("rel")
    axes[0].legend(frameon=False)
    draw_leaves.save_figure(figure, path)


def draw_floor(bakes: dict[str, Bake], reference: Reference, path: Path) -> None:
    """The floor from above: reference, fixed mesh, hierarchy, leaves."""
    import matplotlib.pyplot as plt

    bake, flat = bakes["constant"], bakes["flat"]
    stage = bake.stage
    names = [one.name for one in stage.tracing.snapshot.objects]
    if "Floor" not in names:
        return
    charts = np.flatnonzero(stage.atlas.chart_object == names.index("Floor"))
    chart = charts[np.argmax(np.diff(stage.texels.chart_start)[charts])]
    zoom = max(1, round(320 / (1 << int(stage.texels.chart_log2[chart]))))
    exposure = np.quantile(reference.mean[stage.texels.texel_chart == chart], 0.98)
    panels = [("reference", reference.mean, None), ("fixed mesh", flat.values(), None), ("hierarchical", bake.values(), None)]
    panels.append(("its leaves", bake.values(), RED))
    figure, axes = plt.subplots(1, 4, figsize=(12, 2.8), dpi=90, layout="constrained")
    for axis, (title, values, edges) in zip(axes, panels, strict=True):
        picture, leaf = draw_leaves.chart_picture(bake, values, bake.leaf, int(chart), zoom)
        shown = draw_leaves.to_display(picture, exposure)
        axis.imshow(shown if edges is None else draw_leaves.draw_edges(shown, leaf, edges), interpolation="nearest")
        axis.set_title(title, fontsize=11)
        axis.set_axis_off()
    draw_leaves.save_figure(figure, path)
