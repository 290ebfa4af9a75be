"""Shards of work as pure functions of (files, settings, round, shard), for any concurrent.futures executor.

A shard names its files; a process opens them once, mapped into memory, so that all processes share one copy. Results are
summed by the caller in the order of the shards: the same seed gives the same bytes on one process, two, or a cluster.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import contact, direct, photons, sampling, shared_arrays, tally
from .emitters import build_emitters
from .geometry import UnitBox
from .job import SNAPSHOT_FILE
from .materials import SurfaceMaterials
from .pruning import prune_scene
from .quadtree import TreeView
from .scene import IntArray, SceneSnapshot
from .settings import Settings
from .snapshot import load_snapshot
from .texel_map import TexelMap

TEXELS_FOLDER = "texels"
# A shard's fields that name folders, and what of each folder the shard reads, () all of it.
FOLDER_PARTS: dict[str, tuple[str, ...]] = {"tracing": (SNAPSHOT_FILE, TEXELS_FOLDER), "view": ()}
DIRECT_ROUND = 2**31 - 1  # of the random numbers for shadow rays: no round of photons comes that far


@dataclass(frozen=True)
class Tracing:
    """What a process needs to trace: the scene ready for rays, and where hits fall."""

    snapshot: SceneSnapshot
    unit_box: UnitBox
    scene: photons.TraceScene
    texels: TexelMap
    warnings: tuple[tuple[str, str], ...]  # subject, sentence


@lru_cache(maxsize=1)
def open_tracing(folder: str) -> Tracing:
    """The scene and texel map that were written to `folder`; a process keeps the last one open.

    Raises ValueError with a sentence when the scene has no light.
    """
    snapshot, _ = prune_scene(load_snapshot(Path(folder) / SNAPSHOT_FILE))
    unit_box = UnitBox.from_points(snapshot.vertex_position)
    surfaces = SurfaceMaterials(snapshot)
    emitters, warnings = build_emitters(snapshot, unit_box, surfaces)
    texels = shared_arrays.load_struct(Path(folder) / TEXELS_FOLDER, TexelMap)
    scene = photons.build_trace_scene(snapshot, unit_box, surfaces, emitters)
    return Tracing(snapshot, unit_box, scene, texels, tuple(warnings))


def open_scene(folder: str) -> None:
    """Open `folder` before there is work; what is wrong with it is told when there is."""
    with contextlib.suppress(ValueError, OSError):
        open_tracing(folder)


@lru_cache(maxsize=1)
def open_view(folder: str) -> TreeView:
    """The view that was written to `folder`; a process keeps the last one open."""
    return shared_arrays.load_struct(Path(folder), TreeView)


def forget_folders() -> None:
    """Close what this process keeps open, so that folders can be removed or written anew."""
    for opened in (open_tracing, open_view, _open_direct_scene):
        opened.cache_clear()


@dataclass(frozen=True)
class PhotonShard:
    """One shard of one round."""

    tracing: str  # folder
    view: str  # folder
    seed: int
    round: int
    shard: int
    photons: int
    max_depth: int
    degree: int
    skip_first: bool  # direct light comes from shadow rays


@dataclass(frozen=True)
class PhotonResult:
    """Sums and counts of one shard, each photon carrying its share of a bake with one photon."""

    tally: tally.ShardTally
    audit: photons.EnergyAudit
    counters: photons.Counters


def trace_photons(shard: PhotonShard) -> PhotonResult:
    """Trace the photons of a shard and sum them over the nodes they meet."""
    tracing, view = open_tracing(shard.tracing), open_view(shard.view)
    rng = sampling.shard_rng(shard.seed, shard.round, shard.shard)
    # How many photons the bake will have is not known yet: each carries all the light, and sums are divided when read.
    hits = photons.trace_shard(tracing.scene, shard.photons, float(shard.photons), rng, shard.max_depth, shard.skip_first)
    x, y = tracing.texels.hit_texel_xy(hits.tri, hits.u, hits.v)
    node, s, t = view.locate(tracing.texels.entry_of(hits.tri, x, y), x, y)
    sums = tally.deposit(node, s, t, hits.flux_rgb, hits.is_first, len(view.centre), shard.degree)
    return PhotonResult(sums, hits.audit, hits.counters)


@dataclass(frozen=True)
class DirectShard:
    """Shadow rays for some texel entries."""

    tracing: str  # folder
    seed: int
    turn: int  # how many times the texels have been looked at before
    start: int  # position of the shard in its turn
    texels: IntArray  # ascending
    tolerance: float  # see direct.direct_irradiance


def light_texels(shard: DirectShard) -> direct.DirectLight:
    """Direct light at the texels of a shard."""
    sub_points = open_tracing(shard.tracing).texels.sub_points
    rng = sampling.shard_rng(shard.seed, DIRECT_ROUND - shard.turn, shard.start)
    return direct.direct_irradiance(_open_direct_scene(shard.tracing), sub_points, shard.texels, rng, shard.tolerance)


@dataclass(frozen=True)
class ContactShard:
    """Texel entries start ... end - 1 that are asked whether something touches the surface there."""

    tracing: str  # folder
    start: int
    end: int


def find_contacts(shard: ContactShard) -> NDArray[np.bool_]:
    """(end - start,) bool, see contact."""
    tracing = open_tracing(shard.tracing)
    tri = tracing.texels.texel_tri[shard.start : shard.end]
    bary = tracing.texels.bary_of(shard.start, shard.end)
    position_m = np.einsum("nk,nkj->nj", bary, tracing.snapshot.tri_position[tri])
    size = np.sqrt(tracing.texels.tri_density[tri]) * tracing.unit_box.scale
    return contact.find_contacts(tracing.scene.rays, tracing.unit_box.to_unit(position_m), tracing.scene.tri_normal[:, tri].T, size)


@lru_cache(maxsize=1)
def _open_direct_scene(folder: str) -> direct.DirectScene:
    tracing = open_tracing(folder)
    return direct.DirectScene.of(tracing.scene.rays, tracing.snapshot, tracing.unit_box, tracing.scene.surfaces)


class InlineExecutor(Executor):
    """Runs each call at once, in this process: what one worker is."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        _settle(future, partial(fn, *args, **kwargs))
        return future


