"""The child process that bakes: what it says, how it is ended, and that nobody stays behind."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from boxes import lamp_scene
from leaflight.addon.app import job
from leaflight.addon.app.job import BakeProcess
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.messages import Done, Error, Message, Progress, Status
from leaflight.core.util.settings import Settings
from leaflight.core.util.threads import count_usable
from processes import PATIENCE_S, is_alive, wait_for_end

ENDLESS = Settings(size=32, padding=1, error=1e-4, max_photons=10**12)
needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found in /proc")


@pytest.fixture
def start(tmp_path: Path, open_image_io: None) -> Iterator[Callable[..., BakeProcess]]:
    """Starts a bake of a small scene, by default one without end; kills what is left of it."""
    started = []

    def start_bake(settings: Settings = ENDLESS) -> BakeProcess:
        save_snapshot(tmp_path / SNAPSHOT_FILE, lamp_scene())
        Job(settings, str(tmp_path / "out"), "room").save(tmp_path)
        started.append(BakeProcess(tmp_path))
        return started[-1]

    yield start_bake
    for process in started:
        process.kill()


@pytest.fixture
def replace_bake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Has children run these lines in place of a bake; `tell` sends a message of this kind and fields."""

    def replace_by(lines: str) -> None:
        boot = tmp_path / "boot.py"
        head = (
            "import json, os, signal, sys, time\ndef tell(kind, **fields):\n    print(json.dumps({'kind': kind, **fields}), flush=True)\n"
        )
        boot.write_text(head + lines, encoding="utf-8")
        own, popen = str(Path(job.__file__).with_name("boot.py")), subprocess.Popen
        monkeypatch.setattr(
            job.subprocess, "Popen", lambda words, **options: popen([str(boot) if word == own else word for word in words], **options)
        )

    return replace_by


@pytest.fixture
def dummy(tmp_path: Path, replace_bake: Callable[[str], None]) -> Callable[..., BakeProcess]:
    """A child that runs these lines in place of a bake."""

    def start_dummy(lines: str, **options: bool) -> BakeProcess:
        replace_bake(lines)
        return BakeProcess(tmp_path, **options)

    return start_dummy


def find_descendants(pid: int) -> list[int]:
    """Processes below this one, by /proc."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except (FileNotFoundError, ProcessLookupError):
                continue  # it ended while we looked
    found = [child for child, parent in parents.items() if parent == pid]
    return found + [below for child in found for below in find_descendants(child)]


def find_semaphores(pid: int) -> list[Path]:
    """Files of the named semaphores that a process has mapped, where Linux keeps them."""
    mapped = {int(line.split()[4]) for line in Path(f"/proc/{pid}/maps").read_text().splitlines() if "/dev/shm/sem." in line}
    return [path for path in Path("/dev/shm").glob("sem.*") if find_inode(path) in mapped]


def find_inode(path: Path) -> int:
    """0 where another process has just taken the file away."""
    try:
        return path.stat().st_ino
    except FileNotFoundError:
        return 0


def run_to(process: BakeProcess, kind: type[Message]) -> Message:
    return next(message for message in process.messages() if isinstance(message, kind))


@needs_proc
def test_cancel_gives_the_best_so_far_and_ends_the_workers(start, tmp_path):
    process = start(replace(ENDLESS, workers=2))
    last, workers = None, []
    for message in process.messages():
        if isinstance(message, Progress) and not workers:
            workers = find_descendants(process._process.pid)
            process.cancel()
            process.cancel()  # an impatient user's second time does no harm
        last = message
    assert last == Done(str(tmp_path / RESULT_FILE), interrupted=True)
    assert json.loads((tmp_path / RESULT_FILE).read_text())["stopped_by"] == "interrupted"
    assert (tmp_path / "out" / "room_0.combined.exr").is_file()
    assert len(workers) >= 2
    assert wait_for_end(workers) == []
    process.cancel()  # too late, and no harm either


def close_stdin(process: BakeProcess) -> None:
    """What the system does when the parent is gone."""
    process._process.stdin.close()


@needs_proc
@pytest.mark.parametrize(("end", "copied"), [(BakeProcess.kill, True), (close_stdin, False)])
def test_nobody_stays_behind(start, tmp_path, end, copied):
    """Killed, or left by its parent, the child takes its workers along, idle ones too, and what they have of the system's."""
    # Two shards a round: a third worker is idle. Another number than the processors is not that of the copies.
    process = start(replace(ENDLESS, workers=0 if copied else max(3, count_usable() + 1)))
    run_to(process, Progress)
    everyone = [process._process.pid, *find_descendants(process._process.pid)]
    assert len(everyone) >= (2 if copied else 3)
    semaphores = find_semaphores(process._process.pid)
    assert bool(semaphores) != copied or sys.platform != "linux"
    end(process)
    process._process.wait(PATIENCE_S)
    assert wait_for_end(everyone) == []
    assert [path for path in semaphores if path.exists()] == []
    assert [path.name for path in (tmp_path / "out").iterdir()] == [".leaflight_room.charts"]  # whole, for the next bake


