"""Bakes of one scene from the core alone, and how far they are from a reference."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from boxes import prepare_folder
from leaflight.core.bake import solve
from leaflight.core.parallel import folders
from leaflight.core.radiosity import quadtree, tally
from leaflight.core.scene.scene import SceneSnapshot
from leaflight.core.transport import contact_map, traced_scene
from leaflight.core.util.job import SNAPSHOT_FILE
from leaflight.core.util.settings import Settings

BEST_TEXELS = 0.99
DARK_FLOOR = 0.1
NEVER = 1e-4  # an error that no bake here comes to, so that the photons decide


@dataclass(frozen=True)
class Errors:
    """Of light at texels, root mean squares.

    rel     relative to local brightness, over the best texels, each counting alike
    nrmse   relative to the mean, over the surface: texels count by their area, for one photon in a sliver is a flash that nobody sees
    """

    rel: float
    nrmse: float


@dataclass(frozen=True)
class Reference:
    """Two independent means of long runs on the fixed mesh: without bias, and their noise cancels in products.

    first, second   (n, 3) float64, W/m^2
    variance        (n, 3) float64, (W/m^2)^2, of one run
    received        (n,) float64, photons of one run, on average
    area            (n,) float64, m^2
    """

    first: np.ndarray
    second: np.ndarray
    variance: np.ndarray
    received: np.ndarray
    area: np.ndarray

    @cached_property
    def mean(self) -> np.ndarray:
        """(n, 3) W/m^2."""
        return (self.first + self.second) / 2.0

    @cached_property
    def level(self) -> float:
        """W/m^2: mean over surface and channels."""
        return float(np.average(self.mean.mean(1), weights=self.area))

    @cached_property
    def local2(self) -> np.ndarray:
        """(n, 3) (W/m^2)^2: what squared errors are relative to."""
        return self.mean**2 + (DARK_FLOOR * self.level) ** 2

    def find_best(self, value: np.ndarray) -> np.ndarray:
        """(n,) bool: all but the worst texels of light (n, 3) at texels."""
        local = np.abs(value - self.mean).sum(1) / (self.mean.sum(1) + 3.0 * DARK_FLOOR * self.level)
        return local <= np.quantile(local, BEST_TEXELS)

    def measure(self, value: np.ndarray, rows: np.ndarray | None = None) -> Errors:
        """Errors of light at texels.

        value   (n, 3) float, W/m^2
        rows    (n,) bool: texels to look at, the mean brightness and the best being those of all
        """
        rows = np.ones(len(value), bool) if rows is None else rows
        square = (value - self.first) * (value - self.second)
        best = rows & self.find_best(value)
        rel2 = (square[best] / self.local2[best]).mean()
        mean2 = np.average(square[rows].mean(1), weights=self.area[rows])
        return Errors(float(np.sqrt(max(rel2, 0.0))), float(np.sqrt(max(mean2, 0.0)) / self.level))


@dataclass(frozen=True)
class Bake:
    """A light field and the scene it belongs to."""

    stage: Stage
    light: solve.LightField
    tally: tally.Tally

    @cached_property
    def solution(self) -> tally.Solution:
        """Of all nodes, as their photons have it; the light field tells of its leaves alone, and those are shrunk."""
        return tally.solve_tallies(self.light.tree, tally.accumulate(self.light.tree, self.tally))

    @cached_property
    def leaf(self) -> np.ndarray:
        """(n,) int32: the leaf at each texel."""
        return self.leaf_of(self.light.leaves)

    def leaf_of(self, nodes: np.ndarray) -> np.ndarray:
        """(n,) int32: which of `nodes`, that tile all charts, lies at each texel."""
        return quadtree.node_of_texel(self.light.tree, nodes, len(self.stage.texels.texel_area))

    def values(self, leaf: np.ndarray | None = None) -> np.ndarray:
        """(n, 3) irradiance, W/m^2: means over each texel of the leaves' own functions, edges and all, as in the paper.

        leaf   of leaf_of; None for the leaves of the bake
        """
        solution = self.light.solution if leaf is None else self.solution
        leaf, tree, texels = self.leaf if leaf is None else leaf, self.light.tree, self.stage.texels
        half, entry = tree.side[leaf] / 2.0, np.arange(len(leaf))
        moments = texels.range_moments(entry, entry + 1, tree.origin[leaf] + half[:, None], half, 2 * tree.degree)
        coefficient = solution.coefficient.sum(0)[..., leaf]
        total = np.einsum("ckn,nk->nc", coefficient, moments[:, : coefficient.shape[1]])
        return np.maximum(total / texels.texel_area[:, None], 0.0)

    def show_stable(self, stability: int) -> np.ndarray:
        """The deepest nodes at or below the current ones of which all siblings are stable: what the paper displays."""
        tree, received = self.light.tree, self.light.received
        front, leaves = np.flatnonzero(tree.parent < 0), []
        while len(front):
            children = tree.children[front]
            there = children >= 0
            below = ~tree.current[front] & self._above_current[front]
            stable = (~there | (received[children] >= stability)).all(1) & there.any(1)
            opened = below | stable
            leaves.append(front[~opened])
            front = children[opened][there[opened]]
        return np.concatenate(leaves)

    @cached_property
    def _above_current(self) -> np.ndarray:
        above = np.zeros(len(self.light.tree), bool)
        for level in reversed(self.light.tree.levels[1:]):
            marked = level[self.light.tree.current[level] | above[level]]
            above[self.light.tree.parent[marked]] = True
        return above


class Stage:
    """A scene unwrapped once, to be baked many times by photons alone."""

    def __init__(self, folder: Path, scene: SceneSnapshot, settings: Settings, executor: Executor) -> None:
        self.folder, self.executor = folder, executor
        self.settings = dataclasses.replace(settings, direct="photons", error=NEVER)
        # Moments of the greatest degree serve every basis.
        self.atlas, self.texels = prepare_folder(folder, scene, dataclasses.replace(settings, basis="quadratic"))
        self.tracing = traced_scene.open_tracing(str(folder))
        self.contact = contact_map.find_contacts(self.tracing, self.texels).touched
        self._bakes = 0

    def bake(self, photons: int, **knobs: object) -> Bake:
        """A bake with so many photons; `knobs` are fields of Settings."""
        settings = dataclasses.replace(self.settings, max_photons=int(photons), **knobs)
        n_texel = len(self.texels.texel_area)
        forced = self.contact if settings.contact else np.zeros(n_texel, bool)
        solver = solve.Solver(self._open_folder(), settings, self.executor, solve.DirectField.none(n_texel), forced)
        light = solver.run(lambda message: None, lambda: False)
        return Bake(self, light, solver.tally)

    def _open_folder(self) -> Path:
        """A folder for one bake: workers keep views open by name, and those of two bakes must not be taken for each other."""
        self._bakes += 1
        folder = self.folder / f"bake_{self._bakes}"
        folder.mkdir()
        for name in (SNAPSHOT_FILE, folders.TEXELS_FOLDER):
            (folder / name).symlink_to(self.folder / name)
        return folder
