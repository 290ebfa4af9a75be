"""Main program of the process in which xatlas runs; the only module that imports xatlas.

A request consists of meshes, their area, and whether they are dense; the result is their charts, or the reason why xatlas cannot be loaded.
Both are pickles.

When an atlas of xatlas is destroyed, it joins its threads. It signals them to wake up without holding the lock under which they wait, so a
thread about to wait misses the signal, and the join never ends. A caller cannot wait until all threads wait. So no atlas is ever destroyed:
the process keeps all of its atlases and is killed, which releases their threads and memory.

Each mesh added to an atlas is a task in a queue that is reallocated as it grows, while a thread may be reading a task at its old address.
That race crashes about one in 500 requests with several meshes; unfolding repeats these.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

Mesh: TypeAlias = tuple[NDArray[np.float32], NDArray[np.uint32]]
Unfolded: TypeAlias = tuple[NDArray[np.int32], NDArray[np.float64]]

# xatlas also packs the charts, which we do not need, and stretches them to whole texels, which is undone. So its raster is coarse: with 512
# texels a side, sides differ from those with 32 by the rounding of float32 only, and packing takes longer than finding the charts.
_TEXELS_PER_UNIT = 0.5  # the median triangle has area 1
_RASTER_TEXELS = 512  # a side, if some triangles are much larger
# Greatest cost of a triangle that a growing chart may add. xatlas evaluates the whole chart again for each triangle, so in dense meshes
# charts should stay small while they grow; xatlas joins them afterwards. Measured: up to two thirds less time, about as many charts, and up
# to 4 % fewer texels that fit on a page; with 0.35 a sixth less time again, and 7 % fewer texels; with 0.1 it joins too few charts.
_DENSE_COST = 0.5  # xatlas's default is 2
_MAX_RASTER_TEXELS = 2048  # greatest length of a chart on the raster, to bound memory


def _serve(questions: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until there are no more."""
    kept: list[Any] = []
    try:
        import xatlas
    except (ImportError, OSError) as reason:
        answer: list[Unfolded] | str = str(reason)
        xatlas = None
    while True:
        try:
            meshes, area, dense = pickle.load(questions)
        except EOFError:
            return
        if xatlas is not None:
            kept.append(xatlas.Atlas())
            density = min(_TEXELS_PER_UNIT, _RASTER_TEXELS / area**0.5)
            charts = xatlas.ChartOptions()
            if dense:
                charts.max_cost = _DENSE_COST
            answer = _generate(kept[-1], charts, xatlas.PackOptions(), meshes, density)
        pickle.dump(answer, answers, pickle.HIGHEST_PROTOCOL)
        answers.flush()


def _generate(atlas: Any, charts: Any, packing: Any, meshes: list[Mesh], density: float) -> list[Unfolded]:
    for position, triangles in meshes:
        atlas.add_mesh(position, triangles)
    packing.bilinear, packing.create_image, packing.max_chart_size = False, False, _MAX_RASTER_TEXELS
    packing.texels_per_unit = density
    packing.rotate_charts = False  # rotation to fit beside other charts would make a chart depend on the rest of its request
    atlas.generate(charts, packing)
    if not atlas.chart_count:
        return [(np.full(len(triangles), -1, np.int32), np.zeros((len(triangles), 3, 2))) for _, triangles in meshes]
    page = np.array([atlas.width, atlas.height], np.float64)
    unfolded: list[Unfolded] = []
    for k in range(len(meshes)):
        _, corner, uv = atlas.get_mesh(k)
        chart = atlas.get_mesh_vertex_assignment(k)[1].astype(np.int32)
        unfolded.append((chart[corner[:, 0]], (uv * page)[corner]))
    return unfolded


def _main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the parent decides
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print to stdout must not mix with the answers
    _serve(sys.stdin.buffer, answers)
    os._exit(0)  # a normal exit would destroy the atlases


if __name__ == "__main__":
    _main()
