"""Fixtures that several test files use."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest


@pytest.fixture
def open_image_io(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenImageIO lies inside the bpy package; bpy itself is not imported."""
    if importlib.util.find_spec("OpenImageIO"):
        return
    bpy = importlib.util.find_spec("bpy")
    folders = [Path(folder) for folder in (bpy.submodule_search_locations or [])] if bpy else []
    found = [site for folder in folders for site in folder.glob("*/python/lib/**/site-packages") if (site / "OpenImageIO").is_dir()]
    if not found:
        pytest.skip("no OpenImageIO here")
    monkeypatch.syspath_prepend(str(found[0]))
    sys.path.append(sys.path.pop(0))  # last: its numpy is not ours
