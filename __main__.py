"""python -m leaflight: the command line, on pip's bpy."""

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from .addon.app.console import print_message
from .addon.app.job import BakeProcess, open_bake
from .addon.app.watched import run_watched
from .core.util.messages import Error

EXIT_INTERRUPTED = 130
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
_PYTHON_ARGS = ("-I",)  # those of Blender, bpy.app.python_args


def main() -> int:
    """Run the command line and give its exit code."""
    began = time.monotonic()
    try:
        _take_interrupts()
        with open_bake(_PYTHON_ARGS) as process:  # it loads while Blender does
            return _run(process, began)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except OSError as reason:  # no room for the job
        print_message(Error(str(reason)), quiet=True)
        return 1


def _run(process: BakeProcess, began: float) -> int:
    with _interrupts_wait():
        try:
            import bpy  # noqa: F401  tried first, for a sentence instead of a traceback
        except ImportError as reason:
            print(
                f"leaflight: error: Blender as a Python module (bpy) cannot be loaded: {reason}\n"
                "Install it with `pip install bpy`, or bake with `blender -b SCENE.blend --command leaflight bake`.",
                file=sys.stderr,
            )
            return 1
        from .addon.ui import cli
    return cli.main(sys.argv[1:], prog="python -m leaflight", with_scene=True, process=process, began=began)


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Ctrl-C and SIGTERM come at the end of this block: they crash Blender, or are lost, while it starts."""
    can_wait = hasattr(signal, "pthread_sigmask")  # not on Windows
    if can_wait:
        signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
    try:
        yield
    finally:
        _take_interrupts()  # Blender took SIGINT for itself
        if can_wait:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)


def _take_interrupts() -> None:
    for number in _INTERRUPTS:
        signal.signal(number, signal.default_int_handler)


if __name__ == "__main__":
    sys.exit(run_watched(main))
