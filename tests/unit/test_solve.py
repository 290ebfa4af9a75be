"""Rounds of photons: what stops them, that light is neither lost nor made, and that workers change nothing."""

import json
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from boxes import lamp_scene, make_solver, room_mesh, solution_bytes, solve_scene
from leaflight.core.bake import bake, photon_shards
from leaflight.core.bake.first_photons import FirstPhotons
from leaflight.core.bake.lost_light import state_lost
from leaflight.core.bake.photon_shards import PhotonShard
from leaflight.core.integrate import direct_shards
from leaflight.core.parallel import executors
from leaflight.core.radiosity import tally
from leaflight.core.scene.scene import Light, Material
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.transport.rounds import EARLY_GROWTH, FIRST_ROUND_PHOTONS
from leaflight.core.util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.messages import Progress
from leaflight.core.util.settings import Settings
from scenes import make_scene, moved

# Rounds of photons: what stops them, that light is neither lost nor made, and that workers change nothing.
SETTINGS = Settings(size=32, padding=1, max_photons=600_000, error=1e-4, direct="photons")
QUICK = replace(SETTINGS, max_photons=20_000)


@pytest.fixture(scope="module")
def two_workers():
    with executors.make_executor(2) as executor:
        yield executor


@pytest.mark.parametrize(("direct", "most"), [("photons", 5_000_000), ("rays", 600_000)], ids=["photons", "rays"])
def test_two_workers_give_the_bytes_of_one(tmp_path, two_workers, direct, most, hold):
    settings = replace(SETTINGS, direct=direct, max_photons=most, error=1e-4 if direct == "photons" else 0.02)
    solver, late = make_solver(tmp_path / "1", lamp_scene(), settings), []
    solver.watch = lambda light: late.append(solver.rounds.count_late())
    alone = solver.run(lambda message: None, lambda: False)
    assert (max(late) > 0) == (direct == "photons")  # which are traced while a round is looked at
    assert solver.tally.photons.sum() == pytest.approx(alone.photons, rel=1e-12)  # each is read once
    assert not list((tmp_path / "1").glob("view_*"))
    together = solve_scene(tmp_path / "2", lamp_scene(), settings, two_workers)
    assert alone.rounds > 1  # so that refined trees are compared, not only roots
    assert len(alone.leaves) > 7
    bytes_of = [np.frombuffer(solution_bytes(light), np.uint8) for light in (alone, together)]
    assert len(bytes_of[0]) == len(bytes_of[1])
    hold("workers: bytes that differ between one and two", np.count_nonzero(bytes_of[0] != bytes_of[1]), high=0)


@pytest.mark.parametrize("direct", ["photons", "rays"])
def test_another_seed_is_another_bake(tmp_path, direct):
    enough = {"photons": 20_000, "rays": 2_000_000}[direct]  # little of this lamp's light is indirect: a tenth by chance, of 20,000
    lights = [
        solve_scene(tmp_path / str(seed), lamp_scene(), replace(QUICK, error=0.01, direct=direct, seed=seed, max_photons=enough))
        for seed in (1, 2)
    ]
    flux = [light.solution.flux[:, light.leaves].sum() for light in lights]
    assert flux[0] != flux[1]
    assert flux[0] == pytest.approx(flux[1], rel=0.05)


@pytest.mark.parametrize("maximum", [1000, 12_345, 70_001, 600_000])
def test_photons_stop_at_the_greatest_number_allowed(tmp_path, maximum):
    light = solve_scene(tmp_path, lamp_scene(), replace(SETTINGS, max_photons=maximum))
    assert maximum - 1 <= light.photons <= maximum
    assert light.stopped_by == "max_photons"


def test_the_error_asked_for_stops(tmp_path):
    light = solve_scene(tmp_path, lamp_scene(), replace(SETTINGS, error=0.2, max_photons=10**9))
    assert light.stopped_by == "error"
    assert light.error <= 0.2


