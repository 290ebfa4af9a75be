"""Fixtures and options that several test files use."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from claims import Claim, hold_claim, save_claims
from image_io_path import find_image_io

HELD = pytest.StashKey[list[Claim]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--claims", type=Path, metavar="FILE.json", help="run the tests that hold claims, and all slow ones, and write the claims"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.stash[HELD] = []


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Function]) -> None:
    if config.getoption("claims"):
        chosen = [item for item in items if "hold" in item.fixturenames or item.get_closest_marker("slow")]
        config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
        items[:] = chosen


def pytest_sessionfinish(session: pytest.Session) -> None:
    path = session.config.getoption("claims")
    if path:
        failed = Claim("tests: those of these claims, and slow ones, that fail", session.testsfailed, high=0)
        save_claims([*session.config.stash[HELD], failed], path)


@pytest.fixture(name="hold")
def fixture_hold(request: pytest.FixtureRequest) -> Callable[..., None]:
    """hold(name, measured, low=, high=, unit=, points=) asserts a Claim, whose case is the test's parameters."""
    case = request.node.callspec.id if hasattr(request.node, "callspec") else ""

    def hold(name: str, measured: float, **bounds: object) -> None:
        hold_claim(request.config.stash[HELD], Claim(name, float(measured), **{"case": case, **bounds}))

    return hold


@pytest.fixture
def scene_name(request: pytest.FixtureRequest) -> str:
    """Of the scene that the fixture `known` bakes, the first of its parameters."""
    return str(request.node.callspec.params["known"][0])


@pytest.fixture
def part_entries(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """part_entries(count) gives threads so many texel entries at a time from then on."""

    def part(count: int) -> None:
        monkeypatch.setattr("leaflight.core.threads._LEAST", count)
        monkeypatch.setattr("leaflight.core.threads._MOST", count)

    return part


@pytest.fixture
def open_image_io(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenImageIO lies inside the bpy package; bpy itself is not imported."""
    if importlib.util.find_spec("OpenImageIO"):
        return
    found = find_image_io()
    if found is None:
        pytest.skip("no OpenImageIO here")
    monkeypatch.syspath_prepend(str(found))
    sys.path.append(sys.path.pop(0))  # last: its numpy is not ours
