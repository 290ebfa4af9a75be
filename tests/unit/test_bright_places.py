"""Gather rays that are aimed at bright places: their pdf, and what they gather, beside rays of a cosine distribution alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from boxes import make_solver, room_mesh
from floors import sigma_limit
from leaflight.core.integrate import gather, texel_shards
from leaflight.core.integrate.bright_places import Targets, find_bright
from leaflight.core.lights.direct_points import each_chunk
from leaflight.core.scene.scene import Light, Material
from leaflight.core.scene.surface_cells import SurfaceCells
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, moved, quad_mesh

LAMP = Light("POINT", "Lamp", (0.5, 0.5, 0.5), power_rgb=(1.0, 1.0, 1.0))
ROOM = moved(room_mesh(), (0.5, 0.5, 0.5))
BLOCK = moved(box_mesh("Block", (0.2, 0.2, 0.2)), (0.5, 0.5, 0.1))


class Lit:
    """A room whose light is known: 1 W/m^2, but 300 on a spot of its ceiling and on other things in it; or, where these have no lightmap,
    120 on one side of them.
    """

    def __init__(self, folder, meshes=(ROOM,), bare=False, front=True):
        scene = make_scene(meshes, [LAMP], [Material("Grey", (0.5,) * 3)])
        if bare:
            scene = replace(scene, objects=(scene.objects[0], *(replace(thing, receives=False) for thing in scene.objects[1:])))
        solver = make_solver(folder, scene, Settings(even_out=False, size=64, padding=1), begun=False)
        self.texels, self.folder, self.unit_box = solver.tracing.texels, str(folder), solver.tracing.unit_box
        every = np.arange(len(self.texels))
        self.place = np.einsum("nk,nkj->nj", self.texels.bary_at(every), scene.tri_position[self.texels.texel_tri])
        spot = (self.place[:, 2] > 0.85) & (np.abs(self.place[:, :2] - 0.3).max(axis=1) < 0.06)
        spot |= scene.tri_object[self.texels.texel_tri] > 0
        light = np.where(spot & (not bare), 300.0, 1.0).astype(np.float32)
        tri, is_front, _ = solver.tracing.cells.locate(np.arange(len(solver.tracing.cells)))
        on_cells = np.zeros((2, 3, len(tri)), np.float32)
        on_cells[:, :, (is_front == front) & (scene.tri_object[tri] == 1)] = 60.0
        bright = find_bright(self.surfaces, np.tile(light, (3, 1)), on_cells.sum(axis=0))
        doubt = np.zeros((1, len(every)), np.float32), np.zeros((1, *on_cells.shape[::2]), np.float32)
        self.known = gather.KnownLight(np.tile(light, (3, 1)), doubt[0], on_cells, doubt[1], bright)

    @property
    def surfaces(self):
        return texel_shards.open_surfaces(self.folder)

    def gather(self, aimed=True, texel=None, seed=1, n_ray=64):
        bright = self.known.bright if aimed else find_bright(self.surfaces, 0 * self.known.light, 0 * self.known.on_cells[0])
        scene, targets = texel_shards._open_gather_scene(self.folder), Targets(bright, self.surfaces)
        texel = np.arange(len(self.texels)) if texel is None else texel
        return gather.gather_light(scene, self.known, targets, texel, np.random.default_rng(seed), n_ray)


@pytest.mark.parametrize("meshes", [(ROOM,), (ROOM, moved(BLOCK, (0.0, 0.0, 0.2)))], ids=["empty", "block"])
def test_all_that_a_closed_room_sends_arrives(tmp_path, meshes):
    """Of the block's sides some hide the others, and the spot."""
    lit = Lit(tmp_path, meshes)
    bakes, area = [lit.gather(seed=seed) for seed in range(4)], lit.texels.texel_area
    arrived = np.mean([bake.irradiance_rgb[:, 0] @ area for bake in bakes])
    sigma = math.sqrt(np.mean([bake.variance_rgb[:, 0] @ area**2 for bake in bakes]) / len(bakes)) / arrived
    assert sigma < 0.001
    assert arrived == pytest.approx(0.5 * (lit.known.light[0] @ area), rel=sigma_limit(1) * sigma + 1e-3)
    if len(meshes) == 1:
        assert bakes[0].variance_rgb.mean() < 0.06 * lit.gather(aimed=False).variance_rgb.mean()  # twice the rays alone would halve it


SHEET = moved(quad_mesh("Sheet", 0.3, 0.3), (0.3, 0.3, 0.7))


