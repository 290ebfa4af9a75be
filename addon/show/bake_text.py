"""What the panel says of a bake that is done, and numbers as it writes them; no bpy here."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import Any

from .bake_pace import Pace

_REASONS = {"max_photons": ", stopped at Max Photons", "time_limit": ", stopped at Time Limit"}

_MATTERS = 0.005  # more error than the whole's, for an object to be named
_NEARLY_BLACK = 0.1  # share of the bake's mean light; below it the stated error of the whole counts less too (docs/units.md)
_FEW_TEXELS = 256  # with fewer, an object's error is known roughly, and more texels help it more than less noise


@dataclass(frozen=True)
class Worn:
    """What the panel says of the bake that a scene wears.

    lines      of its result
    warnings   (subject, sentence)
    worst      name of the object that one of the lines is about, "" where none is
    details    lines for those who want to know more
    pace       of the last bake of the scene that says how long the next will take
    """

    lines: tuple[str, ...] = ()
    warnings: tuple[tuple[str, str], ...] = ()
    worst: str = ""
    details: tuple[str, ...] = ()
    pace: Pace | None = None

    @classmethod
    def of_result(
        cls, result: dict[str, Any], seconds: float, kept: str, warnings: list[tuple[str, str]], earlier: Pace | None = None
    ) -> Worn:
        """Of the core's result.

        kept      the sentence in place of the time where nothing had to be baked
        earlier   the pace of the bake before it, where this one has none
        """
        leaves, photons = result["leaves"], result["photons"]
        details = f"{leaves:,} {'leaf' if leaves == 1 else 'leaves'}", f"{describe_count(photons)} photons"
        pace = Pace.of_result(result, seconds) or earlier
        return cls(tuple(summarize(result, seconds, kept)), tuple(warnings), find_worst(result), details, pace)

    def encode(self) -> str:
        """As text that a .blend can keep."""
        return json.dumps(asdict(self))

    @classmethod
    def decode(cls, text: str) -> Worn:
        """What `encode` made; nothing where the text is another version's."""
        try:
            kept = json.loads(text)
            warnings = tuple((str(subject), str(sentence)) for subject, sentence in kept["warnings"])
            lines, details = (tuple(str(line) for line in kept[name]) for name in ("lines", "details"))
            return cls(lines, warnings, str(kept["worst"]), details, Pace.of_fields(kept.get("pace")))
        except (ValueError, KeyError, TypeError):
            return cls()


def summarize(result: dict[str, Any], seconds: float, kept: str) -> list[str]:
    """Lines about the core's result of a bake that took so long; `kept` as for Worn.of_result."""
    why = result["stopped_by"]
    first = ("Stopped after " if why == "interrupted" else "Baked in ") + describe_seconds(seconds)
    error, *more = describe_error(result)
    pages, size = result["pages"], result["page_size"]
    return [
        kept if result["skipped"]["bake"] else first,
        error + _REASONS.get(why, ""),
        *more,
        f"{pages} page{'s' if pages > 1 else ''} of {size} x {size} texels",
    ]


def describe_percent(share: float) -> str:
    """An error for a person."""
    return f"{100.0 * share:.1f} %"


def describe_count(count: int) -> str:
    """A number of photons for a narrow panel."""
    if count < 1e5:
        return f"{count:,}"
    return f"{count / 1e6:.2f} M" if count < 1e7 else f"{count / 1e6:.1f} M"


def describe_seconds(seconds: float) -> str:
    """A duration for a person."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def describe_error(result: dict[str, Any]) -> list[str]:
    """Lines about the error of a bake, and of the object that errs most beside its own brightness where that is more."""
    if not math.isfinite(result["estimated_error"]):
        return ["Error not known"]
    error = f"Error {100.0 * result['estimated_error']:.1f} %"
    worst = _find_worst(result)
    each = result["error_of"] == "objects"
    first = f"{error}, of the worst object" if each else error
    if not worst:
        return [first]
    of_it = "" if each else f", {100.0 * worst['estimated_error']:.0f} %"
    return [first, f"Worst object: {worst['name']}{of_it}{_excuse(worst, result)}"]


def find_worst(result: dict[str, Any]) -> str:
    """Name of the object that `describe_error` speaks of, "" where it speaks of none."""
    worst = _find_worst(result)
    return str(worst["name"]) if worst else ""


def _find_worst(result: dict[str, Any]) -> dict[str, Any] | None:
    """The object whose error is seen most; where each object has to have the error, that of the greatest error, which held up the bake."""
    known = [one for one in result["objects"] if one["estimated_error"] is not None]
    if result["error_of"] == "objects":
        return max(known, key=lambda one: float(one["estimated_error"]), default=None)

    def find_seen(one: dict[str, Any]) -> float:
        return float(one["estimated_error"]) * min(_find_brightness(one, result) / _NEARLY_BLACK, 1.0)

    worst = max(known, key=find_seen, default=None)
    return worst if worst and find_seen(worst) > result["estimated_error"] + _MATTERS else None


def _excuse(one: dict[str, Any], result: dict[str, Any]) -> str:
    """Why a great error of an object is no alarm, "" where it is one."""
    if _find_brightness(one, result) < _NEARLY_BLACK:
        return " (nearly black)"
    return f" (only {one['texels']} texels)" if one["texels"] < _FEW_TEXELS else ""


def _find_brightness(one: dict[str, Any], result: dict[str, Any]) -> float:
    """An object's light, as a share of the mean over all texels."""
    texels = sum(other["texels"] for other in result["objects"])
    mean = sum(other["texels"] * other["lighting"] for other in result["objects"]) / max(texels, 1)
    return float(one["lighting"] / mean) if mean > 0.0 else 1.0
