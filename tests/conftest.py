"""Fixtures that several test files use."""

from __future__ import annotations

import importlib.util
import sys

import pytest
from image_io_path import find_image_io


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
