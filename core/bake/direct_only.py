"""A bake without photons: direct light by shadow rays up to the requested error, or no light at all."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..filter import error_estimate
from ..integrate.direct_field import DirectField
from ..integrate.light_field import LightField
from ..parallel.executors import ShardExecutor
from ..radiosity import quadtree, tally
from ..texels.error_metric import ErrorMetric
from ..texels.texel_map import TexelMap
from ..transport.energy_audit import Ledger
from ..util.arrays import IntArray
from ..util.messages import Message
from ..util.settings import Settings
from .deadline import Deadline
from .stop_rules import StopRules

_DEGREE = 0  # basis degree of the empty leaves


def settle_direct(
    folder: Path,
    texels: TexelMap,
    tri_object: IntArray,
    settings: Settings,
    executor: ShardExecutor,
    direct: DirectField,
    tell: Callable[[Message], None],
    should_stop: Callable[[], bool],
    deadline: Deadline | None = None,
) -> LightField:
    """The light of a bake without photons. Shadow rays were sent from all texels once; texels of large error send more.

    direct       direct light so far; empty if no light is wanted
    tri_object   (n_tri,) int: the object of each triangle
    """
    metric = ErrorMetric.of(settings.error_of, texels, tri_object)
    rules = StopRules(settings, should_stop, time.monotonic(), deadline)
    tree = quadtree.plant_trees(texels, _DEGREE, 0, settings.finest_texels, flat=False)
    totals = tally.accumulate(tree, tally.Tally.empty(len(tree), _DEGREE))
    while True:
        looked = time.monotonic()
        shown = direct.show(texels, settings.denoise, executor.spread)
        stated = error_estimate.state_error(metric, shown, error_estimate.PhotonLight.none())
        if deadline:
            deadline.note_light(time.monotonic() - looked)
        worst = _find_worst(direct, stated.texel_direct2(), settings.error)
        stopped_by = "error" if stated.relative <= settings.error else "" if len(worst) else "max_rays"
        if should_stop():
            stopped_by = "interrupted"
        elif not stopped_by and rules.is_late():
            stopped_by = "time_limit"
        if stopped_by:
            break
        direct.shoot(folder, settings, executor, worst, tell, rules.break_off)
    return LightField(
        tree=tree,
        solution=tally.solve_tallies(tree, totals),
        leaves=np.arange(len(tree)),
        received=totals.received,
        direct=direct,
        error=stated.relative,
        photons=0,
        rounds=0,
        stopped_by=stopped_by,
        ledger=Ledger(),
        object_error=stated.of_objects(),
    )


def _find_worst(direct: DirectField, error2: NDArray[np.float32], error: float) -> NDArray[np.intp]:
    """Texels (m,), ascending, to sample again: those that exceed the error, shared between neighbours below openings; if there are none,
    those whose own error exceeds it.

    If no texel exceeds the error but the bake does, by the blur of the filter, the noisiest texels: the blur shrinks with the noise.

    error2   (n,): relative, squared
    """
    shared = direct.share_error(error2)
    asked = [found > error**2 for found in (shared, error2)]
    if not any(of.any() for of in asked):
        asked = [shared > shared.mean(dtype=np.float64)]
    for of in asked:
        worst = np.flatnonzero(of & (direct.passes < direct.most_passes))
        if len(worst):
            break
    return worst
