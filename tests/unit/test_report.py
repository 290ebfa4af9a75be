"""What a bake tells of its objects, and of its memory."""

from types import SimpleNamespace

import numpy as np
from leaflight.core import report


def test_each_object_that_takes_light_has_a_row():
    things = [SimpleNamespace(name=name, receives=receives) for name, receives in (("Floor", True), ("Lamp", False), ("Box", True))]
    atlas = SimpleNamespace(object_page=np.array([0, -1, 1]), chart_object=np.array([0, 2, 2]))
    rows = report.list_objects(SimpleNamespace(objects=things), atlas, np.array([0, 0, 0, 2]), {0: 0.25})
    assert rows == [
        {"name": "Floor", "page": 0, "texels": 3, "charts": 1, "estimated_error": 0.25},
        {"name": "Box", "page": 1, "texels": 1, "charts": 2, "estimated_error": None},
    ]


def test_peak_memory_is_in_megabytes():
    found = report.measure_memory_mb()
    assert not found or 20 < found["core"] < 100_000
