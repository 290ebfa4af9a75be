"""Claims: a figure beside the bounds that are claimed of it. Tests hold them one by one, benchmarks print them in one table."""

import json
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from tables import Table

PUBLISHED = Path(__file__).resolve().parents[1] / "out" / "claims"
HEAD = ("of", "claim", "cases", "measured", "claimed", "holds")


@dataclass(frozen=True)
class Claim:
    """A measured figure and the bounds that it must lie within.

    name     "subject: what is measured"; claims of one name, for different cases, make one row of the table
    unit     follows the figures: "%", "sigmas"
    case     which of those that make the row
    points   x and y of what the figure was fitted to, for a plot
    """

    name: str
    measured: float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    case: str = ""
    points: tuple[tuple[float, float], ...] = ()

    @property
    def holds(self) -> bool:
        return self.low <= self.measured <= self.high

    @property
    def strain(self) -> float:
        """How much of what the bounds allow is used: above 1 the claim fails."""
        if not math.isfinite(self.measured):
            return math.inf
        ends = [end for end in (self.low, self.high) if math.isfinite(end)]
        scale = (self.high - self.low) / 2 if len(ends) == 2 else abs(ends[0])
        return 1 + max(self.low - self.measured, self.measured - self.high) / (scale or 1.0)

    @property
    def bound(self) -> str:
        """The bounds as text."""
        if self.low == self.high:
            return self._text(self.low)
        if math.isinf(self.low):
            return f"at most {self._text(self.high)}"
        if math.isinf(self.high):
            return f"at least {self._text(self.low)}"
        return f"{self.low:.3g} to {self._text(self.high)}"

    @property
    def texts(self) -> tuple[str, str]:
        """The figure and its bounds."""
        return self._text(self.measured), self.bound

    def __str__(self) -> str:
        return f"{self.name}{f' [{self.case}]' if self.case else ''}: {self._text(self.measured)}, claimed: {self.bound}"

    def _text(self, value: float) -> str:
        return f"{value:.3g}{' ' if self.unit else ''}{self.unit}"


def hold_claim(kept: list[Claim], claim: Claim) -> None:
    """Keep a claim, whether it holds or not; AssertionError where it does not."""
    kept.append(claim)
    assert claim.holds, str(claim)


def tabulate_claims(claims: Iterable[Claim]) -> Table:
    """A row for each name, with the case that comes closest to its bounds, or is farthest beyond them."""
    groups: dict[str, list[Claim]] = {}
    for claim in claims:
        groups.setdefault(claim.name, []).append(claim)
    rows = []
    for name, group in groups.items():
        worst = max(group, key=lambda claim: claim.strain)
        case = f" ({worst.case})" if len(group) > 1 else ""
        fails = sum(not claim.holds for claim in group)
        subject, _, what = name.partition(": ")
        rows.append(
            [subject, what, str(len(group)), worst._text(worst.measured) + case, worst.bound, f"**{fails} fail**" if fails else "yes"]
        )
    return Table(HEAD, rows)


def save_claims(claims: Sequence[Claim], path: Path) -> None:
    """Write claims for `load_claims`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(write_claims(claims), encoding="utf-8")


def load_claims(path: Path) -> list[Claim]:
    """What `save_claims` wrote."""
    return read_claims(path.read_text(encoding="utf-8"))


def write_claims(claims: Sequence[Claim]) -> str:
    """Claims as text, for `read_claims`."""
    return json.dumps([asdict(claim) for claim in claims], indent=1)


def read_claims(text: str) -> list[Claim]:
    """What `write_claims` wrote."""
    rows = json.loads(text)
    return [Claim(**{**row, "points": tuple(map(tuple, row["points"]))}) for row in rows]


def tell_failures(claims: Sequence[Claim]) -> int:
    """Exit code of a benchmark: 1, and each claim that fails on standard error, or 0; no claims at all fail too."""
    failing = [claim for claim in claims if not claim.holds]
    for claim in failing:
        print(f"FAILS  {claim}", file=sys.stderr)
    print(f"{len(claims)} claims, {len(failing)} fail", file=sys.stderr)
    return int(bool(failing) or not claims)


def publish_claims(name: str, claims: Sequence[Claim], folder: Path = PUBLISHED) -> int:
    """Print a benchmark's claims, keep them for the table of all benchmarks (print_claims.py), and give its exit code."""
    save_claims(claims, folder / f"{name}.json")
    print(tabulate_claims(claims))
    return tell_failures(claims)
