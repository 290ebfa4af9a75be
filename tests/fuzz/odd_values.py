"""Names and numbers that programs stumble over, drawn from a seed."""

from __future__ import annotations

import math
from random import Random
from typing import Any

NAMES = [
    "Wall",
    "a/b",
    "..",
    "../up",
    "//beside",
    "C:\\x",
    "-leading",
    "--objects",
    'quote"s',
    "it's",
    "new\nline",
    "tab\there",
    "nul",
    "CON",
    "%s %d",
    "{name}",
    "$HOME",
    "`id`",
    "; rm",
    " ",
    " trailing. ",
    "....",
    "x" * 63,
    "Ä" * 31,
    "😀👩‍👩‍👧",
    "e\u0301te\u0301",  # NFD
    "\u00e9t\u00e9",  # NFC, the same letters
    "\u202eright to left",
    "\ufeffmark",
    "\u0001control",
    "Wall.001",
    "wall",
]
NUMBERS = [math.nan, math.inf, -math.inf, 0.0, -0.0, -1.0, 1.0, 1e-8, 1e8, -1e8, 1e-38, 1e-45, 3e38, -3e38, 0.5]


def draw_name(rng: Random) -> str:
    """A name, every other time a plain one."""
    return f"Thing {rng.randrange(100)}" if rng.random() < 0.5 else rng.choice(NAMES)


def draw_number(rng: Random, odd: float = 0.5) -> float:
    """A number of everyday size, or with this probability an odd one."""
    return rng.choice(NUMBERS) if rng.random() < odd else rng.uniform(-2.0, 2.0)


def draw_json(rng: Random, depth: int = 2) -> Any:
    """Something that JSON can say, in Python's generous sense of it."""
    plain = [None, True, False, 0, -1, 2**70, rng.randrange(1000), draw_number(rng, 0.8), draw_name(rng), "", "../../victim.txt"]
    if depth and rng.random() < 0.4:
        inner = [draw_json(rng, depth - 1) for _ in range(rng.randrange(4))]
        return inner if rng.random() < 0.5 else {draw_name(rng): one for one in inner}
    return rng.choice(plain)