@needs_proc
def test_one_whose_parent_is_gone_writes_no_pages(dummy, tmp_path):
    """The signal that ends its workers reaches the bake too, which would end it as if it were cancelled."""
    boot = Path(job.__file__).with_name("boot.py")
    process = dummy(
        f"import pathlib, runpy\nmain = runpy.run_path({str(boot)!r}, run_name='boot')['main']\n"
        "from leaflight.core.bake import bake\nfrom leaflight.core.util.messages import Status\n"
        "def run_bake(folder, send, is_stopped, open_executor):\n"
        "    send(Status('bake', ''))\n"
        "    while not is_stopped():\n        time.sleep(0.001)\n"
        "    (folder / 'pages').touch()\n"
        "bake.run_bake = run_bake\nsys.exit(main(pathlib.Path(sys.argv[1])))\n"
    )
    run_to(process, Status)
    close_stdin(process)
    assert process._process.wait(PATIENCE_S) == 4
    assert not (tmp_path / "pages").exists()


def test_the_folder_of_a_job_whose_parent_is_gone_is_taken_away(tmp_path, open_image_io):
    """As where Blender crashes, or is killed."""
    folder = tmp_path / "leaflight_job"
    folder.mkdir()
    save_snapshot(folder / SNAPSHOT_FILE, lamp_scene())
    Job(replace(ENDLESS, workers=1), str(tmp_path / "out"), "room").save(folder)
    process = BakeProcess(folder)
    run_to(process, Progress)
    close_stdin(process)
    process._process.wait(PATIENCE_S)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@needs_proc
def test_a_yielding_bake_and_its_workers_step_back(dummy):
    ask = "import subprocess\nsys.stdin.readline()\nnice = lambda: os.getpriority(os.PRIO_PROCESS, 0)\n"
    ask += "worker = [sys.executable, '-c', 'import os; print(os.getpriority(os.PRIO_PROCESS, 0))']\n"
    ask += "tell('STATUS', stage='nice', text=f'{nice()} {int(subprocess.check_output(worker))}')\n"
    own = os.getpriority(os.PRIO_PROCESS, 0)
    for yielding, steps in ((False, 0), (True, 10)):
        expected = min(own + steps, 19) if yielding else own
        process = dummy(ask, yielding=yielding)
        assert run_to(process, Status) == Status("nice", f"{expected} {expected}")
        process.kill()


@needs_proc
def test_a_yielding_bake_steps_back_on_a_desktop_too(dummy):
    """Where Linux shares time out between sessions, a priority within one's own does nothing."""
    process = dummy("sys.stdin.readline()", yielding=True)
    place = Path(f"/proc/{process._process.pid}/autogroup")
    if not place.exists() or "nice" not in place.read_text():
        pytest.skip("time is not shared out between sessions")
    assert place.read_text().split()[-1] == "10"
    process.kill()


@pytest.mark.parametrize(
    ("reason", "sentence"),
    [
        ("MemoryError()", "The bake ran out of memory: "),
        ("OSError(errno.ENOSPC, 'No space left')", "temporary files cannot be kept there (No space left)"),
    ],
)
def test_what_is_lacking_is_named(dummy, reason, sentence):
    boot = Path(job.__file__).with_name("boot.py")
    process = dummy(
        f"import errno, pathlib, runpy\nmain = runpy.run_path({str(boot)!r}, run_name='boot')['main']\n"
        "from leaflight.core.bake import bake\n"
        f"def fail(*_): raise {reason}\n"
        "bake.run_bake = fail\nsys.exit(main(pathlib.Path(sys.argv[1])))\n"
    )
    *_, error = process.messages()
    assert isinstance(error, Error)
    assert sentence in error.text


@needs_proc
def test_numpy_starts_no_threads_of_its_own(dummy):
    process = dummy(
        "import os, numpy\nfrom leaflight.core.util.messages import Error, encode_message\n"
        "numpy.ones((500, 500)) @ numpy.ones((500, 500))\n"
        "threads = len(os.listdir('/proc/self/task'))\n"
        "print(encode_message(Error(f'threads {threads}')), flush=True)\n"
    )
    *_, error = process.messages()
    assert error.text == "threads 1"


