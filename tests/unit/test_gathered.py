"""Gathered light in a bake: what it takes the place of, what it leaves to the leaves, and that workers change nothing."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene, make_solver, room_mesh
from leaflight.core.bake.stop_rules import StopRules
from leaflight.core.integrate import direct_shards, texel_light, texel_shards
from leaflight.core.integrate.gathered import GatheredField, PilotError
from leaflight.core.parallel import executors
from leaflight.core.scene.scene import Light, Material
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, moved, quad_mesh

SETTINGS = Settings(size=128, padding=1, error=0.008)
LAMP = Light("POINT", "Lamp", (0.2, 0.1, 0.3), power_rgb=(10.0, 5.0, 2.5), radius_m=0.05)
SCENE = make_scene([room_mesh(), box_mesh("Block", (0.3, 0.2, 0.3))], [LAMP], [Material("Grey", (0.6,) * 3)])


def bake(folder, settings=SETTINGS, executor=None, scene=SCENE, plan=None):
    solver = make_solver(folder, scene, settings, executor)
    if plan is not None:
        solver._may_gather = plan
    return solver.run(lambda message: None, lambda: False), solver


@pytest.fixture(scope="module")
def gathered(tmp_path_factory):
    return bake(tmp_path_factory.mktemp("gathered"))


def test_a_bake_gathers_where_photons_would_have_to_be_many_more(gathered, tmp_path):
    light, solver = gathered
    assert light.gathered is not None
    assert light.stopped_by == "error"
    alone, _ = bake(tmp_path, replace(SETTINGS, gather=False, max_photons=1_500_000))  # somewhat more rays
    assert alone.gathered is None
    assert alone.stopped_by == "max_photons"
    assert light.ledger.gathered == light.gathered.counters["rays"]  # no pilots, for leaves err by little more than is asked
    assert light.ledger.rays + light.ledger.gathered < alone.ledger.rays
    assert light.error < 0.8 * alone.error  # 0.53 to 0.8 of it, twelve bakes
    shown, of_leaves = (texel_light.light_at_texels(one, solver.tracing.texels).indirect for one in (light, alone))
    assert shown.mean() == pytest.approx(of_leaves.mean(), rel=0.01)
    assert np.sqrt(((shown - of_leaves) ** 2).mean()) < 0.05 * of_leaves.mean()


def test_a_bake_that_may_trace_no_more_photons_gathers_if_that_is_better(tmp_path):
    few = replace(SETTINGS, size=64, error=1e-4, max_photons=400_000)
    light, _ = bake(tmp_path / "1", few, scene=table_scene(100.0))
    alone, _ = bake(tmp_path / "2", replace(few, gather=False), scene=table_scene(100.0))
    assert (light.stopped_by, light.photons) == (alone.stopped_by, alone.photons) == ("max_photons", 400_000)
    assert light.gathered is not None
    assert light.error < 0.7 * alone.error
    pilots = light.ledger.gathered - light.gathered.counters["rays"]
    assert 0 < pilots < 0.2 * light.gathered.counters["rays"]


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


def halt(folder, monkeypatch, most, late=False, tell=lambda message: None, plan=None, **knobs):
    """A bake that is to stop after so many shards of what it gathers, at someone's wish or for the time."""
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", 512)
    executor = Halted(most)
    if late:
        monkeypatch.setattr(StopRules, "is_late", lambda rules: executor.is_done())
    solver = make_solver(folder, SCENE, replace(SETTINGS, **knobs), executor)
    if plan is not None:
        solver._may_gather = plan
    return solver.run(tell, (lambda: False) if late else executor.is_done), solver, executor


@pytest.mark.parametrize(("late", "why"), [(False, "interrupted"), (True, "time_limit")])
def test_a_bake_that_stops_amid_its_first_gathering_shows_leaves(gathered, tmp_path, monkeypatch, late, why):
    light, solver, executor = halt(tmp_path / "1", monkeypatch, 3, late=late)
    assert (light.stopped_by, light.gathered, executor.left) == (why, None, 0)
    assert light.rounds == gathered[0].rounds
    assert not list(solver.folder.glob("known_*"))
    alone, _, _ = halt(tmp_path / "2", monkeypatch, 1, late, gather=False, max_photons=light.photons)
    mine, theirs = (texel_light.light_at_texels(one, solver.tracing.texels) for one in (light, alone))
    for name in ("direct", "indirect", "stderr"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))
    assert light.error == alone.error


