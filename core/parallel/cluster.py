"""Runs shards on the workers of a dask.distributed cluster; the only module that imports dask.

A worker reads the folders of a shard from this machine's own folder if it sees that with the same contents, else from a copy that is sent
to it. A worker that joins late, or again, reports what it lacks and is sent that.
"""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from distributed import Client, KilledWorker, Worker, get_worker
from distributed.comm import CommClosedError, get_address_host_port, resolve_address

from ..util.digest import hash_code, hash_file, hash_pieces
from . import folders
from .executors import ShardExecutor

STAMP_FILE = "content.txt"  # digest of a folder's files, within the folder
CONNECT_S, NO_WORKER_S, ASK_AGAIN_S = 10.0, 60.0, 10.0
_MOST_CALLS = 256  # in flight
_PIECE_BYTES = 1 << 26  # size of a message
_KEPT_COPIES = 8  # folders that a worker keeps, enough for a few bakes at a time
_TRIES = 20  # of one call, if each time its worker lacks the folders


@dataclass(frozen=True)
class FolderCopy:
    """Identity of a folder for workers: its path on the sending machine, and the digest of its files."""

    folder: str
    content: str


@dataclass(frozen=True)
class Missing:
    """A worker's answer if it lacks the folders of a shard."""

    worker: str
    copies: tuple[FolderCopy, ...]


def connect(address: str) -> ClusterExecutor:
    """An executor on the cluster whose scheduler is at `address`; close it with shutdown().

    Raises OSError with a sentence if it cannot be reached or has no worker; ValueError if a worker has another Leaflight.
    """
    try:
        get_address_host_port(address)  # a client would take half a minute to report the errors of these two
        resolve_address(address)
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as reason:
        raise OSError(
            f"--cluster {address}: no dask scheduler answers there ({_first_line(reason)}); start one with `dask scheduler`, "
            "and give the address that it prints, as host:port."
        ) from reason
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
        found = client.run(describe_code, on_error="return")
    except (OSError, TimeoutError) as reason:
        client.close()
        raise OSError(f"--cluster {address}: it has no workers; start some with `dask worker {address}`.") from reason
    for worker, theirs in found.items():
        if theirs != describe_code():
            client.close()
            raise ValueError(describe_stranger(worker, theirs))
    return ClusterExecutor(client, address)


class ClusterExecutor(ShardExecutor):
    """Runs calls, of one shard each, on the workers of a cluster; lost workers cost time only."""

    def __init__(self, client: Client, address: str) -> None:
        super().__init__()
        self._client, self._address = client, address
        self._threads = ThreadPoolExecutor(_MOST_CALLS)  # each waits for one call
        self._copies: dict[str, FolderCopy] = {}
        self._sending = threading.Lock()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run `fn` with one shard (see folders) on some worker."""
        shard: Any = args[0]
        return self._threads.submit(self._call, fn, shard, {name: self._copy(name, getattr(shard, name)) for name in _folder_fields(shard)})

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._threads.shutdown(wait and not cancel_futures, cancel_futures=cancel_futures)
        self._client.close()
        self._threads.shutdown(wait)

    def _copy(self, field: str, folder: str) -> FolderCopy:
        """The folder's identity, once every present worker has a copy."""
        with self._sending:
            if self._copies.get(field, FolderCopy("", "")).folder != folder:
                copy = FolderCopy(folder, stamp_folder(Path(folder), folders.FOLDER_PARTS[field]))
                with self._sentences():
                    have = self._client.run(has_copy, copy, on_error="ignore")  # workers that die or join meanwhile request it
                    self._send(copy, folders.FOLDER_PARTS[field], [worker for worker, has in have.items() if not has])
                self._copies[field] = copy
            return self._copies[field]

    def _send(self, copy: FolderCopy, parts: tuple[str, ...], to: list[str]) -> None:
        """Send a copy to workers; those whose transfer fails request it again."""
        if to:
            for pieces in read_pieces(Path(copy.folder), parts):
                self._client.run(write_pieces, copy, pieces, workers=to, on_error="ignore")
            self._client.run(finish_copy, copy, workers=to, on_error="ignore")

    def _call(self, fn: Callable[..., Any], shard: Any, copies: dict[str, FolderCopy]) -> Any:
        for _ in range(_TRIES):
            with self._sentences():
                result = self._wait(self._client.submit(run_shard, fn, shard, copies, describe_code(), pure=False))
                if not isinstance(result, Missing):
                    return result
                with self._sending:  # several calls may miss the same copy; the first sends it
                    for field, copy in copies.items():
                        if copy in result.copies and not self._has(result.worker, copy):
                            self._send(copy, folders.FOLDER_PARTS[field], [result.worker])
        raise OSError(f"--cluster {self._address}: its workers cannot keep what they are sent; make room on their disks.")

    def _has(self, worker: str, copy: FolderCopy) -> bool:
        """Whether a worker has a copy, or is gone."""
        answer = self._client.run(has_copy, copy, workers=[worker], on_error="ignore")
        return bool(answer.get(worker, True))

    def _wait(self, future: Any) -> Any:
        alone_s = 0.0
        while True:
            try:
                return future.result(timeout=ASK_AGAIN_S)
            except TimeoutError:
                alone_s = 0.0 if self._client.scheduler_info(n_workers=-1).get("workers") else alone_s + ASK_AGAIN_S
                if alone_s >= NO_WORKER_S:
                    raise OSError(f"--cluster {self._address}: all of its workers are gone; start some, and bake again.") from None

    @contextmanager
    def _sentences(self) -> Iterator[None]:
        """Turn errors of dask into sentences."""
        try:
            yield
        except KilledWorker as reason:
            raise OSError(
                f"--cluster {self._address}: several workers died over the same piece of work, most likely for lack of memory; "
                "give them more, or choose a smaller --size."
            ) from reason
        except (CancelledError, CommClosedError) as reason:
            raise OSError(f"--cluster {self._address}: its scheduler is gone; start it, and bake again.") from reason
        except ModuleNotFoundError as reason:
            raise ValueError(describe_stranger("a worker that joined", reason)) from reason


