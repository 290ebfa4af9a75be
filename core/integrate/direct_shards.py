"""How direct light is asked for: in shards of texels, each as sure as it must be; the first of them before all else is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..lights.emitters import usable_environment, usable_world
from ..parallel import executors
from ..texels.judged import DARK_FLOOR, choose_sample
from ..transport import traced_scene
from ..util.ablation import uses
from ..util.arrays import IntArray
from ..util.settings import Settings
from . import texel_shards
from .direct import DirectLight

_Shard = TypeVar("_Shard", bound=texel_shards.TexelShard)

# Texels of a shard on a small page, and on a large one. In shards of two thirds of the one numpy's calls take a seventh of the time more;
# more than the other are not lit together, see direct_points.
SHARD_TEXELS, _LARGEST_SHARD = 6 << 10, 1 << 15
_SHARDS_ENOUGH = 32  # that no worker waits long for another's last
# Of the error asked for: its noise is averaged over neighbours, at less cost than more rays. Twice as much where that error is loose, 5 %,
# takes 5 to 10 % less time at 1024^2, but what it blurs among many lamps is not all stated: 4.4 for a real 5.0 % (furnished_room).
TOLERANCE = 0.5
_GLANCE_TEXELS, _GLANCE_TOLERANCE = 256, 1.0  # that tell how bright all will be, before there is any light, and how sure each is
# One of so many shards is sent ahead, while trees are grown and the first photons read. As nobody knows yet what else will be seen there,
# its shadows are made as sure as if there were nothing, which takes more rays (of `instances` at 256^2 6 % more in all): so only few are,
# and no more than these, for who waits for them is deaf to a stop.
_AHEAD, _MOST_AHEAD = 10, 3


def cut_into_shards(count: int) -> list[int]:
    """Where shards of so many texels begin, and the last one ends: all of a size, and of few as many for each of two workers.

    Not by how many workers there are: the same seed gives the same bytes.
    """
    if not count:
        return [0]
    size = min(max(count // _SHARDS_ENOUGH, SHARD_TEXELS), _LARGEST_SHARD)
    n_shard = max(2 * round(count / (2 * size)), math.ceil(count / _LARGEST_SHARD))
    return [count * i // n_shard for i in range(n_shard + 1)]


def list_shards(whole: _Shard) -> list[_Shard]:
    """Those of a shard of all texels, in the order in which they are sent: the last charts are often those of many small things, which take
    longest; first, the others are shared out evenly after them.
    """
    texels = whole.texels
    return [replace(whole, start=start, texels=texels[start:end]) for start, end in pairwise(cut_into_shards(len(texels)))][::-1]


def ask_for_direct(folder: Path, settings: Settings, turn: int, texels: IntArray | range) -> texel_shards.DirectShard:
    """A shard of these texels (m,), ascending; what is seen with their light is not known yet."""
    smoothed = settings.denoise and uses("filter_tolerance")
    return texel_shards.DirectShard(str(folder), settings.seed, turn, 0, texels, TOLERANCE * settings.error, smoothed)


def find_dark(settings: Settings, brightness: float) -> float:
    """DirectShard.dark, where all texels show so much light in the mean, W/m^2."""
    return brightness * (DARK_FLOOR**2 if settings.error_of == "objects" else DARK_FLOOR)


def is_below_sky(folder: str) -> bool:
    """Whether there is a sky, of which alone somebody asks how bright all is."""
    snapshot = traced_scene.open_tracing(folder).snapshot
    return uses("dark_level") and (bool(usable_world(snapshot).any()) or usable_environment(snapshot) is not None)


def glance(shard: texel_shards.DirectShard) -> float:
    """Mean direct light, W/m^2, of a few of all texels, before there is any; tells of whose scene, and with what seed, `shard` does."""
    texels = traced_scene.open_tracing(shard.tracing).texels
    some = choose_sample(texels)
    few = some[:: max(len(some) // _GLANCE_TEXELS, 1)]
    found = texel_shards.light_texels(replace(shard, start=len(texels), texels=few, tolerance=_GLANCE_TOLERANCE))
    return float(found.irradiance_rgb.mean(dtype=np.float64))


@dataclass(frozen=True)
class ShotAhead:
    """The first shards of a shot of all texels, which one of the processes that have nothing else to do has begun, if there is one.

    count   how many they are; not by how many workers there are, lest the same seed give other bytes
    wait    gives their light; where nobody has begun them, whoever asks does
    """

    count: int = 0
    wait: Callable[[], list[DirectLight]] = list

    @classmethod
    def send(cls, folder: Path, settings: Settings, executor: Executor, n_texel: int) -> ShotAhead:
        """Arguments as of DirectField.shoot."""
        if not uses("rays_ahead"):
            return cls()
        shards = list_shards(ask_for_direct(folder, settings, 0, range(n_texel)))
        first = shards[: min(round(len(shards) / _AHEAD), _MOST_AHEAD)]
        return cls(len(first), executors.set_apart(executor, partial(_light_ahead, first, settings))) if first else cls()


NOTHING_AHEAD = ShotAhead()


def _light_ahead(shards: list[texel_shards.DirectShard], settings: Settings) -> list[DirectLight]:
    dark = find_dark(settings, glance(shards[0])) if is_below_sky(shards[0].tracing) else 0.0
    return [texel_shards.light_texels(replace(shard, dark=dark)) for shard in shards]
