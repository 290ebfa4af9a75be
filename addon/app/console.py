"""Messages of a bake as lines on standard error."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

from ...core.util.messages import Done, Error, Message, Preview, Progress, Status, Warning_
from ...core.util.user_text import strip_subject

_NAMED = 3  # files in one line
_ENDS = {  # LightField.stopped_by -> where it ended, and what to raise
    "max_photons": ("--max-photons", "--max-photons or --error"),
    "time_limit": ("--time-limit", "--time-limit or --error"),
    "max_rays": ("the most shadow rays that a texel takes", "--error"),
}


def print_message(message: Message, quiet: bool) -> None:
    """One line for a person; with `quiet` only warnings and errors."""
    line = _line(message, quiet)
    if line:
        print(f"leaflight: {escape_controls(line)}", file=sys.stderr, flush=True)


def escape_controls(text: str) -> str:
    """The text on one line: names in a file may hold line ends, and codes that a terminal would obey."""
    return "".join(letter if letter.isprintable() else letter.encode("unicode_escape", "backslashreplace").decode() for letter in text)


def _line(message: Message, quiet: bool) -> str:
    match message:
        case Warning_(subject, text):
            return f"warning: {subject}: {strip_subject(text, subject)}" if subject else f"warning: {text}"
        case Error(text):
            return f"error: {text}"
        case Status(text=text) if not quiet:
            return text
        case Progress() if not quiet:
            return describe_progress(message)
        case Status() | Progress() | Preview() | Done():
            return ""


def describe_miss(stopped_by: str, error: float, asked: float) -> str:
    """A sentence about a bake that ended before it had the relative error asked for; "" where it has."""
    if stopped_by not in _ENDS or error <= asked:
        return ""
    end, remedy = _ENDS[stopped_by]
    percent = (100.0 * error, 100.0 * asked)
    digits = next((n for n in range(2, 9) if f"{percent[0]:.{n}g}" != f"{percent[1]:.{n}g}"), 9)
    reached, wanted = (f"{value:.{digits}g} %" for value in percent)
    found = f"with an error of {reached}" if math.isfinite(error) else "before its error could be told"
    return f"stopped at {end} {found}, where {wanted} was asked for; raise {remedy}"


def describe_files(paths: Sequence[str]) -> str:
    """Where the images of a bake are, all in one folder."""
    names = [Path(path).name for path in paths]
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{len(names)} image{'' if len(names) == 1 else 's'} in {Path(paths[0]).parent}: {', '.join(names[:_NAMED])}{more}"


def describe_progress(progress: Progress) -> str:
    """Percentage, photons a second, estimated error and time left."""
    parts = [f"{progress.fraction:4.0%}", f"{progress.photons / 1e6:.2f} M photons", f"{progress.photons_per_s / 1e6:.2f} M/s"]
    if math.isfinite(progress.estimated_error):
        parts.append(f"error {progress.estimated_error:.1%}")
    if math.isfinite(progress.seconds_left):
        parts.append(f"{progress.seconds_left:.0f} s left")
    return "  ".join(parts)
