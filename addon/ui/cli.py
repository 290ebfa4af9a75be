"""The command line inside Blender: `python -m leaflight` on pip's bpy, and `blender -b ... --command leaflight`."""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import bpy

from ...core.bake.checkpoint import no_state_error, read_info
from ...core.util.messages import Done, Error, Message, Status, Warning_
from ...core.util.user_text import group_warnings
from ..app import session
from ..app.arguments import BakeRequest, parse_arguments
from ..app.console import describe_files, describe_miss, print_message
from ..app.job import BakeProcess, open_bake
from ..app.request import resolve_paths
from ..gltf.export_gltf import export_gltf
from ..read.blender_output import hold_output
from ..read.scene_file import choose_scene, open_scene
from ..show.bake_text import describe_error
from ..show.images import check_shown
from ..show.shown_pages import keep_for_file
from .dry_run import describe_bake

EXIT_DONE, EXIT_CANNOT_BAKE, EXIT_INTERRUPTED = 0, 1, 130


def main(argv: list[str], prog: str = "leaflight", with_scene: bool = False, process: BakeProcess | None = None, began: float = 0.0) -> int:
    """Run the command line and give its exit code: 0 done, 1 cannot be baked, 130 interrupted; argparse exits with 2.

    process   that bakes, where there is one already
    began     time.monotonic() of when the command was started, 0 now
    """
    began = began or time.monotonic()
    try:
        with _interrupts(_stop_here):  # Blender takes SIGINT for itself until someone else does
            request = replace(parse_arguments(argv, prog, with_scene), began=began)
            if process is not None:
                return _bake(request, process)
            with open_bake(tuple(bpy.app.python_args)) as process:
                return _bake(request, process)
    except KeyboardInterrupt:
        print_message(Error("interrupted before there was any light; nothing was written."), quiet=True)
        return EXIT_INTERRUPTED
    except (ValueError, OSError) as reason:
        print_message(Error(str(reason)), quiet=True)
        return EXIT_CANNOT_BAKE


def _bake(request: BakeRequest, process: BakeProcess) -> int:
    begin = time.perf_counter()
    warnings: session.Warnings = []
    if request.scene is not None:
        with _hold_news(request.quiet):
            warnings += open_scene(request.scene, request.scripts)
    elif not bpy.data.filepath:
        raise ValueError("no .blend is open (Blender goes on with its startup scene where it cannot read a file); check the path.")
    choose_scene(bpy.context, request.scene_name, request.view_layer, request.frame)
    request = resolve_paths(request)
    if request.dry_run:
        return _print_plan(request, process, warnings)
    _check(request)
    if request.save is not None:  # a later bake into the same folder must not change what that file shows, with or without the add-on
        request = replace(request, keep_pages=True)
    scene = bpy.data.filepath or str(request.scene)
    seconds = {"open": time.perf_counter() - begin}
    start = time.perf_counter()
    with _hold_news(request.quiet):
        work = session.prepare(bpy.context, request, process.folder, partial(print_message, quiet=request.quiet))
    seconds["export"] = time.perf_counter() - start
    _print_warnings([*warnings, *work.export.warnings], request.quiet)
    with _interrupts(_stop_here if work.kept else process.cancel):  # until the end: what was baked is saved
        error, interrupted, told = _follow(session.list_kept_messages(work) if work.kept else process.messages(), request.quiet)
        if error:
            raise ValueError(error)
        if interrupted and not session.has_result(work):
            _stop_here()
        result = session.read_result(work)
        missed = "" if interrupted else describe_miss(result["stopped_by"], result["estimated_error"], request.settings.error)
        if missed:
            told.append(("", missed))
            print_message(Warning_("", missed), request.quiet)
        elif math.isfinite(result["estimated_error"]):
            first, *more = describe_error(result)
            print_message(Status("done", "; ".join([first, *(line[0].lower() + line[1:] for line in more)])), request.quiet)
        start = time.perf_counter()
        with _hold_news(request.quiet):
            late = _finish(request, work, result)
        _print_warnings(late, request.quiet)
        seconds |= {**result["seconds"], "assign": time.perf_counter() - start}
        seconds["total"] = time.perf_counter() - begin
        result["seconds"] = {name: round(value, 4) for name, value in seconds.items()}
        _report(request, {"scene": scene, **result, "interrupted": interrupted}, [*warnings, *work.export.warnings, *told, *late])
        print_message(Status("done", describe_files([file["path"] for file in result["files"]])), request.quiet)
        process.close()
    if result["spare"]:
        print_message(Error(f"{request.output}: the images are not there but in {result['spare']}; make room and move them."), quiet=True)
        return EXIT_CANNOT_BAKE
    return EXIT_INTERRUPTED if interrupted else EXIT_DONE


