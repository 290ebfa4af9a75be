"""The numbers of docs/paper.md: tables of bakes with one knob turned, against a long run of the same photons on the fixed mesh."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from claims import Claim
from leaflight.core.irradiance import polygon_irradiance
from leaflight.core.settings import BASES, Settings
from paper_bakes import Bake, Errors, Reference, Stage
from tables import Table

REFERENCE_SEED, REFERENCE_RUNS = 1000, 4  # runs of each of the two references
SEEDS = 4  # for variances between bakes
PHOTONS_IN_A_NODE = 16  # on the fixed mesh, for a variance to be worth comparing
LAMP_W, LAMP_M, LAMP_HEIGHT_M, SHEET_EDGE_M = 40.0, 0.3, 2.0, 0.5  # of figure2_square.blend
PAPER_OVERHEAD = 1 / (1 - 1 / 4)  # [Tobler97]: what late nodes may lose
LOT_LESS_NOISE = math.sqrt(0.5)  # "a lot less variance" of the paper: at most half
DEFAULTS = Settings()


def percent(value: float) -> str:
    return f"{100.0 * value:.1f} %"


def millions(photons: float) -> str:
    return f"{photons / 1e6:g} M"


# -- figure 2 --


def square_irradiance(position_m: np.ndarray) -> np.ndarray:
    """(n,) W/m^2 on the square: of what the sheet, half as high as the lamp, leaves of the lamp to see.

    position_m   (n, 3) float
    """
    low, high = 0.5 - LAMP_M / 2.0, 0.5 + LAMP_M / 2.0
    end = np.clip(2.0 * SHEET_EDGE_M - position_m[:, 0], low, high)
    corners = np.empty((len(end), 4, 3))
    corners[:, :, 0] = np.stack([np.full_like(end, low), np.full_like(end, low), end, end], 1)
    corners[:, :, 1] = [low, high, high, low]
    corners[:, :, 2] = LAMP_HEIGHT_M
    seen = polygon_irradiance(corners, position_m, np.broadcast_to([0.0, 0.0, 1.0], position_m.shape))
    return np.abs(seen) * LAMP_W / (np.pi * LAMP_M**2)


def texel_positions(stage: Stage) -> np.ndarray:
    """(n, 3) m: each texel's own point."""
    texels = stage.texels
    return np.einsum("nk,nkj->nj", texels.texel_bary, stage.tracing.snapshot.tri_position[texels.texel_tri])


def bake_square(stage: Stage, arriving: float) -> tuple[Table, dict[str, Bake]]:
    """Figure 2: bakes in which so many photons land on the square; the table, and those to draw by their basis."""
    truth = square_irradiance(texel_positions(stage))
    photons = arriving * LAMP_W / (truth * stage.texels.texel_area).sum()
    rows, drawn = [], {}
    for basis in BASES:
        for oracle, stability in (
            (("significance", DEFAULTS.stability), ("paper", 256)) if basis == "constant" else (("significance", DEFAULTS.stability),)
        ):
            bake = stage.bake(photons, basis=basis, oracle=oracle, stability=stability)
            leaf = bake.leaf if oracle == "significance" else bake.leaf_of(bake.show_stable(stability))
            off = bake.values(leaf)[:, 0] - truth
            count = len(np.unique(leaf))
            rows.append([basis, f"{oracle}, stable from {stability}", f"{count:,}", percent(np.sqrt((off**2).mean()) / truth.mean())])
            if oracle == "significance":
                drawn[basis] = bake
    return Table(("basis", "oracle", "leaves", "RMSE / mean"), rows), drawn


# -- figure 3 --


def make_reference(stage: Stage, photons: float) -> Reference:
    """Runs of so many photons each, on the fixed mesh at the finest level: noisy, but without bias."""
    values, received = [], []
    for run in range(2 * REFERENCE_RUNS):
        bake = stage.bake(photons, hierarchical=False, basis="constant", seed=REFERENCE_SEED + run)
        values.append(bake.values())
        received.append(bake.light.received[bake.leaf])
    halves = [np.mean(values[half::2], axis=0) for half in (0, 1)]
    return Reference(*halves, np.var(values, axis=0, ddof=1), np.mean(received, axis=0), stage.texels.texel_area)


