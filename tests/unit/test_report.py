"""What a bake tells of its objects, and of its memory."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.output import report


def test_each_object_that_takes_light_has_a_row():
    things = [SimpleNamespace(name=name, receives=receives) for name, receives in (("Floor", True), ("Lamp", False), ("Box", True))]
    atlas = SimpleNamespace(object_page=np.array([0, -1, 1]), chart_object=np.array([0, 2, 2]))
    rows = report.list_objects(SimpleNamespace(objects=things), atlas, np.array([0, 0, 0, 2]), {0: 0.25})
    assert rows == [
        {"name": "Floor", "page": 0, "texels": 3, "share": 0.75, "charts": 1, "estimated_error": 0.25},
        {"name": "Box", "page": 1, "texels": 1, "share": 0.25, "charts": 2, "estimated_error": None},
    ]


@pytest.mark.parametrize("gathered", [SimpleNamespace(counters={"rays": 20}), None])
def test_rays_are_those_of_photons_of_gathering_and_of_direct_light(gathered):
    ledger = SimpleNamespace(rays=1, gathered=20, audit_w=dict)
    light = SimpleNamespace(
        direct=SimpleNamespace(counters={"rays": 300}), ledger=ledger, gathered=gathered,
        photons=1, rounds=1, leaves=[7], tree=[7, 8], error=0.1, stopped_by="error",
    )  # fmt: skip
    told = report.describe_light(light)
    assert (told["rays"], told["leaves"], told["nodes"]) == (321, 1, 2)
    assert told["gathered"] == ({"rays": 20} if gathered else {})
    light.direct.counters = {}  # by photons
    assert report.describe_light(light)["rays"] == 21


def test_peak_memory_is_in_megabytes():
    found = report.measure_memory_mb()
    assert not found if sys.platform == "win32" else 20 < found["core"] < 100_000


@pytest.mark.parametrize(("platform", "unit_mb"), [("linux", 1e-3), ("darwin", 1e-6)])
def test_peak_memory_is_told_in_the_units_of_the_system(monkeypatch, platform, unit_mb):
    usage = SimpleNamespace(RUSAGE_SELF=0, RUSAGE_CHILDREN=-1, getrusage=lambda who: SimpleNamespace(ru_maxrss=(5 - who) / unit_mb))
    monkeypatch.setitem(sys.modules, "resource", usage)
    monkeypatch.setattr(report.sys, "platform", platform)
    assert report.measure_memory_mb() == {"core": 5.0, "worker": 6.0}