def test_what_more_rays_have_gathered_stays_where_they_are_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", 512)
    small = replace(SETTINGS, size=80)
    shards = len(direct_shards.cut_into_shards(len(make_solver(tmp_path / "1", SCENE, small, begun=False).tracing.texels))) - 1
    light, solver, executor = halt(tmp_path / "2", monkeypatch, shards + 3, plan=lambda *_: True, size=80, error=0.004)
    assert (light.stopped_by, executor.left) == ("interrupted", 0)
    once, twice = np.bincount(light.gathered.passes)[1:]
    assert once + twice == len(solver.tracing.texels)
    assert twice == pytest.approx(2 * 512, rel=0.3)  # the third shard was not waited for
    assert 0.004 < light.error < 0.02
    assert np.isfinite(texel_light.light_at_texels(light, solver.tracing.texels).indirect).all()


def test_texels_that_nothing_was_gathered_of_keep_the_light_of_the_leaves(gathered):
    light, solver = gathered
    passes = light.gathered.passes.copy()
    passes[64:128] = 0
    in_part = GatheredField(**{name: getattr(light.gathered, name) for name in ("irradiance", "variance", "doubt")}, passes=passes)
    is_shown = in_part.show_gathered(solver.tracing.texels, smooth=False).is_shown
    assert np.flatnonzero(~is_shown).tolist() == list(range(64, 128))
    whole, of_leaves, mixed = (
        texel_light.light_at_texels(replace(light, gathered=one), solver.tracing.texels, smooth_grain=False).indirect
        for one in (light.gathered, None, in_part)
    )
    assert np.array_equal(mixed[is_shown], whole[is_shown])
    assert np.array_equal(mixed[~is_shown], of_leaves[~is_shown])
    assert not np.array_equal(whole[~is_shown], of_leaves[~is_shown])


def test_a_thing_without_a_lightmap_sends_as_much_as_with_one(tmp_path):
    objects = tuple(replace(thing, receives=thing.name != "Block") for thing in SCENE.objects)
    settings = replace(SETTINGS, size=64, error=0.02)
    light, solver = bake(tmp_path / "1", settings, scene=replace(SCENE, objects=objects), plan=lambda *_: True)
    every, other = bake(tmp_path / "2", settings, plan=lambda *_: True)
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


def test_a_bake_gathers_where_pilots_tell_that_few_photons_are_enough(tmp_path, monkeypatch):
    """Below a table that few of the photons meet: leaves err by far more than what is asked."""
    settings = replace(SETTINGS, size=64, error=0.04, max_photons=2_000_000)
    light, _ = bake(tmp_path / "1", settings, scene=table_scene(60.0))
    monkeypatch.setenv("LEAFLIGHT_WITHOUT", "gather_pilots")
    alone, _ = bake(tmp_path / "2", settings, scene=table_scene(60.0))
    assert (light.stopped_by, alone.stopped_by) == ("error", "max_photons")
    assert alone.gathered is None
    assert alone.error > 2.5 * settings.error > 2.5 * light.error


def test_noise_that_pilots_miss_by_chance_is_expected_from_what_they_found_before():
    field, entry = GatheredField.none(256), np.arange(256)
    errors = []
    for photons, doubt in ((1000, 0.4), (2000, 0.01), (8000, 0.01)):
        field.doubt[:] = doubt
        errors.append(PilotError.of(field, entry, np.full((256, 3), 4.0, np.float32), photons, errors[-1] if errors else None))
    assert [error.photons2 for error in errors] == pytest.approx([0.64, 0.0004, 0.0004])
    assert [error.cautious2 for error in errors] == pytest.approx([2.56, 0.32, 0.0004])


def test_shadows_on_a_vast_ground_without_a_lightmap_reach_what_stands_there(tmp_path):
    """A table on a ground of cells that are wider than itself is as bright below as on a small ground, whose cells are fine."""
    means = []
    for name, width in (("vast", 1000.0), ("small", 20.0)):
        settings = replace(SETTINGS, size=64, error=0.03)
        light, solver = bake(tmp_path / name, settings, scene=table_scene(width), plan=lambda *_: True)
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
    light, solver = bake(tmp_path / "1", replace(SETTINGS, error=0.02), scene=scene, plan=lambda *_: True)
    many, _ = bake(tmp_path / "2", replace(SETTINGS, gather=False, error=1e-4, max_photons=1_500_000), scene=scene)
    assert light.gathered is not None
    mine, theirs = (texel_light.light_at_texels(each, solver.tracing.texels) for each in (light, many))
    shown = solver.tracing.texels.shown & solver.tracing.texels.is_central
    gap = np.abs(mine.indirect - theirs.indirect)[shown]
    assert np.quantile(gap, 0.95) < 0.05 * (theirs.direct + theirs.indirect).mean()
