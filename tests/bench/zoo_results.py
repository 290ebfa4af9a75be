"""The arithmetic of the zoo's benchmark: from bakes to times, ratios, stated over real errors, and tables."""

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from speed_curves import Point, Reach, geometric_mean, ratio_text, reach_error
from tables import Table

OURS, CYCLES, OIDN = "Leaflight", "Cycles", "Cycles + OIDN"
ERRORS = (0.05, 0.02)
# Functions that processes are given, see busy_seconds of the report.
TRACING = {"trace_photons", "trace_ahead", "light_texels", "_light_ahead", "gather_texels"}
NOT_TRACING = {"find_in_charts", "_smooth_strips"}
LONG_S = 3.0  # bakes for which the share of tracing counts


@dataclass(frozen=True)
class Outcome:
    """One bake of ours beside the truth.

    asked, stated, rel   errors: asked for, stated in the report, real
    bias                 mean difference relative to the mean
    seconds, cpu_s       wall time after loading; of all processes
    stages               seconds of each stage of the report
    traced               share of the processes' time in calls that trace rays; None where the report does not say
    """

    asked: float
    stated: float
    rel: float
    nrmse: float
    bias: float
    seconds: float
    cpu_s: float
    photons: int
    stopped_by: str
    stages: dict[str, float] = field(default_factory=dict)
    traced: float | None = None

    @property
    def honesty(self) -> float:
        """Stated over real error."""
        return self.stated / self.rel if self.rel > 0.0 else math.inf


@dataclass(frozen=True)
class SceneResult:
    """All bakes of a scene.

    noise    of the reference
    rivals   series of Cycles and Cycles + OIDN; empty in a quick run
    """

    name: str
    about: str
    noise: float
    ours: tuple[Outcome, ...]
    rivals: dict[str, tuple[Point, ...]] = field(default_factory=dict)

    def reach(self, label: str, error: float) -> Reach | None:
        """When that way of baking comes to the error; Cycles' time is extrapolated where it was not run for so long."""
        if label == OURS:
            return reach_error([Point(one.seconds, one.rel, one.nrmse, one.asked) for one in self.ours], error)
        return reach_error(self.rivals.get(label, ()), error, extrapolate=label == CYCLES)

    def ratio(self, rival: str, error: float) -> float | None:
        """The rival's time over ours: 0 where only it comes to the error, infinite where only we do, None where neither does."""
        ours, theirs = self.reach(OURS, error), self.reach(rival, error)
        if ours is None:
            return 0.0 if theirs else None
        return theirs.seconds / ours.seconds if theirs else math.inf


def share_of_tracing(busy_s: dict[str, float], seconds: float) -> float | None:
    """What calls that trace rays take of the time of all processes; None where no calls are counted, as on a cluster.

    busy_s    seconds of calls by their function, as the report has them
    Raises ValueError where it names a function that is not known here.
    """
    unknown = set(busy_s) - TRACING - NOT_TRACING
    if unknown:
        raise ValueError(f"busy_seconds of the report has {', '.join(sorted(unknown))}; say in zoo_results.py whether that traces rays.")
    return sum(busy_s.get(name, 0.0) for name in TRACING) / seconds if busy_s else None


def join_outcomes(turns: Sequence[Outcome]) -> Outcome:
    """One bake of several with seeds of their own: medians; errors are root mean squares, the bias is the mean."""

    def mean_square(errors: Iterable[float]) -> float:
        return math.sqrt(statistics.mean(error * error for error in errors))

    traced = [one.traced for one in turns if one.traced is not None]
    return replace(
        turns[0],
        stated=mean_square(one.stated for one in turns),
        rel=mean_square(one.rel for one in turns),
        nrmse=mean_square(one.nrmse for one in turns),
        bias=statistics.mean(one.bias for one in turns),
        seconds=statistics.median(one.seconds for one in turns),
        cpu_s=statistics.median(one.cpu_s for one in turns),
        traced=statistics.median(traced) if traced else None,
    )


def list_scenes(results: Sequence[SceneResult]) -> Table:
    """What each scene is."""
    return Table(("scene", "what it is"), [[result.name, result.about.partition(": ")[2]] for result in results])


