"""Shards that are traced while a round is looked at: none is lost or read twice, and none is waited for in vain."""

from concurrent.futures import Executor, Future
from dataclasses import replace
from types import SimpleNamespace

import pytest
from boxes import lamp_scene, make_solver, solution_bytes, solve_scene
from leaflight.core.bake import photon_shards
from leaflight.core.bake.photon_rounds import PhotonRounds
from leaflight.core.parallel import executors
from leaflight.core.transport import rounds
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, padding=1, max_photons=600_000, error=1e-4)


class Patient(Executor):
    """Runs calls when their results are asked for, and says in which order they were asked of it and done."""

    def __init__(self):
        self.asked, self.done = [], []

    def submit(self, fn, /, *args, **kwargs):
        self.asked.append(args[0].shard)
        patient = self

        class Later(Future):
            def result(self, timeout=None):
                if not self.done():
                    patient.done.append(args[0].shard)
                    self.set_result(fn(*args))
                return super().result()

        return Later()


@pytest.fixture
def shards(tmp_path, monkeypatch):
    """Gives shards of a round with a view of its own; what comes of each is its number."""
    monkeypatch.setattr(photon_shards, "trace_photons", lambda shard: shard.shard)

    def make(round_, numbers):
        view = tmp_path / f"view_{round_}"
        view.mkdir()
        return [SimpleNamespace(view=str(view), shard=number, photons=10, weight=2.0, round=round_) for number in numbers]

    return make


def test_late_shards_come_first_in_the_round_after_once_that_one_is_asked_for(shards, tmp_path):
    executor = Patient()
    under_way = PhotonRounds(executor)
    assert [result for _, result in under_way.trace(shards(0, range(4)), 2)] == [0, 1]
    assert executor.asked == [0, 1, 2, 3]
    assert executor.done == [0, 1]
    assert under_way.count_late() == (20, 40.0)
    assert (tmp_path / "view_0").exists()  # late ones read it
    found = list(under_way.trace(shards(1, range(4, 6)), 0))
    assert [result for _, result in found] == [2, 3, 4, 5]
    assert [shard.round for shard, _ in found] == [0, 0, 1, 1]
    assert executor.asked == [0, 1, 2, 3, 4, 5]
    assert under_way.count_late() == (0, 0.0)
    assert not list(tmp_path.glob("view_*"))


def test_late_shards_are_given_out_when_the_others_are_nearly_done(shards):
    """Sooner, whoever waits for the others would do them meanwhile, and nothing would be left for the time after."""
    executor = Patient()
    results = PhotonRounds(executor).trace(shards(0, range(6)), 2)
    asked = [len(executor.asked) for _ in results]
    assert asked == [4, 4, 6, 6]


def test_what_nobody_wants_any_more_is_not_begun(shards, tmp_path):
    executor = Patient()
    under_way = PhotonRounds(executor)
    list(under_way.trace(shards(0, range(4)), 2))
    under_way.drop()
    assert executor.done == [0, 1]
    assert under_way.count_late() == (0, 0.0)
    assert not list(tmp_path.glob("view_*"))
    under_way.drop()


@pytest.fixture
def small_shards(monkeypatch):
    monkeypatch.setattr(rounds, "SHARD_PHOTONS", 1 << 13)


class Counter(executors.InlineExecutor):
    def __init__(self):
        super().__init__()
        self.photons = 0

    def submit(self, fn, /, *args, **kwargs):
        self.photons += getattr(args[0], "photons", 0)
        return super().submit(fn, *args, **kwargs)


def test_every_photon_of_a_bake_is_read_once(small_shards, tmp_path):
    counter = Counter()
    solver = make_solver(tmp_path, lamp_scene(), SETTINGS, counter)
    late = []
    solver.watch = lambda light: late.append(solver.rounds.count_late()[0])
    light = solver.run(lambda message: None, lambda: False)
    assert max(late) > 0
    assert light.photons == counter.photons == SETTINGS.max_photons
    assert [solver.tally.photons.sum(), solver.square_tally.photons.sum()] == pytest.approx([light.ledger.told] * 2, rel=1e-12)
    assert not list(tmp_path.glob("view_*"))


def test_photons_under_way_when_a_bake_stops_are_told_by_nothing(small_shards, tmp_path):
    counter = Counter()
    solver = make_solver(tmp_path, lamp_scene(), SETTINGS, counter)
    late = []
    solver.watch = lambda light: late.append(solver.rounds.count_late()[0])
    light = solver.run(lambda message: None, lambda: any(late))
    assert light.stopped_by == "interrupted"
    assert light.photons < counter.photons
    assert light.ledger.told == pytest.approx(solver.tally.photons.sum(), rel=1e-12)
    assert not list(tmp_path.glob("view_*"))


def test_no_photon_is_traced_in_vain_where_the_round_was_likely_to_be_the_last(small_shards, tmp_path):
    """To an error that is come to in a round that was to be enough: others end by luck, with shards under way."""
    counter = Counter()
    solver = make_solver(tmp_path, lamp_scene(), replace(SETTINGS, error=0.07, max_photons=10**7, direct="photons"), counter)
    late = []
    solver.watch = lambda light: late.append(solver.rounds.count_late()[0])
    light = solver.run(lambda message: None, lambda: False)
    assert light.stopped_by == "error"
    assert max(late) > 0
    assert light.photons == counter.photons


@pytest.mark.parametrize("direct", ["photons", "rays"])
def test_two_workers_give_the_bytes_of_one(small_shards, tmp_path, direct):
    settings = replace(SETTINGS, direct=direct)
    alone = solve_scene(tmp_path / "1", lamp_scene(), settings)
    with executors.make_executor(2) as two:
        assert solution_bytes(solve_scene(tmp_path / "2", lamp_scene(), settings, two)) == solution_bytes(alone)
