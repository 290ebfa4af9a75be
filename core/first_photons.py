"""Photons of a first round, traced while charts and texels are still made: until it is asked where on a page they fall, they need only
the scene. Processes that would have nothing to do by then trace them, and the same bytes come of it as without them.
"""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from pathlib import Path

from . import rounds
from .executors import LocalExecutor
from .settings import Settings
from .workers import PhotonShard, trace_ahead

_HITS_FOLDER = "hits"  # and the shard's number


@dataclass(frozen=True)
class FirstPhotons:
    """hits   folders of the first shards' hits, and what is done when they are there"""

    hits: list[tuple[str, Future[None]]] = field(default_factory=list)

    @classmethod
    def send(cls, folder: Path, settings: Settings, executor: Executor) -> FirstPhotons:
        """Has those traced that every first round has; none where this process would do it by itself, or other machines do it.

        folder   of workers.open_scene
        """
        if not isinstance(executor, LocalExecutor) or not executor.is_awake:  # to start them now would keep charts waiting
            return cls()
        shards = [
            PhotonShard(
                tracing=str(folder),
                view="",
                seed=settings.seed,
                round=0,
                shard=number,
                photons=photons,
                max_depth=settings.max_depth,
                degree=0,
                skip_first=settings.direct == "rays",
                hits=str(folder / f"{_HITS_FOLDER}_{number}"),
            )
            for number, photons in enumerate(rounds.share_photons(min(rounds.FIRST_ROUND_PHOTONS, settings.max_photons)))
        ]
        return cls([(shard.hits, executor.submit(trace_ahead, shard)) for shard in shards])

    def take(self, shard: int) -> str:
        """The folder of that shard's hits, once they are there; "" where they were not traced ahead."""
        if shard >= len(self.hits):
            return ""
        place, traced = self.hits[shard]
        traced.result()
        return place