@pytest.mark.parametrize(("thing", "front"), [(BLOCK, True), (SHEET, True), (SHEET, False)])
def test_a_bright_thing_without_a_lightmap_sends_the_same_with_less_noise(tmp_path, thing, front):
    lit = Lit(tmp_path, (ROOM, thing), bare=True, front=front)
    aimed, plain = lit.gather(), lit.gather(aimed=False, seed=2)
    difference = (aimed.irradiance_rgb - plain.irradiance_rgb)[:, 0].mean()
    sigma = math.sqrt((aimed.variance_rgb + plain.variance_rgb)[:, 0].sum()) / len(lit.texels)
    assert sigma < 0.02 * plain.irradiance_rgb[:, 0].mean()
    assert abs(difference) < sigma_limit(1) * sigma
    assert aimed.variance_rgb.mean() < 0.25 * plain.variance_rgb.mean()


def test_the_stated_variance_is_that_between_seeds(tmp_path):
    lit = Lit(tmp_path)
    bakes = [lit.gather(seed=seed, n_ray=16, texel=np.arange(0, len(lit.texels), 5)) for seed in range(8)]
    between = np.var([one.irradiance_rgb[:, 0] for one in bakes], axis=0, ddof=1).mean()
    stated = np.mean([one.variance_rgb[:, 0] for one in bakes])
    assert 0.4 * stated < between < 1.1 * stated  # neighbouring strata tell more noise than all strata together leave


def test_points_are_chosen_with_the_stated_pdf(tmp_path):
    """From one texel of the floor to the whole spot: the share of each place, and all of its pdf."""
    lit = Lit(tmp_path)
    targets, rng = Targets(lit.known.bright, lit.surfaces), np.random.default_rng(3)
    texel = np.flatnonzero((lit.place[:, 2] < 0.15) & (np.abs(lit.place[:, :2] - 0.6).max(axis=1) < 0.05))[:16]
    no_side = np.zeros(len(lit.surfaces.receiving.normal), bool)
    (_, chunk), *_ = each_chunk(lit.surfaces.receiving, lit.texels.footprints_at, texel, no_side, rng, 64)
    end, rows = targets.find_chances(chunk), np.zeros(1, int)
    number, point = targets.choose(end, rows, rng.random((40_000, 1)), rng)
    away = point - chunk.receivers_at(rows, np.full((1, 1, 2), 0.5)).position
    down = np.broadcast_to(np.float32([0, 0, -1]), away.shape)
    pdf = targets.find_pdf(end, np.zeros(len(number), int), number, away, down)
    # The mean of 1 / pdf over the points of a place is the solid angle of the place.
    found = np.bincount(number, 1 / pdf) / len(number)
    area = lit.texels.texel_area[lit.known.bright.entry] * lit.unit_box.scale**2
    expected = area * np.bincount(number, away[:, 2] / np.linalg.norm(away, axis=1) ** 3) / np.bincount(number)
    assert len(area) > 3
    assert found == pytest.approx(expected, rel=0.05)


def test_places_are_those_far_brighter_than_the_rest(tmp_path):
    lit = Lit(tmp_path)
    assert set(lit.known.bright.entry) == set(np.flatnonzero(lit.known.light[0] == 300.0))
    dark = find_bright(lit.surfaces, 0 * lit.known.light, 0 * lit.known.on_cells[0])
    even = find_bright(lit.surfaces, 0 * lit.known.light + 3, 0 * lit.known.on_cells[0])
    assert len(dark) == len(even) == 0


def test_cells_are_located_where_they_are_found():
    cells = SurfaceCells.of(np.array([1.0, 4.0, 0.1]), np.array([False, True, False]))
    rng = np.random.default_rng(1)
    u, v = rng.random((2, 2000))
    u, v = (np.where(u + v > 1, 1 - one, one).astype(np.float32) for one in (u, v))
    tri, is_front = rng.integers(0, 3, 2000), rng.random(2000) < 0.5
    cell = cells.find(tri, is_front, u, v)
    of, front, corners = cells.locate(cell)
    assert np.array_equal(of, tri)
    assert np.array_equal(front, is_front)
    assert np.array_equal(cells.find(tri, is_front, *corners.mean(axis=1).T), cell)
    first, second, third = np.moveaxis(corners.astype(float), 1, 0)
    weights = np.linalg.solve(np.stack([second - first, third - first], axis=2), (np.stack([u, v], axis=1) - first)[..., None])
    assert weights.min() > -1e-3
    assert weights.sum(axis=1).max() < 1 + 1e-3
