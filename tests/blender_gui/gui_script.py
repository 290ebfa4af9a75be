"""What scripts for a Blender with a window share: checks, areas, pictures, keys, waiting, and the timer that takes their steps.

A script is a generator: each value is the seconds until its next step, between which Blender draws and handles events.
"""

import os
import shutil
import subprocess
import tempfile
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


def open_tab() -> Iterator[float]:
    view().spaces.active.show_region_ui = True
    yield 1.0  # the sidebar must be drawn once before its tab can be chosen
    region_of(view(), "UI").active_panel_category = "Leaflight"
    yield from settle(0.5)


def press(name: str, *arguments: str, **more: object) -> None:
    """An operator of Leaflight's, in the view; what it refuses with is printed."""
    with in_view():
        try:
            getattr(bpy.ops.leaflight, name)(*arguments, **more)
        except RuntimeError as reason:
            print(f"REPORT {str(reason).strip()}", flush=True)


def type_key(kind: str, height: float = 0.5, **held: bool) -> Iterator[float]:
    """A key, with the mouse in the left of the view at this part of its height; needs --enable-event-simulate."""
    area = view()
    at = {"x": area.x + area.width // 3, "y": area.y + int(height * area.height)}
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", **at)
    yield 0.2
    for value in ("PRESS", "RELEASE"):
        window().event_simulate(type=kind, value=value, **at, **held)
    yield 0.5


def bake() -> Iterator[float]:
    """As a click on the button does it, up to the end."""
    press("bake", "INVOKE_DEFAULT")
    yield from wait(lambda: not state().running)
    print(f"BAKED {state().summarize()} {state().error!r} {state().warnings}", flush=True)


def has_bake(scene: bpy.types.Scene | None = None) -> bool:
    return any("leaflight_bake" in obj for obj in (scene or bpy.context.scene).objects)


def crop_of(part, height: int | None = None) -> str:
    """The upper part of an area or a region, as ImageMagick has it."""
    height = min(height or part.height, part.height)
    return f"{part.width}x{height}+{part.x}+{window().height - part.y - part.height}"


def take_picture(path: Path, crop: str, width: int = 0, colors: int = 0, dither: str = "None") -> Iterator[float]:
    """A part of the screen, at most so wide, and of so many colours, where these are set. Dithered pictures are four times as large.

    Blender's own picture is black where OpenGL is software.
    """
    narrow = ["-resize", f"{width}x>"] if width else []
    few = ["-dither", dither, "-colors", str(colors), f"PNG8:{path}"] if colors else [str(path)]
    process = subprocess.Popen(["import", "-window", "root", "-crop", crop, "+repage", *narrow, *few])
    while process.poll() is None:
        yield TICK_SECONDS
    print(f"PICTURE {path} {path.stat().st_size // 1000} kB", flush=True)


def make_pictures_folder() -> Path:
    """The folder that the environment variable PICTURES names, else a temporary one."""
    if not shutil.which("import"):
        raise SystemExit("ImageMagick's import is needed to take pictures: install ImageMagick.")
    folder = Path(os.environ.get("PICTURES") or tempfile.mkdtemp(prefix="leaflight_pictures_"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


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
