"""Shards that are traced while a round is looked at: none is lost or read twice, and none is waited for in vain."""

from dataclasses import replace

import pytest
from boxes import lamp_scene, make_solver
from leaflight.core.parallel import executors
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, padding=1, max_photons=5_000_000, error=1e-4, direct="photons")  # so many that a round ends with late shards


class Counter(executors.InlineExecutor):
    def __init__(self):
        super().__init__()
        self.photons = 0

    def submit(self, fn, /, *args, **kwargs):
        self.photons += getattr(args[0], "photons", 0)
        return super().submit(fn, *args, **kwargs)


def test_every_photon_of_a_bake_is_read_once(tmp_path):
    counter = Counter()
    solver = make_solver(tmp_path, lamp_scene(), SETTINGS, counter)
    late = []
    solver.watch = lambda light: late.append(solver.rounds.count_late())
    light = solver.run(lambda message: None, lambda: False)
    assert max(late) > 0
    assert light.photons == counter.photons == SETTINGS.max_photons
    assert solver.tally.photons.sum() == pytest.approx(light.photons, rel=1e-12)
    assert not list(tmp_path.glob("view_*"))


def test_photons_under_way_when_a_bake_stops_are_told_by_nothing(tmp_path):
    counter = Counter()
    solver = make_solver(tmp_path, lamp_scene(), replace(SETTINGS, max_photons=20_000_000), counter)
    late = []
    solver.watch = lambda light: late.append(solver.rounds.count_late())
    light = solver.run(lambda message: None, lambda: any(late))
    assert light.stopped_by == "interrupted"
    assert light.photons < counter.photons
    assert light.photons == pytest.approx(solver.tally.photons.sum(), rel=1e-12)
    assert not list(tmp_path.glob("view_*"))
