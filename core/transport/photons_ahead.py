"""Files for the results of photons that are traced before the texels are known."""

from __future__ import annotations

from pathlib import Path

from ..parallel import shared_arrays
from .photon_log import ShardHits


def keep_hits(folder: Path, hits: ShardHits) -> None:
    """Write hits to `folder`. Raises OSError if the disk is full."""
    shared_arrays.save_struct(folder, hits)


def fetch_hits(folder: Path) -> ShardHits:
    """Read what keep_hits wrote, and remove the folder."""
    hits = shared_arrays.load_struct(folder, ShardHits)
    shared_arrays.remove_struct(folder)
    return hits
