"""Fixtures and options that several test files use."""

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from claims import Claim, hold_claim, read_claims, save_claims, write_claims
from image_io_path import find_image_io

HELD = pytest.StashKey[dict[int, list[Claim]]]()  # by the place of the test among all


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--claims", type=Path, metavar="FILE.json", help="run the tests that hold claims, and all slow ones, and write the claims"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.stash[HELD] = {}


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Function]) -> None:
    if config.getoption("claims"):
        chosen = [item for item in items if "hold" in item.fixturenames or item.get_closest_marker("slow")]
        config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
        items[:] = chosen


def pytest_sessionfinish(session: pytest.Session) -> None:
    path, held = session.config.getoption("claims"), session.config.stash[HELD]
    if hasattr(session.config, "workeroutput"):  # one of pytest-xdist's processes: it hands them to the one that writes
        session.config.workeroutput["held"] = {place: write_claims(claims) for place, claims in held.items()}
    elif path:
        failed = Claim("tests: those of these claims, and slow ones, that fail", session.testsfailed, high=0)
        save_claims([*(claim for place in sorted(held) for claim in held[place]), failed], path)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Takes over what a process of pytest-xdist held, if it came to its end."""
    held = getattr(node, "workeroutput", {}).get("held", {})
    node.config.stash[HELD].update({place: read_claims(text) for place, text in held.items()})


@pytest.fixture(name="hold")
def fixture_hold(request: pytest.FixtureRequest) -> Callable[..., None]:
    """hold(name, measured, low=, high=, unit=, points=) asserts a Claim, whose case is the test's parameters."""
    case = request.node.callspec.id if hasattr(request.node, "callspec") else ""
    held = request.config.stash[HELD].setdefault(request.session.items.index(request.node), [])

    def hold(name: str, measured: float, **bounds: object) -> None:
        hold_claim(held, Claim(name, float(measured), **{"case": case, **bounds}))

    return hold


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands still until the test sets it: [seconds]."""
    now = [1000.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


@pytest.fixture
def part_entries(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """part_entries(count) gives threads so many texel entries at a time from then on."""

    def part(count: int) -> None:
        def split(total: int, within: slice | None = None) -> list[slice]:
            low, high = (within.start, within.stop) if within else (0, total)
            first = low - low % count
            return [slice(max(at, low) - low, min(at + count, high) - low) for at in range(first, max(high, first + 1), count)]

        monkeypatch.setattr("leaflight.core.util.threads.split_entries", split)

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
