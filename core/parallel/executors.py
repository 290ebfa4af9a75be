"""Executors of shards: in this process alone, in several processes of this machine, or on a cluster."""

import atexit
import multiprocessing
import os
import pickle
import select
import signal
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from functools import partial
from itertools import islice, starmap
from pathlib import Path
from typing import Any, TypeVar

from ..util.settings import Settings
from ..util.threads import count_usable, is_alone

T = TypeVar("T")

# Greatest result that a pipe takes atomically, together with what a pool adds. Source: POSIX, write() of {PIPE_BUF} bytes
_AT_ONCE = getattr(select, "PIPE_BUF", 512) - 256


def start_process(load_ahead: Callable[[], None]) -> None:
    """Set up the process before its first call; `load_ahead` loads what calls will need."""
    atexit.register(os._exit, 0)  # skips the interpreter's shutdown, which would take time; the system frees everything
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the main process decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a fork inherits the main process's handler
    load_ahead()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Exit with the main process: if that is killed, it cannot announce the end of work, and its workers would wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()  # forks hold the pipes of earlier ones open, so they end in reverse order
        os._exit(1)


def time_call(run: Callable[[], T]) -> tuple[T, float, float]:
    """The result of `run`, its wall seconds, and the CPU seconds of this process meanwhile."""
    begin, cpu_begin = time.perf_counter(), time.process_time()
    result = run()
    return result, time.perf_counter() - begin, time.process_time() - cpu_begin


def keep_result(run: Callable[[], Any], folder: str) -> bytes | str:
    """The pickled result of `run`; or, if a pipe would not take it atomically, the name of a file with it.

    If a process were killed while it writes to the pipe, the main process would wait for the rest for ever, since it holds the pipe open
    itself. And a full pipe would block this process until the main one, which also traces, reads it.
    """
    result = pickle.dumps(run(), pickle.HIGHEST_PROTOCOL)
    if len(result) <= _AT_ONCE:
        return result
    try:
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            file.write(result)
    except OSError:  # the disk is full
        return result
    return file.name


def fetch_result(kept: bytes | str) -> Any:
    """The result of keep_result; its file is removed."""
    if isinstance(kept, bytes):
        return pickle.loads(kept)
    file = Path(kept)
    result = file.read_bytes()
    file.unlink()
    return pickle.loads(result)


_MOST_PER_CORE = 4  # greatest number of processes per core: more slow each other down, and a thousand would stop the machine
_MOST_ON_WINDOWS = 61  # processes of a pool, which waits for all at once. Source: WaitForMultipleObjects, less two handles of its own


class BusyTime:
    """Seconds that the processes of this machine spent in calls, by function name."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seconds: dict[str, float] = {}
        self.lent_cpu_s = 0.0  # CPU seconds of calls in other processes than this one

    def add(self, run: Callable[[], Any], seconds: float, lent_cpu_s: float = 0.0) -> None:
        """Add the seconds of a call `run`, and its CPU seconds if another process ran it."""
        name = getattr(run.func if isinstance(run, partial) else run, "__name__", "other")
        with self._lock:
            self._seconds[name] = self._seconds.get(name, 0.0) + seconds
            self.lent_cpu_s += lent_cpu_s

    def run(self, run: Callable[[], T]) -> T:
        """Run a call, add its time, and return its result."""
        result, seconds, _ = time_call(run)
        self.add(run, seconds)
        return result

    def read(self) -> dict[str, float]:
        """Seconds so far."""
        with self._lock:
            return dict(self._seconds)

    def read_cpu_s(self) -> float:
        """CPU seconds of this process since its start, plus those of calls in other processes."""
        return time.process_time() + self.lent_cpu_s


class ShardExecutor(Executor):
    """An executor of shards. What only a LocalExecutor can do is done by this process, or not at all.

    busy       seconds of calls on this machine
    is_awake   whether other processes of this machine are starting, or have started
    """

    is_awake = False

    def __init__(self) -> None:
        self.busy = BusyTime()

    @property
    def idle(self) -> int:
        """Number of processes of this machine, including this one, that would begin new calls at once; 1 if any other is busy."""
        return 1

    def wake(self) -> None:
        """Start processes of this machine before they have work; starting takes as long as reading a scene."""

    def on_each(self, fn: Callable[..., Any], /, *args: Any) -> None:
        """Run `fn` in each of the other processes of this machine, in the background; the results are dropped."""

    def set_apart(self, run: Callable[[], T]) -> Callable[[], T]:
        """Give a long call to another process of this machine, which gets no other call meanwhile. Returns a function for its result, which
        runs the call itself if no process was ready.
        """
        return run

    def spread(self, fn: Callable[..., T], calls: Iterable[tuple[Any, ...]]) -> Iterator[T]:
        """Results of `fn` for each tuple of arguments, in order. A few calls are submitted at once, and more as results are read, which
        bounds the memory of arguments.

        Processes of this machine run them, not threads: with numpy's brief calls on short arrays, threads slow each other down.
        """
        return starmap(fn, calls)

    def send_home(self) -> None:
        """End the other processes of this machine in the background; all calls must be done, and no more may follow."""


class InlineExecutor(ShardExecutor):
    """Runs each call at once, in this process: the executor of a single worker."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        _settle(future, partial(self.busy.run, partial(fn, *args, **kwargs)))
        return future

    def map(self, fn: Callable[..., T], *iterables: Iterable[Any], timeout: float | None = None, chunksize: int = 1) -> Iterator[T]:
        """Run each call when its result is read, so that the reader sees progress, and work ends when it stops reading."""
        return (self.submit(fn, *arguments).result() for arguments in zip(*iterables, strict=False))


