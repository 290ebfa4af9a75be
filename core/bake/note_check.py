"""Validation of a bake's note, which is not trusted, since anyone may write into the folder of the images."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.scene import SceneSnapshot
from ..util.settings import ERROR_OF, IMAGE_FORMATS, PASSES


def is_sound(header: dict[str, Any]) -> bool:
    """Whether all fields of a header have their types, and its file names lead out of no folder."""
    return _fits(header, _HEADER)


def fits_scene(layout: Mapping[str, NDArray[Any]], snapshot: SceneSnapshot, pages: int) -> bool:
    """Whether the arrays of a layout file (job.LAYOUT_FILE) fit this scene."""
    n_tri, n_object = snapshot.n_tri, len(snapshot.objects)
    shapes = {
        "tri_uv": ("f", (n_tri, 3, 2)),
        "tri_chart": ("i", (n_tri,)),
        "object_page": ("i", (n_object,)),
        "object_block": ("i", (n_object,)),
        "object_place": ("f", (n_object, 4)),
    }
    for name, (kind, shape) in shapes.items():
        array = layout.get(name)
        if array is None or array.dtype.kind != kind or array.shape != shape or not np.isfinite(array).all():
            return False
    page, place = layout["object_page"], layout["object_place"]
    return bool((page >= -1).all() and (page < pages).all() and (layout["tri_chart"] >= -1).all() and (place[:, :2] > 0.0).all())


def _fits(value: Any, shape: Any) -> bool:
    """Whether a value has a shape: a type, a test, a list of one shape, or a dictionary of shapes, whose keys it must have."""
    if isinstance(shape, dict):
        return isinstance(value, dict) and all(name in value and _fits(value[name], inner) for name, inner in shape.items())
    if isinstance(shape, list):
        return isinstance(value, list) and all(_fits(one, shape[0]) for one in value)
    return isinstance(value, shape) if isinstance(shape, type) else bool(shape(value))


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 63


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_error(value: Any) -> bool:
    """An error may be infinite if it is unknown, and None for objects without one."""
    return value is None or _is_count(value) or (isinstance(value, float) and not value < 0.0)


def _is_plain(value: Any) -> bool:
    """Whether a value may occur in a report."""
    if isinstance(value, dict):
        return all(map(_is_plain, value.values()))
    if isinstance(value, list):
        return all(map(_is_plain, value))
    return isinstance(value, str | bool | None) or _is_number(value)


def _is_file_name(value: Any) -> bool:
    """Whether a value is a plain file name, on any system."""
    return isinstance(value, str) and value not in ("", ".", "..") and value == PurePosixPath(value).name == PureWindowsPath(value).name


def _is_pair_of_texts(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(isinstance(one, str) for one in value)


def _is_one_of(*choices: str) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, str) and value in choices


_HEADER: dict[str, Any] = {
    "contents": [str],
    "stateless": bool,
    "left_over": [str],
    "warnings": [_is_pair_of_texts],
    "result": {
        "files": [
            {
                "path": _is_file_name,
                "pass_name": _is_one_of(*PASSES),
                "kind": _is_one_of(*IMAGE_FORMATS),
                "page": _is_count,
                "objects": [_is_count],
                "encoding": str,
                "range": _is_number,
                "maximum": _is_number,
                "linear": _is_one_of(""),
            }
        ],
        "objects": [{"name": str, "texels": _is_count, "charts": _is_count, "estimated_error": _is_error, "lighting": _is_number}],
        "seconds": dict,
        "skipped": dict,
        "spare": _is_one_of(""),
        "photons": _is_count,
        "leaves": _is_count,
        "pages": _is_count,
        "page_size": _is_count,
        "estimated_error": lambda value: value is not None and _is_error(value),
        "error_of": _is_one_of(*ERROR_OF),
        "stopped_by": str,
        **dict.fromkeys(
            ("rounds", "rays", "direct", "gathered", "nodes", "energy_audit_w", "seams", "peak_memory_mb", "busy_seconds"), _is_plain
        ),
    },
}
