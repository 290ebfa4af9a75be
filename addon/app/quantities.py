"""Numbers as artists write and read them: "64 M", "5 min"; no bpy here."""

from __future__ import annotations

import re

_NUMBER = r"(\d+(?:\.\d*)?|\.\d+)(?:e(\d{1,2}))?"
_COUNTS = {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9, "b": 1e9}
_SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0}


def write_count(count: int) -> str:
    """64000000 -> "64 M"; what has no short form stays whole: "1,234,567"."""
    for unit, size in (("G", 10**9), ("M", 10**6), ("k", 10**3)):
        if count >= size and count % (size // 10) == 0:
            return f"{count / size:g} {unit}"
    return f"{count:,}"


def read_count(text: str) -> int | None:
    """The number that a text says, such as "64 M", "1,000" or "2e6"; None where it says none."""
    found = re.fullmatch(_NUMBER + r"\s*([a-z]?)(?:\s*photons)?", text.replace(",", "").strip().lower())
    if not found or found[3] not in _COUNTS:
        return None
    return round(_join(found) * _COUNTS[found[3]])


def read_number(text: str) -> float | None:
    """The number that a text says; None where it says none."""
    found = re.fullmatch(_NUMBER, text.strip().lower())
    return _join(found) if found else None


def write_duration(seconds: float) -> str:
    """90 -> "1.5 min"."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= size and seconds % (size / 10.0) == 0.0:
            return f"{seconds / size:g} {unit}"
    return f"{seconds:g} s"


def read_duration(text: str) -> float | None:
    """Seconds that a text says, such as "90", "5 min", "1.5 h" or "2:30"; None where it says none."""
    text = text.strip().lower()
    clock = re.fullmatch(r"(?:(\d+):)?(\d+):(\d+)", text)
    if clock:
        hours, minutes, seconds = (int(part or 0) for part in clock.groups())
        return 3600.0 * hours + 60.0 * minutes + seconds
    found = re.fullmatch(_NUMBER + r"\s*([a-z]*)", text)
    if not found or found[3] not in _SECONDS:
        return None
    return _join(found) * _SECONDS[found[3]]


def _join(found: re.Match[str]) -> float:
    return float(found[1]) * 10.0 ** int(found[2] or 0)
