"""Where pip's bpy keeps OpenImageIO: inside its own folder, which is not on sys.path."""

import importlib.util
import sys
from pathlib import Path


def find_image_io() -> Path | None:
    """The folder to put on sys.path, last: its numpy is not ours. None where there is none; bpy itself is not imported."""
    bpy = importlib.util.find_spec("bpy")
    folders = [Path(folder) for folder in (bpy.submodule_search_locations or [])] if bpy else []
    found = [site for folder in folders for site in folder.glob("*/python/lib/**/site-packages") if (site / "OpenImageIO").is_dir()]
    return found[0] if found else None


def add_image_io() -> None:
    """Let this process and those it starts import OpenImageIO.

    Raises ImportError with a sentence where it is nowhere.
    """
    if importlib.util.find_spec("OpenImageIO"):
        return
    found = find_image_io()
    if found is None:
        raise ImportError("OpenImageIO is not here: install bpy, which brings it along")
    sys.path.append(str(found))
