"""Watches what has changed in a scene since it was baked, for the panel; never computed while drawing.

What changes is looked at a moment later by a timer, a little at a time; meshes are read again only where they changed.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import bpy

from ..show.redraw import redraw
from ..show.scene_prints import PRINTS, Prints, list_changes, read_marked, walk_prints

_CALM_S = 0.2  # without a change, before looking
_STEP_S = 0.02  # of looking at a time: Blender must stay smooth
_PAUSE_S = 0.03


class ChangeWatch:
    """What has changed since the bake of the scene that is shown.

    names   of it, [] nothing, or nothing is known
    older   of scene_prints.Baked
    """

    def __init__(self) -> None:
        self._first: dict[str, Prints] = {}  # of scenes that another Blender has baked, as they were when they were first looked at
        self.clear()

    def clear(self) -> None:
        """Forget everything: another file, or a moment that undo brought back."""
        self.names: list[str] = []
        self.older: tuple[str, ...] = ()
        self.stale = True
        self._meshes: dict[int, str] = {}
        self._shown = ""  # what it was looked at for: the scene, and the mark of its bake
        self._changed = 0.0
        self._walk: Iterator[tuple[str, str]] | None = None
        self._prints: Prints = {}

    def note(self, meshes: set[int]) -> None:
        """Something in the scene changed; meshes of these session_uid too."""
        for uid in meshes:
            self._meshes.pop(uid, None)
        self.stale, self._changed, self._walk = True, time.monotonic(), None

    def watch(self, context: bpy.types.Context) -> list[str]:
        """The panel is being drawn: gives the names, and sees to it that they are brought up to date."""
        if self._shown != _read_key(context):
            self._shown, self.names, self.stale, self._walk = _read_key(context), [], True, None
            baked = read_marked(context.scene)
            self.older = baked.older if baked else ()
        if PRINTS not in context.scene:
            return []
        if self.stale:
            self.start()
        return self.names

    def start(self) -> None:
        """See to it that the timer runs."""
        if not bpy.app.timers.is_registered(_tick):
            bpy.app.timers.register(_tick, first_interval=_CALM_S)

    def is_calm(self) -> bool:
        """Whether the last change is long enough ago."""
        return time.monotonic() - self._changed >= _CALM_S

    def look(self, context: bpy.types.Context, seconds: float = float("inf")) -> bool:
        """Look at the scene, for so long at most; gives whether it is done and `names` are up to date."""
        baked, until = read_marked(context.scene), time.monotonic() + seconds
        if baked is None:
            self.names, self.stale = [], False
            return True
        if self._walk is None:
            self._walk, self._prints = walk_prints(context.scene, context.view_layer, self._meshes), {}
        for name, digest in self._walk:
            self._prints[name] = digest
            if time.monotonic() > until:
                return False
        before = baked.prints if baked.is_comparable else self._first.setdefault(_read_key(context), self._prints)
        self.names, self.stale, self._walk = list_changes(before, self._prints), False, None
        return True


def _read_key(context: bpy.types.Context) -> str:
    return f"{context.scene.session_uid} {context.view_layer.name} {hash(context.scene.get(PRINTS, ''))}"


def _tick() -> float | None:
    """The timer: looks once the scene is calm; ends when all is up to date."""
    context = bpy.context
    watch: ChangeWatch = context.window_manager.leaflight_changes
    screen = context.screen
    if context.window_manager.leaflight_state.running or not watch.is_calm() or (screen and screen.is_animation_playing):
        return _CALM_S
    if not watch.look(context, _STEP_S):
        return _PAUSE_S
    redraw(context, "UI")
    return None


@bpy.app.handlers.persistent
def note_changes(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Handler of every change that Blender evaluates."""
    watch = getattr(bpy.context.window_manager, "leaflight_changes", None)
    if watch is None:
        return
    changed = [update.id.original for update in depsgraph.updates if update.is_updated_geometry]
    meshes = {block.data if isinstance(block, bpy.types.Object) else block for block in changed}
    watch.note({block.session_uid for block in meshes if isinstance(block, bpy.types.Mesh)})
    scene = bpy.context.scene
    if not bpy.app.background and scene and PRINTS in scene:
        watch.start()  # also where nothing has the panel drawn again


@bpy.app.handlers.persistent
def forget_prints(*_: Any) -> None:
    """Handler of a file that was opened, and of undo."""
    bpy.context.window_manager.leaflight_changes.clear()


_HANDLERS = (
    ("depsgraph_update_post", note_changes),
    ("frame_change_post", note_changes),
    ("load_post", forget_prints),
    ("undo_post", forget_prints),
    ("redo_post", forget_prints),
)


def register() -> None:
    """Listen to changes from now on."""
    bpy.types.WindowManager.leaflight_changes = ChangeWatch()
    for name, handler in _HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Take back what `register` did."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    for name, handler in reversed(_HANDLERS):
        getattr(bpy.app.handlers, name).remove(handler)
    del bpy.types.WindowManager.leaflight_changes