def test_the_time_limit_stops(tmp_path):
    solver = make_solver(tmp_path, lamp_scene(), replace(SETTINGS, time_limit=100.0, max_photons=10**9))
    solver.deadline.began -= 101.0
    light = solver.run(lambda message: None, lambda: False)
    assert (light.stopped_by, light.rounds) == ("time_limit", 1)


def test_an_interrupt_gives_the_best_so_far(tmp_path):
    asked = []

    def should_stop():
        asked.append(True)
        return len(asked) == 2

    light = solve_scene(tmp_path, lamp_scene(), SETTINGS, should_stop=should_stop)
    assert (light.stopped_by, light.rounds, len(asked)) == ("interrupted", 2, 2)
    assert light.photons < SETTINGS.max_photons
    assert light.solution.flux[:, light.leaves].min() >= 0
    assert light.solution.flux[:, light.leaves].max() > 0


def test_a_glance_is_what_a_bake_of_one_round_gives_but_for_its_error(tmp_path):
    settings = replace(QUICK, direct="photons")
    glance = make_solver(tmp_path / "1", lamp_scene(), settings).glance()
    whole = make_solver(tmp_path / "2", lamp_scene(), settings).run(lambda message: None, lambda: True)
    assert (glance.photons, glance.rounds, math.isnan(glance.error)) == (whole.photons, 1, True)
    assert solution_bytes(glance) == solution_bytes(whole)
    assert glance.leaves.size


