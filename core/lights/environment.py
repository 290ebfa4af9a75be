"""A world whose radiance varies with direction: its map, and its photons."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..scene.scene_cover import SceneCover
from ..util.arrays import Float32, Float64, FloatArray
from ..util.brightness import weigh_channels
from ..util.sphere_map import CellTable, find_cells, find_middles, find_solid_angles
from .lights import EmittedPhotons, Emitter, make_photons


@dataclass(frozen=True)
class Environment:
    """Radiance from every direction of infinity, constant in each cell of a map (see sphere_map).

    radiance   (h, w, 3) float32, W/m^2/sr; finite and >= 0
    """

    radiance: Float32

    @cached_property
    def cell_power(self) -> Float64:
        """(h, w) float64: brightness (weigh_channels) times solid angle of each cell."""
        height, width, _ = self.radiance.shape
        brightness = weigh_channels(self.radiance.reshape(-1, 3)).reshape(height, width)
        return brightness * find_solid_angles(height, width)[:, None]

    @property
    def shines(self) -> bool:
        return bool(self.radiance.any())

    def look_up(self, direction: FloatArray) -> Float32:
        """(n, 3) float32, W/m^2/sr: radiance from unit directions (n, 3)."""
        return self.radiance.reshape(-1, 3)[find_cells(self.radiance.shape, direction)]


@dataclass(frozen=True)
class EnvironmentEmitter(Emitter):
    """Photons of an environment: a direction is chosen by power, then a point on the scene's outline perpendicular to it.

    table         cells, weighted by the power that each sends into the scene
    cell_share    (h * w, 3) float32: power of a cell over its probability and over power_rgb, for an outline of 1
    """

    name: str
    power_rgb: Float64
    table: CellTable
    cell_share: Float32
    cover: SceneCover
    casts_shadow: bool = True

    @classmethod
    def of(cls, name: str, environment: Environment, cover: SceneCover, per_area: float) -> EnvironmentEmitter:
        """per_area   square metres per unit of area in the unit box"""
        height, width, _ = environment.radiance.shape
        outline = cover.outline_area(find_middles((height, width))) * per_area
        weight = environment.cell_power.ravel() * outline
        solid_angle = np.repeat(find_solid_angles(height, width), width)
        in_sight = environment.radiance.reshape(-1, 3) * solid_angle[:, None]
        power = (in_sight * outline[:, None]).sum(axis=0)
        probability = weight / weight.sum()
        share = in_sight * per_area * np.divide(1, power, out=np.zeros(3), where=power > 0)
        share = np.divide(share, probability[:, None], out=np.zeros_like(share), where=probability[:, None] > 0)
        return cls(name, power, CellTable(weight.reshape(height, width)), share.astype(np.float32), cover)

    def emit(self, u: Float32) -> EmittedPhotons:
        toward, cell, _ = self.table.sample(u[:, 2:4])
        direction = -toward
        across, rest = self.cover.choose_faces(u[:, 0], np.abs(direction) * self.cover.face_area.astype(np.float32))
        entering_high = (across * direction.T).sum(axis=0) < 0
        relative = self.cell_share[cell] * self.cover.outline_area(direction)[:, None]
        return make_photons(self.cover.place(across, entering_high, rest, u[:, 1]), direction, relative)
