"""A watch over Blender on the command line: where it crashes itself, there is a sentence and an exit code of ours. No bpy here."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Callable
from typing import Any, NoReturn

from ...core.util.messages import Error
from .console import print_message

_CRASHES = tuple(getattr(signal, name) for name in ("SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGABRT") if hasattr(signal, name))
_PASSED_ON = (signal.SIGINT, signal.SIGTERM)
_INTERRUPTED = 130  # exit code
_FROM_KERNEL = 0x80  # si_code: as Ctrl-C in a terminal, which every process there gets by itself. Source: Linux, sigaction(2)
_DIE_WITH_PARENT = 1  # Source: Linux, prctl(2), PR_SET_PDEATHSIG


def run_watched(main: Callable[[], int]) -> int:
    """The exit code of `main`, which runs in a process of its own where the system can do that; 1, and a sentence, where it crashes.

    On Windows and macOS it runs here.
    """
    if not hasattr(signal, "sigwaitinfo") or not sys.platform.startswith("linux"):
        return main()
    numbers = {*_PASSED_ON, signal.SIGCHLD}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    parent, pid = os.getpid(), os.fork()
    if pid == 0:
        _run_child(main, parent, before)
    while True:
        told = signal.sigwaitinfo(numbers)
        if told.si_signo in _PASSED_ON:
            if told.si_code != _FROM_KERNEL:
                with contextlib.suppress(ProcessLookupError):  # it has just ended
                    os.kill(pid, told.si_signo)
            continue
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return _read_status(os.waitstatus_to_exitcode(status))


def _run_child(main: Callable[[], int], parent: int, before: Any) -> NoReturn:
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:  # it has ended already
        os._exit(1)
    for number in _PASSED_ON:  # whoever started this may have had them ignored
        signal.signal(number, signal.default_int_handler)
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        code = main()
    except KeyboardInterrupt:  # before `main` listened
        code = _INTERRUPTED
    sys.exit(code)


def _read_status(code: int) -> int:
    """The exit code to end with; a signal that is no crash ends this process, too."""
    if code >= 0:
        return code
    number = signal.Signals(-code)
    if number in _CRASHES:
        print_message(
            Error(
                f"Blender itself crashed ({number.name}): most likely the scene file is damaged, or holds a modifier or object that this "
                "Blender cannot take; open it in Blender and save it again, or take away what was added last."
            ),
            quiet=True,
        )
        return 1
    if number != signal.SIGKILL:  # which nobody can answer otherwise
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {number})
    os.kill(os.getpid(), number)
    return 128 - code
