"""Bakes beside Blender with a window, as the operators Bake and Refine do it: start, follow, show, end."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from ...core.util.messages import Done, Error
from ...core.util.progress import ProgressReporter
from ...core.util.user_text import group_warnings
from ..app import live, session
from ..app.arguments import BakeRequest
from ..app.bake_state import BakeState
from ..app.job import BakeProcess
from ..app.preparation import Preparation
from ..app.request import find_mode_error, find_output_error, make_request
from ..app.scene_meter import find_worn
from ..read.export_scene import READING
from ..read.steps import Steps, never_halved
from ..show.layout import mark_result
from ..show.redraw import redraw
from ..show.shown_pages import note_pages
from . import preferences, sound
from .panel_parts import describe_plan

_TIMER_SECONDS = 0.1
FIRST_TIMER_SECONDS = 0.02  # until there is light: whoever has pressed Bake waits for it
SLICE_SECONDS = 0.1  # of preparation at a time: Blender must stay smooth
_TEXT_SECONDS = 0.25  # between two texts: nobody reads faster, and drawing them takes time from the bake
_FAULT = "The bake could not be shown: this is a fault of Leaflight's, please report it with the text in the system console."
_HINT = "Esc: stop and keep the best so far"
_NO_LIGHT = "Stopped before there was any light"


def get_state(context: bpy.types.Context) -> BakeState:
    """The bake of this Blender (see `register`)."""
    state: BakeState = context.window_manager.leaflight_state
    return state


class Baking:
    """Bakes beside Blender with a window; without one, or from a script, until it is done."""

    bl_options = frozenset({"UNDO"})  # not REGISTER: changing an operator's settings afterwards would bake again

    _folder: tempfile.TemporaryDirectory[str] | None = None
    _preparation: Preparation[session.Session] | None = None
    _showing: Preparation[bool] | None = None  # the first light, while it is put on
    _ending: Preparation[session.Warnings] | None = None  # the result, while it is put on, or light without one, while it is taken off
    _result: dict[str, Any] | None = None
    _timer: Any = None
    _timer_seconds = 0.0
    _shown: tuple[str, str] = ("", "")
    _shown_s = -math.inf

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if get_state(context).running:
            cls.poll_message_set("A bake is running")
            return False
        error = find_output_error(context.scene.leaflight.output)
        if error:
            cls.poll_message_set(error)
            return False
        return True  # also in Edit Mode: what is the matter is told in words, not by a grey button

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if context.window is None:
            return self.execute(context)
        if not self._start(context, preview=True):
            return {"CANCELLED"}
        ended = self._prepare(context, SLICE_SECONDS)
        if ended:
            return ended
        self._set_timer(context, FIRST_TIMER_SECONDS)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            return self._follow(context, event)
        except Exception:  # goes on to Blender's console; Blender then forgets the operator, so the bake must not run on
            self._abandon(context)
            raise

    def _follow(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        state = get_state(context)
        if self._preparation is not None:
            return self._follow_preparation(context, event, self._preparation)
        if event.type == "ESC" and event.value == "PRESS" and not state.stopping and self._ending is None:
            state.cancel()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"} if self._showing is None and self._ending is None else {"RUNNING_MODAL"}
        if self._showing is not None:
            self._show_on(context, self._showing)
            return {"RUNNING_MODAL"}
        self._ended = self._ended or state.drain()
        if isinstance(self._ended, Done) and session.has_result(self._session) and context.mode.startswith("EDIT") and not state.discarded:
            state.notice = "Leave Edit Mode to see the bake"
        elif self._ended:
            return self._finish(context, self._ended, SLICE_SECONDS) or {"RUNNING_MODAL"}
        elif state.previews and not context.mode.startswith("EDIT"):
            paths, showing = state.take_previews(), self._live
            self._showing = Preparation(lambda: showing.show_steps(bpy.context, paths), count_updates)
            state.give_back = self._showing.give_back
            self._show_on(context, self._showing)
        if state.progress:  # no first light came, or Edit Mode hides it
            self._set_timer(context, _TIMER_SECONDS)
        self._show(context)
        return {"PASS_THROUGH"}

    def _show_on(self, context: bpy.types.Context, showing: Preparation[bool]) -> None:
        """Go on with bringing the objects up to date. Until it is done nothing else reaches the scene, as while it is read."""
        is_done = find_scene(self._scene_uid) is None  # the end of the bake reports it
        if not is_done:
            with self._bake_scene(context):
                is_done = showing.advance(SLICE_SECONDS) is not None
        if is_done:
            self._showing = None
            redraw(context, "WINDOW")
            self._set_timer(context, _TIMER_SECONDS)

    def _follow_preparation(
        self, context: bpy.types.Context, event: bpy.types.Event, preparation: Preparation[session.Session]
    ) -> set[str]:
        """While the scene is read, nothing reaches it: what the user does waits for half a second, or goes on beside."""
        state = get_state(context)
        if (event.type == "ESC" and event.value == "PRESS") or state.stopping or state.discarded:
            self._fail(context, "")
            self.report({"INFO"}, _NO_LIGHT)
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"} if preparation.holds else {"PASS_THROUGH"}
        ended = self._prepare(context, SLICE_SECONDS)
        self._show(context)
        return ended or {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not self._start(context, preview=False):
            return {"CANCELLED"}
        return self._prepare(context, math.inf) or self._finish(context, self._ended or get_state(context).wait()) or {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender quits, opens a file, or closes the window; only then does it come to the timer, for data is not to be changed now."""
        if self._preparation is not None:  # of a window that closes: before a file is opened, the scene was put back already
            self._preparation.close()
        for work in (self._showing, self._ending):
            if work is not None:
                work.close()
        get_state(context).forget()
        self._clean_up(context)
        bpy.app.timers.register(live.take_off if self._live is None else self._live.take_off, first_interval=0.0)

    def _make_request(self, context: bpy.types.Context) -> BakeRequest:
        return make_request(context)

    def _start(self, context: bpy.types.Context, preview: bool) -> bool:
        mode_error = find_mode_error(context)
        if mode_error:  # the panel tells it as long as it holds
            self.report({"ERROR"}, mode_error)
            return False
        state, began = get_state(context), time.monotonic()
        self._ended: Done | Error | None = None
        self._ending = self._result = None
        self._live: live.LiveView | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="leaflight_", ignore_cleanup_errors=True)
        self._pace = find_worn(context).pace
        # Undo and opening a file make references invalid: only names and numbers are kept.
        self._scene_uid, self._view_layer = context.scene.session_uid, context.view_layer.name
        try:
            request = replace(self._make_request(context), preview=preview, began=began)
            # It loads while the scene is exported.
            process = BakeProcess(Path(self._folder.name), tuple(bpy.app.python_args), yielding=not bpy.app.background)
        except (ValueError, OSError) as reason:
            self._fail(context, str(reason))
            return False

        def begin() -> Steps[session.Session]:
            watch = ProgressReporter(state.hear).say
            return session.prepare_steps(bpy.context.scene, bpy.context.view_layer, request, process.folder, watch)

        meter = context.window_manager.leaflight_meter
        self._process, self._began, self._preparation = process, began, Preparation(begin, lambda: int(meter.updates))
        plan = describe_plan(context)  # now: reading the scene is a change, too, after which it would have to be measured anew
        state.prepare(process, began, self._preparation.give_back, self._scene_uid)
        state.hear(READING)
        state.plan = self._plan = plan
        return True

    def _prepare(self, context: bpy.types.Context, seconds: float) -> set[str] | None:
        """Go on with the export; gives how the operator ends, if it does."""
        assert self._preparation is not None
        state = get_state(context)
        if find_scene(self._scene_uid) is None:
            self._fail(context, "The scene was deleted before it was read.")
            return {"CANCELLED"}
        try:
            with self._bake_scene(context):
                prepared = self._preparation.advance(seconds)
        except (ValueError, OSError) as reason:
            self._fail(context, str(reason))
            return {"CANCELLED"}
        if prepared is None:
            if self._preparation.is_long:
                state.stage = session.READING_WORLD
            return None
        self._preparation = None
        self._session, self._live = prepared, live.LiveView(prepared)
        warnings = list(prepared.export.warnings)
        if prepared.kept:
            self._ended = state.begin_kept(session.list_kept_messages(prepared), self._began, warnings, self._scene_uid)
        else:
            state.begin(self._process, self._began, warnings, prepared.request.settings.error, self._scene_uid)
            state.plan = self._plan if self._plan[0] else describe_plan(context, len(prepared.export.objects))
        return self._finish(context, self._ended, seconds) if self._ended else None

    def _fail(self, context: bpy.types.Context, error: str) -> None:
        """End what has not even begun to bake."""
        if self._preparation is not None:
            self._preparation.close()
            self._preparation = None
        get_state(context).fail(error, self._scene_uid)
        if error:
            self.report({"ERROR"}, error)
        self._clean_up(context)

    def _finish(self, context: bpy.types.Context, ended: Done | Error, seconds: float = math.inf) -> set[str] | None:
        """Go on with showing the result, or taking off the light of a bake without one; gives how the operator ends, once it does."""
        state = get_state(context)
        error, result, is_over = _FAULT, None, True
        try:
            if self._ending is None:
                self._begin_ending(context, ended)
            with self._bake_scene(context) if self._result else nullcontext():
                warnings = self._ending.advance(seconds)
                if warnings is None:
                    is_over = False
                    return None
                state.warnings += warnings
                note_pages(context.window_manager.leaflight_pages)
            error, result = ended.text if isinstance(ended, Error) and not state.discarded else "", self._result
        except (ValueError, OSError) as reason:
            error = str(reason)
        finally:  # a fault of ours goes on to Blender's console, but leaves no bake that runs for ever
            if is_over:
                state.end(error, result, self._pace)
                self._live.take_off()
                self._clean_up(context)
        scene = find_scene(self._scene_uid)
        if result is not None and scene is not None:
            mark_result(scene, state.worn[self._scene_uid])
            if context.window is not None and preferences.wants(context, "sound"):
                sound.play_tones()
        if error:
            self.report({"ERROR"}, error)
        if result is None:
            if not error and not state.discarded:
                self.report({"INFO"}, _NO_LIGHT)
            return {"CANCELLED"}
        lines, count = state.summarize(), len(group_warnings(state.warnings))
        told = f"; {count} warning{'s' if count > 1 else ''} in the panel" if count else ""
        self.report({"WARNING"} if count else {"INFO"}, f"{lines[0]}, {lines[1].lower()}{told}")
        return {"FINISHED"}

    def _begin_ending(self, context: bpy.types.Context, ended: Done | Error) -> None:
        state, showing = get_state(context), self._live
        found = None
        if not (isinstance(ended, Error) or state.discarded) and session.has_result(self._session):
            found = session.read_result(self._session) | {"resumed": self._session.request.resume is not None}
            with self._bake_scene(context):
                session.finish_files(bpy.context.scene, found)
        self._result = found
        self._ending = Preparation(lambda: never_halved(showing.end_steps(bpy.context, found)), count_updates)
        state.give_back = self._ending.give_back

    @contextmanager
    def _bake_scene(self, context: bpy.types.Context) -> Iterator[None]:
        """The scene that was baked, whichever is shown now."""
        scene = find_scene(self._scene_uid)
        if scene is None:
            raise ValueError("the scene was deleted during the bake; the images are in the output folder.")
        if scene == context.scene:
            yield
            return
        view_layer = scene.view_layers.get(self._view_layer) or scene.view_layers[0]
        with context.temp_override(scene=scene, view_layer=view_layer):
            yield

    def _abandon(self, context: bpy.types.Context) -> None:
        """End a bake that a fault of ours has left without anyone to follow it."""
        state = get_state(context)
        if state.running:
            state.discard()
            if self._preparation is not None:
                self._preparation.close()
                self._preparation = None
            for work in (self._showing, self._ending):
                if work is not None:
                    work.close()
            self._showing = self._ending = None
            state.end(_FAULT)
            self._clean_up(context)
            live.take_off() if self._live is None else self._live.take_off()

    def _set_timer(self, context: bpy.types.Context, seconds: float) -> None:
        if seconds == self._timer_seconds:
            return
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
        self._timer, self._timer_seconds = context.window_manager.event_timer_add(seconds, window=context.window), seconds

    def _show(self, context: bpy.types.Context) -> None:
        shown, now = get_state(context).describe(), time.monotonic()
        if shown != self._shown and now >= self._shown_s + _TEXT_SECONDS:
            self._shown, self._shown_s = shown, now
            context.workspace.status_text_set(f"Leaflight  {shown[0]}  {shown[1]}    {_HINT}")
            redraw(context, "UI")

    def _clean_up(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
            _clear_status_bar(context)
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None
        redraw(context, "UI")


def find_scene(uid: int) -> bpy.types.Scene | None:
    """The scene of a session_uid, None if it was deleted."""
    return next((scene for scene in bpy.data.scenes if scene.session_uid == uid), None)


def count_updates() -> int:
    """Changes of Blender's data until now; what a step itself has changed is no news to the next."""
    bpy.context.view_layer.update()
    return int(bpy.context.window_manager.leaflight_meter.updates)


def _clear_status_bar(context: bpy.types.Context) -> None:
    """Each workspace has a text of its own, and the user may have changed it meanwhile.

    The context's own window may be closing, which ends the operator: it is listed no more, and Blender crashes on its status bar.
    """
    for window in context.window_manager.windows[:1]:
        for workspace in bpy.data.workspaces:
            with context.temp_override(window=window, workspace=workspace):
                workspace.status_text_set(None)


def is_out_of_edit_mode(operator: Any, context: bpy.types.Context) -> bool:
    if context.mode.startswith("EDIT"):
        operator.poll_message_set("Leave Edit Mode first")
        return False
    return True
