"""python -m leaflight: the command line, on pip's bpy."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

EXIT_INTERRUPTED = 130


def main() -> int:
    """Run the command line and give its exit code."""
    try:
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
            from .addon import cli
        return cli.main(sys.argv[1:], prog="python -m leaflight", with_scene=True)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Ctrl-C and SIGTERM come at the end of this block: they crash Blender, or are lost, while it starts."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    can_wait = hasattr(signal, "pthread_sigmask")  # not on Windows
    if can_wait:
        signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.default_int_handler)  # Blender took SIGINT for itself
        if can_wait:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, numbers)


if __name__ == "__main__":
    sys.exit(main())