def _finish(request: BakeRequest, work: session.Session, result: dict[str, Any]) -> session.Warnings:
    """Write all that only Blender can; gives what could not be done."""
    session.finish_files(bpy.context.scene, result)
    late = session.assign(bpy.context, work, result) if request.assign and request.save else []
    if request.save is not None:
        _save(request.save)
    if request.gltf is not None:  # after saving: what is only for the export is not for the .blend
        late += session.assign(bpy.context, work, result) if not (request.assign and request.save) else []
        late += export_gltf(bpy.context, request.gltf, request.settings.view_transform)
    return late


def _hold_news(quiet: bool) -> AbstractContextManager[None]:
    """With --quiet Blender's own lines are left out too, but for warnings and errors."""
    return hold_output(quiet=True) if quiet else nullcontext()


def _print_plan(request: BakeRequest, process: BakeProcess, warnings: session.Warnings) -> int:
    """What the bake would be; nothing is left on disk."""
    with _hold_news(request.quiet):
        work = session.prepare(bpy.context, replace(request, output=process.folder / "maps"), process.folder)
    _print_warnings([*warnings, *work.export.warnings], request.quiet)
    for line in describe_bake(work.export.snapshot, request.settings):
        print_message(Status("plan", line), quiet=False)
    return EXIT_DONE


def _check(request: BakeRequest) -> None:
    """Raises ValueError or OSError with a sentence for what would stop the bake at its end."""
    for file in (request.report, request.save, request.gltf):
        if file is not None:
            session.check_file(file)
    if request.keep is not None:
        session.check_folder(request.keep)
    if request.resume is not None and read_info(request.resume) is None:
        raise ValueError(no_state_error(request.resume))
    if request.gltf is not None or (request.save is not None and request.assign):
        check_shown(request.settings)


def _follow(messages: Iterable[Message], quiet: bool) -> tuple[str, bool, session.Warnings]:
    """Print a bake's messages to the last; gives the error's sentence, whether the bake was interrupted, and the warnings."""
    error, interrupted = "", False
    warnings: session.Warnings = []
    waiting: session.Warnings = []
    for message in messages:
        if not isinstance(message, Warning_):  # those that come together are said together
            _print_warnings(waiting, quiet)
            waiting = []
        match message:
            case Error(text):
                error = text
            case Done():
                interrupted = message.interrupted
            case Warning_(subject, text):
                warnings.append((subject, text))
                waiting.append((subject, text))
            case _:
                print_message(message, quiet)
        if isinstance(message, Done | Error):
            break  # the result is there; the process that made it may end meanwhile
    _print_warnings(waiting, quiet)
    return error, interrupted, warnings


def _print_warnings(warnings: session.Warnings, quiet: bool) -> None:
    """One line for each kind, with the names of some and how many more there are."""
    for told in group_warnings(warnings):
        print_message(Warning_("", told.text), quiet)


def _stop_here() -> None:
    raise KeyboardInterrupt


@contextmanager
def _interrupts(call: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C and SIGTERM make this call meanwhile."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: call()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: not set from Python


def _save(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), relative_remap=True, check_existing=False)
    except RuntimeError as reason:
        raise OSError(f"{path}: Blender cannot save there ({str(reason).strip()}); choose another folder.") from reason
    keep_for_file(path.resolve())


def _report(request: BakeRequest, result: dict[str, Any], warnings: session.Warnings) -> None:
    if request.report is None:
        return
    told = [{"subject": subject, "text": text} for subject, text in warnings]
    for row in result["objects"]:
        row["warnings"] = [text for subject, text in warnings if subject == row["name"]]
    if not math.isfinite(result["estimated_error"]):
        result["estimated_error"] = None  # JSON has no NaN
    report = {"blender": bpy.app.version_string, **result, "warnings": told}
    try:
        request.report.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as reason:
        raise OSError(f"{request.report}: the report cannot be written ({reason.strerror}); the images are complete.") from reason
