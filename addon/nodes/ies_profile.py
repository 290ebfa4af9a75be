"""IES files of lamps' light by direction: how much of it there is on the whole, as Cycles counts it."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from ...core.util.arrays import FloatArray

UNKNOWN = 100.0  # what Cycles takes without a file
PER_CANDELA = 0.0706650768394  # what a candela counts of a lamp's power. Source: Blender, intern/cycles/util/ies.cpp
_TYPE_C = 1
_STEPS = 1801  # of the angle from straight down to straight up


def find_mean(node: Any) -> float | None:
    """Mean of an IES Texture node over all directions, at a strength of 1; None of a file that cannot be read."""
    try:
        return parse_mean(_read_text(node))
    except (OSError, ValueError, IndexError):
        return None


def parse_mean(text: str) -> float:
    """The same of an IES file's text.

    Raises ValueError or IndexError where it is none, or measured in other angles than those of type C.
    Source: IES LM-63.
    """
    _, found, tail = text.partition("TILT=")
    if not found:
        raise ValueError("no TILT")
    tilt, _, rest = tail.partition("\n")
    numbers = np.array(rest.replace(",", " ").split(), np.float64)
    if tilt.strip() == "INCLUDE":
        numbers = numbers[2 + 2 * int(numbers[1]) :]
    n_vertical, n_horizontal, kind = (int(x) for x in numbers[3:6])
    if kind != _TYPE_C:
        raise ValueError("not of type C")
    factor = numbers[2] * numbers[10] * numbers[11]
    vertical, horizontal, candela = np.split(numbers[13:], [n_vertical, n_vertical + n_horizontal])
    by_angle = candela[: n_vertical * n_horizontal].reshape(n_horizontal, n_vertical)
    around = by_angle[0]
    if n_horizontal > 1:  # a half or a quarter of the circle stands for all of it
        around = np.diff(horizontal) @ (by_angle[1:] + by_angle[:-1]) / 2.0 / np.ptp(horizontal)
    return float(factor * PER_CANDELA * _mean_over_sphere(vertical, around))


def _mean_over_sphere(vertical_deg: FloatArray, value: FloatArray) -> float:
    """Of values by the angle from straight down, nothing beyond the angles that there are."""
    angle = (np.arange(_STEPS) + 0.5) / _STEPS * np.pi
    weight = np.sin(angle)
    return float(np.interp(angle, np.radians(vertical_deg), value, left=0.0, right=0.0) @ weight / weight.sum())


def _read_text(node: Any) -> str:
    if node.mode == "INTERNAL":
        if node.ies is None:
            raise ValueError("no text")
        return str(node.ies.as_string())
    with open(bpy.path.abspath(node.filepath), encoding="latin-1") as file:
        return file.read()