@dataclass(frozen=True)
class Point:
    """One bake on a curve of errors."""

    photons: float
    leaves: int
    rel: float
    nrmse: float
    blended: Errors


def measure_bake(bake: Bake, reference: Reference) -> Point:
    plain, blended = reference.measure(bake.values()), reference.measure(bake.blended)
    return Point(bake.light.photons, len(bake.light.leaves), plain.rel, plain.nrmse, blended)


def trace_curves(stage: Stage, reference: Reference, photons: Sequence[float]) -> tuple[dict[str, list[Point]], dict[str, Bake]]:
    """Errors of the fixed mesh and of each basis over photons; and the bakes with the most of them."""
    kinds: dict[str, dict[str, object]] = {
        "flat": {"hierarchical": False, "basis": "constant"},
        **{name: {"basis": name} for name in BASES},
    }
    curves, last = {}, {}
    for name, knobs in kinds.items():
        bakes = [stage.bake(count, **knobs) for count in photons]
        curves[name], last[name] = [measure_bake(bake, reference) for bake in bakes], bakes[-1]
    return curves, last


def table_curves(curves: dict[str, list[Point]]) -> Table:
    rows = []
    for name, points in curves.items():
        for flat, point in zip(curves["flat"], points, strict=True):
            ratio = "" if name == "flat" else f"{point.rel / flat.rel:.2f} / {point.nrmse / flat.nrmse:.2f}"
            rows.append([name, millions(point.photons), f"{point.leaves:,}", _both(point), ratio, _both(point.blended)])
    return Table(("basis", "photons", "leaves", "rel / nrmse", "of flat's", "blended"), rows)


def table_leaves(curves: dict[str, list[Point]]) -> Table:
    """Leaves and photons that each basis takes to a `rel` that all of them reach, read off the curves."""
    target = max(min(point.rel for point in points) for points in curves.values())
    rows = []
    for name, points in curves.items():
        rel = np.log([point.rel for point in points])[::-1]
        read = [np.exp(np.interp(np.log(target), rel, np.log([getattr(p, of) for p in points])[::-1])) for of in ("leaves", "photons")]
        rows.append([name, percent(target), f"{read[0]:,.0f}", f"{read[1] / 1e6:.2f} M"])
    return Table(("basis", "rel", "leaves", "photons"), rows)


@dataclass(frozen=True)
class Overhead:
    """Hierarchical over fixed mesh at equal photons.

    compared   finest nodes that every seed's hierarchy made
    variance   theirs, between seeds; nan where none was compared
    photons    that they saw, inverse
    noise      of all texels as they are shown: standard deviation between seeds, relative to local brightness
    """

    compared: int
    variance: float
    photons: float
    noise: float

    def claims(self) -> list[Claim]:
        """What [Tobler97] says of them."""
        return [
            Claim("the paper: variance of the finest nodes, hierarchical over fixed mesh", self.variance, high=PAPER_OVERHEAD),
            Claim("the paper: photons for the same variance there, hierarchical over fixed mesh", self.photons, high=PAPER_OVERHEAD),
            Claim("the paper: noise of the whole picture, hierarchical over fixed mesh", self.noise, high=LOT_LESS_NOISE),
        ]


