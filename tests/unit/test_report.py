"""What a bake tells of its objects, and of its memory."""

import sys
from types import SimpleNamespace

import pytest
from leaflight.core.output import report


def test_peak_memory_is_in_megabytes():
    found = report.measure_memory_mb()
    assert not found if sys.platform == "win32" else 20 < found["core"] < 100_000


@pytest.mark.parametrize(("platform", "unit_mb"), [("linux", 1e-3), ("darwin", 1e-6)])
def test_peak_memory_is_told_in_the_units_of_the_system(monkeypatch, platform, unit_mb):
    usage = SimpleNamespace(RUSAGE_SELF=0, RUSAGE_CHILDREN=-1, getrusage=lambda who: SimpleNamespace(ru_maxrss=(5 - who) / unit_mb))
    monkeypatch.setitem(sys.modules, "resource", usage)
    monkeypatch.setattr(report.sys, "platform", platform)
    assert report.measure_memory_mb() == {"core": 5.0, "worker": 6.0}