def tabulate_quick(results: Sequence[SceneResult]) -> Table:
    """A row for each bake of ours."""
    rows = [
        [
            result.name,
            f"{result.noise:.1%}",
            f"{one.asked:.1%}",
            f"{one.rel:.2%}",
            f"{one.honesty:.2f}",
            f"{one.bias:+.2%}",
            f"{one.seconds:.1f}",
            f"{one.cpu_s:.1f}",
            f"{one.photons / 1e6:.1f}",
            "" if one.traced is None else f"{one.traced:.0%}",
            one.stopped_by,
        ]
        for result in results
        for one in result.ours
    ]
    head = ("scene", "noise of reference", "asked", "rel", "stated / real", "bias", "s", "CPU s", "M photons", "tracing", "stopped by")
    return Table(head, rows)


def tabulate_times(results: Sequence[SceneResult]) -> Table:
    """Times to 5 and 2 % and their ratios."""
    rows = []
    for result in results:
        for error in ERRORS:
            reach = {label: result.reach(label, error) for label in (OURS, CYCLES, OIDN)}
            times = [str(reach[label]) if reach[label] else "never" for label in reach]
            rows.append([result.name, f"{error:.0%}", *times, *(ratio_text(reach[label], reach[OURS]) for label in (CYCLES, OIDN))])
    return Table(("scene", "rel", OURS, CYCLES, OIDN, f"{CYCLES} / {OURS}", f"{OIDN} / {OURS}"), rows)


def summarize(results: Sequence[SceneResult]) -> Table:
    """Geometric means, medians and worst of all scenes."""
    rows = []
    for error in ERRORS:
        reaches = [result.reach(OURS, error) for result in results]
        seconds = [reach.seconds for reach in reaches if reach]
        worst = "never" if None in reaches else f"{max(seconds, default=math.nan):.3g}"
        rows.append([f"seconds to {error:.0%}", f"{geometric_mean(seconds):.3g}", worst, f"{len(seconds)} of {len(results)} come to it"])
    both = [(a, b) for a, b in ((result.reach(OURS, 0.05), result.reach(OURS, 0.02)) for result in results) if a and b]
    if both:
        growth = [b.seconds / a.seconds for a, b in both]
        rows.append(["seconds to 2 % / seconds to 5 %", f"{geometric_mean(growth):.3g}", f"{max(growth):.3g}", ""])
    for rival in (CYCLES, OIDN):
        for error in ERRORS:
            if any(result.rivals for result in results):
                rows.append(_summarize_ratio(results, rival, error))
    outcomes = [one for result in results for one in result.ours]
    if outcomes:
        honesty = [one.honesty for one in outcomes]
        far = max(honesty, key=lambda value: abs(math.log(value)) if 0.0 < value < math.inf else math.inf)
        within = sum(0.75 <= value <= 1.33 for value in honesty)
        rows.append(
            ["stated / real", f"{statistics.median(honesty):.2f} (median)", f"{far:.2f}", f"{within} of {len(honesty)} in 0.75 - 1.33"]
        )
        bias = [one.bias for one in (result.ours[-1] for result in results if result.ours)]
        rows.append(["bias, of the finest bake", f"{statistics.median(bias):+.2%} (median)", f"{max(bias, key=abs):+.2%}", ""])
        rows.append(
            [
                "CPU seconds, all bakes",
                f"{geometric_mean([max(one.cpu_s, 1e-3) for one in outcomes]):.3g}",
                f"{max(one.cpu_s for one in outcomes):.3g}",
                "",
            ]
        )
        traced = [one.traced for one in outcomes if one.traced is not None and one.seconds > LONG_S]
        if traced:
            rows.append(
                [
                    f"share of tracing, bakes over {LONG_S:g} s",
                    f"{statistics.median(traced):.0%} (median)",
                    f"{min(traced):.0%}",
                    f"{len(traced)} bakes",
                ]
            )
    return Table(("what", "geometric mean", "worst", ""), rows)


def _summarize_ratio(results: Sequence[SceneResult], rival: str, error: float) -> list[str]:
    ratios = [result.ratio(rival, error) for result in results]
    both = [ratio for ratio in ratios if ratio is not None and 0.0 < ratio < math.inf]
    only_ours, only_theirs, neither = (sum(ratio == value for ratio in ratios) for value in (math.inf, 0.0, None))
    said = [
        f"{only_ours} only by us" * bool(only_ours),
        f"{only_theirs} only by the rival" * bool(only_theirs),
        f"{neither} by neither" * bool(neither),
    ]
    worst = 0.0 if only_theirs else min(both, default=math.nan)
    return [f"time to {error:.0%}, {rival} / {OURS}", f"{geometric_mean(both):.3g}", f"{worst:.3g}", ", ".join(filter(None, said))]
