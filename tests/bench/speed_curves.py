"""Error over time: how long each way of baking takes to come to an error, and by what factor they differ."""

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

Baked = TypeVar("Baked")
PATIENCE = 4.0  # budgets that a bake may take while its series, which is not extrapolated, has not come to the least error asked for
SHORT_S = 10.0  # a bake that takes less is at the mercy of the second it is made in


@dataclass(frozen=True)
class Point:
    """One bake: its time, errors as lightmap_errors has them, and what was asked for, samples or an error."""

    seconds: float
    rel: float
    nrmse: float
    asked: float


@dataclass(frozen=True)
class Reach:
    """When an error is come to.

    mark   "" interpolated between two bakes; "<=" the quickest bake is better already; "~" extrapolated beyond the longest
    """

    seconds: float
    mark: str = ""

    def __str__(self) -> str:
        digits = max(0, 1 - math.floor(math.log10(self.seconds))) if self.seconds > 0.0 else 0
        return f"{self.mark.replace('<=', '≤')}{self.seconds:.{digits}f} s"


def bake_in_turns(
    first: dict[float, Baked], bake: Callable[[float, int], Baked], turns: int, seconds: Callable[[Baked], float]
) -> list[list[Baked]]:
    """Bakes by what they were asked for; short ones are made again, in turn, until there are `turns` of each.

    bake      of what is asked for and the turn, from 1 on
    seconds   of a bake
    """
    made = {asked: [baked] for asked, baked in first.items()}
    for turn in range(1, turns):
        for asked, bakes in made.items():
            if seconds(bakes[0]) < SHORT_S:
                bakes.append(bake(asked, turn))
    return list(made.values())


def list_more_samples(
    cycles: Sequence[Point], filtered: Sequence[Point], samples: Sequence[int], budget_s: float, least_error: float
) -> list[int]:
    """The samples that Cycles is asked for next, one number or none, although a bake takes longer than the budget: it is waited for as
    patiently as we are, while what the filter makes of its bakes has not come to the least error.
    """
    last = cycles[-1]
    most = last.asked * PATIENCE * budget_s / last.seconds
    further = [count for count in samples if last.asked < count <= most]
    return further[:1] if min(point.rel for point in filtered) > least_error else []


def join_turns(points: Sequence[Point]) -> Point:
    """The median of the seconds; errors are root mean squares."""

    def mean(errors: Iterable[float]) -> float:
        return math.sqrt(statistics.mean(error * error for error in errors))

    seconds = statistics.median(point.seconds for point in points)
    return Point(seconds, mean(point.rel for point in points), mean(point.nrmse for point in points), points[0].asked)


def reach_error(points: Sequence[Point], error: float, measure: str = "rel", extrapolate: bool = False) -> Reach | None:
    """When a series of bakes, each longer than the one before, comes to an error; None where it does not.

    Between bakes the error is a power of time. Beyond them, if asked to extrapolate, time is a constant and a part in proportion to
    `asked` (samples), and the error falls with samples^-1/2.
    """
    points = sorted(points, key=lambda point: point.seconds)
    best: list[tuple[float, float]] = []  # of a bake that is worse than a quicker one nothing is to be had
    for point in points:
        value = getattr(point, measure)
        if not best or value < best[-1][1]:
            best.append((point.seconds, max(value, 1e-9)))
    for index, (seconds, value) in enumerate(best):
        if value > error:
            continue
        if not index:
            return Reach(seconds, "<=")
        before_s, before = best[index - 1]
        share = math.log(before / error) / math.log(before / value)
        return Reach(before_s * (seconds / before_s) ** share)
    if not extrapolate or len(points) < 2:
        return None
    first, last = points[0], points[-1]
    per_sample_s = (last.seconds - first.seconds) / (last.asked - first.asked)
    more = last.asked * ((getattr(last, measure) / error) ** 2 - 1.0)
    return Reach(last.seconds + more * per_sample_s, "~")


def geometric_mean(values: Sequence[float]) -> float:
    """Nan of nothing, 0 where one value is 0."""
    if not all(values):
        return 0.0
    return math.exp(sum(map(math.log, values)) / len(values)) if values else math.nan


def ratio_text(rival: Reach | None, ours: Reach | None) -> str:
    """How many times longer the rival takes; "never" where it does not come to the error, "-" where we do not."""
    if ours is None:
        return "-"
    if rival is None:
        return "never"
    mark = "~" if "~" in (rival.mark, ours.mark) else "≤" if rival.mark == "<=" else "≥" if ours.mark == "<=" else ""
    return f"{mark}{rival.seconds / ours.seconds:.3g}"
