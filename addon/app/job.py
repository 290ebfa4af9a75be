"""The child process that bakes, seen from Blender or from the command line; no bpy here."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...core.util.messages import Done, Error, Message, decode_message

_BOOT = Path(__file__).with_name("boot.py")
_LOG_FILE = "core.log"
# Shards are spread over processes: no product of matrices is worth threads of numpy's own, which take long to start.
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1"}
_PATIENCE_S = 10.0  # for a child that has told its last message and has only to let go of what it holds
_LEAST_ROOM_BYTES = 64_000_000  # on the disk of the code: its cache is a tenth of that
_NICE, _NICEST = 10, 19  # of a bake behind a window: it takes what drawing leaves; and the most that systems know


@contextmanager
def open_bake(python_args: tuple[str, ...]) -> Iterator[BakeProcess]:
    """A process with a new folder for its job; at the end nothing is left of both."""
    with tempfile.TemporaryDirectory(prefix="leaflight_", ignore_cleanup_errors=True) as folder:
        process = BakeProcess(Path(folder), python_args)
        try:
            yield process
        finally:
            process.close()


class BakeProcess:
    """Bakes the job in `folder`, which may come there later: the process loads meanwhile and begins when its messages are asked for.

    python_args   arguments of the interpreter, as in bpy.app.python_args
    yielding      whether it leaves the processors to others that want them, as to a window that is to be drawn
    """

    def __init__(self, folder: Path, python_args: tuple[str, ...] = (), *, yielding: bool = False) -> None:
        self.folder = folder
        self._ended = False  # Done or Error has come
        flags = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # on Windows no console flashes up
        self._log = folder / _LOG_FILE
        (folder / "sys_path.json").write_text(json.dumps([*_package_paths(), *library_paths()]), encoding="utf-8")
        with open(self._log, "wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, *python_args, *_keep_code_whole(), str(_BOOT), str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env=os.environ | _ENVIRONMENT,
                start_new_session=True,  # Ctrl-C reaches the parent only, which asks for the best so far
                creationflags=flags | (getattr(subprocess, "BELOW_NORMAL_PRIORITY_CLASS", 0) if yielding else 0),
                encoding="utf-8",
            )
        if yielding and os.name == "posix":
            _step_back(self._process.pid)

    def messages(self) -> Iterator[Message]:
        """Has the child begin, then every message until it ends, for one reader; the last one is Done or Error.

        With that the result is there: who asks for no more need not wait for the child's end.
        """
        self._say("begin")
        assert self._process.stdout is not None
        for line in self._process.stdout:
            message = decode_message(line)
            self._ended = self._ended or isinstance(message, Done | Error)
            yield message
        code = self._process.wait()
        if not self._ended:
            yield Error(self._sudden_end(code))

    def cancel(self) -> None:
        """Ask for the best so far; the messages end with Done soon after."""
        self._say("cancel")

    def _say(self, word: str) -> None:
        if self._process.poll() is None and self._process.stdin is not None:
            with contextlib.suppress(OSError):  # it has just ended by itself: a broken pipe, on Windows an invalid argument
                self._process.stdin.write(f"{word}\n")
                self._process.stdin.flush()

    def close(self) -> None:
        """End the child: in good order where it has told its last message, else at once."""
        if self._ended:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_PATIENCE_S)
                return
        self.kill()

    def kill(self) -> None:
        """End the child at once; nothing is written."""
        self._process.kill()
        if os.name == "posix":
            # Those that it started too, for it leads a session of its own; but Python's resource tracker, which this signal does not
            # end, stays to take away the semaphores of all, and ends by itself.
            with contextlib.suppress(ProcessLookupError):  # they have just ended by themselves
                os.killpg(self._process.pid, signal.SIGTERM)
        self._process.wait()

    def _sudden_end(self, code: int) -> str:
        tail = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        last = f" Its last words: {tail[-1]}" if tail else ""
        if code == -9:
            return "The baking process was killed, most likely for lack of memory: choose a smaller page size or fewer processes." + last
        return f"The baking process ended unexpectedly (code {code}): this is a fault of Leaflight's, please report it." + last


def _keep_code_whole() -> list[str]:
    """Where the disk is full, Python caches modules cut off, and no later process can load them: then it is to cache none."""
    has_room = shutil.disk_usage(_BOOT.parent).free > _LEAST_ROOM_BYTES
    return [] if has_room and not sys.dont_write_bytecode else ["-B"]


def _step_back(pid: int) -> None:
    """Give the processors to others first; before the process starts workers, which inherit it."""
    with contextlib.suppress(OSError):  # it has ended already, and messages tells of it; or the system forbids it
        # More than it has: whoever runs Blender itself with little priority is not overtaken.
        os.setpriority(os.PRIO_PROCESS, pid, min(os.getpriority(os.PRIO_PROCESS, pid) + _NICE, _NICEST))
        # A Linux desktop shares time out between sessions first, and heeds priorities only within each.
        Path(f"/proc/{pid}/autogroup").write_text(str(_NICE), encoding="ascii")


def _package_paths() -> list[str]:
    """Folders of the packages the child needs, as this process finds them."""
    paths: list[str] = []
    for package in ("numpy", "embreex", "xatlas", "OpenImageIO", "distributed"):
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.origin is not None:
            folder = Path(spec.origin).parent
            folder = folder.parent if spec.submodule_search_locations else folder
            if str(folder) not in paths:
                paths.append(str(folder))
    return paths


def library_paths() -> tuple[str, ...]:
    """Where pip's bpy keeps OpenImageIO: not on sys.path, where it has to be last, for its numpy is not ours. Nothing in Blender itself."""
    bpy = importlib.util.find_spec("bpy")
    if bpy is None or importlib.util.find_spec("OpenImageIO") is not None:
        return ()
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    places = [f"*/python/lib/{version}/site-packages", "*/python/lib/site-packages"]  # the second on Windows
    return tuple(str(site) for folder in bpy.submodule_search_locations or () for place in places for site in Path(folder).glob(place))