def measure_overhead(stage: Stage, reference: Reference, photons: float) -> Overhead:
    """From bakes of several seeds."""
    value, received, shown = [], [], []
    for seed in range(1, SEEDS + 1):
        bake = stage.bake(photons, basis="constant", seed=seed)
        tree = bake.light.tree
        node = bake.leaf_of(np.flatnonzero(~tree.has_children))
        finest = (tree.side[node] == stage.settings.finest_texels) & (tree.parent[node] >= 0)
        value.append(np.where(finest[:, None], (bake.light.solution.flux / tree.area).T[node], np.nan))
        received.append(bake.light.received[node])
        shown.append(bake.values())
    spread, seen = np.var(value, axis=0, ddof=1), np.mean(received, axis=0)
    rows = np.isfinite(spread).all(1) & (reference.received >= PHOTONS_IN_A_NODE)
    variance = lost = math.nan
    if rows.any():
        variance = (spread[rows] / reference.local2[rows]).mean() / (reference.variance[rows] / reference.local2[rows]).mean()
        lost = reference.received[rows].sum() / seen[rows].sum()
    noise = [
        np.average((one / reference.local2).mean(1), weights=reference.area) for one in (np.var(shown, axis=0, ddof=1), reference.variance)
    ]
    return Overhead(int(rows.sum()), float(variance), float(lost), float(np.sqrt(noise[0] / noise[1])))


def table_overhead(found: Overhead) -> Table:
    if not found.compared:
        return Table(("finest nodes compared",), [["none"]])
    return Table(
        ("finest nodes compared", "their variance", "photons they saw, inverse", "the paper's limit of both", "noise of the whole picture"),
        [[f"{found.compared:,}", f"{found.variance:.2f}", f"{found.photons:.2f}", f"{PAPER_OVERHEAD:.2f}", f"{found.noise:.2f}"]],
    )


# -- knobs --


@dataclass(frozen=True)
class Choice:
    """A row of a sweep; `printed` shows all stable nodes, as the paper does, instead of the leaves with the least expected error."""

    name: str
    knobs: dict[str, object]
    printed: bool = False


def sweep(stage: Stage, reference: Reference, photons: float, choices: Sequence[Choice]) -> Table:
    """One row for each choice of knobs; errors also at texels that contact flags, where shadows leak."""
    rows = []
    for choice in choices:
        bake = stage.bake(photons, **choice.knobs)
        leaf = bake.leaf_of(bake.show_stable(int(choice.knobs["stability"]))) if choice.printed else bake.leaf
        values = bake.values(leaf)
        errors = [_both(reference.measure(values, texels)) for texels in (None, stage.contact)]
        rows.append([choice.name, *errors, f"{len(np.unique(leaf)):,}", f"{len(bake.light.tree):,}"])
    return Table(("", "rel / nrmse", "the same at contacts", "leaves", "nodes"), rows)


def _both(errors: Errors | Point) -> str:
    return f"{percent(errors.rel)} / {percent(errors.nrmse)}"


HINTS = [
    Choice(f"{basis}, {'' if contact else 'no '}contact, min level {level}", {"basis": basis, "contact": contact, "min_level": level})
    for basis in ("constant", "linear")
    for contact, level in ((False, 0), (True, 0), (False, 3), (True, 3), (False, 5))
]

KNOBS = [
    Choice(
        f"**the defaults**: {DEFAULTS.basis}, threshold {DEFAULTS.threshold:g}, stability {DEFAULTS.stability}, "
        f"{DEFAULTS.oracle}, preview depth {DEFAULTS.preview_depth}",
        {},
    ),
    Choice("the same, seed 2", {"seed": 2}),
    *[Choice(f"threshold {value:g}", {"threshold": value}) for value in (0.0, 0.02, 0.1, 0.3, 1.0)],
    *[Choice(f"stability {value}", {"stability": value}) for value in (1, 2, 4, 8, 16, 64)],
    *[Choice(f"preview depth {value}", {"preview_depth": value}) for value in (1, 3)],
    *[Choice(f"oracle paper, stability {value}", {"oracle": "paper", "stability": value}) for value in (DEFAULTS.stability, 64)],
    *[
        Choice(f"as printed: {basis}, oracle paper, stability {value}", {"basis": basis, "oracle": "paper", "stability": value}, True)
        for basis in ("constant", "linear")
        for value in (4, 8, 16, 64)
    ],
]
