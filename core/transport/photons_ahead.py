"""Results of photons that were traced before there were texels, kept in a folder."""

from __future__ import annotations

from pathlib import Path

from ..parallel import shared_arrays
from .photon_log import ShardHits


def keep_hits(folder: Path, hits: ShardHits) -> None:
    """Write them to `folder`. Raises OSError where there is no room."""
    shared_arrays.save_struct(folder, hits)


def fetch_hits(folder: Path) -> ShardHits:
    """Those of keep_hits, once: the folder is removed."""
    hits = shared_arrays.load_struct(folder, ShardHits)
    shared_arrays.remove_struct(folder)
    return hits
