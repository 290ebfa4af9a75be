"""Images of an earlier bake with more pages, which could be mistaken for those of the last one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy

from ..core.earlier_bakes import name_some
from .images import remove_unused_images


def remove_left_over(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Delete those that are certainly ours and that this .blend, which wore them, uses no more; gives what is to be told."""
    left = result.pop("left_over", {"own": [], "doubtful": []})
    if not left["own"]:
        return _tell_doubtful(left["doubtful"])
    remove_unused_images()  # the last bake's, which nothing but an open editor shows
    used = {_spell(path) for path in bpy.utils.blend_paths(absolute=True, packed=True, local=False)}
    removed, kept = [], []
    for path in left["own"]:
        if _spell(path) in used:
            kept.append(path)
            continue
        try:
            Path(path).unlink()
            removed.append(path)
        except OSError:  # write-protected, or open elsewhere
            left["doubtful"].append(path)
    told = []
    if removed:
        told.append(("", f"{_name(removed)}: deleted, for the last bake had more pages than this one"))
    if kept:
        told.append(("", f"{_name(kept)}: no page of this bake, but this file still uses it; remove the image in Blender, then the file"))
    return told + _tell_doubtful(left["doubtful"])


def tell_left_over(result: dict[str, Any]) -> list[tuple[str, str]]:
    """What is to be told of them, of a bake whose images others wear that are not at hand: then nothing is deleted."""
    left = result.pop("left_over", {"own": [], "doubtful": []})
    return _tell_doubtful(left["own"] + left["doubtful"])


def _tell_doubtful(paths: Sequence[str]) -> list[tuple[str, str]]:
    if not paths:
        return []
    return [("", f"{_name(paths)}: no page of this bake, but called like one; if nothing else uses it, delete it")]


def _name(paths: Sequence[str]) -> str:
    return f"{name_some([Path(path).name for path in paths])} in {Path(paths[0]).parent}"


def _spell(path: str) -> str:
    return os.path.normcase(Path(path).resolve())
