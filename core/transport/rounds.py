"""How many photons a round has, and how they are shared out.

Never by the clock, nor by how many workers there are: the same seed gives the same bytes.
"""

from __future__ import annotations

import math
from itertools import pairwise

from ..util.ablation import uses

FIRST_ROUND_PHOTONS = 1 << 17  # at least
# ... and so many for each node that the trees start with: fewer say little of where to split. But later photons are better sent, so that a
# first round is never long, nor a great share of a bake.
FIRST_NODE_PHOTONS = 160
MOST_FIRST_PHOTONS = 3 << 17
FIRST_SHARE = 0.125
SHARD_PHOTONS = 1 << 18  # at most
MANY_PAIRS = 3  # of shards, from which on a round ends with smaller ones, and is looked at before these are done
SMALL_PAIRS = 2
# A round adds at most so many times all photons so far, for late nodes lose what came before them (docs/paper.md, "What the hierarchy
# costs"); while these are few, more: to read a round takes time too, and most nodes are still to come.
ROUND_GROWTH, EARLY_GROWTH = 0.7, 2.0
EARLY_PHOTONS = 1 << 20
# Photons that the first and the second round have whatever their trees are, if the bake may have so many: as nothing guides them, they can
# be traced before there are trees, by first_photons.
AHEAD_PHOTONS = FIRST_ROUND_PHOTONS, int(EARLY_GROWTH * FIRST_ROUND_PHOTONS)
# Of a bake whose error is to be come to with fewer than so many times its photons: as many as that needs, or so many times all so far. Few
# nodes are still to come then, and each round less saves its reading; what late nodes lose shows in a bake of many more photons only.
NEAR_TIMES, NEAR_GROWTH = 36.0, 5.0
ROUND_PHOTONS = 1 << 22  # at most, so that progress, cancelling and time limits are felt
# ... and at least so many photons for each node: to look at what came of a round takes as long as tracing them does on two cores, and on
# some samples several times as long.
NODE_PHOTONS = 16
SPARE = 1.1  # how much less squared noise a round aims at than would be enough, for it may come out worse than foretold


def grow_photons(noise2: float, wanted2: float, degree: int | None) -> float:
    """How many times the photons so far are likely to take squared noise from noise2 >= 0 to wanted2 > 0.

    Where trees are refined as photons come, fewer are left to each leaf: of N photons, with functions of order p = degree + 1 on surfaces,
    the squared error falls as N^(-p / (p + 1)). Source: Stone 1982, "Optimal global rates of convergence for nonparametric regression".

    degree   of the basis; None where trees stay as they are, and noise falls as 1 / N
    """
    power = 1.0 if degree is None else (degree + 2) / (degree + 1)
    growth: float = (noise2 / wanted2) ** power
    return growth


def next_photons(
    so_far: int,
    told: float,
    weight: float,
    most: int,
    n_node: int,
    wanted_error: float,
    error: float,
    fixed_error: float,
    degree: int | None,
) -> tuple[int, bool]:
    """Photons of the next round: those that the error asked for is likely to need, if that is not too many for one round. And whether so
    many are likely to be enough, so that no other round follows.

    so_far        photons, of a bake that may have `most`
    told          photons of a first round that would tell as much
    weight        how much one of the next round tells, over one of a first
    n_node        nodes of the trees
    error         relative, as it stands; nan where nothing is known
    fixed_error   relative, the part of it that no photon makes less
    degree        of grow_photons
    """
    if not so_far:
        wanted = min(FIRST_NODE_PHOTONS * n_node, MOST_FIRST_PHOTONS, int(FIRST_SHARE * most))
        return min(max(wanted, FIRST_ROUND_PHOTONS), most), False
    enough = math.inf
    growth = EARLY_GROWTH if told < EARLY_PHOTONS else ROUND_GROWTH
    noise2, left2 = error**2 - fixed_error**2, wanted_error**2 - fixed_error**2
    if left2 > 0.0 and noise2 > 0.0:
        times = max(grow_photons(SPARE * noise2, left2, degree), SPARE)
        enough = (times - 1.0) * told / weight
        growth = min(times - 1.0, NEAR_GROWTH if times < NEAR_TIMES else growth)
    photons = max(min(growth * told / weight, ROUND_PHOTONS), FIRST_ROUND_PHOTONS / weight, min(NODE_PHOTONS * n_node, so_far) / weight)
    return int(min(photons, most - so_far)), photons >= enough


def count_ahead(round_: int, by_rays: bool) -> int:
    """Of AHEAD_PHOTONS, those of a round; in the second of photons alone births are grouped by where they were, which takes a guide."""
    return AHEAD_PHOTONS[round_] if round_ < (len(AHEAD_PHOTONS) if by_rays else 1) else 0


def share_photons(photons: int, ahead: int = 0) -> list[int]:
    """Photons of each shard of a round, for the halves of the bake in turn: equal shards, of many the last ones half as large.

    ahead   so many of them, of count_ahead, come first in shards of their own

    Who works on the last shard of all keeps the others waiting, and a small one not long; but small ones take longer by the photon, and
    their nets of directions are coarser.
    """
    if 0 < ahead < photons:
        return share_photons(ahead) + share_photons(photons - ahead)
    n_pair = max(1, math.ceil(photons / (2 * SHARD_PHOTONS)))
    ends = [2 * pair for pair in range(n_pair + 1)]  # of all pairs, in half shards
    if n_pair >= MANY_PAIRS:
        ends.insert(n_pair, 2 * n_pair - 1)  # SMALL_PAIRS in place of one
    halves = (photons + 1) // 2, photons // 2
    return [half * end // ends[-1] - half * start // ends[-1] for start, end in pairwise(ends) for half in halves]


def count_late(n_shard: int, left: int) -> int:
    """How many shards of a round with so many, the small last ones, need not be waited for; see photon_rounds.

    left   photons that the bake may still have, 0 where it is likely to need none: if there is no other round, all are waited for
    """
    return 2 * SMALL_PAIRS if n_shard > 2 * MANY_PAIRS and left > 1 and uses("late_shards") else 0
