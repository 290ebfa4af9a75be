"""Gathered light in a bake: what it takes the place of, what it leaves to the leaves, and that workers change nothing."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene, make_solver, room_mesh
from leaflight.core.bake.stop_rules import StopRules
from leaflight.core.integrate import direct_shards, texel_light, texel_shards
from leaflight.core.parallel import executors
from leaflight.core.scene.scene import Light, Material
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, moved, quad_mesh

SETTINGS = Settings(size=64, padding=1, error=0.008)
LAMP = Light("POINT", "Lamp", (0.2, 0.1, 0.3), power_rgb=(10.0, 5.0, 2.5), radius_m=0.05)
SCENE = make_scene([room_mesh(), box_mesh("Block", (0.3, 0.2, 0.3))], [LAMP], [Material("Grey", (0.6,) * 3)])


def bake(folder, settings=SETTINGS, executor=None, scene=SCENE):
    solver = make_solver(folder, scene, settings, executor)
    return solver.run(lambda message: None, lambda: False), solver


@pytest.fixture(scope="module")
def gathered(tmp_path_factory):
    return bake(tmp_path_factory.mktemp("gathered"))


def test_gathered_light_is_that_of_many_photons(gathered, tmp_path):
    light, solver = gathered
    assert light.stopped_by == "error"
    assert light.ledger.gathered >= light.gathered.counters["rays"]
    many, _ = bake(tmp_path, replace(SETTINGS, direct="photons", error=1e-4, max_photons=1_000_000))
    mine, theirs = (texel_light.light_at_texels(one, solver.tracing.texels) for one in (light, many))
    assert mine.indirect.mean() == pytest.approx(theirs.indirect.mean(), rel=0.01)
    assert np.sqrt(((mine.indirect - theirs.indirect) ** 2).mean()) < 0.05 * theirs.indirect.mean()


@pytest.mark.parametrize("knobs", [{"hierarchical": False}, {"max_photons": 100_000}, {"max_depth": 2}])
def test_every_bake_with_shadow_rays_gathers(tmp_path, knobs):
    light, _ = bake(tmp_path, replace(SETTINGS, size=32, error=0.05, **knobs))
    assert light.gathered.passes.all()


@pytest.mark.parametrize("depth", [2, 3])
def test_gathered_light_has_the_bounces_that_are_allowed(tmp_path, depth):
    means = []
    for direct in ("rays", "photons"):
        settings = replace(SETTINGS, size=32, error=0.02, max_photons=400_000, max_depth=depth, direct=direct)
        light, solver = bake(tmp_path / direct, settings)
        means.append(texel_light.light_at_texels(light, solver.tracing.texels).indirect.mean())
    assert means[0] == pytest.approx(means[1], rel=0.03)


def test_two_workers_give_the_bytes_of_one(gathered, tmp_path):
    light, _ = gathered
    with executors.make_executor(2) as executor:
        other, _ = bake(tmp_path, executor=executor)
    for name in ("irradiance", "variance", "doubt", "passes"):
        assert getattr(other.gathered, name).tobytes() == getattr(light.gathered, name).tobytes()


class Halted(executors.InlineExecutor):
    """Wants all to stop once it has gathered for so many shards."""

    def __init__(self, most):
        super().__init__()
        self.left = self.most = most

    def submit(self, fn, /, *args, **kwargs):
        self.left -= fn is texel_shards.gather_texels
        return super().submit(fn, *args, **kwargs)

    def is_done(self):
        return self.left <= 0


def halt(folder, monkeypatch, most, late=False, tell=lambda message: None, **knobs):
    """A bake that is to stop after so many shards of what it gathers, at someone's wish or for the time."""
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", 512)
    executor = Halted(most)
    if late:
        monkeypatch.setattr(StopRules, "is_late", lambda rules: executor.is_done())
    solver = make_solver(folder, SCENE, replace(SETTINGS, **knobs), executor)
    return solver.run(tell, (lambda: False) if late else executor.is_done), solver, executor


@pytest.mark.parametrize(("late", "why"), [(False, "interrupted"), (True, "time_limit")])
def test_a_bake_that_stops_amid_its_first_gathering_shows_leaves(gathered, tmp_path, monkeypatch, late, why):
    light, solver, executor = halt(tmp_path / "1", monkeypatch, 3, late=late)
    assert (light.stopped_by, light.gathered, executor.left) == (why, None, 0)
    assert light.rounds == gathered[0].rounds
    assert not list(solver.folder.glob("known_*"))


