"""Photons of the first rounds, traced by idle processes while charts and texels are made.

Tracing needs only the scene, since hits are found on pages later. The result is the same to the byte as without tracing ahead.
"""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..parallel.executors import ShardExecutor
from ..transport import rounds
from ..util.ablation import uses
from ..util.settings import Settings
from .photon_shards import PhotonShard, trace_ahead

_HITS_FOLDER = "hits"  # followed by the numbers of the round and the shard


@dataclass(frozen=True)
class FirstPhotons:
    """sent   shards that are traced ahead, by (round, number), each with a future whose result is True if its hits were kept"""

    sent: dict[tuple[int, int], tuple[PhotonShard, Future[bool]]] = field(default_factory=dict)

    @classmethod
    def send(cls, folder: Path, settings: Settings, executor: ShardExecutor) -> FirstPhotons:
        """Send the shards that the first rounds have in any case. None are sent if there are no other processes, or if they run on other
        machines.

        folder   of traced_scene.open_scene
        """
        if not uses("photons_ahead"):
            return cls()
        if not executor.is_awake:  # starting processes now would delay the charts
            return cls()
        first, second = (rounds.count_ahead(round_, settings.direct == "rays") for round_ in (0, 1))
        photons = [min(first, settings.max_photons)]
        if second and settings.max_photons >= rounds.MOST_FIRST_PHOTONS + second:
            photons.append(second)
        shards = [
            replace(shard, hits=str(folder / f"{_HITS_FOLDER}_{round_}_{shard.shard}"))
            for round_, of_round in enumerate(photons)
            for shard in PhotonShard.of_round(folder, settings, round_, rounds.share_photons(of_round), view="", degree=0)
        ]
        return cls({(shard.round, shard.shard): (shard, executor.submit(trace_ahead, shard)) for shard in shards})

    def take(self, shard: PhotonShard) -> PhotonShard:
        """The shard with the folder of its hits, waiting for them; unchanged if it was not traced ahead."""
        ahead, traced = self.sent.get((shard.round, shard.shard), (None, None))
        if ahead is None or traced is None or shard.photons != ahead.photons:
            return shard
        return replace(shard, hits=ahead.hits) if traced.result() else shard
