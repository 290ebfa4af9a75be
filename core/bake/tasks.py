"""Imports all kinds of work that a process of a bake may get, so that processes load them at once."""

from __future__ import annotations

from ..filter import denoise
from ..integrate import texel_shards
from ..parallel import executors
from ..scene import rays
from ..transport import contact_map
from ..util import sampling
from ..util.settings import Settings
from . import photon_shards

_KINDS = contact_map, denoise, photon_shards, texel_shards  # their functions run in other processes


def load_ahead() -> None:
    """Load and build what shards need before there is one; importing this module is part of it."""
    rays.load_ahead()
    sampling.load_ahead()


def open_executor(settings: Settings) -> executors.ShardExecutor:
    """executors.open_executor whose processes load all kinds of work at once."""
    return executors.open_executor(settings, load_ahead)
