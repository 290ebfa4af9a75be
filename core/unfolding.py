"""xatlas, in a child process; the only module that knows it, and the child's main program.

When an atlas of xatlas is destroyed, it joins its threads. It tells them to wake up without holding the lock that they fall
asleep under, so that the call is lost on one that is just doing so, and then the join never ends; there is no way to wait for their
sleep. So no atlas is ever destroyed: the child keeps all of its own and is killed, which gives their threads and memory back.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable
from functools import lru_cache
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

Mesh: TypeAlias = tuple[NDArray[np.float32], NDArray[np.uint32]]
Unfolded: TypeAlias = tuple[NDArray[np.int32], NDArray[np.float64]]

_RASTER_TEXELS = 512  # xatlas packs what we only want unfolded; this many texels a side cost it little and keep its UVs exact to 1e-4
_MAX_RASTER_TEXELS = 2048  # a long thin chart is drawn no longer than this, to bound memory
# The child finds packages where this process does, and is no package itself, lest it load the core.
_BOOT = "import runpy, sys; sys.path[:] = sys.argv[2:]; runpy.run_path(sys.argv[1], run_name='__main__')"
_MOST_ATLASES = 64  # that a child keeps, each with a thread per core
_MOST_TRIANGLES = 100_000  # that a child keeps, about 1 kB each


class UnfolderDied(RuntimeError):
    """The child ended without an answer; its return code."""


def unfold_meshes(meshes: list[Mesh], area: float) -> list[Unfolded]:
    """Charts and UVs of meshes, by xatlas; the charts of all of them lie side by side.

    meshes   each (n_vertex, 3) float32 and (n, 3) uint32, whose usual triangle has an area of about 1
    area     of all of them
    out      for each (n,) int32 chart, -1 where it is left out, and (n, 3, 2) float64 UV, of any scale and proportion
    Raises ValueError when xatlas cannot be loaded, UnfolderDied when it crashes.
    """
    answer = _own_unfolder(os.getpid()).unfold(meshes, area)
    if isinstance(answer, str):
        raise ValueError(
            f"The unwrapper xatlas cannot be loaded ({answer}); reinstall Leaflight with the package for this platform and Python "
            "(Linux x64, Windows x64, or macOS), or choose an existing UV layer."
        )
    return answer


def start_ahead() -> None:
    """Starts the child before there is a mesh, so that it has loaded by then."""
    _own_unfolder(os.getpid()).start()


@lru_cache(maxsize=1)
def _own_unfolder(process_id: int) -> Unfolder:
    """A process keeps one; not that of the process it was forked from."""
    return Unfolder()


class Unfolder:
    """The child, started when there is a mesh for it, and anew when it has kept enough; it ends with this process at the latest."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._kill: Callable[[], object] = lambda: None
        self._atlases = self._triangles = 0

    def start(self) -> None:
        """Start the child if there is none."""
        with self._lock:
            self._find_child()

    def _find_child(self) -> subprocess.Popen[bytes]:
        return self._child if self._child and self._child.poll() is None else self._start()

    def unfold(self, meshes: list[Mesh], area: float) -> list[Unfolded] | str:
        """See unfold_meshes; why xatlas cannot be loaded, where it cannot."""
        with self._lock:
            child = self._find_child()
            assert child.stdin is not None
            assert child.stdout is not None
            try:
                pickle.dump((meshes, area), child.stdin, pickle.HIGHEST_PROTOCOL)
                child.stdin.flush()
                answer: list[Unfolded] | str = pickle.load(child.stdout)
            except (EOFError, OSError, pickle.UnpicklingError) as reason:
                self._kill()
                raise UnfolderDied(child.returncode) from reason
            except BaseException:  # interrupted: its answer must not be taken for that to the next question
                self._kill()
                raise
            self._atlases += 1
            self._triangles += sum(len(triangles) for _, triangles in meshes)
            if self._atlases >= _MOST_ATLASES or self._triangles >= _MOST_TRIANGLES:
                self._kill()
            return answer

    def _start(self) -> subprocess.Popen[bytes]:
        flags = ["-S", "-P", *(["-E"] if sys.flags.ignore_environment else [])]
        paths = [os.path.abspath(path) for path in sys.path]
        self._child = subprocess.Popen(
            [sys.executable, *flags, "-c", _BOOT, __file__, *paths],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # on Windows no console flashes up
        )
        self._kill = weakref.finalize(self, _kill, self._child)  # runs once; at the latest when this process ends
        self._atlases = self._triangles = 0
        return self._child


def _kill(child: subprocess.Popen[bytes]) -> None:
    child.kill()
    child.communicate()


def _serve(questions: BinaryIO, answers: BinaryIO) -> None:
    """Answers until there are no more questions."""
    kept: list[Any] = []
    try:
        import xatlas
    except (ImportError, OSError) as reason:
        answer: list[Unfolded] | str = str(reason)
        xatlas = None
    while True:
        try:
            meshes, area = pickle.load(questions)
        except EOFError:
            return
        if xatlas is not None:
            kept.append(xatlas.Atlas())
            answer = _generate(kept[-1], xatlas.ChartOptions(), xatlas.PackOptions(), meshes, area)
        pickle.dump(answer, answers, pickle.HIGHEST_PROTOCOL)
        answers.flush()


def _generate(atlas: Any, charts: Any, packing: Any, meshes: list[Mesh], area: float) -> list[Unfolded]:
    for position, triangles in meshes:
        atlas.add_mesh(position, triangles)
    packing.bilinear, packing.create_image, packing.max_chart_size = False, False, _MAX_RASTER_TEXELS
    packing.texels_per_unit = _RASTER_TEXELS / area**0.5
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
    os.dup2(2, 1)  # what libraries print must not get between the answers
    _serve(sys.stdin.buffer, answers)
    os._exit(0)  # an end in good order would destroy the atlases


if __name__ == "__main__":
    _main()
