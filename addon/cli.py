"""The command line inside Blender: `python -m leaflight` on pip's bpy, and `blender -b ... --command leaflight`."""

from __future__ import annotations

import importlib.util
import json
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy

from ..core.messages import Done, Error, Warning_
from . import session
from .arguments import BakeRequest, parse_arguments
from .console import print_message
from .job import BakeProcess
from .scene_file import open_scene

EXIT_DONE, EXIT_CANNOT_BAKE, EXIT_INTERRUPTED = 0, 1, 130


def main(argv: list[str], prog: str = "leaflight", with_scene: bool = False) -> int:
    """Run the command line and give its exit code: 0 done, 1 cannot be baked, 130 interrupted; argparse exits with 2."""
    try:
        request = parse_arguments(argv, prog, with_scene)
        return _bake(request)
    except (ValueError, OSError) as reason:
        print_message(Error(str(reason)), quiet=True)
        return EXIT_CANNOT_BAKE


def _bake(request: BakeRequest) -> int:
    begin = time.perf_counter()
    for file in (request.report, request.save):
        if file is not None:
            session.check_folder(file.parent)
    warnings: session.Warnings = []
    if request.scene is not None:
        warnings += open_scene(request.scene)
    elif not bpy.data.filepath:
        raise ValueError("no .blend is open (Blender goes on with its startup scene where it cannot read a file); check the path.")
    seconds = {"open": time.perf_counter() - begin}
    with tempfile.TemporaryDirectory(prefix="leaflight_", ignore_cleanup_errors=True) as folder:
        start = time.perf_counter()
        work = session.prepare(bpy.context, request, Path(folder))
        seconds["export"] = time.perf_counter() - start
        for subject, text in [*warnings, *work.export.warnings]:
            print_message(Warning_(subject, text), request.quiet)
        process = BakeProcess(Path(folder), tuple(bpy.app.python_args), library_paths())
        error, interrupted, told = _follow(process, request.quiet)
        if error:
            raise ValueError(error)
        result = session.read_result(work)
        start = time.perf_counter()
        late = session.assign(bpy.context, work, result) if request.assign and request.save else []
        for subject, text in late:
            print_message(Warning_(subject, text), request.quiet)
        if request.save is not None:
            _save(request.save)
        seconds = {**seconds, **result["seconds"], "assign": time.perf_counter() - start}
    seconds["total"] = time.perf_counter() - begin
    result["seconds"] = {name: round(value, 4) for name, value in seconds.items()}
    result["interrupted"] = interrupted
    _report(request, result, [*warnings, *work.export.warnings, *told, *late])
    return EXIT_INTERRUPTED if interrupted else EXIT_DONE


def _follow(process: BakeProcess, quiet: bool) -> tuple[str, bool, session.Warnings]:
    """Print the child's messages; gives the error's sentence, whether the bake was interrupted, and the warnings."""
    error, interrupted, warnings = "", False, []
    with _interrupts_ask_for_the_best_so_far(process):
        for message in process.messages():
            match message:
                case Error(text):
                    error = text
                case Done():
                    interrupted = message.interrupted
                case Warning_(subject, text):
                    warnings.append((subject, text))
                    print_message(message, quiet)
                case _:
                    print_message(message, quiet)
    return error, interrupted, warnings


@contextmanager
def _interrupts_ask_for_the_best_so_far(process: BakeProcess) -> Iterator[None]:
    def cancel(*_: Any) -> None:
        process.cancel()

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, cancel) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def library_paths() -> tuple[str, ...]:
    """Where pip's bpy keeps OpenImageIO, which is not on its sys.path; nothing in Blender itself."""
    if importlib.util.find_spec("OpenImageIO") is not None:
        return ()
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    return (str(Path(bpy.utils.resource_path("LOCAL")) / "python" / "lib" / version / "site-packages"),)


def _save(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), relative_remap=True, check_existing=False)
    except RuntimeError as reason:
        raise OSError(f"{path}: Blender cannot save there ({str(reason).strip()}); choose another folder.") from reason


def _report(request: BakeRequest, result: dict[str, Any], warnings: session.Warnings) -> None:
    if request.report is None:
        return
    told = [{"subject": subject, "text": text} for subject, text in warnings]
    for row in result["objects"]:
        row["warnings"] = [text for subject, text in warnings if subject == row["name"]]
    report = {"blender": bpy.app.version_string, "scene": bpy.data.filepath or str(request.scene), **result, "warnings": told}
    request.report.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