def test_progress_is_told_after_every_round(tmp_path):
    told = []
    light = make_solver(tmp_path, lamp_scene(), SETTINGS).run(told.append, lambda: False)
    assert len(told) == light.rounds > 1
    assert all(isinstance(message, Progress) for message in told)
    assert (np.diff([message.photons for message in told]) > 0).all()
    assert (np.diff([message.fraction for message in told]) > 0).all()
    assert all(0 < message.fraction <= 1 and message.seconds_left >= 0 for message in told)
    assert (told[-1].fraction, told[-1].photons, told[-1].leaves) == (1.0, light.photons, len(light.leaves))
    for message in told:  # time so far is photons over their pace; what is left takes as long for its share
        spent = message.photons / message.photons_per_s
        assert message.seconds_left == pytest.approx(spent * (1 / message.fraction - 1), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("tolerance", [0.2, 20.0])
def test_rays_are_shot_again_where_they_err_most(tmp_path, monkeypatch, tolerance):
    """And only there, and only where the first turn left more noise than half of the error asked for, smoothed or not."""
    monkeypatch.setattr(direct_shards, "TOLERANCE", tolerance)
    light = solve_scene(tmp_path, lamp_scene(rho=0.05), replace(SETTINGS, direct="rays", error=0.03, denoise=False))
    assert light.direct.passes.min() == 1
    assert (light.direct.passes.max() > 1) == (tolerance > 1)


@pytest.mark.parametrize(("knobs", "rounds"), [({}, 2), ({"finest_texels": 16}, 1), ({"hierarchical": False}, 1)])
def test_no_bake_stops_at_its_first_leaves_while_they_would_be_split(tmp_path, knobs, rounds):
    light = solve_scene(tmp_path, lamp_scene(), replace(SETTINGS, error=0.9, max_photons=10**7, direct="photons", **knobs))
    assert (light.rounds, light.stopped_by) == (rounds, "error")
    if rounds == 2:  # its error tells nothing of how many photons the leaves to come need
        assert light.photons == FIRST_ROUND_PHOTONS * (1 + EARLY_GROWTH)


@pytest.mark.parametrize("basis", ["constant", "linear", "quadratic"])
def test_splitting_loses_no_flux(tmp_path, basis):
    """The flux of the leaves is all that was deposited, though nodes were made late."""
    solver = make_solver(tmp_path, lamp_scene(), replace(SETTINGS, direct="photons", basis=basis))
    light = solver.run(lambda message: None, lambda: False)
    deposited = solver.tally.raw[:, :, :, 0].sum((0, 1, 3)) / light.photons
    assert len(light.leaves) > 7
    assert light.rounds > 2
    assert light.solution.flux[:, light.leaves].sum(1) == pytest.approx(deposited, rel=1e-9)


@pytest.mark.parametrize("finest", [1, 4])
def test_flat_mode_has_leaves_of_the_finest_size(tmp_path, finest):
    solver = make_solver(tmp_path, lamp_scene(), replace(QUICK, hierarchical=False, finest_texels=finest))
    light = solver.run(lambda message: None, lambda: False)
    assert (light.tree.side == np.minimum(finest, light.tree.side.max())).all()
    assert len(light.leaves) == len(light.tree)
    if finest == 1:
        assert len(light.leaves) == len(light.direct.irradiance)
    plain = tally.solve_tallies(light.tree, tally.accumulate(light.tree, solver.tally))
    np.testing.assert_array_equal(light.solution.coefficient, plain.coefficient)  # held against: as the photons say


def test_an_error_in_a_shard_ends_the_bake_and_leaves_no_view(tmp_path, monkeypatch):
    def fail(shard):
        raise ValueError(f"shard {shard.shard}")

    monkeypatch.setattr(photon_shards, "trace_photons", fail)
    with pytest.raises(ValueError, match="shard 0"):
        solve_scene(tmp_path, lamp_scene(), QUICK)
    assert not list(tmp_path.glob("view_*"))


def hall_and_den():
    """A bright room, and a dim one elsewhere; and the settings by which the bright one is right long before the dim one is."""
    rooms = [room_mesh("Hall"), moved(room_mesh("Den", (0.5, 0.5, 0.5)), (5.0, 0.0, 0.0))]
    lamps = [Light("POINT", "Lamp", (x, 0.1, 0.1), power_rgb=(watts,) * 3) for x, watts in ((0.2, 1000.0), (5.1, 3.0))]
    return make_scene(rooms, lamps, [Material("Grey", (0.5,) * 3)]), replace(SETTINGS, direct="rays", error=0.03, max_photons=10**8)


def test_a_dim_room_is_told_to_err_more_than_the_whole_and_comes_to_the_error_where_each_object_has_to(tmp_path):
    scene, settings = hall_and_den()
    whole = solve_scene(tmp_path / "whole", scene, replace(settings, direct="photons"))
    assert whole.stopped_by == "error"
    assert whole.object_error[1] > 1.5 * settings.error > whole.object_error[0]
    each = solve_scene(tmp_path / "each", scene, replace(settings, error_of="objects"))
    assert each.stopped_by == "error"
    assert max(each.object_error.values()) == pytest.approx(each.error, rel=0.01)
    assert each.error <= settings.error


# Shards that are traced while a round is looked at: none is lost or read twice, and none is waited for in vain.
LATE = Settings(size=32, padding=1, max_photons=5_000_000, error=1e-4, direct="photons")  # so many that a round ends with late shards


class Counter(executors.InlineExecutor):
    def __init__(self):
        super().__init__()
        self.photons = 0

    def submit(self, fn, /, *args, **kwargs):
        self.photons += getattr(args[0], "photons", 0)
        return super().submit(fn, *args, **kwargs)


def test_photons_under_way_when_a_bake_stops_are_told_by_nothing(tmp_path):
    counter = Counter()
    solver = make_solver(tmp_path, lamp_scene(), replace(LATE, max_photons=20_000_000), counter)
    late = []
    solver.watch = lambda light: late.append(solver.rounds.count_late())
    light = solver.run(lambda message: None, lambda: any(late))
    assert light.stopped_by == "interrupted"
    assert light.photons < counter.photons
    assert light.photons == pytest.approx(solver.tally.photons.sum(), rel=1e-12)
    assert not list(tmp_path.glob("view_*"))


# Photons that are traced before there are texels are those that the first round would trace itself.
FEW = Settings(size=32, padding=1, error=0.5, max_photons=20_000)


@pytest.fixture
def awake():
    """Two processes, of which one is there from the start."""
    with executors.LocalExecutor(2) as executor:
        executor.wake()
        yield executor


def shard_of(round_, number, photons, **others):
    return PhotonShard(
        tracing="", view="", seed=0, round=round_, shard=number, photons=photons, max_depth=9, degree=1, skip_first=True, **others
    )


def test_what_goes_wrong_there_is_told_where_they_are_taken(tmp_path, awake):
    (tmp_path / SNAPSHOT_FILE).write_bytes(b"no snapshot")
    first = FirstPhotons.send(tmp_path, FEW, awake)
    with pytest.raises(ValueError, match=r"snapshot\.npz"):
        first.take(shard_of(0, 0, 10_000))


@pytest.mark.usefixtures("open_image_io")
def test_a_bake_is_the_same_with_them(tmp_path, monkeypatch):
    """Of processes that wait for their job, and of one that does all by itself."""
    traced, files = [], []
    take = FirstPhotons.take
    monkeypatch.setattr(FirstPhotons, "take", lambda first, shard: traced.append(take(first, shard)) or traced[-1])
    ahead = executors.Ahead()
    ahead.wake()  # pytest has threads, so that they are no copies
    for name, opener in (("ahead", ahead.open), ("alone", executors.open_executor)):
        folder = tmp_path / name
        folder.mkdir()
        save_snapshot(folder / SNAPSHOT_FILE, lamp_scene())
        workers_asked = 0 if name == "ahead" else 1
        Job(Settings(size=32, padding=1, error=0.5, max_photons=20_000, workers=workers_asked), str(folder / "out"), "box").save(folder)
        bake.run_bake(folder, lambda message: None, lambda: False, opener)
        result = json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))
        files.append((np.fromfile(result["files"][0]["path"], np.uint8).tobytes(), result["photons"]))
    assert any(shard.hits for shard in traced) == (executors.count_processors(0) > 1)
    assert files[0] == files[1]


