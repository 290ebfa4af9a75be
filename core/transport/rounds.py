"""Number of photons in a round, and their division into shards.

Neither depends on the clock or the number of workers, so the same seed gives the same bytes.
"""

import math
from itertools import pairwise

from ..util.ablation import uses

# The first round has FIRST_NODE_PHOTONS for each node of the first trees, since refinement needs that many; at least FIRST_ROUND_PHOTONS,
# and at most MOST_FIRST_PHOTONS and FIRST_SHARE of a bake, for nodes that are split late lose the photons from before.
FIRST_ROUND_PHOTONS = 1 << 17
FIRST_NODE_PHOTONS = 160
MOST_FIRST_PHOTONS = 3 << 17
FIRST_SHARE = 0.125
SHARD_PHOTONS = 1 << 18  # at most
# A round of MANY_PAIRS pairs of shards or more ends with SMALL_PAIRS pairs of half size, and is evaluated before these are done.
MANY_PAIRS = 3
SMALL_PAIRS = 2
# A round adds at most ROUND_GROWTH times the photons so far, since nodes that are split late lose the photons from before (docs/paper.md,
# "What the hierarchy costs"). It adds up to EARLY_GROWTH times as many while there are less than EARLY_PHOTONS: evaluating a round takes
# time too, and most nodes are not split yet.
ROUND_GROWTH, EARLY_GROWTH = 0.7, 2.0
EARLY_PHOTONS = 1 << 20
# Least photons of the first and the second round, within the bake's limit: first_photons traces them before there are trees.
AHEAD_PHOTONS = FIRST_ROUND_PHOTONS, int(EARLY_GROWTH * FIRST_ROUND_PHOTONS)
# If the requested error needs fewer than NEAR_TIMES the photons so far, a round adds as many as it needs, up to NEAR_GROWTH times. Few
# nodes will be split then, and fewer rounds take less evaluation; the loss at late nodes shows only in bakes of many more photons.
NEAR_TIMES, NEAR_GROWTH = 36.0, 5.0
# A round has at most ROUND_PHOTONS, so that progress, cancelling and time limits take effect soon; but at least NODE_PHOTONS for each node,
# since evaluating a round takes as long as tracing those on two cores, and several times as long on some samples.
ROUND_PHOTONS = 1 << 22
NODE_PHOTONS = 16
SPARE = 1.1  # safety factor on the squared noise, which may turn out higher than predicted


def grow_photons(noise2: float, wanted2: float, degree: int | None) -> float:
    """Predicted factor on the number of photons that brings squared noise from noise2 >= 0 to wanted2 > 0.

    Refinement with more photons leaves fewer to each leaf. With N photons and functions of order p = degree + 1 on surfaces,

        error^2 ~ N^(-p / (p + 1))   [Stone 1982, "Optimal global rates of convergence for nonparametric regression"]

    degree   of the basis; None if the trees are fixed, so that noise falls as 1 / N
    """
    power = 1.0 if degree is None else (degree + 2) / (degree + 1)
    return (noise2 / wanted2) ** power


def next_photons(
    so_far: int, most: int, n_node: int, wanted_error: float, error: float, fixed_error: float, degree: int | None
) -> tuple[int, bool]:
    """Photons of the next round: the predicted need of the requested error, up to the limits of a round. Also whether no further round is
    expected.

    so_far        photons so far
    most          photons that the bake may have
    n_node        nodes of the trees
    error         current relative error; nan if unknown
    fixed_error   the part of it that photons do not reduce
    degree        as for grow_photons
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
    """Photons of a round that are traced ahead: of the first, and where direct light comes by rays of the second too."""
    return AHEAD_PHOTONS[round_] if round_ < (len(AHEAD_PHOTONS) if by_rays else 1) else 0


def share_photons(photons: int, ahead: int = 0) -> list[int]:
    """Photons of each shard of a round, alternating between both halves of the bake. Shards are equal, but the last ones of many are half
    as large.

    ahead   number of them, from count_ahead, that come first in shards of their own

    Workers wait for the last shard, and less long if it is small; but small shards cost more per photon and are stratified more coarsely.
    """
    if 0 < ahead < photons:
        return share_photons(ahead) + share_photons(photons - ahead)
    n_pair = max(1, math.ceil(photons / (2 * SHARD_PHOTONS)))
    ends = [2 * pair for pair in range(n_pair + 1)]  # of the pairs, in units of half a shard
    if n_pair >= MANY_PAIRS:
        ends.insert(n_pair, 2 * n_pair - 1)  # cuts the last pair into SMALL_PAIRS
    halves = (photons + 1) // 2, photons // 2
    return [half * end // ends[-1] - half * start // ends[-1] for start, end in pairwise(ends) for half in halves]


def count_late(n_shard: int, left: int) -> int:
    """Number of last shards of a round of `n_shard` that may arrive during the next round; see photon_rounds.

    left   photons that the bake may still have; 0 if no round follows, so that this one waits for all shards
    """
    return 2 * SMALL_PAIRS if n_shard > 2 * MANY_PAIRS and left > 1 and uses("late_shards") else 0
