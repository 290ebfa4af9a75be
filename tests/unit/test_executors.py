"""Executors, processes and threads: results in order, errors handed on, and nobody left behind."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor
from functools import partial

import pytest
from leaflight.addon.app import boot
from leaflight.core.parallel import executors
from leaflight.core.util.progress import Interrupted
from leaflight.core.util.settings import Settings
from leaflight.core.util.threads import count_usable, run_on_threads, split_entries
from processes import is_alive, wait_for_end, wait_until_ready


# Executors: results in order, errors handed on, and this process one of the workers.
def test_local_executor_hands_errors_on():
    with executors.make_executor(2) as executor, pytest.raises(ZeroDivisionError):
        list(executor.map(divmod, [1, 1], [1, 0]))


def tell_process(seconds):
    time.sleep(seconds)
    return os.getpid()


def test_nothing_waits_for_a_process_that_is_still_starting():
    with executors.LocalExecutor(2) as executor:
        assert executor.submit(os.getpid).result() == os.getpid()  # to start takes a tenth of a second at least
        wait_until_ready(executor)
        assert executor.submit(os.getpid).result() != os.getpid()


def test_a_process_that_was_killed_is_told_from_then_on():
    with executors.LocalExecutor(2) as executor:
        wait_until_ready(executor)
        assert executor.submit(os.getpid).result() != os.getpid()
        lost = executor.submit(os._exit, 1)
        with pytest.raises(BrokenExecutor):
            lost.result()
        with pytest.raises(BrokenExecutor):
            executor.submit(abs, -1).result()


def work_on(executor):
    for _ in range(500):
        executor.submit(time.sleep, 0.01).result(timeout=20)


def test_work_that_nobody_has_begun_is_cancelled():
    executor = executors.LocalExecutor(2)
    begun, *rest = [executor.submit(tell_process, 0.1) for _ in range(3)]
    executor.shutdown(cancel_futures=True)
    assert begun.done()
    assert [future.cancelled() for future in rest] == [True, True]
    with pytest.raises(RuntimeError, match="shutdown"):
        executor.submit(abs, 1).result()


def test_processes_that_are_sent_home_end_while_this_one_goes_on():
    executor = executors.LocalExecutor(2)
    wait_until_ready(executor)
    assert executor.submit(os.getpid).result() != os.getpid()
    (other,) = executor._pool._processes.values()
    executor.send_home()
    executor._leaving.join(60)  # not the process: whoever waits for it second is told nothing of how it ended
    assert not executor._leaving.is_alive()
    assert other.exitcode == 0
    with pytest.raises(RuntimeError, match="shutdown"):
        executor.submit(abs, 1).result()
    executor.shutdown()
    executors.InlineExecutor().send_home()  # there is nobody to send


@pytest.mark.parametrize("count", [1, 2])
def test_calls_are_spread_a_few_ahead_and_answered_in_order(count):
    made = []
    calls = ((made.append(k) or k,) for k in range(20))
    with executors.make_executor(count) as executor:
        found = executor.spread(float, calls)
        assert next(found) == 0.0
        assert len(made) <= 2 * count + 1
        assert list(found) == [float(k) for k in range(1, 20)]


def test_calls_are_spread_over_processes_of_this_machine_alone():
    with executors.LocalExecutor(2) as executor:
        wait_until_ready(executor)
        assert len(set(executor.spread(tell_process, [(0.02,)] * 8))) == 2

    class Elsewhere(executors.InlineExecutor):
        def submit(self, fn, /, *args, **kwargs):
            raise AssertionError("arrays would be sent over the network")

    assert set(Elsewhere().spread(os.getpid, [()] * 3)) == {os.getpid()}


@pytest.mark.parametrize(
    ("asked", "cores", "kind"), [(1, 8, executors.InlineExecutor), (0, 1, executors.InlineExecutor), (3, 1, executors.LocalExecutor)]
)
def test_one_worker_is_this_process(monkeypatch, asked, cores, kind):
    monkeypatch.setattr(executors, "count_usable", lambda: cores)
    executor = executors.make_executor(asked)
    assert isinstance(executor, kind)
    executor.shutdown()


@pytest.mark.parametrize(("system", "others"), [("win32", 61), ("linux", 127)])
def test_machines_of_many_cores_are_used_as_far_as_the_system_goes(monkeypatch, system, others):
    """On Windows a pool of more is an error."""
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(executors, "count_usable", lambda: 128)
    with executors.make_executor(0) as executor:
        assert executor._pool._max_workers == others
        assert executor.most_ahead == 2 * (others + 1)
    assert executors.count_processors(0) == 128  # threads are not bounded so


def test_no_more_processes_than_the_machine_can_do_with(monkeypatch):
    monkeypatch.setattr(executors, "count_usable", lambda: 2)
    assert [executors.count_processors(asked) for asked in (0, 1, 3, 8, 1024)] == [2, 1, 3, 8, 8]


def test_a_cluster_without_dask_is_a_sentence(monkeypatch):
    monkeypatch.setitem(executors.sys.modules, "distributed", None)
    monkeypatch.delitem(executors.sys.modules, "leaflight.core.parallel.cluster", raising=False)
    monkeypatch.delattr("leaflight.core.parallel.cluster", raising=False)
    with pytest.raises(ValueError, match=r"^--cluster farm:8786: dask\.distributed cannot be loaded .*extra `cluster`, .* -m pip install "):
        executors.open_executor(Settings(cluster="farm:8786"))


def test_a_process_that_is_killed_while_it_starts_is_told_and_nothing_hangs():
    executor = executors.LocalExecutor(2)
    executor.wake()
    for pid in list(executor._pool._processes):
        os.kill(pid, signal.SIGKILL)
    with pytest.raises(BrokenExecutor):
        work_on(executor)
    executor.shutdown()


def test_processes_started_ahead_serve_whoever_asks_for_as_many(monkeypatch):
    monkeypatch.setattr(executors, "count_usable", lambda: 2)
    ahead = executors.Ahead()
    with ahead.open(Settings(workers=2)) as executor:
        assert list(executor.map(abs, [-1, -2, -3])) == [1, 2, 3]
    ahead.close()  # after their own shutdown
    other = executors.Ahead()
    assert isinstance(other.open(Settings(workers=1)), executors.InlineExecutor)
    with pytest.raises(RuntimeError, match="after the executor's shutdown"):
        other.open(Settings(workers=0)).submit(abs, -1)
    monkeypatch.setattr(executors, "open_executor", lambda settings, load_ahead: settings.cluster)
    assert executors.Ahead().open(Settings(cluster="tcp://elsewhere:1")) == "tcp://elsewhere:1"


@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux alone")
@pytest.mark.parametrize(
    ("before", "method"), [("pass", "fork"), ("threading.Thread(target=time.sleep, args=(60,), daemon=True).start()", "spawn")]
)
def test_processes_started_ahead_are_copies_of_one_without_threads(tmp_path, before, method):
    """Of threads a copy would have what they left in an unknown state."""
    program = tmp_path / "program.py"
    program.write_text(
        f"import runpy, sys, threading, time\nrunpy.run_path({boot.__file__!r}, run_name='boot')\n"
        "from leaflight.core.parallel import executors\nfrom leaflight.core.util.settings import Settings\n"
        f"if __name__ == '__main__':\n    executors.count_usable = lambda: 2\n    {before}\n"
        "    with executors.Ahead().open(Settings()) as executor:\n"
        "        print(executor._pool._mp_context.get_start_method(), executor.is_awake, *executor.map(abs, [-1, -2, -3]))\n",
        encoding="utf-8",
    )
    alone = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    said = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, env=alone, timeout=120, check=True)
    assert said.stdout.split() == [method, str(method == "fork"), "1", "2", "3"]
    assert "DeprecationWarning" not in said.stderr


def _work(seconds):
    """Uses so many CPU seconds."""
    begin = time.process_time()
    while time.process_time() < begin + seconds:
        sum(range(1000))


def test_cpu_seconds_are_those_of_all_processes():
    with executors.make_executor(2) as executor:
        wait_until_ready(executor)
        before, own = executor.busy.read_cpu_s(), time.process_time()
        for call in [executor.submit(_work, 0.1) for _ in range(4)]:
            call.result()
        executor.submit(time.sleep, 0.3).result()
        used, own = executor.busy.read_cpu_s() - before, time.process_time() - own
    assert 0.4 <= used < 0.65
    assert used - own > 0.08


# What a process does that is given calls: how it begins and ends, as a copy too, and how it hands over what they give.
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


# Parts of texel entries for threads: all of them once, in order, and the same whoever works.
def test_what_is_found_comes_in_order_from_threads_side_by_side():
    """Each waits for the other, which one thread alone would do for ever."""
    both = threading.Barrier(2)

    def work(part):
        both.wait(timeout=30)
        return part.start

    assert run_on_threads(work, 2 << 16, 2) == [0, 1 << 16]


def test_an_error_in_a_thread_is_raised():
    def work(part):
        raise ValueError(f"part {part.start}")

    with pytest.raises(ValueError, match="part 0"):
        run_on_threads(work, 10, 2)


def test_share_of_the_parts_that_are_done_is_told():
    told = []
    run_on_threads(lambda part: part, 4 << 16, 2, told.append)
    assert told == [0.25, 0.5, 0.75, 1.0]
    assert run_on_threads(lambda part: part.stop, 4 << 16, 2, within=slice(10, 1 << 17)) == [(1 << 16) - 10, (1 << 17) - 10]


def test_whoever_wants_no_more_has_no_further_part_begun():
    """The one thread has a part in hand when it is told, and six are left."""
    begun, go_on = [], threading.Event()

    def work(part):
        begun.append(part.start)
        if len(begun) > 1:
            go_on.wait(30)

    def stop(share):
        threading.Timer(0.2, go_on.set).start()
        raise Interrupted

    with pytest.raises(Interrupted):
        run_on_threads(work, 8 << 16, 1, stop)
    assert len(begun) <= 2


@pytest.mark.parametrize("usable", [{0}, {2, 3, 5}])
def test_processors_that_a_batch_system_gives_to_others_are_not_counted(monkeypatch, usable):
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: usable, raising=False)
    assert count_usable() == len(usable)


def test_all_processors_are_usable_where_the_system_does_not_tell(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    for told, count in ((64, 64), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda told=told: told)
        assert count_usable() == count


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")
def test_a_process_is_alone_until_it_has_a_thread_that_works():
    lines = (
        "from leaflight.core.util.threads import is_alone; import threading; e = threading.Event(); t = threading.Thread(target=e.wait); "
        "found = [is_alone()]; t.start(); found.append(is_alone()); e.set(); t.join(); print(found)"
    )
    said = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["[True,", "False]"]


@pytest.mark.parametrize("count", [0, 1, (1 << 16) + 1, 11_700_000])
def test_parts_follow_each_other_to_the_end(count):
    parts = split_entries(count)
    assert [part.start for part in parts] == [0, *(part.stop for part in parts[:-1])]
    assert parts[-1].stop == count
    assert all(part.stop - part.start <= 1 << 18 for part in parts)
    assert all(part.stop - part.start >= 1 << 16 for part in parts[:-1])
