"""Executors: results in order, errors handed on, and this process one of the workers."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor

import pytest
from leaflight.addon.app import boot
from leaflight.core.parallel import executors
from leaflight.core.util.settings import Settings
from processes import wait_until_ready


def fail(number):
    raise ValueError(f"shard {number}")


def test_inline_executor_hands_errors_on_with_the_result():
    future = executors.InlineExecutor().submit(fail, 7)
    assert isinstance(future.exception(), ValueError)
    with pytest.raises(ValueError, match="shard 7"):
        future.result()


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


def test_time_in_calls_is_counted_in_every_process_by_function():
    with executors.make_executor(2) as executor:
        wait_until_ready(executor)
        calls = [executor.submit(time.sleep, 0.05) for _ in range(4)]
        assert executor.submit(abs, -3).result() == 3
        for call in calls:
            call.result()
        busy = executor.busy.read()
    assert 0.2 <= busy["sleep"] < 2.0
    assert 0.0 <= busy["abs"] < 0.1


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
