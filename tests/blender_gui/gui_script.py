"""What scripts for a Blender with a window share: checks, the window and its areas, waiting, and the timer that takes their steps.

A script is a generator: each value is the seconds until its next step, between which Blender draws and handles events.
"""

import os
import shutil
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

FAILED: list[str] = []
TICK_SECONDS = 0.05
GIVE_UP_SECONDS = 300.0


def check(name: str, holds: object) -> None:
    print(f"CHECK {'ok    ' if holds else 'FAILED'} {name}", flush=True)
    if not holds:
        found = state()
        print(f"      error {found.error!r}, notice {found.notice!r}, stage {found.stage!r}, warnings {found.warnings}", flush=True)
        FAILED.append(name)


def check_all(parts: Iterator[float], name: str) -> Iterator[float]:
    """The steps of some checks; a fault of the script is a check of this name that failed."""
    try:
        yield from parts
    except Exception:  # the next checks are to be made all the same
        traceback.print_exc()
        check(name, False)


def state():
    return bpy.context.window_manager.leaflight_state


def window():
    return bpy.context.window_manager.windows[0]


def area_of(kind: str):
    return next(area for area in window().screen.areas if area.type == kind)


def view():
    return area_of("VIEW_3D")


def region_of(area, kind: str = "WINDOW"):
    return next(region for region in area.regions if region.type == kind)


def in_view():
    return bpy.context.temp_override(window=window(), area=view(), region=region_of(view()))


def wait(condition: Callable[[], object], seconds: float = GIVE_UP_SECONDS, tick: float = TICK_SECONDS) -> Iterator[float]:
    give_up = time.monotonic() + seconds
    while not condition() and time.monotonic() < give_up:
        yield tick


def settle(seconds: float = 2.5) -> Iterator[float]:
    """Everything is drawn anew for so long."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for area in window().screen.areas:
            area.tag_redraw()
        yield 0.2


def make_pictures_folder(folder: Path) -> None:
    if not shutil.which("import"):
        raise SystemExit("ImageMagick's import is needed to take pictures: install ImageMagick.")
    folder.mkdir(parents=True, exist_ok=True)


def choose_parts(parts: tuple[Callable[[], Iterator[float]], ...], prefix: str = "") -> list[Callable[[], Iterator[float]]]:
    """Those that the environment variable PARTS names, without the prefix of all names; all where it is not set."""
    named = {part.__name__.removeprefix(prefix): part for part in parts}
    chosen = os.environ.get("PARTS", "").split() or list(named)
    if not set(chosen) <= set(named):
        raise SystemExit(f"PARTS: expected some of {' '.join(named)}, got {' '.join(chosen)}.")
    return [named[name] for name in named if name in chosen]


def start(steps: Iterator[float], has_checks: bool = True) -> None:
    """Take the steps by a timer, say how many checks failed, and quit Blender."""
    if not hasattr(bpy.context.window_manager, "leaflight_state"):
        raise SystemExit("The extension is not enabled: install it first.")
    bpy.context.preferences.use_preferences_save = False  # else Blender keeps what follows for whoever works here
    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.filepaths.use_auto_save_temporary_files = False

    def run() -> float | None:
        pause = next(steps, None)
        if pause is None:
            if has_checks:
                print(f"{len(FAILED)} FAILED", flush=True)
            with in_view():
                bpy.ops.wm.quit_blender()
        return pause

    bpy.app.timers.register(run, first_interval=2.0, persistent=True)
