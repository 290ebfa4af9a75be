"""Photons of a round, traced by workers; the last shards of a large round are traced while the round is evaluated.

Evaluating a round keeps one process busy while the workers would be idle. So the last shards of a large round overlap with it, and their
sums are added to the next round. Which shards these are depends on the round alone, so the same seed gives the same bytes for any number of
workers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from pathlib import Path

from ..parallel import shared_arrays
from ..radiosity.quadtree import Quadtree, TreeView
from . import photon_shards
from .photon_shards import PhotonResult, PhotonShard

_NEARLY_DONE = 2  # shards without a result when the late ones are submitted


@dataclass
class PhotonRounds:
    """Shards under way.

    late      late shards of the last round, with their future results; all have one view
    dropped   shards that were late when the bake stopped; a continued bake sends them again, so it equals one that did not stop
    """

    executor: Executor
    late: list[tuple[PhotonShard, Future[PhotonResult]]] = field(default_factory=list)
    dropped: list[PhotonShard] = field(default_factory=list)

    def count_late(self) -> int:
        """Number of photons of the late shards."""
        return sum(shard.photons for shard, _ in self.late)

    def trace(self, shards: Sequence[PhotonShard], n_late: int) -> Iterator[tuple[PhotonShard, PhotonResult]]:
        """Results of the previous round's late shards, then of these shards without the last `n_late`. Views are removed after use."""
        first, last = shards[: len(shards) - n_late], shards[len(shards) - n_late :]
        before, self.late = self.late, []
        results = self.executor.map(photon_shards.trace_photons, first)
        try:
            for shard, late in before:
                yield shard, late.result()
            _remove_views([shard for shard, _ in before])
            for left, shard in zip(range(len(first), 0, -1), first, strict=True):
                if left == _NEARLY_DONE:  # sent earlier, this process would run them while it waits for the others
                    self.send(last)
                yield shard, next(results)
        finally:
            if not self.late:
                _remove_views(shards)

    def send(self, late: Sequence[PhotonShard]) -> None:
        """Send late shards, which have one view; the next round receives their results."""
        self.late = [(shard, self.executor.submit(photon_shards.trace_photons, shard)) for shard in late]

    def drop(self) -> None:
        """Abandon the late shards; their workers may then find the view removed."""
        for _, late in self.late:
            late.cancel()
        self.dropped, self.late = [shard for shard, _ in self.late], []
        _remove_views(self.dropped)


def save_view(folder: Path, tree: Quadtree, n_texel: int) -> str:
    """Save the view for the shards of a round, and return the folder; arguments are as for TreeView.of_tree."""
    shared_arrays.save_struct(folder, TreeView.of_tree(tree, n_texel, shared_arrays.Room(folder)))
    return str(folder)


def _remove_views(shards: Sequence[PhotonShard]) -> None:
    for view in {shard.view for shard in shards}:
        shared_arrays.remove_struct(Path(view))
