"""Charts of the last bake, kept beside its images, so that a bake with other lamps or colours need not wait for xatlas.

Their key is a digest of everything that they depend on, including the code. A file holds the charts of one bake; the next one replaces it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float64, Int64, IntArray
from ..util.digest import hash_code, hash_pieces
from ..util.file_names import clean_name
from ..util.files import load_arrays, save_whole
from ..util.job import Job
from .unwrap import Unwrapping

Charts: TypeAlias = tuple[Int64, Float64, BoolArray]  # results of Unwrapping.finish

_ROW = np.dtype([("chart", np.int32), ("uv", np.float64, (3, 2)), ("shared", np.bool_, 3)])  # one triangle


@dataclass(frozen=True)
class PendingCharts:
    """Charts of some objects, from xatlas or from the cache: finish(watch) as Unwrapping.finish; cancel() gives them up."""

    finish: Callable[[Callable[[int, int], None]], Charts]
    cancel: Callable[[], None] = lambda: None


def find_charts_file(job: Job) -> Path:
    """The file in which the charts of a job are kept."""
    return Path(job.output) / f".leaflight_{clean_name(job.atlas_name)}.charts"


class ChartCache:
    """The charts of an earlier bake, and those of the current one.

    known   number of objects whose charts came from the earlier bake
    """

    def __init__(self, earlier: dict[str, NDArray[np.void]] | None = None) -> None:
        self._earlier = earlier or {}
        self._own: dict[str, NDArray[np.void]] = {}
        self.known = 0

    @classmethod
    def load(cls, file: Path) -> ChartCache:
        """The charts that a bake saved in `file`; none if it is missing or damaged, since xatlas can make them again."""
        try:
            return cls({key: rows for key, rows in load_arrays(file).items() if _is_sound(rows)})
        except (OSError, ValueError):
            return cls()

    def begin(
        self, tri_position: Float64, tri_vertex: IntArray, tri_polygon: IntArray, tri_corner: IntArray, tri_object: IntArray
    ) -> PendingCharts:
        """Begin to make the charts of some objects, unless they are known; arguments are as for Unwrapping."""
        # Labels start at numbers that depend on earlier objects, which has no effect on the charts.
        labels = [label - label.min(initial=label.max(initial=0)) for label in (tri_vertex, tri_polygon, tri_corner, tri_object)]
        arrays = [np.ascontiguousarray(tri_position), *(np.ascontiguousarray(label, np.int64) for label in labels)]
        key = hash_pieces([hash_code().encode(), *(array.reshape(-1).view(np.uint8).data for array in arrays)])
        rows = self._earlier.get(key)
        if rows is not None:
            self._own[key] = rows
            self.known += len(np.unique(tri_object))
            charts = rows["chart"].astype(np.int64), rows["uv"].copy(), rows["shared"].copy()
            return PendingCharts(lambda watch: charts)
        unwrapping = Unwrapping(tri_position, tri_vertex, tri_polygon, tri_corner, tri_object)

        def finish(watch: Callable[[int, int], None]) -> Charts:
            charts = unwrapping.finish(watch)
            self._own[key] = found = np.empty(len(charts[0]), _ROW)
            found["chart"], found["uv"], found["shared"] = charts
            return charts

        return PendingCharts(finish, unwrapping.cancel)

    def save(self, file: Path, is_whole: bool = True) -> None:
        """Save the charts of the current bake.

        is_whole   whether it has all of its charts; if not, those of the earlier bake are kept too
        Raises OSError if the file cannot be written.
        """
        kept = self._own if is_whole else self._earlier | self._own
        if kept.keys() != self._earlier.keys():
            save_whole(file, kept)


def _is_sound(rows: NDArray[Any]) -> bool:
    """Whether rows from a file are charts with valid indices and finite UVs."""
    if rows.dtype != _ROW or rows.ndim != 1:
        return False
    chart = rows["chart"].astype(np.int64)
    return bool(np.isfinite(rows["uv"]).all() and (chart >= -1).all() and (chart < len(rows)).all())
