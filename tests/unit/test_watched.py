"""The watch over Blender: exit codes as they are, crashes as a sentence, signals passed on, and nobody left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from processes import wait_for_end

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere nothing is watched")
ROOT = Path(__file__).resolve().parents[2]
HEAD = "import os, signal, sys, time\nfrom leaflight.addon.app.watched import run_watched\n"
WAIT = "    print(os.getpid(), flush=True)\n    time.sleep(60)\n"


def start(lines):
    """A process that runs these lines as its main function, watched."""
    script = f"{HEAD}def main():\n{lines}\nsys.exit(run_watched(main))"
    return subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8", cwd=ROOT)


def end_of(process):
    out, err = process.communicate(timeout=30)
    return process.returncode, out, err


@pytest.mark.parametrize(("lines", "code"), [("    return 2", 2), ("    sys.exit(130)", 130), ("    1 / 0", 1)])
def test_exit_codes_are_those_of_the_main_function(lines, code):
    assert end_of(start(lines))[0] == code


@pytest.mark.parametrize("name", ["SIGSEGV"])
def test_a_crash_is_a_sentence(name):
    code, _, err = end_of(start(f"    os.kill(os.getpid(), signal.{name})"))
    assert code == 1
    assert err.startswith(f"leaflight: error: Blender itself crashed ({name}): most likely the scene file is damaged, ")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_signals_are_passed_on_once(name):
    number = getattr(signal, name)
    lines = f"    got = []\n    signal.signal({int(number)}, lambda *_: got.append(1))\n    print(os.getpid(), flush=True)\n"
    process = start(f"{lines}    time.sleep(0.5)\n    return len(got)")
    process.stdout.readline()
    process.send_signal(number)
    assert end_of(process)[0] == 1


def test_a_signal_that_ends_the_one_ends_the_other_alike():
    process = start(WAIT)
    os.kill(int(process.stdout.readline()), signal.SIGKILL)
    assert end_of(process)[0] == -signal.SIGKILL


@pytest.mark.parametrize("ignored", [False, True])
def test_a_signal_before_the_main_function_listens_is_not_lost(ignored):
    """A shell has what it starts in the background ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if ignored else None
    process = start("    os.kill(os.getppid(), signal.SIGINT)\n    time.sleep(60)")
    if ignored:
        signal.signal(signal.SIGINT, before)
    assert end_of(process)[0] == 130


def test_nobody_stays_behind_where_the_watch_is_killed():
    process = start(WAIT)
    child = int(process.stdout.readline())
    time.sleep(0.1)
    process.kill()
    end_of(process)
    assert wait_for_end([child]) == []
