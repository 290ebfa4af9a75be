"""How long a bake took, for the estimate of the next one; kept in the .blend with what the panel says of the bake. No bpy here."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Pace:
    """How the last bake of the scene went.

    around_s   that Blender took before and after the core's work: whoever waits counts them, too
    """

    texels: int
    error: float
    error_of: str
    photon_s: float
    other_s: float
    around_s: float = 0.0

    @classmethod
    def of_result(cls, result: dict[str, Any], waited_s: float = 0.0) -> Pace | None:
        """The pace behind the result file of a bake that was waited for so long.

        None where it says too little: a bake that was kept, or gone on with.
        """
        if (
            result["resumed"]
            or result["skipped"]["bake"]
            or not math.isfinite(result["estimated_error"])
            or result["estimated_error"] <= 0.0
        ):
            return None
        texels = sum(row["texels"] for row in result["objects"])
        photon_s = result["seconds"].get("photons", 0.0)
        total_s = sum(result["seconds"].values())
        around_s = max(waited_s - total_s, 0.0)
        if not texels:
            return None
        return cls(texels, result["estimated_error"], result["error_of"], photon_s, total_s - photon_s, around_s)

    @classmethod
    def of_fields(cls, fields: Any) -> Pace | None:
        """What `dataclasses.asdict` gave, from a file; None where it is anything else, or of another version."""
        if not isinstance(fields, dict) or set(fields) != {field.name for field in dataclasses.fields(cls)}:
            return None
        numbers = [value for name, value in fields.items() if name != "error_of"]
        if not all(isinstance(value, int | float) and math.isfinite(value) and value >= 0 for value in numbers):
            return None
        return cls(**fields) if fields["texels"] and fields["error"] and isinstance(fields["error_of"], str) else None
