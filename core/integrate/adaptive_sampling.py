"""Adaptive allocation of rays from texels, where they reduce the error by more than further photons."""

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
Look: TypeAlias = Callable[[Tell, Stop], object]

DIRECT_SHARE = 0.5  # of the requested error, that direct light by rays may contribute
# Estimates of a batch over all earlier ones, if enough texels need more: the error is stated after each batch, which takes about as long as
# a pass of rays over all texels. Batches that grow geometrically are few, and overshoot by this share at most.
_GROWTH = 0.5


def choose_texels(
    error: float, stated: StatedError, traced: int, direct: DirectField, gathered: GatheredField | None
) -> tuple[DirectField, NDArray[np.intp], int] | None:
    """The field whose rays reduce the error most, the texels (m,) that need more of them, and how many estimates each gets.

    None where photons reduce it as much per ray, or no texel needs rays. Squared errors fall as 1 / rays, and gathered light must be
    gathered anew after more photons. The texels are as many as probably reach the requested error, or as fill a batch (_GROWTH).

    error    relative, requested
    traced   rays of photons
    """
    again = gathered.counters["rays"] if gathered else 0
    by_photons = (stated.relative**2 - stated.direct**2 - stated.gathered**2) / max(traced + again, 1)
    most = (DIRECT_SHARE * error) ** 2
    kinds = [(stated.direct**2, direct, stated.texel_direct2)]
    kinds += [(stated.gathered**2, gathered, stated.texel_gathered2)] if gathered and stated.texel_gathered2 else []
    is_open = None  # texels of parts above the requested error; None is all
    if stated.parts.of_entry is not None:
        is_open = stated.parts.spread(stated.of_parts > error, slice(None), False)
    share = 1.0 if is_open is None else float(is_open.mean())  # share of rays for these texels
    gains = [error2 / max(share * rays.counters["rays"], 1.0) if error2 > most else 0.0 for error2, rays, _ in kinds]
    if max(gains) <= by_photons:
        return None
    own2, rays, texel2 = kinds[int(np.argmax(gains))]
    error2 = rays.share_error(texel2())
    if is_open is not None:
        error2[~is_open] = 0.0
    worst = np.flatnonzero((error2 > most) & (rays.passes < rays.most_passes))
    least = int(_GROWTH * rays.passes.sum(dtype=np.int64)) if uses("batches") else 0
    left2 = (error**2 - (stated.chosen**2 - own2)) / SPARE
    if most < left2 < own2:  # otherwise another term dominates, and every texel is sampled to its own tolerance
        worst = _find_enough(error2, worst, rays.passes[worst], 1.0 - left2 / own2, least)
    if not len(worst):
        return None
    # Where the same few texels need more again, each repeat doubles their estimates, within the batch.
    repeats = min(least // len(worst), int(np.median(rays.passes[worst])))
    return rays, worst, max(repeats, 1)


def _find_enough(
    error2: NDArray[np.float32], worst: NDArray[np.intp], passes: NDArray[np.int16], share: float, least: int
) -> NDArray[np.intp]:
    """Fewest of the texels `worst` (m,), ascending, that reduce the mean of squared errors (n,) of all by a share: those of largest error.

    passes   (m,): number of estimates in each texel's mean
    least    least number of texels, as far as there are
    """
    counted = np.minimum(error2, np.quantile(error2, BEST_TEXELS))  # as StatedError, without the worst texels
    gain = counted[worst] / (passes + 1)
    order = np.argsort(-error2[worst], kind="stable")
    wanted = share * counted.sum(dtype=np.float64)
    count = int(np.searchsorted(np.cumsum(gain[order], dtype=np.float64), wanted)) + 1
    return np.sort(worst[order[: max(count, least)]])


def have_look(look: Look, tell: Tell, should_stop: Stop, following: Message) -> None:
    """Run a look; if it has reported progress, report `following` after it."""
    heard: list[Message] = []

    def tell_of(message: Message) -> None:
        heard.append(message)
        tell(message)

    look(tell_of, should_stop)
    if heard:
        tell(following)
