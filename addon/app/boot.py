"""Main program of the child process that bakes: boot.py JOB_FOLDER. No bpy here.

Messages go to standard output, a JSON line each. On standard input "begin" says that the job is in its folder, "cancel" ends the bake
with the best so far, and the end of it, which comes when the parent is gone, ends it at once.
"""

import atexit
import contextlib
import errno
import importlib.util
import json
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor
from pathlib import Path

# A worker process imports this file again as its main module, so the package is made known at import time.
_ROOT = Path(__file__).resolve().parent.parent.parent
if "leaflight" not in sys.modules:
    _spec = importlib.util.spec_from_file_location("leaflight", _ROOT / "__init__.py", submodule_search_locations=[str(_ROOT)])
    assert _spec is not None
    assert _spec.loader is not None
    sys.modules["leaflight"] = importlib.util.module_from_spec(_spec)
    _spec.loader.exec_module(sys.modules["leaflight"])

_TRIES = 20  # to take the job's folder away
_LEAVING = threading.Lock()  # held by whoever takes it away: the process does not end before


def main(folder: Path) -> int:
    """Bake the job in `folder`; 0 done, 1 a sentence was told, 3 a fault of ours, its traceback on standard error."""
    # Blender's own options make Python ignore PYTHONPATH, so the folders of the packages come with the job.
    sys.path += json.loads((folder / "sys_path.json").read_text(encoding="utf-8"))
    tempfile.tempdir = str(folder)  # what is left where this process is ended at once is taken away with the job
    begun, stop = threading.Event(), threading.Event()

    def end(*_: object) -> None:
        if not _LEAVING.locked():  # nobody waits for pages of one that leaves
            stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    # While the parent reads the scene: what the bake will need, and first what loads beside this process.
    from leaflight.core.atlas import unfolding
    from leaflight.core.util import malloc_tuning

    malloc_tuning.keep_freed_memory(whole=True)  # before there are threads
    unfolding.own_unfolder().start()
    from leaflight.core.bake import bake, tasks
    from leaflight.core.output import image_file
    from leaflight.core.parallel import executors
    from leaflight.core.util import digest

    tasks.load_ahead()
    ahead = executors.Ahead(tasks.load_ahead)  # copies with all of that, if there are no threads yet
    try:
        threading.Thread(target=_listen, args=(folder, begun, stop), daemon=True).start()
        digest.hash_code()
        if not begun.is_set():  # with nothing to wait for, processes that are no copies would only be in the way of the first light
            ahead.wake()
        image_file.load_ahead()
        return _run_and_send(bake.run_bake, folder, begun, stop, ahead.open)
    finally:
        ahead.close()


def _run_and_send(
    run: Callable[..., None], folder: Path, begun: threading.Event, stop: threading.Event, open_executor: Callable[..., Executor]
) -> int:
    """Runs bake.run_bake once it has begun, its messages and errors to standard output; out as of main."""
    from leaflight.core.util import messages

    out = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)  # what libraries print must not get between the messages

    def send(message: messages.Message) -> None:
        out.write(messages.encode_message(message) + "\n")

    begun.wait()
    try:
        run(folder, send, stop.is_set, open_executor)
    except (ValueError, OSError, MemoryError) as reason:
        _log_fault()
        send(messages.Error(_sentence(reason, folder)))
        return 1
    except BrokenExecutor:
        _log_fault()
        send(
            messages.Error(
                "A worker of the bake was killed, most likely for lack of memory: choose a smaller page size or fewer processes."
            )
        )
        return 1
    except Exception:  # the last line of defence of a process: a fault of ours is shown whole
        _log_fault()
        return 3
    return 0


def _log_fault() -> None:
    """The traceback is kept with the job, for whoever has to find out more; where that disk is full it is lost, the sentence is not."""
    with contextlib.suppress(OSError):
        traceback.print_exc()


def _sentence(reason: ValueError | OSError | MemoryError, folder: Path) -> str:
    # Mapping a file into memory that there is not is an OSError.
    if isinstance(reason, MemoryError) or (isinstance(reason, OSError) and reason.errno == errno.ENOMEM):
        return "The bake ran out of memory: choose a smaller page size or density, or fewer processes."
    if isinstance(reason, OSError) and reason.strerror:  # the system's own words, not ours: of a file in the job's folder
        return f"{folder}: the bake's temporary files cannot be kept there ({reason.strerror}); make room, or set TMPDIR to another folder."
    return str(reason)


def _listen(folder: Path, begun: threading.Event, stop: threading.Event) -> None:
    for line in sys.stdin:
        match line.strip():
            case "begin":
                begun.set()
            case "cancel":
                stop.set()
    _leave(folder)


def _leave(folder: Path) -> None:
    """End at once, with the workers, and take the job's folder away: whoever would do so is gone."""
    with _LEAVING:
        if os.name == "posix" and os.getpgid(0) == os.getpid():  # as job.BakeProcess starts it
            os.killpg(os.getpid(), signal.SIGTERM)  # which ends the workers
        for _ in range(_TRIES):  # what they are writing comes into a new folder
            if folder.name.startswith("leaflight_"):  # as job.open_bake calls it
                shutil.rmtree(folder, ignore_errors=True)
            time.sleep(0.01)
        os._exit(4)


if __name__ == "__main__":
    _codes = [1]
    # First to be registered, so the last that is called: the others have ended processes and taken away what belongs to the system by
    # then, and to take Python apart would only keep whoever waits for this process.
    atexit.register(lambda: _LEAVING.acquire() and os._exit(_codes[-1]))
    _codes.append(main(Path(sys.argv[1])))
