"""Which rays are sent next, where more from texels help more than more photons."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .direct_field import MOST_PASSES, DirectField
from .estimate import StatedError
from .gathered import GatheredField
from .messages import Message

# Sends rays from texels; told who is to hear of it, and what asks it to stop.
Look: TypeAlias = Callable[[Callable[[Message], None], Callable[[], bool]], object]

DIRECT_SHARE = 0.5  # of the error asked for, that direct light by rays may have


def choose_texels(
    error: float, stated: StatedError, traced: int, direct: DirectField, gathered: GatheredField | None
) -> tuple[DirectField, NDArray[np.intp]] | None:
    """The field whose rays help most, and the texels (m,) that want more of them; None where a photon's help as much, or no texel does.

    Squared errors fall as one over the number of rays; and what is gathered has to be so again after more photons.

    error    relative, that is asked for
    traced   rays of photons
    """
    again = gathered.counters["rays"] if gathered else 0
    by_photons = (stated.relative**2 - stated.direct**2 - stated.gathered**2) / max(traced + again, 1)
    most = (DIRECT_SHARE * error) ** 2
    kinds = [(stated.direct**2, direct, stated.texel_direct2)]
    kinds += [(stated.gathered**2, gathered, stated.texel_gathered2)] if gathered and stated.texel_gathered2 else []
    gains = [error2 / max(rays.counters["rays"], 1) if error2 > most else 0.0 for error2, rays, _ in kinds]
    if max(gains) <= by_photons:
        return None
    _, rays, texel2 = kinds[int(np.argmax(gains))]
    worst = np.flatnonzero((texel2() > most) & (rays.passes < MOST_PASSES))
    return (rays, worst) if len(worst) else None


def have_look(look: Look, tell: Callable[[Message], None], should_stop: Callable[[], bool], following: Message) -> None:
    """Has a look; whoever heard of it is told afterwards what follows."""
    heard: list[Message] = []

    def tell_of(message: Message) -> None:
        heard.append(message)
        tell(message)

    look(tell_of, should_stop)
    if heard:
        tell(following)
