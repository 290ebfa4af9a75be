"""Search for contacts by all processes of a machine, each with whole charts, since no contact spans two charts."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..parallel import shared_arrays
from ..parallel.executors import ShardExecutor
from ..parallel.folders import TEXELS_FOLDER
from ..texels.texel_map import TexelMap
from ..util.arrays import Int64
from ..util.progress import Watch, unwatched
from .contact_map import LOOKING, ContactMap, find_contacts, find_in_charts
from .traced_scene import TracedScene

_LEAST = 1 << 14  # entries of a part; with fewer, opening the scene and returning the result take nearly as long as the search
_MOST = 1 << 20  # entries of a part; a cancelled bake stops between parts
_MOST_UNEVEN = 0.75  # share of the largest part; where one chart has nearly all entries, threads divide it instead
_FOUND = 0.7  # progress within LOOKING when find_contacts ends


def search_contacts(
    folder: Path, opened: TracedScene, texels: TexelMap, executor: ShardExecutor, threads: int, watch: Watch = unwatched
) -> ContactMap:
    """As contact_map.find_contacts, by several processes; the result is the same for any number of them. Uses threads only where there is
    little to do or no other process is idle.

    folder    of traced_scene.open_scene; the map is saved there for the other processes and must be saved anew once it is cut
    threads   number of threads where one process does all
    """
    first, *others = split_at_charts(texels.chart_start, executor.idle)
    if not others:
        return find_contacts(opened, texels, threads, watch)
    shared_arrays.save_struct(folder / TEXELS_FOLDER, texels)
    found = executor.spread(find_in_charts, ((str(folder), part.start, part.stop) for part in others))
    own_share = first.stop / len(texels)
    own = find_contacts(opened, texels, 1, lambda said, share, about: watch(said, own_share * share, about), first)

    def report_each() -> Iterator[ContactMap]:
        for part, one in zip(others, found, strict=True):
            yield one
            watch(LOOKING, _FOUND * part.stop / len(texels), "")

    return ContactMap.join([own, *report_each()])


def split_at_charts(chart_start: Int64, processes: int) -> list[slice]:
    """Ranges of entries of about equal size that end between charts; a single range where more would not pay.

    chart_start   (n_chart + 1,) int64, as in TexelMap
    """
    count = int(chart_start[-1])
    parts = min(processes * max(-(-count // (processes * _MOST)), 1), count // _LEAST)
    if processes == 1 or parts < 2:
        return [slice(0, count)]
    even = np.arange(1, parts) * count // parts
    after = np.searchsorted(chart_start, even)
    low, high = chart_start[after - 1], chart_start[after]
    ends = np.unique([0, *np.where(high - even <= even - low, high, low).tolist(), count])
    if np.diff(ends).max() > _MOST_UNEVEN * count:
        return [slice(0, count)]
    return [slice(*part) for part in pairwise(ends.tolist())]