def _load_nothing() -> None:
    """Default for processes that load nothing before their first call."""


def open_executor(settings: Settings, load_ahead: Callable[[], None] = _load_nothing) -> ShardExecutor:
    """The executor that the settings select, whose processes first call `load_ahead`; close it with shutdown().

    Raises ValueError or OSError with a sentence if a cluster is selected and cannot be used.
    """
    if not settings.cluster:
        return make_executor(settings.workers, load_ahead=load_ahead)
    try:
        from . import cluster  # dask is an optional dependency
    except ImportError as reason:
        raise ValueError(
            f"--cluster {settings.cluster}: dask.distributed cannot be loaded ({reason}); install Leaflight with its extra `cluster`, "
            f"or into this Python: {sys.executable} -m pip install 'dask[distributed]'."
        ) from reason
    return cluster.connect(settings.cluster)


class Ahead:
    """Processes that start before the settings are known; if this process has no threads yet, they are forked from it.

    Always close them, however the bake ends: a pool that is garbage collected just as one of its processes dies may deadlock (CPython
    3.13.0, _ExecutorManagerThread.terminate_broken).
    """

    def __init__(self, load_ahead: Callable[[], None] = _load_nothing) -> None:
        copied = is_alone()
        self._load_ahead = load_ahead
        self._executor = make_executor(0, copied, load_ahead)
        if copied:
            self.wake()

    def wake(self) -> None:
        """Start processes that are not forked, and so have to load all modules."""
        self._executor.wake()

    def open(self, settings: Settings) -> ShardExecutor:
        """The executor for the settings, which uses these processes if possible."""
        if not settings.cluster and count_processors(settings.workers) == count_processors(0):
            return self._executor
        self.close()
        return open_executor(settings, self._load_ahead)

    def close(self) -> None:
        """Shut down; may be called repeatedly, also after the executor's own shutdown."""
        self._executor.shutdown(cancel_futures=True)


def count_processors(workers: int) -> int:
    """Number of processes to use, 0 for one per core that this process may use; at most a few for each core."""
    return min(workers or count_usable(), _MOST_PER_CORE * count_usable())


def make_executor(workers: int, copied: bool = False, load_ahead: Callable[[], None] = _load_nothing) -> ShardExecutor:
    """An executor of `workers` processes of this machine, including this one, 0 for one per core; close it with shutdown().

    copied   whether the others are forked from this process, which must then have no threads until they are awake
    """
    count = count_processors(workers)
    return InlineExecutor() if count == 1 else LocalExecutor(count, copied, load_ahead)


class _Call(Future[Any]):
    """A call that the reader of its result may run itself."""

    def __init__(self, help_out: Callable[[], bool], run: Callable[[], Any]) -> None:
        super().__init__()
        self._help_out, self.run = help_out, run

    def result(self, timeout: float | None = None) -> Any:
        while not self.done() and self._help_out():
            pass
        return super().result(timeout)


class _Answers(Iterator[T]):
    """Results of calls in order, made so many ahead. When it is dropped, the rest is cancelled, even before the first was read."""

    def __init__(self, calls: Iterator[Future[T]], most_ahead: int | None = None) -> None:
        self._calls, self._begun = calls, deque[Future[T]]()
        self._begun.extend(islice(calls, most_ahead))

    def __next__(self) -> T:
        self._begun.extend(islice(self._calls, 1))
        if not self._begun:
            raise StopIteration
        return self._begun.popleft().result()

    def __del__(self) -> None:
        for call in self._begun:
            call.cancel()


