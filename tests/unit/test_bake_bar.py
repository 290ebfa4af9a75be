"""The bar of a bake, from the messages of its stages."""

import math

import pytest
from leaflight.addon.app.bake_bar import Bar
from leaflight.core.util.messages import Progress, Status


def progress(fraction, left=12.0, error=0.1):
    return Progress(fraction, 1_500_000, 1e6, error, left, 100)


def hear(bar, *messages):
    """The bar after each message."""
    found = []
    for message in messages:
        (bar.hear_status if isinstance(message, Status) else bar.hear_progress)(message)
        found.append(bar.fraction)
    return found


def test_every_stage_moves_the_bar_forward():
    stages = [
        *(Status(stage, stage, share) for stage in ("read", "load", "charts", "texels", "scene", "contacts") for share in (0.0, 0.5, 1.0)),
        Status("photons", "Tracing photons"),  # the first round, before direct light
        Status("direct", "Direct light"),
        Status("direct", "Direct light, 50%", 0.5),
        Status("photons", "Tracing photons"),
        progress(0.006, error=math.nan),
        progress(0.5),
        progress(0.3),  # a later round knows better
        progress(1.0),
        Status("write", "Writing images"),
        Status("keep", "Keeping the state"),
    ]
    bars = hear(Bar(), *stages)
    assert bars == sorted(bars)
    assert bars[-1] < 1.0
    assert bars[len(bars) // 2] < 0.25, "else the bar would wait for the light nearly full"


def test_a_time_is_told_once_two_rounds_agree():
    bar = Bar()
    hear(bar, progress(0.01, left=61.0, error=math.nan))
    assert bar.predict_seconds() == 0.0
    hear(bar, progress(0.1, left=60.0))
    assert bar.predict_seconds() == 0.0, "one prediction is not to be trusted"
    hear(bar, progress(0.4, left=10.0))
    assert bar.predict_seconds() == 0.0, "they contradict each other"
    hear(bar, progress(0.6, left=8.0))
    assert bar.predict_seconds() == pytest.approx(8.0, abs=1.0)
    hear(bar, Status("photons", "Indirect light", 0.5))
    assert bar.predict_seconds() == 0.0, "rays are no photons"
