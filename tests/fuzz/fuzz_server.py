"""A process that runs cases one after the other: fuzz_server.py KIT. See run_fuzz.py.

Reads a line of JSON per case, {"seed", "folder"}; writes a line of JSON, the fields of run_fuzz.Outcome. Cases are run by the function that
both command lines call, in this process, so that Blender is loaded once; every twentieth by a process of its own.
"""

from __future__ import annotations

import faulthandler
import json
import os
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(Path(__file__).parent), str(ROOT / "tests")]

_APART = 20  # of so many cases one is run by a process of its own
_PATIENCE_S = 120.0


def main(kit: Path) -> None:
    out = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    faulthandler.enable()  # a case that crashes Blender says where
    import bpy  # noqa: F401  before what needs it
    from fuzz_cases import make_kit
    from image_io_path import add_image_io

    add_image_io()
    warnings.showwarning = _show_warning
    if not kit.is_dir():
        make_kit(kit)
    out.write("ready\n")
    for line in sys.stdin:
        asked = json.loads(line)
        out.write(json.dumps(run_case(asked["seed"], Path(asked["folder"]), kit, asked.get("apart", False))) + "\n")


def _show_warning(message: Warning | str, category: type[Warning], filename: str, *_: Any) -> None:
    if f"{os.sep}scripts{os.sep}" in filename:
        return  # Blender's own, as of its exporters
    print(f"{category.__name__}: {message}", file=sys.stderr)
    traceback.print_stack()


def run_case(seed: int, folder: Path, kit: Path, apart: bool = False) -> dict[str, Any]:
    """Prepare, run and judge the case of a seed in a folder, which is made.

    apart   by a process of its own in any case
    """
    from fuzz_cases import draw_case
    from fuzz_judge import find_left, judge, list_content

    work, temporary, log = folder / "case", folder / "tmp", folder / "told.txt"
    for path in (work, temporary):
        path.mkdir(parents=True)
    case = draw_case(seed, work, kit)
    (folder / "words.json").write_text(json.dumps(case.words), encoding="utf-8")
    before = list_content(work)
    begin = time.monotonic()
    with _surroundings(str(seed), work, temporary, log):
        code = _run_apart(case.words) if apart or seed % _APART == 0 else _run_here(case.words)
    seconds = time.monotonic() - begin
    told = log.read_text(encoding="utf-8", errors="replace")
    wrong = judge(code, told, work, before, case.outputs, temporary)
    left = find_left(str(seed))
    wrong += [f"still runs: {', '.join(left)}"] if left else []
    return {"seed": seed, "code": code, "about": case.about, "wrong": wrong, "seconds": round(seconds, 2)}


def _run_here(words: tuple[str, ...]) -> int:
    from leaflight.addon.ui import cli

    try:
        return cli.main(list(words), "leaflight", with_scene=True)
    except SystemExit as end:
        return int(end.code or 0)
    except BaseException:  # what would end the command line with a traceback
        traceback.print_exc()
        return -1


def _run_apart(words: tuple[str, ...]) -> int:
    if any("\0" in word for word in words):  # which no system hands to a process
        return _run_here(words)
    done = subprocess.run([sys.executable, "-m", "leaflight", *words], timeout=_PATIENCE_S, check=False)
    return done.returncode


@contextmanager
def _surroundings(case: str, work: Path, temporary: Path, log: Path) -> Iterator[None]:
    """The folder of the case as the current one, its temporary folder, its mark on new processes, and all that is printed in a file."""
    from fuzz_judge import MARK

    saved = [os.dup(1), os.dup(2)]
    before = Path.cwd()
    with open(log, "wb") as file:
        sys.stdout.flush()
        sys.stderr.flush()
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.environ |= {MARK: case, "TMPDIR": str(temporary)}
    tempfile.tempdir = str(temporary)
    os.chdir(work)
    try:
        yield
    finally:
        os.chdir(before)
        tempfile.tempdir = None
        sys.stdout.flush()
        sys.stderr.flush()
        for number, kept in zip((1, 2), saved, strict=True):
            os.dup2(kept, number)
            os.close(kept)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
