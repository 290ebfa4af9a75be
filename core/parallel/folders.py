"""Folders of a bake that a process reads once and keeps open. Their files are mapped into memory, so all processes share one copy.

A shard of work is a pure function of (folders, settings, round, shard): it names its folders, and the process that runs it opens them.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import ParamSpec, TypeVar, cast

from ..util.job import SNAPSHOT_FILE

P = ParamSpec("P")
T = TypeVar("T")

TEXELS_FOLDER = "texels"
# Fields of shards that name folders, and the files that shards read there; () for all.
FOLDER_PARTS: dict[str, tuple[str, ...]] = {"tracing": (SNAPSHOT_FILE, TEXELS_FOLDER), "view": ()}

_forget_scenes: list[Callable[[], None]] = []  # filled while modules load, by the decorators below
_forget_views: list[Callable[[], None]] = []


def keep_scene_open(read: Callable[[str], T]) -> Callable[[str], T]:
    """Decorator for a function that reads a bake's folder: a process keeps the last one open until forget_folders."""
    cached = lru_cache(maxsize=1)(read)
    _forget_scenes.append(cached.cache_clear)
    return cached


def keep_view_open(read: Callable[P, T]) -> Callable[P, T]:
    """Decorator for a function that reads a round's folder: a process keeps the last one open until forget_views."""
    cached = lru_cache(maxsize=1)(read)
    _forget_views.append(cached.cache_clear)
    return cast(Callable[P, T], cached)


def forget_folders() -> None:
    """Close all folders that this process keeps open, so that they can be removed or written anew."""
    forget_views()
    for forget in _forget_scenes:
        forget()


def forget_views() -> None:
    """Close the folders of rounds only."""
    for forget in _forget_views:
        forget()