def stamp_folder(folder: Path, parts: tuple[str, ...]) -> str:
    """Digest of the files of a folder, which is also written there.

    Files are synchronised first: mapped files reach a shared drive late, but a machine that sees the digest must see their contents.
    """
    for path in _list_files(folder, parts):
        with open(path, "r+b") as file:
            os.fsync(file.fileno())
    digests = ((path.relative_to(folder).as_posix(), hash_file(path)) for path in _list_files(folder, parts))
    content = hash_pieces(text.encode() for pair in digests for text in pair)
    (folder / STAMP_FILE).write_text(content, encoding="ascii")
    return content


def _list_files(folder: Path, parts: tuple[str, ...]) -> list[Path]:
    tops = [folder / part for part in parts] if parts else [path for path in folder.iterdir() if path.name != STAMP_FILE]
    return sorted(path for top in tops for path in (top.rglob("*") if top.is_dir() else [top]) if path.is_file())


def read_pieces(folder: Path, parts: tuple[str, ...]) -> Iterator[list[tuple[str, bytes]]]:
    """The files' names and bytes, in messages of bounded size; a long file is sent in several pieces, in order."""
    message: list[tuple[str, bytes]] = []
    room = _PIECE_BYTES
    for path in _list_files(folder, parts):
        with open(path, "rb") as file:
            while True:
                piece = file.read(room)
                message.append((path.relative_to(folder).as_posix(), piece))
                room -= len(piece)
                if room:
                    break
                yield message
                message, room = [], _PIECE_BYTES
    yield message


def describe_stranger(worker: str, found: object) -> str:
    """A sentence about a worker whose describe_code() differs from ours or cannot be called."""
    return (
        f"--cluster: the worker {worker} cannot work for this bake: it has {found}, and here is {describe_code()}; "
        "install the same Leaflight with the extra `cluster`, the same numpy and the same embreex there."
    )


def _folder_fields(shard: Any) -> list[str]:
    return [name for name in folders.FOLDER_PARTS if getattr(shard, name, "")]


# The functions below run on the workers.


def describe_code() -> dict[str, str]:
    """Versions that must be equal so that results are the same to the byte."""
    return {"leaflight": hash_code(), "numpy": version("numpy"), "embreex": version("embreex")}


def has_copy(copy: FolderCopy, dask_worker: Worker) -> bool:
    """Whether this worker can read the folder."""
    return _find(copy, dask_worker) is not None


def write_pieces(copy: FolderCopy, pieces: list[tuple[str, bytes]], dask_worker: Worker) -> None:
    """Append pieces to the copy that is being sent."""
    part = _part(copy, dask_worker)
    for name, data in pieces:
        path = part / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "ab") as file:
            file.write(data)


def finish_copy(copy: FolderCopy, dask_worker: Worker) -> None:
    """Complete the copy, and remove the oldest if there are many."""
    place, part = _place(copy, dask_worker), _part(copy, dask_worker)
    if place.exists() or stamp_folder(part, ()) != copy.content:  # sent twice; or incomplete, then it is requested again
        shutil.rmtree(part)
        return
    part.rename(place)
    copies = sorted((path for path in place.parent.iterdir() if not path.suffix), key=lambda path: path.stat().st_mtime)
    for old in copies[:-_KEPT_COPIES]:
        shutil.rmtree(old, ignore_errors=True)  # files may still be mapped, which some systems do not allow


def run_shard(fn: Callable[..., Any], shard: Any, copies: dict[str, FolderCopy], code: dict[str, str]) -> Any:
    """Run `fn` with a shard; returns Missing if this worker lacks its folders."""
    worker = get_worker()
    if describe_code() != code:
        raise ValueError(describe_stranger(worker.address, describe_code()))
    found = {field: _find(copy, worker) for field, copy in copies.items()}
    lacking = tuple(copy for field, copy in copies.items() if found[field] is None)
    if lacking:
        return Missing(worker.address, lacking)
    for field, copy in copies.items():
        _OPENED[field](copy)
        if found[field] == _place(copy, worker):
            os.utime(_place(copy, worker))  # the copy that was unused for longest is removed
    return fn(replace(shard, **{field: str(path) for field, path in found.items()}) if found else shard)


def _find(copy: FolderCopy, worker: Worker) -> Path | None:
    for place in (Path(copy.folder), _place(copy, worker)):
        try:
            if (place / STAMP_FILE).read_text(encoding="ascii") == copy.content:
                return place
        except OSError:  # missing, or not readable
            continue
    return None


def _place(copy: FolderCopy, worker: Worker) -> Path:
    return Path(worker.local_directory) / "leaflight" / copy.content


def _part(copy: FolderCopy, worker: Worker) -> Path:
    """Folder of an incomplete copy, a separate one for each sender."""
    return _place(copy, worker).with_suffix(f".{hash_pieces([copy.folder.encode()])}")


@lru_cache(maxsize=1)
def _turn_to_tracing(copy: FolderCopy) -> None:
    folders.forget_folders()  # another bake's folder may have had the same name


@lru_cache(maxsize=1)
def _turn_to_view(copy: FolderCopy) -> None:
    folders.forget_views()


_OPENED = {"tracing": _turn_to_tracing, "view": _turn_to_view}


def _first_line(reason: BaseException) -> str:
    return (str(reason).splitlines() or [type(reason).__name__])[0]
