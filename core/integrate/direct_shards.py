"""How direct light is cut into shards of texels, the settings of a shard, and the first shards, which are sent ahead."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

from ..parallel.executors import ShardExecutor
from ..util.ablation import uses
from ..util.arrays import IntArray
from ..util.settings import Settings
from . import texel_shards
from .direct import DirectLight

_Shard = TypeVar("_Shard", bound=texel_shards.TexelShard)

# Number of texels of a shard on a small page, and on a large one. Shards two thirds as large as the former take a seventh more time, in
# numpy's calls; more texels than the latter are never sampled together, see direct_points.
SHARD_TEXELS, _LARGEST_SHARD = 6 << 10, 1 << 15
_SHARDS_ENOUGH = 32  # enough for an even load of the workers
# Tolerance of shadow rays over the requested error: the filter averages the noise over neighbours, which costs less than more rays.
# Measured on one sample and three random scenes, asked for 5 %: 0.5 takes 1.1 times as long, and leaves 0.93 to 1 times the error; 2 takes
# 0.85 to 1 times as long, and leaves 1.0 to 1.07 times the error.
TOLERANCE = 1.0
# One shard in _AHEAD is sent ahead, while trees are grown and the first photons are read; at most _MOST_AHEAD, because a stop request has
# no effect until they are done.
_AHEAD, _MOST_AHEAD = 10, 3


def cut_into_shards(count: int) -> list[int]:
    """Where each shard of `count` texels begins, and where the last ends. Shards are equal; if they are few, their number is even, for two
    workers.

    The cut does not depend on the number of workers, so that the same seed gives the same bytes.
    """
    if not count:
        return [0]
    size = min(max(count // _SHARDS_ENOUGH, SHARD_TEXELS), _LARGEST_SHARD)
    n_shard = max(2 * round(count / (2 * size)), math.ceil(count / _LARGEST_SHARD))
    return [count * i // n_shard for i in range(n_shard + 1)]


def list_shards(whole: _Shard) -> list[_Shard]:
    """Cut `whole` into shards, in the order of sending: the last charts first, because they often hold many small objects, which take
    longest; the others then even out the load.
    """
    texels = whole.texels
    return [replace(whole, start=start, texels=texels[start:end]) for start, end in pairwise(cut_into_shards(len(texels)))][::-1]


def ask_for_direct(folder: Path, settings: Settings, turn: int, texels: IntArray | range) -> texel_shards.DirectShard:
    """One shard of all of these texels (m,), ascending."""
    return texel_shards.DirectShard(str(folder), settings.seed, turn, 0, texels, TOLERANCE * settings.error)


@dataclass(frozen=True)
class ShotAhead:
    """The first shards of a shot at all texels, computed by an idle process if there is one.

    count   number of shards; independent of the number of workers, so that the same seed gives the same bytes
    wait    returns the light of each shard; computes them in this process if no other has begun them
    """

    count: int = 0
    wait: Callable[[], list[DirectLight]] = list

    @classmethod
    def send(cls, folder: Path, settings: Settings, executor: ShardExecutor, n_texel: int) -> ShotAhead:
        """Send the shards; arguments as in DirectField.shoot."""
        if not uses("rays_ahead"):
            return cls()
        shards = list_shards(ask_for_direct(folder, settings, 0, range(n_texel)))
        first = shards[: min(round(len(shards) / _AHEAD), _MOST_AHEAD)]
        return cls(len(first), executor.set_apart(partial(_light_ahead, first))) if first else cls()


NOTHING_AHEAD = ShotAhead()


def _light_ahead(shards: list[texel_shards.DirectShard]) -> list[DirectLight]:
    return [texel_shards.light_texels(shard) for shard in shards]