# Light that photons had not lost yet when they had met as many surfaces as they may.
LAMP = Light("POINT", "Lamp", (0.2, 0.1, 0.0), power_rgb=(10.0, 10.0, 10.0), radius_m=0.02)


def bake_lossy(folder, albedo, max_depth):
    settings = Settings(size=32, padding=1, max_photons=4000, max_depth=max_depth, direct="photons")
    scene = make_scene([room_mesh()], [LAMP], [Material("Paint", (albedo,) * 3)])
    light = make_solver(folder, scene, settings).run(lambda message: None, lambda: False)
    return light, *state_lost(light, settings)


def test_what_is_under_way_still_is_stated_and_told(tmp_path):
    light, stated, warnings = bake_lossy(tmp_path, 0.99, 200)
    lost = 0.99**200  # of what has met as many surfaces
    assert light.ledger.find_lost() == pytest.approx(lost, rel=0.1)
    assert stated.error == math.hypot(light.error, light.ledger.find_lost())
    assert [subject for subject, _ in warnings] == [""]
    assert warnings[0][1].startswith(f"{light.ledger.find_lost():.0%} of the light was still under way after 200 surfaces")


def test_rooms_that_keep_little_of_it_lose_nothing(tmp_path):
    light, stated, warnings = bake_lossy(tmp_path, 0.8, 200)
    assert (stated, warnings) == (light, [])


def test_who_asks_for_few_surfaces_wants_no_more(tmp_path):
    light, stated, warnings = bake_lossy(tmp_path, 0.8, 3)
    assert light.ledger.find_lost() > 0.3
    assert (stated, warnings) == (light, [])


def test_a_little_of_it_is_stated_without_a_word(tmp_path):
    light, stated, warnings = bake_lossy(tmp_path, 0.96, 150)
    assert 0.0 < light.ledger.find_lost() < 0.01
    assert stated.error > light.error
    assert not warnings
    assert all(getattr(stated, field.name) is getattr(light, field.name) for field in fields(light) if field.name != "error")
