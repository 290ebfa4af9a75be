"""Number of photons of a round, and their division into shards.

Neither depends on the clock or the number of workers, so that the same seed gives the same bytes.
"""

from __future__ import annotations

import math
from itertools import pairwise

from ..util.ablation import uses

FIRST_ROUND_PHOTONS = 1 << 17  # at least
# ... and so many for each node of the first trees: fewer are too noisy for refinement. Later photons are guided better, so that the first
# round has at most so many, and at most a share of a bake.
FIRST_NODE_PHOTONS = 160
MOST_FIRST_PHOTONS = 3 << 17
FIRST_SHARE = 0.125
SHARD_PHOTONS = 1 << 18  # at most
MANY_PAIRS = 3  # shard pairs from which on a round ends with smaller ones, and is read before these are done
SMALL_PAIRS = 2
# A round adds at most so many times all photons so far, for late nodes lose photons from before they were split (docs/paper.md, "What the
# hierarchy costs"); more while these are few, for reading a round takes time too, and most nodes are still to come.
ROUND_GROWTH, EARLY_GROWTH = 0.7, 2.0
EARLY_PHOTONS = 1 << 20
# Least photons of the first and the second round, within the bake's limit: without a guide they can be traced before there are trees, by
# first_photons.
AHEAD_PHOTONS = FIRST_ROUND_PHOTONS, int(EARLY_GROWTH * FIRST_ROUND_PHOTONS)
# Where the requested error needs fewer than NEAR_TIMES the photons so far, a round adds as many as it needs, up to NEAR_GROWTH times. Few
# nodes are still to come then, and each round less saves its reading; the loss of late nodes shows only in bakes of many more photons.
NEAR_TIMES, NEAR_GROWTH = 36.0, 5.0
ROUND_PHOTONS = 1 << 22  # at most, so that progress, cancelling and time limits are felt
# ... and at least so many photons for each node: reading a round takes as long as tracing these does on two cores, and on some samples
# several times as long.
NODE_PHOTONS = 16
SPARE = 1.1  # margin of squared noise that a round aims at, for it may turn out higher than predicted


def grow_photons(noise2: float, wanted2: float, degree: int | None) -> float:
    """Factor on the photons so far that probably brings squared noise from noise2 >= 0 to wanted2 > 0.

    Trees are refined as photons come, which leaves fewer to each leaf: with N photons and functions of order p = degree + 1 on surfaces,

        error^2 ~ N^(-p / (p + 1))   [Stone 1982, "Optimal global rates of convergence for nonparametric regression"]

    degree   of the basis; None where trees stay as they are, and noise falls as 1 / N
    """
    power = 1.0 if degree is None else (degree + 2) / (degree + 1)
    growth: float = (noise2 / wanted2) ** power
    return growth


def next_photons(
    so_far: int,
    most: int,
    n_node: int,
    wanted_error: float,
    error: float,
    fixed_error: float,
    degree: int | None,
) -> tuple[int, bool]:
    """Photons of the next round: those that the requested error probably needs, up to a limit for one round. Also whether they are probably
    enough, so that no round follows.

    so_far        photons so far, of a bake that may have `most`
    n_node        nodes of the trees
    error         relative, so far; nan where it is unknown
    fixed_error   relative, the part that photons do not reduce
    degree        of grow_photons
    """
    if not so_far:
        wanted = min(FIRST_NODE_PHOTONS * n_node, MOST_FIRST_PHOTONS, int(FIRST_SHARE * most))
        return min(max(wanted, FIRST_ROUND_PHOTONS), most), False
    enough = math.inf
    growth = EARLY_GROWTH if so_far < EARLY_PHOTONS else ROUND_GROWTH
    noise2, left2 = error**2 - fixed_error**2, wanted_error**2 - fixed_error**2
    if left2 > 0.0 and noise2 > 0.0:
        times = max(grow_photons(SPARE * noise2, left2, degree), SPARE)
        enough = (times - 1.0) * so_far
        growth = min(times - 1.0, NEAR_GROWTH if times < NEAR_TIMES else growth)
    grown = min(growth * so_far, ROUND_PHOTONS)
    photons = max(grown, FIRST_ROUND_PHOTONS, min(NODE_PHOTONS * n_node, so_far))
    return int(min(photons, most - so_far)), photons >= enough


def count_ahead(round_: int, by_rays: bool) -> int:
    """AHEAD_PHOTONS of a round, else 0: the second round of photons alone tallies them by place of emission, which takes a guide."""
    return AHEAD_PHOTONS[round_] if round_ < (len(AHEAD_PHOTONS) if by_rays else 1) else 0


def share_photons(photons: int, ahead: int = 0) -> list[int]:
    """Photons of each shard of a round, for both halves of the bake in turn: equal shards, the last ones half as large where they are many.

    ahead   so many of them, of count_ahead, come first in shards of their own

    All others wait for the last shard, and less for a small one; but small shards take longer by the photon, and their stratification is
    coarser.
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
    """How many of the small last shards of a round of `n_shard` may arrive in the next round; see photon_rounds.

    left   photons that the bake may still have; 0 where no round follows, which waits for all shards
    """
    return 2 * SMALL_PAIRS if n_shard > 2 * MANY_PAIRS and left > 1 and uses("late_shards") else 0
