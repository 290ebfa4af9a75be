"""Folders of a bake that a process reads once and keeps open, mapped into memory, so that all processes share one copy.

A shard of work is a pure function of (folders, settings, round, shard): it names its folders and the process that runs it opens them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TypeVar

from ..util.job import SNAPSHOT_FILE

T = TypeVar("T")

TEXELS_FOLDER = "texels"
# A shard's fields that name folders, and which files of each folder the shard reads, () for all.
FOLDER_PARTS: dict[str, tuple[str, ...]] = {"tracing": (SNAPSHOT_FILE, TEXELS_FOLDER), "view": ()}

_forget_scenes: list[Callable[[], None]] = []  # filled while modules load, by the decorators below
_forget_views: list[Callable[[], None]] = []


def keep_scene_open(read: Callable[[str], T]) -> Callable[[str], T]:
    """Decorator of a function that reads a bake's folder: a process keeps the last one open until forget_folders."""
    cached = lru_cache(maxsize=1)(read)
    _forget_scenes.append(cached.cache_clear)
    return cached


def keep_view_open(read: Callable[[str], T]) -> Callable[[str], T]:
    """The same of a folder that holds for one round only, until forget_views."""
    cached = lru_cache(maxsize=1)(read)
    _forget_views.append(cached.cache_clear)
    return cached


def forget_folders() -> None:
    """Close what this process keeps open, so that folders can be removed or written anew."""
    forget_views()
    for forget in _forget_scenes:
        forget()


def forget_views() -> None:
    """The same of views alone."""
    for forget in _forget_views:
        forget()