def test_what_more_rays_have_gathered_stays_where_they_are_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", 512)
    small = replace(SETTINGS, size=80, error=0.02)
    shards = len(direct_shards.cut_into_shards(len(make_solver(tmp_path / "1", SCENE, small, begun=False).tracing.texels))) - 1
    light, solver, executor = halt(tmp_path / "2", monkeypatch, shards + 3, size=80, error=0.02, denoise=False)
    assert (light.stopped_by, executor.left) == ("interrupted", 0)
    once, twice = np.bincount(light.gathered.passes)[1:]
    assert once + twice == len(solver.tracing.texels)
    assert twice == pytest.approx(2 * 512, rel=0.3)  # the third shard was not waited for
    assert 0.02 < light.error < 0.2
    assert np.isfinite(texel_light.light_at_texels(light, solver.tracing.texels).indirect).all()


def test_a_thing_without_a_lightmap_sends_as_much_as_with_one(tmp_path):
    objects = tuple(replace(thing, receives=thing.name != "Block") for thing in SCENE.objects)
    settings = replace(SETTINGS, size=64, error=0.02)
    light, solver = bake(tmp_path / "1", settings, scene=replace(SCENE, objects=objects))
    every, other = bake(tmp_path / "2", settings)
    assert light.gathered is not None
    mine, theirs = (_find_mean(one, its) for one, its in ((light, solver), (every, other)))
    assert mine == pytest.approx(theirs, rel=0.02)


def table_scene(width_m):
    """A black table on a ground without a lightmap, so wide."""
    top = moved(box_mesh("Top", (1.0, 1.0, 0.1)), (0.0, 0.0, 0.5))
    ground = replace(moved(quad_mesh("Ground", width_m, width_m), (-width_m / 2, -width_m / 2, 0.0)), receives=False)
    sun = Light("SUN", "Sun", power_rgb=(3.0,) * 3)
    scene = make_scene([top, ground], [sun], [Material("Black", (0.0,) * 3), Material("Grey", (0.5,) * 3)])
    return replace(scene, tri_material=scene.tri_object.copy())


def test_shadows_on_a_vast_ground_without_a_lightmap_reach_what_stands_there(tmp_path):
    """A table on a ground of cells that are wider than itself is as bright below as on a small ground, whose cells are fine."""
    means = []
    for name, width in (("vast", 1000.0), ("small", 20.0)):
        settings = replace(SETTINGS, size=64, error=0.03)
        light, solver = bake(tmp_path / name, settings, scene=table_scene(width))
        texels = solver.tracing.texels
        below = texels.shown & (solver.tracing.scene.tri_normal[2, texels.texel_tri] < -0.9)
        means.append(float(texel_light.light_at_texels(light, texels).indirect[below].mean()))
    assert means[0] == pytest.approx(means[1], rel=0.03)  # less than 0.3 % comes from farther than 10 m


def _find_mean(light, solver):
    """W/m^2, of indirect light in the room without the block."""
    texels, snapshot = solver.tracing.texels, solver.tracing.snapshot
    room = [thing.name for thing in snapshot.objects].index("Room")
    mine = texels.shown & (snapshot.tri_object[texels.texel_tri] == room)
    return float(np.average(texel_light.light_at_texels(light, texels).indirect[mine].mean(axis=1), weights=texels.texel_area[mine]))


def test_an_open_scene_is_as_bright_as_by_photons(tmp_path):
    scene = lamp_scene()
    light, solver = bake(tmp_path / "1", replace(SETTINGS, error=0.02), scene=scene)
    many, _ = bake(tmp_path / "2", replace(SETTINGS, direct="photons", error=1e-4, max_photons=1_500_000), scene=scene)
    assert light.gathered is not None
    mine, theirs = (texel_light.light_at_texels(each, solver.tracing.texels) for each in (light, many))
    shown = solver.tracing.texels.shown & solver.tracing.texels.is_central
    gap = np.abs(mine.indirect - theirs.indirect)[shown]
    assert np.quantile(gap, 0.95) < 0.05 * (theirs.direct + theirs.indirect).mean()
