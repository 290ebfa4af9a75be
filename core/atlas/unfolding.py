"""Client of xatlas, which runs in a child process (xatlas_process says why). This module loads fast."""

from __future__ import annotations

import os
import pickle
import queue
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, wait
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from .xatlas_process import Mesh, Unfolded

_Questions: TypeAlias = "queue.SimpleQueue[tuple[Future[list[Unfolded]], list[Mesh], float, bool]]"

_PROGRAM = Path(__file__).with_name("xatlas_process.py")
# The child gets this process's sys.path. It runs a script, since a module of the package would load the core.
_BOOT = "import runpy, sys; sys.path[:] = sys.argv[2:]; runpy.run_path(sys.argv[1], run_name='__main__')"
_MOST_ATLASES = 64  # that a child keeps, each with a thread per core
_MOST_TRIANGLES = 100_000  # that a child keeps, about 1 kB each
_SPARE_FROM = 0.5  # the next child is started at this share of both limits, so that it has loaded when it is needed
_WATCH_S = 0.2  # between two checks for cancellation
_TRIES = 3  # of a request that ends the child, since most crashes are random


class UnfolderDied(RuntimeError):
    """The child ended without a result; the arguments are its return code and, if known, the object of the request."""


def wait_for(answer: Future[list[Unfolded]], watch: Callable[[], None]) -> list[Unfolded]:
    """Wait for the result of Unfolder.ask; `watch` is called regularly meanwhile, and may raise."""
    while not wait((answer,), _WATCH_S).done:
        watch()
    return answer.result()


def own_unfolder() -> Unfolder:
    """The unfolder of this process; after a fork the new process gets one of its own."""
    return _unfolder_of(os.getpid())


@lru_cache(maxsize=1)
def _unfolder_of(process_id: int) -> Unfolder:
    return Unfolder()


class Unfolder:
    """Manages the child: it starts at the first mesh, is replaced when it keeps too much, and ends with this process at the latest."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._kill: Callable[[], object] = lambda: None
        self._spare: tuple[subprocess.Popen[bytes], Callable[[], object]] | None = None  # the next child, and the function that kills it
        self._atlases = self._triangles = 0
        self._given_up = False  # the pending result is not needed

    @cached_property
    def _questions(self) -> _Questions:
        """The queue of requests, created with the thread that serves it at the first use: before that, the process can be forked."""
        questions: _Questions = queue.SimpleQueue()
        threading.Thread(target=self._answer_all, args=(questions,), daemon=True).start()
        return questions

    def start(self) -> None:
        """Start the child if there is none, so that it has loaded before the first mesh."""
        with self._lock:
            self._find_child()

    def ask(self, meshes: list[Mesh], area: float, dense: bool) -> Future[list[Unfolded]]:
        """Request charts and UVs of meshes from xatlas; the charts of all meshes lie side by side. Requests are served in order.

        meshes    each (n_vertex, 3) float32 and (n, 3) uint32, whose median triangle has an area of about 1
        area      total area of the meshes
        dense     whether the meshes have so many triangles that growing large charts takes long
        out       future of, for each mesh, (n,) int32 chart, -1 if xatlas left it out, and (n, 3, 2) float64 UV of any scale
        Its result raises ValueError if xatlas cannot be loaded, UnfolderDied if it crashes.
        """
        answer: Future[list[Unfolded]] = Future()
        self._questions.put((answer, meshes, area, dense))
        return answer

    def give_up(self, answer: Future[list[Unfolded]]) -> None:
        """Give up a result of `ask`. If the child works on it, it is killed, which is the only way to stop it."""
        if not answer.cancel() and not answer.done():
            self._given_up, child = True, self._child
            if child:
                child.kill()

    def _answer_all(self, questions: _Questions) -> None:
        while True:
            answer, meshes, area, dense = questions.get()
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                answer.set_result(self.unfold(meshes, area, dense))
            except Exception as reason:  # raised where the result is read
                answer.set_exception(reason)

    def unfold(self, meshes: list[Mesh], area: float, dense: bool) -> list[Unfolded]:
        """As `ask`, but waits for the result."""
        with self._lock:
            self._given_up = False
            for _ in range(_TRIES - 1):
                try:
                    return self._unfold(meshes, area, dense)
                except UnfolderDied:
                    if self._given_up:
                        raise
            return self._unfold(meshes, area, dense)

    def _unfold(self, meshes: list[Mesh], area: float, dense: bool) -> list[Unfolded]:
        child = self._find_child()
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            pickle.dump((meshes, area, dense), child.stdin, pickle.HIGHEST_PROTOCOL)
            child.stdin.flush()
            answer: list[Unfolded] | str = pickle.load(child.stdout)
        except (EOFError, OSError, pickle.UnpicklingError) as reason:
            self._kill()
            raise UnfolderDied(child.returncode) from reason
        except BaseException:  # interrupted; the pending result must not be read as that of the next request
            self._kill()
            raise
        if isinstance(answer, str):
            raise ValueError(
                f"The unwrapper xatlas cannot be loaded ({answer}); reinstall Leaflight with the package for this platform and Python "
                "(Linux x64, Windows x64, or macOS), or choose an existing UV layer."
            )
        self._atlases += 1
        self._triangles += sum(len(triangles) for _, triangles in meshes)
        kept = max(self._atlases / _MOST_ATLASES, self._triangles / _MOST_TRIANGLES)
        if kept >= 1.0:
            self._kill()
        elif kept >= _SPARE_FROM and not self._spare:
            self._spare = self._start()
        return answer

    def _find_child(self) -> subprocess.Popen[bytes]:
        while not self._child or self._child.poll() is not None:
            (self._child, self._kill), self._spare = self._spare or self._start(), None
            self._atlases = self._triangles = 0
        return self._child

    def _start(self) -> tuple[subprocess.Popen[bytes], Callable[[], object]]:
        flags = ["-S", "-P", *(["-E"] if sys.flags.ignore_environment else []), *(["-B"] if sys.dont_write_bytecode else [])]
        paths = [os.path.abspath(path) for path in sys.path]
        child = subprocess.Popen(
            [sys.executable, *flags, "-c", _BOOT, str(_PROGRAM), *paths],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # opens no console on Windows
        )
        return child, weakref.finalize(self, _kill, child)  # runs once; at the latest when this process ends


def _kill(child: subprocess.Popen[bytes]) -> None:
    child.kill()
    child.communicate()
