"""What a process does that is given calls: how it begins and ends, as a copy too, and how it hands over what they give."""

import os
import signal
import subprocess
import sys
from functools import partial

import pytest
from leaflight.addon.app import boot
from leaflight.core.parallel import executors
from processes import is_alive, wait_for_end

# A main process of one thread, with a copy of it, which is asked for some lines of Python. Numpy would start threads of its own.
PROGRAM = """
import atexit, os, pathlib, runpy, signal, sys, threading, time
runpy.run_path(sys.argv[1], run_name="boot")
from leaflight.core.parallel import executors
signal.signal(signal.SIGTERM, lambda *_: None)
atexit.register(lambda: print("main" if os.getpid() == main else "copy", flush=True))
main = os.getpid()
executor = executors.make_executor(int(sys.argv[2]), copied=True)
executor.wake()
while executor._ready < executor._others:
    time.sleep(0.01)
"""
needs_copies = pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux alone")


def test_large_results_come_by_files_that_are_taken_away(tmp_path):
    kept = executors.keep_result(partial(range, 10), str(tmp_path))
    assert isinstance(kept, bytes)
    assert executors.fetch_result(kept) == range(10)
    much = executors.keep_result(partial(bytes, 1 << 20), str(tmp_path))
    assert isinstance(much, str)
    assert executors.fetch_result(much) == bytes(1 << 20)
    assert not list(tmp_path.iterdir())
    full = executors.keep_result(partial(bytes, 1 << 20), str(tmp_path / "nowhere"))  # as where there is no room
    assert executors.fetch_result(full) == bytes(1 << 20)


def run_main(lines: str, count: int = 2) -> subprocess.Popen[str]:
    """A main process that has its copies and goes on with these lines."""
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM + lines, boot.__file__, str(count)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        text=True,
    )


@needs_copies
def test_a_copy_has_what_was_loaded_and_leaves_what_is_the_main_process_s_alone():
    """As what is to be taken away at the end, which the copy knows of too."""
    with run_main("print(executor._pool.submit(eval, '__import__(\"__main__\").main').result() == main)\nexecutor.shutdown()\n") as main:
        said = main.communicate(timeout=60)[0]
    assert said.split() == ["True", "main"]


@needs_copies
def test_a_copy_ends_when_it_is_told_to_and_not_by_what_is_meant_for_the_main_process():
    # The pool waits for its processes in a thread: two that wait for one process take its exit code from each other.
    lines = """
((copy, process),) = executor._pool._processes.items()
os.kill(copy, signal.SIGINT)
print(executor._pool.submit(os.getpid).result() == copy)
waiting = executor._pool._executor_manager_thread
os.kill(copy, signal.SIGTERM)
waiting.join(30)
print(process.exitcode)
os._exit(0)
"""
    with run_main(lines) as main:
        assert main.communicate(timeout=60)[0].split() == ["True", str(-signal.SIGTERM)]


@needs_copies
def test_copies_end_with_a_main_process_that_is_killed():
    with run_main("print(*executor._pool._processes, flush=True)\nsys.stdin.read()\n", count=4) as main:
        copies = [int(pid) for pid in main.stdout.readline().split()]
        assert len(copies) == 3
        assert all(map(is_alive, copies))
        main.kill()
        left = wait_for_end(copies)
        for pid in left:
            os.kill(pid, signal.SIGKILL)
    assert left == []
