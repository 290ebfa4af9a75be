"""Photons that are traced before there are texels are those that the first round would trace itself."""

from __future__ import annotations

import json
from concurrent.futures import Future

import numpy as np
import pytest
from boxes import lamp_scene, make_solver
from leaflight.core.bake import bake
from leaflight.core.bake.first_photons import FirstPhotons
from leaflight.core.bake.photon_shards import PhotonShard
from leaflight.core.parallel import executors, folders
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.transport import rounds
from leaflight.core.util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, padding=1, max_photons=20_000)


@pytest.fixture
def awake():
    """Two processes, of which one is there from the start."""
    with executors.LocalExecutor(2) as executor:
        executor.wake()
        yield executor


def begin(folder, settings, executor, n_sent):
    """A bake of the lamp scene that has traced its first round, with so many shards sent ahead, 0 none."""
    solver = make_solver(folder, lamp_scene(), settings, executor, begun=False)
    # Not before: it writes the scene that they are traced in, and who reads it meanwhile finds half of it.
    solver.first = FirstPhotons.send(folder, settings, executor) if n_sent else FirstPhotons()
    assert len(solver.first.sent) == n_sent
    solver.begin()
    return solver


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_round_of_them_is_the_round_without(tmp_path, awake, direct):
    settings = Settings(size=32, padding=1, max_photons=20_000, direct=direct)
    sums = []
    for name, is_ahead in (("ahead", True), ("alone", False)):
        solver = begin(tmp_path / name, settings, awake, 2 * is_ahead)
        assert solver.ledger.photons == 20_000
        sums.append(solver.reading.solution.coefficient.tobytes() + solver.square_tally.raw.tobytes())
        folders.forget_folders()
    assert sums[0] == sums[1]


def test_who_has_no_process_to_spare_traces_them_later(tmp_path):
    assert not FirstPhotons.send(tmp_path, SETTINGS, executors.InlineExecutor()).sent
    with executors.LocalExecutor(2) as asleep:
        assert not FirstPhotons.send(tmp_path, SETTINGS, asleep).sent
    assert FirstPhotons().take(shard_of(0, 0, 10)) == shard_of(0, 0, 10)


def shard_of(round_, number, photons, **others):
    return PhotonShard(
        tracing="", view="", seed=0, round=round_, shard=number, photons=photons, max_depth=9, degree=1, skip_first=True, **others
    )


def test_the_second_round_is_the_same_and_tells_the_third_the_same(tmp_path, awake, monkeypatch):
    """Where photons parted is told once there are trees."""
    monkeypatch.setattr(rounds, "AHEAD_PHOTONS", (10_000, 20_000))
    monkeypatch.setattr(rounds, "FIRST_ROUND_PHOTONS", 10_000)
    monkeypatch.setattr(rounds, "MOST_FIRST_PHOTONS", 15_000)
    settings, told = Settings(size=32, padding=1, max_photons=100_000, error=1e-3, gather=False), []
    for name, is_ahead in (("ahead", True), ("alone", False)):
        solver = begin(tmp_path / name, settings, awake, 4 * is_ahead)
        solver._refine(solver.reading)
        solver._trace_round(None)
        assert solver.ledger.photons >= 30_000
        assert not list((tmp_path / name).glob("hits_*"))  # read once
        solver.reading = solver._read_tallies()
        splitting, weight = solver._guide_photons()
        assert weight > 1.0
        told.append((solver.reading.solution.coefficient.tobytes(), splitting.factor.tobytes(), weight, solver.ledger.rays))
        folders.forget_folders()
    assert told[0] == told[1]


def test_it_is_not_sent_ahead_where_it_may_turn_out_smaller(tmp_path, awake):
    def count(**others):
        sent = FirstPhotons.send(tmp_path, Settings(size=32, **others), awake).sent.values()
        for _, traced in sent:
            traced.cancel()
        return sum(shard.photons for shard, _ in sent)

    first, second = rounds.AHEAD_PHOTONS
    enough = rounds.MOST_FIRST_PHOTONS + second
    assert count(max_photons=enough) == first + second
    assert count(max_photons=enough - 1) == first
    assert count(max_photons=enough, direct="photons") == first


def test_shards_that_turn_out_otherwise_are_traced_when_they_are_known():
    done = Future()
    done.set_result(True)
    first = FirstPhotons({(1, 0): (shard_of(1, 0, 100, hits="there"), done)})
    assert first.take(shard_of(1, 0, 100)).hits == "there"
    for other in (shard_of(1, 0, 101), shard_of(1, 1, 100), shard_of(0, 0, 100), shard_of(1, 0, 100, weight=1.5)):
        assert first.take(other) == other


@pytest.mark.parametrize("round_", [0, 1])
def test_what_trees_ask_for_beyond_them_is_traced_with_the_round(round_):
    photons = rounds.count_ahead(round_, by_rays=True)
    ahead = rounds.share_photons(photons)
    assert rounds.share_photons(photons, photons) == ahead
    shares = rounds.share_photons(2 * photons + 3, photons)
    assert shares[: len(ahead)] == ahead
    assert sum(shares) == 2 * photons + 3
    assert sum(shares[::2]) - sum(shares[1::2]) == 1
    assert rounds.share_photons(2 * photons + 3) != shares


def test_photons_alone_have_the_first_round_ahead_only():
    counts = [[rounds.count_ahead(round_, by_rays) for round_ in range(4)] for by_rays in (True, False)]
    first, second = rounds.AHEAD_PHOTONS
    assert counts == [[first, second, 0, 0], [first, 0, 0, 0]]


def test_what_goes_wrong_there_is_told_where_they_are_taken(tmp_path, awake):
    (tmp_path / SNAPSHOT_FILE).write_bytes(b"no snapshot")
    first = FirstPhotons.send(tmp_path, SETTINGS, awake)
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
        Job(Settings(size=32, padding=1, max_photons=20_000, workers=workers_asked), str(folder / "out"), "box").save(folder)
        bake.run_bake(folder, lambda message: None, lambda: False, opener)
        result = json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))
        files.append((np.fromfile(result["files"][0]["path"], np.uint8).tobytes(), result["photons"]))
    assert any(shard.hits for shard in traced) == (executors.count_processors(0) > 1)
    assert files[0] == files[1]
