"""What the tables of docs/paper.md claim: of [Tobler97], of the hints, and of the defaults that were chosen from them."""

import math
from collections.abc import Iterable, Mapping, Sequence

from claims import Claim
from leaflight.core.util.settings import BASES
from paper_tables import DEFAULTS, PAPER_OVERHEAD, Need, Overhead, Point, SquareRow, Swept

LOT_LESS_NOISE = math.sqrt(0.5)  # "a lot less variance" of the paper: at most half
LESS, MUCH_LESS = 0.9, 0.5  # ratios: what a knob without effect would not come to, and "far fewer", "several times"
NEAR_BEST = 1.05  # a default may err so much more than the best value that was tried, for the nodes that it saves


def judge_square(rows: Sequence[SquareRow]) -> list[Claim]:
    """Figure 2: linear leaves follow the ramp with fewer of them and less error than constant ones."""
    of = {row.basis: row for row in reversed(rows)}  # the first of each basis has our own oracle
    few, many = of["linear"], of["constant"]
    return [
        Claim("the paper, figure 2: leaves, linear over constant", few.leaves / many.leaves, high=MUCH_LESS),
        Claim("the paper, figure 2: error, linear over constant", few.rmse / many.rmse, high=LESS),
    ]


def judge_curves(curves: Mapping[str, Sequence[Point]], needs: Mapping[str, Need]) -> list[Claim]:
    """Figure 3: error at equal photons; leaves and photons for the same error."""
    ratio = curves[DEFAULTS.basis][-1].rel / curves["flat"][-1].rel
    claims = [Claim("the paper, figure 3: rel at equal photons, hierarchical over fixed mesh", ratio, high=MUCH_LESS)]
    for basis, simpler in zip(BASES, ("flat", *BASES), strict=False):
        fewer = needs[basis].leaves / needs[simpler].leaves
        claims.append(Claim("the paper, figure 3: leaves for the same rel, over the next simpler", fewer, high=LESS, case=basis))
        less = needs[basis].photons / needs["flat"].photons
        claims.append(Claim("the paper, figure 3: photons for the same rel, over the fixed mesh", less, high=MUCH_LESS, case=basis))
    return claims


def judge_overhead(found: Overhead) -> list[Claim]:
    """What the hierarchy costs the finest nodes, and what it saves."""
    return [
        Claim("the paper: photons for the same variance in the finest nodes, over the fixed mesh", found.variance, high=PAPER_OVERHEAD),
        Claim("the paper: photons that the finest nodes saw, fixed mesh over hierarchical", found.photons, high=PAPER_OVERHEAD),
        Claim("the paper: noise of the whole picture, hierarchical over fixed mesh", found.noise, high=LOT_LESS_NOISE),
    ]


def judge_hints(swept: Sequence[Swept]) -> list[Claim]:
    """At contacts, where shadows of table legs lie and light leaks: either hint takes error away from a bake that has neither."""
    at = {(one.choice.knobs["basis"], one.choice.knobs["contact"], one.choice.knobs["min_level"]): one.contact.nrmse for one in swept}
    claims = []
    for basis in sorted({basis for basis, _, _ in at}):
        name = "hints: nrmse at contacts"
        claims.append(Claim(f"{name}, contact subdivision over none", at[basis, True, 0] / at[basis, False, 0], high=LESS, case=basis))
        claims.append(Claim(f"{name}, minimum level 3 over 0", at[basis, False, 3] / at[basis, False, 0], high=LESS, case=basis))
    return claims


def judge_knobs(swept: Sequence[Swept]) -> list[Claim]:
    """No value of a knob that was tried alone is much better than its default; a preview depth of 1 is worse."""
    default, tried = next(one for one in swept if not one.choice.knobs), [one for one in swept if not one.choice.printed]
    claims = []
    for knob in ("stability", "oracle", "preview_depth"):
        others = [one for one in tried if knob in one.choice.knobs and set(one.choice.knobs) <= {knob, "stability"}]
        claims.append(_claim_near_best(knob, default, others))
    # Of the rows as printed: no other rule has a threshold.
    by_threshold = {one.choice.knobs["threshold"]: one for one in swept if "threshold" in one.choice.knobs}
    claims.append(_claim_near_best("threshold", by_threshold[DEFAULTS.threshold], by_threshold.values()))
    shallow = next(one for one in swept if one.choice.knobs == {"preview_depth": 1})
    claims.append(Claim("defaults: rel, preview depth 2 over 1", default.errors.rel / shallow.errors.rel, high=LESS))
    return claims


def _claim_near_best(knob: str, default: Swept, others: Iterable[Swept]) -> Claim:
    ratio = default.errors.rel / min(one.errors.rel for one in others)
    return Claim("defaults: rel over that of the best value tried", ratio, high=NEAR_BEST, case=knob.replace("_", " "))
