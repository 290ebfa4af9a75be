"""Adaptive allocation of rays from texels to where they reduce the error by more than further photons would."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..filter.error_estimate import StatedError
from ..texels.error_metric import BEST_TEXELS
from ..transport.rounds import SPARE
from ..util.ablation import uses
from ..util.messages import Message
from .direct_field import DirectField
from .gathered import GatheredField

Tell: TypeAlias = Callable[[Message], None]
Stop: TypeAlias = Callable[[], bool]
# Sends rays from texels; its arguments receive progress and request a stop.
SamplingStep: TypeAlias = Callable[[Tell, Stop], object]

DIRECT_SHARE = 0.5  # direct light by rays may contribute this share of the requested error
# Size of a batch relative to all earlier estimates, if enough texels need more. The error is stated after each batch, which takes about as
# long as a pass of rays over all texels. Batches that grow geometrically are few, and overshoot by this share at most.
_GROWTH = 0.5


def choose_texels(
    error: float, stated: StatedError, traced: int, direct: DirectField, gathered: GatheredField | None
) -> tuple[DirectField, NDArray[np.intp], int] | None:
    """Return the field whose rays reduce the error most, the texels (m,) that need more of them, and how many estimates each gets.

    Returns None where photons reduce the error as much per ray, or where no texel needs rays. Squared errors fall as 1 / rays, and light
    must be gathered anew after more photons. As many texels are chosen as will probably reach the requested error, or fill a batch
    (_GROWTH).

    error    requested relative error
    traced   number of rays that photons took
    """
    again = gathered.counters["rays"] if gathered else 0
    by_photons = (stated.relative**2 - stated.direct**2 - stated.gathered**2) / max(traced + again, 1)
    most = (DIRECT_SHARE * error) ** 2
    kinds = [(stated.direct**2, direct, stated.texel_direct2)]
    kinds += [(stated.gathered**2, gathered, stated.texel_gathered2)] if gathered and stated.texel_gathered2 else []
    is_open = None  # texels of parts above the requested error; None stands for all texels
    if stated.parts.of_entry is not None:
        is_open = stated.parts.spread(stated.of_parts > error, slice(None), False)
    share = 1.0 if is_open is None else float(is_open.mean())  # of the rays, for these texels
    gains = [error2 / max(share * rays.counters["rays"], 1.0) if error2 > most else 0.0 for error2, rays, _ in kinds]
    if max(gains) <= by_photons:
        return None
    own2, rays, texel2 = kinds[int(np.argmax(gains))]
    error2 = rays.share_error(texel2())
    if is_open is not None:
        error2[~is_open] = 0.0
    worst = np.flatnonzero((error2 > most) & (rays.passes < rays.most_passes))
    least = int(_GROWTH * rays.passes.sum(dtype=np.int64)) if uses("batches") else 0
    left2 = (error**2 - (stated.relative**2 - own2)) / SPARE
    if most < left2 < own2:  # otherwise another error term dominates, and every texel is sampled to its own tolerance
        worst = _find_enough(error2, worst, rays.passes[worst], 1.0 - left2 / own2, least)
    if not len(worst):
        return None
    # Where the same few texels need more rays again, their number of estimates doubles, within the size of a batch.
    repeats = min(least // len(worst), int(np.median(rays.passes[worst])))
    return rays, worst, max(repeats, 1)


def _find_enough(
    error2: NDArray[np.float32], worst: NDArray[np.intp], passes: NDArray[np.int16], share: float, least: int
) -> NDArray[np.intp]:
    """Choose the fewest texels whose next estimate reduces the mean squared error by a given share: the texels of largest error.

    error2   (n,): squared errors of all texels
    worst    (m,) candidates, ascending, as is the result
    passes   (m,): number of estimates in each candidate's mean
    least    choose at least this many, if there are as many candidates
    """
    counted = np.minimum(error2, np.quantile(error2, BEST_TEXELS))  # as in StatedError, which leaves out the worst texels
    gain = counted[worst] / (passes + 1)
    order = np.argsort(-error2[worst], kind="stable")
    wanted = share * counted.sum(dtype=np.float64)
    count = int(np.searchsorted(np.cumsum(gain[order], dtype=np.float64), wanted)) + 1
    return np.sort(worst[order[: max(count, least)]])


def run_step(step: SamplingStep, tell: Tell, should_stop: Stop, following: Message) -> None:
    """Send rays by `step`; if it reported progress, report `following` afterwards."""
    heard: list[Message] = []

    def tell_of(message: Message) -> None:
        heard.append(message)
        tell(message)

    step(tell_of, should_stop)
    if heard:
        tell(following)