class LocalExecutor(ShardExecutor):
    """Runs calls in several processes of this machine. This process is one of them: it runs pending calls while it waits for a result.

    So no call waits for a process that is still starting, and two workers need only one new process.
    """

    def __init__(self, count: int, copied: bool = False, load_ahead: Callable[[], None] = _load_nothing) -> None:
        # A fork has all modules loaded at once, but if this process had threads, as embree's, their data would be in an unknown state.
        context = multiprocessing.get_context("fork" if copied else "spawn")
        super().__init__()
        self._others = min(count - 1, _MOST_ON_WINDOWS) if sys.platform == "win32" else count - 1
        self.most_ahead = 2 * (self._others + 1)
        self._pool = ProcessPoolExecutor(self._others, mp_context=context, initializer=start_process, initargs=(load_ahead,))
        self._waiting: deque[_Call] = deque()
        self._turn = threading.Lock()  # guards _ready and _given
        self._closed = False
        self._ready = 0  # other processes that have started
        self._given = 0  # calls in the other processes
        self._results = tempfile.TemporaryDirectory(prefix="leaflight_", ignore_cleanup_errors=True)
        self._leaving: threading.Thread | None = None
        self._lost: BaseException | None = None  # the error of a killed process, after which no call can run

    @property
    def idle(self) -> int:
        return 1 if self._given or self._waiting else self._ready + 1

    def wake(self) -> None:
        if not self.is_awake:
            self.is_awake = True
            for _ in range(self._others):
                self._pool.submit(os.getpid).add_done_callback(self._greet)

    def _greet(self, sent: Future[int]) -> None:
        self._note_loss(sent)
        with self._turn:
            self._ready += 1
        self._feed()

    def _note_loss(self, sent: Future[Any]) -> None:
        """Record a broken pool, since a later submit would wait for a lock that the pool holds while it reports the error."""
        if not sent.cancelled() and isinstance(sent.exception(), BrokenExecutor):
            self._lost = sent.exception()

    def on_each(self, fn: Callable[..., Any], /, *args: Any) -> None:
        self.wake()
        for _ in range(self._others):
            self._pool.submit(fn, *args)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if self._closed:
            raise RuntimeError("a call was submitted after the executor's shutdown")
        self.wake()
        call = _Call(self._help_out, partial(fn, *args, **kwargs))
        self._waiting.append(call)
        self._feed()
        return call

    def map(self, fn: Callable[..., T], *iterables: Iterable[Any], timeout: float | None = None, chunksize: int = 1) -> Iterator[T]:
        """Submit all calls at once."""
        return _Answers(self.submit(fn, *arguments) for arguments in zip(*iterables, strict=False))

    def set_apart(self, run: Callable[[], T]) -> Callable[[], T]:
        with self._turn:
            if not self._ready or self._lost:
                return run
            self._ready -= 1
        call = _Call(self._help_out, run)
        self._send(call, apart=True)
        return call.result

    def spread(self, fn: Callable[..., T], calls: Iterable[tuple[Any, ...]]) -> Iterator[T]:
        return _Answers((self.submit(fn, *arguments) for arguments in calls), self.most_ahead)

    def send_home(self) -> None:
        self._leaving = threading.Thread(target=self._pool.shutdown)
        self._leaving.start()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._closed = True
        for call in list(self._waiting) if cancel_futures else ():
            call.cancel()
        while wait and self._help_out():
            pass
        if wait and self._leaving:
            self._leaving.join()
        self._pool.shutdown(wait, cancel_futures=cancel_futures)
        self._results.cleanup()

    def _take(self) -> _Call | None:
        """The first pending call."""
        while True:
            try:
                call = self._waiting.popleft()
            except IndexError:
                return None
            if call.set_running_or_notify_cancel():
                return call

    def _help_out(self) -> bool:
        """Run a pending call here; False when there is none."""
        call = self._take()
        if call is not None:
            if self._lost:
                call.set_exception(self._lost)
            else:
                _settle(call, partial(self.busy.run, call.run))
        return call is not None

    def _feed(self) -> None:
        """Give each other process a call, and while many are pending, one more in reserve; the last ones stay for this process too."""
        while True:
            with self._turn:
                most = self._ready * (2 if len(self._waiting) > self._others + 1 else 1)
                call = self._take() if self._given < most and not (self._lost or self._closed) else None
                if call is None:
                    return
                self._given += 1
            if not self._send(call):
                self._release()

    def _send(self, call: _Call, apart: bool = False) -> bool:
        """Send the call to another process; returns whether that succeeded."""
        try:
            sent = self._pool.submit(keep_result, partial(time_call, call.run), self._results.name)
            sent.add_done_callback(partial(self._receive, call, apart))
        except RuntimeError as error:  # a process was killed, or all were ended
            call.set_exception(error)
            return False
        return True

    def _release(self, apart: bool = False) -> None:
        """Count a process's call as done."""
        with self._turn:
            if apart:
                self._ready += 1
            else:
                self._given -= 1

    def _receive(self, call: _Call, apart: bool, sent: Future[bytes | str]) -> None:
        self._release(apart)
        self._note_loss(sent)
        self._feed()  # first, so that it works while the result is read
        _settle(call, lambda: self._unpack(call, sent))

    def _unpack(self, call: _Call, sent: Future[bytes | str]) -> Any:
        result, *seconds = fetch_result(sent.result())
        self.busy.add(call.run, *seconds)
        return result


def _settle(future: Future[Any], run: Callable[[], Any]) -> None:
    try:
        future.set_result(run())
    except Exception as error:  # the executor passes every error to the reader of the result
        future.set_exception(error)