def open_executor(settings: Settings) -> Executor:
    """The executor that the settings ask for; close it with shutdown().

    Raises ValueError or OSError with a sentence when a cluster is asked for and cannot be used.
    """
    if not settings.cluster:
        return make_executor(settings.workers)
    try:
        from . import cluster  # dask is there only for those who use it
    except ImportError as reason:
        raise ValueError(
            f"--cluster {settings.cluster}: dask.distributed cannot be loaded ({reason}); install Leaflight with its extra `cluster`, "
            f"or into this Python: {sys.executable} -m pip install 'dask[distributed]'."
        ) from reason
    return cluster.connect(settings.cluster)


def count_processors(workers: int) -> int:
    """How many may be used at once, 0 for one per core."""
    return workers or os.cpu_count() or 1


def make_executor(workers: int) -> Executor:
    """An executor of `workers` processes of this machine, this one among them, 0 for one per core; close it with shutdown()."""
    count = count_processors(workers)
    return InlineExecutor() if count == 1 else LocalExecutor(count)


class _Call(Future[Any]):
    """A call that whoever asks for its result helps to come to."""

    def __init__(self, help_out: Callable[[], bool], run: Callable[[], Any]) -> None:
        super().__init__()
        self._help_out, self.run = help_out, run

    def result(self, timeout: float | None = None) -> Any:
        while not self.done() and self._help_out():
            pass
        return super().result(timeout)


class LocalExecutor(Executor):
    """Processes of this machine, and this one as one more of them: while it waits for a result it works on what nobody has begun.

    So little waits for processes that are still starting, and two workers are one process to start.
    """

    def __init__(self, count: int) -> None:
        # A fork would copy embree's threads in an unknown state; a spawned process starts clean on every platform.
        context = multiprocessing.get_context("spawn")
        self._others = count - 1
        self._pool = ProcessPoolExecutor(self._others, mp_context=context, initializer=_start_worker)
        self._waiting: deque[_Call] = deque()
        self._turn = threading.Lock()  # of _idle
        self._idle = self._others
        self.on_each(os.getpid)  # else they would start, which takes as long as reading a scene, when there is something to trace

    def on_each(self, fn: Callable[..., Any], /, *args: Any) -> None:
        """Have each of the other processes run `fn` while this one goes on; what it gives is dropped."""
        for _ in range(self._others):
            self._pool.submit(fn, *args)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        call = _Call(self._help_out, partial(fn, *args, **kwargs))
        self._waiting.append(call)
        self._feed()
        return call

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        for call in list(self._waiting) if cancel_futures else ():
            call.cancel()
        while wait and self._help_out():
            pass
        self._pool.shutdown(wait, cancel_futures=cancel_futures)

    def _take(self) -> _Call | None:
        """The first call that nobody has begun."""
        while True:
            try:
                call = self._waiting.popleft()
            except IndexError:
                return None
            if call.set_running_or_notify_cancel():
                return call

    def _help_out(self) -> bool:
        """Run a call here; False when all have been begun."""
        call = self._take()
        if call is not None:
            _settle(call, call.run)
        return call is not None

    def _feed(self) -> None:
        """Give the other processes a call each: a second one in reserve would be missing here at the end."""
        while True:
            with self._turn:
                call = self._take() if self._idle else None
                if call is None:
                    return
                self._idle -= 1
            try:
                self._pool.submit(call.run).add_done_callback(partial(self._receive, call))
            except RuntimeError as error:  # one of them was killed, or all were sent home
                call.set_exception(error)
                with self._turn:
                    self._idle += 1

    def _receive(self, call: _Call, sent: Future[Any]) -> None:
        with self._turn:
            self._idle += 1
        self._feed()  # first: it works while the result is looked at
        _settle(call, sent.result)


def _settle(future: Future[Any], run: Callable[[], Any]) -> None:
    try:
        future.set_result(run())
    except Exception as error:  # an executor hands every error to the one who asks for the result
        future.set_exception(error)


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the main process decides
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A main process that is killed cannot say that no more work comes: its workers would wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