@pytest.mark.parametrize(
    ("lines", "sentence"),
    [
        (
            "tell('STATUS', stage='a', text='b'); os.kill(os.getpid(), signal.SIGKILL)",
            r"was killed, most likely for lack of memory: .*fewer",
        ),
        ("print('KeyError: 3', file=sys.stderr); sys.exit(3)", r"ended unexpectedly \(code 3\).* Its last words: KeyError: 3$"),
        ("sys.exit(0)", r"ended unexpectedly \(code 0\)"),
    ],
)
def test_a_sudden_end_becomes_an_error(dummy, lines, sentence):
    *_, last = dummy(lines).messages()
    assert isinstance(last, Error)
    assert re.search(sentence, last.text)


@needs_proc
def test_a_worker_that_was_killed_is_told(start):
    process = start(replace(ENDLESS, workers=2))
    messages = process.messages()
    next(message for message in messages if isinstance(message, Progress))
    worker = next(pid for pid in find_descendants(process._process.pid) if is_worker(pid))
    os.kill(worker, signal.SIGKILL)
    *_, last = messages
    assert isinstance(last, Error)
    assert last.text.startswith("A worker of the bake was killed, most likely for lack of memory: choose")


def is_worker(pid: int) -> bool:
    words = Path(f"/proc/{pid}/cmdline").read_bytes()
    return is_copy(pid) or (b"spawn_main" in words and b"resource_tracker" not in words)


def is_copy(pid: int) -> bool:
    """Whether a process is one of its parent, which bakes: with the same program and arguments."""
    parent = int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
    words = Path(f"/proc/{pid}/cmdline").read_bytes()
    return b"boot.py" in words and words == Path(f"/proc/{parent}/cmdline").read_bytes()


def test_nothing_follows_the_childs_own_end(dummy):
    messages = list(dummy("tell('ERROR', text='no light'); sys.exit(1)").messages())
    assert messages == [Error("no light")]


def test_who_has_the_result_lets_the_child_end_in_good_order(replace_bake, tmp_path):
    """And who leaves before there is one does not wait for it."""
    replace_bake(f"tell('DONE', result='', interrupted=False); time.sleep(0.3); open({str(tmp_path / 'put_away')!r}, 'w')")
    with job.open_bake(()) as process:
        run_to(process, Done)
    assert process._process.returncode == 0
    assert (tmp_path / "put_away").exists()
    replace_bake("tell('STATUS', stage='a', text='b'); time.sleep(600)")
    with job.open_bake(()) as process:
        run_to(process, Status)
    assert process._process.returncode == -signal.SIGKILL


@needs_proc
def test_what_the_child_has_started_is_killed_with_it(dummy):
    """Even what does not look whether its parent is still there."""
    process = dummy(
        "import subprocess\nother = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
        "tell('STATUS', stage='other', text=str(other.pid)); time.sleep(600)"
    )
    other = int(run_to(process, Status).text)
    assert is_alive(other)
    process.kill()
    assert wait_for_end([other]) == []


def test_a_line_that_is_no_message_is_told(dummy):
    with pytest.raises(ValueError, match="not a Leaflight message: 'hello"):
        list(dummy("print('hello')").messages())


def test_a_bake_begins_when_its_messages_are_asked_for(open_image_io):
    """So the process loads while the scene is still being read; nothing is left of it and its folder."""
    with job.open_bake(()) as process:
        save_snapshot(process.folder / SNAPSHOT_FILE, lamp_scene())
        time.sleep(0.5)  # it would have failed for want of a job
        assert process._process.poll() is None
        Job(replace(ENDLESS, max_photons=2000, workers=1), str(process.folder / "out"), "room").save(process.folder)
        *_, last = process.messages()
        assert isinstance(last, Done)
    assert not process.folder.exists()


@needs_proc
def test_a_bake_that_never_begins_leaves_nothing():
    with pytest.raises(KeyboardInterrupt), job.open_bake(()) as process:
        raise KeyboardInterrupt
    assert not is_alive(process._process.pid)
    assert not process.folder.exists()


def test_asking_a_child_that_has_just_ended_is_no_error(dummy, monkeypatch):
    """Windows has an invalid argument for a broken pipe."""
    process = dummy("time.sleep(60)")
    for number in (errno.EPIPE, errno.EINVAL):

        def fail(_, number=number):
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(process._process, "stdin", SimpleNamespace(write=fail))
        process.cancel()
    process.kill()


@pytest.mark.parametrize(("free_bytes", "cached"), [(10**6, False), (10**9, True)])
def test_no_code_is_cached_where_the_disk_is_nearly_full(dummy, monkeypatch, free_bytes, cached):
    """It would be cut off, and no later process could load it."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    monkeypatch.setattr(job.shutil, "disk_usage", lambda _: SimpleNamespace(free=free_bytes))
    *_, error = dummy("tell('ERROR', text=str(not sys.dont_write_bytecode))").messages()
    assert error.text == str(cached)
