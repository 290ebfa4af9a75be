"""The arithmetic of the ablation: what bakes without a mechanism cost and err, beside bakes with everything, and whether that is chance."""

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from speed_curves import geometric_mean
from tables import Table

# Standard errors from which on a ratio is no chance: among 40 mechanisms that are worth nothing, one in ten tables has one beyond them.
SIGMAS = 3.0
HONEST = (0.75, 1.33)  # stated / real
_TINY = 1e-12
_WITH, _AGAIN = "everything", "everything, another seed"


@dataclass(frozen=True)
class Trial:
    """One bake.

    rel, stated   errors: real, and as the bake states it, nan where it was stopped before it knew
    cpu_s         of all processes of the core
    changed       some pixel differs from the bake with everything and the same seed
    """

    rel: float
    stated: float
    cpu_s: float
    changed: bool = True

    @property
    def effort(self) -> float:
        """Squared error times CPU seconds: what more samples leave as it is."""
        return self.rel**2 * self.cpu_s

    @property
    def honesty(self) -> float:
        """Stated over real error."""
        return self.stated / self.rel if self.rel > 0.0 else math.inf


@dataclass(frozen=True)
class SceneTrials:
    """All bakes of a scene.

    base      with everything: first that with the seed of the others, then with other seeds
    without   by mechanism; a bake that failed is missing
    """

    name: str
    about: str
    base: tuple[Trial, ...]
    without: dict[str, Trial] = field(default_factory=dict)


@dataclass(frozen=True)
class Worth:
    """What a mechanism is worth over all scenes, as ratios without / with it.

    error, cpu, effort   geometric means of the ratios
    sigmas               logarithm of `effort` over its standard error, were the mechanism worth nothing
    cpu_sigmas           the same of `cpu`
    honesty              geometric mean of stated / real without it
    honest               share of scenes in which that is in HONEST
    changed, scenes      scenes whose pixels changed, and all
    freedom              degrees of freedom of the noise by which `sigmas` is told
    """

    error: float
    cpu: float
    effort: float
    sigmas: float
    cpu_sigmas: float
    honesty: float
    honest: float
    changed: int
    scenes: int
    freedom: int

    @property
    def limit(self) -> float:
        """SIGMAS of noise that is known, as standard errors of noise that few scenes tell.

        Source: the first term of the expansion of Student's t by its degrees of freedom (Fisher 1925).
        """
        return SIGMAS + (SIGMAS**3 + SIGMAS) / (4.0 * max(self.freedom, 1))

    @property
    def verdict(self) -> str:
        if not self.scenes:
            return "failed"
        if not self.changed and abs(self.cpu_sigmas) < self.limit:
            return "no effect"
        if abs(self.sigmas) < self.limit:
            return "within noise"
        return "worth it" if self.sigmas > 0.0 else "does harm"


def find_noise(scenes: Sequence[SceneTrials], value: Callable[[Trial], float]) -> float:
    """Standard deviation of the logarithm of a ratio of two bakes that differ in their seed alone, by the bakes with everything."""
    variances = [statistics.variance([math.log(value(trial)) for trial in scene.base]) for scene in scenes if len(scene.base) > 1]
    return math.sqrt(2.0 * statistics.mean(variances)) if variances else math.nan


def weigh_mechanism(scenes: Sequence[SceneTrials], mechanism: str) -> Worth:
    """Over the scenes where the bake without it did not fail."""
    pairs = [(scene.base[0], scene.without[mechanism]) for scene in scenes if mechanism in scene.without]
    if not pairs:
        return Worth(*[math.nan] * 7, 0, 0, 0)
    changed, count = sum(without.changed for _, without in pairs), len(pairs)
    # Where pixels are the same the error is no chance, and what processes are charged for still is.
    noise2 = changed * (2.0 * find_noise(scenes, lambda trial: trial.rel)) ** 2
    cpu_noise2 = count * find_noise(scenes, lambda trial: trial.cpu_s) ** 2

    def total(value: Callable[[Trial], float]) -> float:
        return math.fsum(math.log(value(without) / value(whole)) for whole, without in pairs)

    cpu, effort = total(lambda trial: trial.cpu_s), total(lambda trial: trial.effort)
    honesty, honest = _join_honesty([without for _, without in pairs])
    return Worth(
        error=math.exp(total(lambda trial: trial.rel) / count),
        cpu=math.exp(cpu / count),
        effort=math.exp(effort / count),
        sigmas=effort / math.sqrt(noise2 + cpu_noise2 + _TINY),
        cpu_sigmas=cpu / math.sqrt(cpu_noise2 + _TINY),
        honesty=honesty,
        honest=honest,
        changed=changed,
        scenes=count,
        freedom=sum(len(scene.base) - 1 for scene in scenes),
    )


def _join_honesty(trials: Sequence[Trial]) -> tuple[float, float]:
    """Geometric mean of stated / real, and the share that is in HONEST; of those that state an error."""
    known = [trial.honesty for trial in trials if 0.0 < trial.honesty < math.inf]
    return geometric_mean(known), sum(HONEST[0] <= value <= HONEST[1] for value in known) / max(len(known), 1)


def tabulate_worth(scenes: Sequence[SceneTrials], mechanisms: Iterable[str]) -> Table:
    """A row for each mechanism, those that are worth most first; on top what bakes with everything are like, and what noise does."""
    rows = []
    if scenes:
        honesty, honest = _join_honesty([scene.base[0] for scene in scenes])
        rows.append([_WITH, "1", "1", "1", "", f"{honesty:.2f}", f"{honest:.0%}", "", ""])
        noise = [find_noise(scenes, value) for value in (lambda one: one.rel, lambda one: one.cpu_s, lambda one: one.effort)]
        rows.append([_AGAIN, *(f"x/ {math.exp(value):.2f}" for value in noise), "", "", "", "", "noise of one scene"])
    found = [(name, weigh_mechanism(scenes, name)) for name in mechanisms]
    for name, worth in sorted(found, key=lambda one: -one[1].sigmas if one[1].scenes else math.inf):
        failed = len(scenes) - worth.scenes
        said = worth.verdict + (f"; failed in {failed}" if failed and worth.scenes else "")
        ratios = [f"{value:.2f}" for value in (worth.error, worth.cpu, worth.effort)] if worth.scenes else ["", "", ""]
        told = [f"{worth.sigmas:+.1f}", f"{worth.honesty:.2f}", f"{worth.honest:.0%}"] if worth.scenes else ["", "", ""]
        rows.append([name, *ratios, *told, f"{worth.changed} of {worth.scenes}", said])
    low, high = HONEST
    return Table(
        ("without", "error", "CPU s", "error² x CPU s", "standard errors", "stated / real", f"in {low} - {high}", "changed", "verdict"),
        rows,
    )


def tabulate_scenes(scenes: Sequence[SceneTrials]) -> Table:
    """The bakes with everything, and which mechanism each scene would miss most."""
    rows = []
    for scene in scenes:
        whole, *others = scene.base
        missed = sorted(scene.without, key=lambda name: -scene.without[name].effort)[:3]
        rows.append(
            [
                scene.name,
                scene.about.partition(": ")[2],
                ", ".join(f"{one.rel:.2%}" for one in (whole, *others)),
                f"{whole.honesty:.2f}",
                f"{whole.cpu_s:.1f}",
                ", ".join(f"{name} {scene.without[name].effort / whole.effort:.1f}" for name in missed),
            ]
        )
    return Table(("scene", "what it is", "rel, each seed", "stated / real", "CPU s", "error² x CPU s most without"), rows)
