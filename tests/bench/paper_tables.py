"""The numbers of docs/paper.md: tables of bakes with one knob turned, against a long run of the same photons on the fixed mesh."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from leaflight.core.lights.irradiance import polygon_irradiance
from leaflight.core.util.settings import BASES, Settings
from paper_bakes import Bake, Errors, Reference, Stage
from tables import Table

REFERENCE_SEED, REFERENCE_RUNS = 1000, 8  # runs of each of the two references
TRUTH_SEED, TRUTH_RUNS = 2000, 8  # of those that the best leaves are chosen by
SEEDS = 16  # for variances between bakes: by four of them, the ratio of variances comes out 0.05 off
PHOTONS_IN_A_NODE = 16  # on the fixed mesh, for a variance to be worth comparing
LAMP_W, LAMP_M, LAMP_HEIGHT_M, SHEET_EDGE_M = 40.0, 0.3, 2.0, 0.5  # of figure2_square.blend
PAPER_OVERHEAD = 1 / (1 - 1 / 4)  # [Tobler97]: what late nodes may lose
DEFAULTS = Settings()
T = TypeVar("T")
FIXED_MESH: dict[str, object] = {"hierarchical": False, "basis": "constant"}


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


@dataclass(frozen=True)
class SquareRow:
    """One bake of figure 2; rmse is relative to the mean."""

    basis: str
    rule: str
    leaves: int
    rmse: float


def bake_square(stage: Stage, arriving: float) -> tuple[list[SquareRow], dict[str, Bake]]:
    """Figure 2: bakes in which so many photons land on the square, and those to draw by their basis."""
    truth = square_irradiance(texel_positions(stage))
    photons = arriving * LAMP_W / (truth * stage.texels.texel_area).sum()
    rows, drawn = [], {}
    for basis in BASES:
        for oracle, stability in (
            (("significance", DEFAULTS.stability), ("paper", 256)) if basis == "constant" else (("significance", DEFAULTS.stability),)
        ):
            bake = stage.bake(photons, basis=basis, oracle=oracle, stability=stability)
            leaf = None if oracle == "significance" else bake.leaf_of(bake.show_stable(stability))
            off = bake.values(leaf)[:, 0] - truth
            rmse = float(np.sqrt((off**2).mean()) / truth.mean())
            count = len(bake.light.leaves if leaf is None else np.unique(leaf))
            rows.append(SquareRow(basis, f"{oracle}, stable from {stability}", count, rmse))
            if oracle == "significance":
                drawn[basis] = bake
    return rows, drawn


def table_square(rows: Sequence[SquareRow]) -> Table:
    return Table(("basis", "oracle", "leaves", "RMSE / mean"), [[r.basis, r.rule, f"{r.leaves:,}", percent(r.rmse)] for r in rows])


# -- figure 3 --


def make_reference(stage: Stage, photons: float, seed: int = REFERENCE_SEED, runs: int = REFERENCE_RUNS) -> Reference:
    """Runs of so many photons each, on the fixed mesh at the finest level: noisy, but without bias."""
    values, received = [], []
    for run in range(2 * runs):
        bake = stage.bake(photons, **FIXED_MESH, seed=seed + run)
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
    rays: int


def measure_bake(bake: Bake, reference: Reference) -> Point:
    errors = reference.measure(bake.values())
    return Point(bake.light.photons, len(bake.light.leaves), errors.rel, errors.nrmse, bake.light.ledger.rays)


def trace_curves(stage: Stage, reference: Reference, photons: Sequence[float]) -> tuple[dict[str, list[Point]], dict[str, Bake]]:
    """Errors over photons of the fixed mesh and of each basis, and the bakes with the most of them."""
    kinds: dict[str, dict[str, object]] = {"flat": FIXED_MESH, **{name: {"basis": name} for name in BASES}}
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
            rays = f"{point.rays / 1e6:.1f} M"
            rows.append([name, millions(point.photons), rays, f"{point.leaves:,}", _both(point), ratio])
    return Table(("basis", "photons", "rays", "leaves", "rel / nrmse", "of flat's"), rows)


@dataclass(frozen=True)
class Need:
    """What a basis takes to come to an error."""

    rel: float
    leaves: float
    photons: float


def read_needs(curves: dict[str, list[Point]]) -> dict[str, Need]:
    """Leaves and photons that each basis takes to a `rel` that all of them reach, read off the curves."""
    target = max(min(point.rel for point in points) for points in curves.values())
    needs = {}
    for name, points in curves.items():
        rel = np.log([point.rel for point in points])[::-1]
        read = [np.exp(np.interp(np.log(target), rel, np.log([getattr(p, of) for p in points])[::-1])) for of in ("leaves", "photons")]
        needs[name] = Need(target, *map(float, read))
    return needs


def table_needs(needs: dict[str, Need]) -> Table:
    rows = [[name, percent(need.rel), f"{need.leaves:,.0f}", f"{need.photons / 1e6:.2f} M"] for name, need in needs.items()]
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


def measure_overhead(stage: Stage, reference: Reference, photons: float) -> Overhead:
    """From bakes of several seeds."""
    value, received, shown = [], [], []
    for seed in range(1, SEEDS + 1):
        bake = stage.bake(photons, basis="constant", seed=seed)
        tree = bake.light.tree
        node = bake.leaf_of(np.flatnonzero(~tree.has_children))
        finest = (tree.side[node] == stage.settings.finest_texels) & (tree.parent[node] >= 0)
        value.append(np.where(finest[:, None], (bake.solution.flux / tree.area).T[node], np.nan))
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


@dataclass(frozen=True)
class Swept:
    """A choice of knobs, and what came of it; `contact` are the errors at texels that contact flags, where shadows leak."""

    choice: Choice
    errors: Errors
    contact: Errors
    leaves: int
    nodes: int


def sweep(stage: Stage, reference: Reference, photons: float, choices: Sequence[Choice]) -> list[Swept]:
    """One bake for each choice of knobs."""
    swept = []
    for choice in choices:
        bake = stage.bake(photons, **choice.knobs)
        leaf = bake.leaf_of(bake.show_stable(int(choice.knobs["stability"]))) if choice.printed else None
        values = bake.values(leaf)
        errors = [reference.measure(values, texels) for texels in (None, stage.contact)]
        count = len(bake.light.leaves if leaf is None else np.unique(leaf))
        swept.append(Swept(choice, *errors, count, len(bake.light.tree)))
    return swept


def table_sweep(swept: Sequence[Swept]) -> Table:
    rows = [[one.choice.name, _both(one.errors), _both(one.contact), f"{one.leaves:,}", f"{one.nodes:,}"] for one in swept]
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
        f"**the defaults**: {DEFAULTS.basis}, {DEFAULTS.oracle}, stability {DEFAULTS.stability}, preview depth {DEFAULTS.preview_depth}", {}
    ),
    Choice("the same, seed 2", {"seed": 2}),
    *[Choice(f"stability {value}", {"stability": value}) for value in (1, 2, 4, 8, 16, 64)],
    *[Choice(f"preview depth {value}", {"preview_depth": value}) for value in (1, 3)],
    *[Choice(f"oracle paper, stability {value}", {"oracle": "paper", "stability": value}) for value in (DEFAULTS.stability, 64)],
    *[
        Choice(f"as printed: {basis}, oracle paper, stability {value}", {"basis": basis, "oracle": "paper", "stability": value}, True)
        for basis in ("constant", "linear")
        for value in (4, 8, 16, 64)
    ],
    *[
        Choice(
            f"as printed: {DEFAULTS.basis}, oracle paper, stability {DEFAULTS.stability}, threshold {value:g}",
            {"basis": DEFAULTS.basis, "oracle": "paper", "stability": DEFAULTS.stability, "threshold": value},
            True,
        )
        for value in sorted({0.0, 0.02, 0.05, 0.1, 0.3, 1.0, DEFAULTS.threshold})
    ],
]
