"""Bakes inside of the tests' own process, for all tests that are not about the process that bakes."""

from __future__ import annotations

import shutil
import threading
import traceback
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from leaflight.addon.app import job
from leaflight.core.bake import bake, tasks
from leaflight.core.output import image_file
from leaflight.core.parallel.executors import InlineExecutor
from leaflight.core.util.messages import Error, Message
from leaflight.core.util.settings import Settings


class InsideBake:
    """Does what job.BakeProcess does, in a thread: loading the core into a process of its own takes longer than a small bake."""

    def __init__(self, folder: Path, python_args: tuple[str, ...] = (), *, yielding: bool = False) -> None:
        self.folder = folder
        self._told: SimpleQueue[Message | None] = SimpleQueue()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._bake, daemon=True)

    def _bake(self) -> None:
        try:
            bake.run_bake(self.folder, self._told.put, self._stop.is_set, _open_executor)
        except (ValueError, OSError) as reason:
            self._told.put(Error(str(reason)))
        except Exception:  # a fault of ours ends the bake with its traceback, as it ends the process that this stands in for
            self._told.put(Error(traceback.format_exc()))
        self._told.put(None)

    def messages(self) -> Iterator[Message]:
        self._thread.start()
        yield from iter(self._told.get, None)

    def cancel(self) -> None:
        self._stop.set()

    def kill(self) -> None:
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    close = kill


def _open_executor(settings: Settings) -> Executor:
    return tasks.open_executor(settings) if settings.cluster else InlineExecutor()


@pytest.fixture(autouse=True)
def _bake_inside(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bakes take place in this process, by one worker, but for tests that are marked own_process."""
    if request.node.get_closest_marker("own_process"):
        return
    image_file.load_ahead(job.library_paths())
    for name in ("__init__", "_bake", "messages", "cancel", "kill", "close"):
        monkeypatch.setattr(job.BakeProcess, name, vars(InsideBake)[name], raising=False)


@pytest.fixture
def empty_file() -> None:
    """Much sooner there than by read_factory_settings, which loads all add-ons again."""
    import bpy  # where there is none, the tests themselves are left out

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


@pytest.fixture
def sky(empty_file: None) -> tuple[Any, Any, Any]:
    """A world of one black background node: the world, its tree, the node."""
    import bpy

    world = bpy.data.worlds.new("Sky")
    bpy.context.scene.world = world
    if world.node_tree is None:
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    return world, world.node_tree, background


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """The .blend of blend_rooms' room, which is open."""
    from blend_rooms import open_room, save_scene

    open_room()
    return save_scene(tmp_path / "room.blend")


@pytest.fixture
def addon() -> Iterator[None]:
    """The add-on is registered."""
    from blend_rooms import use_addon

    with use_addon():
        yield


@pytest.fixture
def addon_room(addon: None, tmp_path: Path) -> None:
    """blend_rooms' room, open with the add-on, set for quick bakes into the folder `maps`."""
    from blend_rooms import ask_quick_bake, open_room

    open_room()
    ask_quick_bake(tmp_path / "maps")


@pytest.fixture
def baked_room(baked: Path, addon: None, tmp_path: Path) -> Path:
    """A copy of what `baked`, a fixture of the test's file, has from blend_rooms.save_baked, its room.blend open with the add-on."""
    import bpy

    shutil.copytree(baked, tmp_path, dirs_exist_ok=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    return tmp_path


@pytest.fixture
def state() -> Any:
    """What the panel knows of the bake."""
    import bpy

    return bpy.context.window_manager.leaflight_state
