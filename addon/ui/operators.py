"""Bake, stop, show and remove, as Blender's operators."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ..app import live
from ..app.arguments import BakeRequest
from ..app.kept_state import describe_lack, refine_request, remove_state
from ..app.marks_check import drop_broken_marks
from ..app.preparation import Preparation
from ..app.request import make_request
from ..read.steps import never_halved
from ..show import restore, shown_pages, view_shading
from .baking import FIRST_TIMER_SECONDS, SLICE_SECONDS, Baking, count_updates, find_scene, get_state, is_out_of_edit_mode


@bpy.app.handlers.persistent
def forget_last_bake(*_: Any) -> None:
    """The panel must not tell of another file's bake, and a file saved in the middle of one must not show it."""
    drop_broken_marks()
    get_state(bpy.context).clear()
    live.take_off()
    shown_pages.keep_named_pages()
    shown_pages.check_pages()
    pages = bpy.context.window_manager.leaflight_pages
    pages.clear()
    pages.update(shown_pages.list_pages())


@bpy.app.handlers.persistent
def give_scene_back(*_: Any) -> None:
    """Another file is opened: flags of this one may be those of objects that both use."""
    get_state(bpy.context).give_back()


@bpy.app.handlers.persistent
def take_live_off(*_: Any) -> None:
    """A file that is saved during a bake holds what was there before; the next pages put the light on again.

    Where the scene is still being read, it is put back as it was, and is read again.

    So does an undo: light so far is in none of its steps, and Blender crashes where objects wear what no step knows.
    """
    get_state(bpy.context).give_back()
    live.take_off()


@bpy.app.handlers.persistent
def forget_old_light(*_: Any) -> None:
    """Undo may bring back a moment of a bake that is over, or a page that is gone."""
    if not get_state(bpy.context).running:
        live.take_off()
        shown_pages.check_pages()
        view_shading.restore_views()


@bpy.app.handlers.persistent
def keep_pages(*_: Any) -> None:
    """A file that was saved needs its pages, and no longer those of earlier sessions."""
    if bpy.data.filepath:
        shown_pages.keep_for_file(Path(bpy.data.filepath), bpy.context.window_manager.leaflight_pages)


class LEAFLIGHT_OT_bake(Baking, bpy.types.Operator):
    bl_idname = "leaflight.bake"
    bl_label = "Bake"
    bl_description = "Bake the light of the scene to textures and show them on the objects"


class LEAFLIGHT_OT_refine(Baking, bpy.types.Operator):
    bl_idname = "leaflight.refine"
    bl_label = "Refine"
    bl_description = "Go on with the last bake to the panel's error, or to half its own where that is smaller"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context) or not restore.has_bake(context.scene):
            return False
        lack = describe_lack(context.scene)
        if lack:
            cls.poll_message_set(lack)
            return False
        return True

    def _make_request(self, context: bpy.types.Context) -> BakeRequest:
        return refine_request(context.scene, make_request(context))


class LEAFLIGHT_OT_stop(bpy.types.Operator):
    bl_idname = "leaflight.stop"
    bl_label = "Stop"
    bl_description = "Stop the bake and keep the best so far"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        state = get_state(context)
        return state.running and not (state.stopping or state.notice)

    def execute(self, context: bpy.types.Context) -> set[str]:
        get_state(context).cancel()
        return {"FINISHED"}


class LEAFLIGHT_OT_discard(bpy.types.Operator):
    """In a place of its own: a second click on Stop must not throw the bake away."""

    bl_idname = "leaflight.discard"
    bl_label = "Discard"
    bl_description = "Throw this bake away and put back what was there"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return get_state(context).running

    def execute(self, context: bpy.types.Context) -> set[str]:
        get_state(context).discard()
        return {"FINISHED"}


class LEAFLIGHT_OT_toggle_preview(bpy.types.Operator):
    bl_idname = "leaflight.toggle_preview"
    bl_label = "Show Bake"
    bl_description = "Switch between the baked and the original materials"
    bl_options = frozenset({"REGISTER", "UNDO"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return restore.has_bake(context.scene) and is_out_of_edit_mode(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        for _, sentence in restore.toggle_preview(scene, not restore.is_preview_on(scene)):
            self.report({"WARNING"}, sentence)
        return {"FINISHED"}


class LEAFLIGHT_OT_remove(bpy.types.Operator):
    bl_idname = "leaflight.remove"
    bl_label = "Remove"
    bl_description = "Take the bake off the scene and put everything back as it was; the image files stay"
    bl_options = frozenset({"REGISTER", "UNDO"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return restore.has_bake(context.scene) and not get_state(context).running and is_out_of_edit_mode(cls, context)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if context.window is None:
            return self.execute(context)
        remove_state(context.scene)
        self._scene_uid = context.scene.session_uid
        self._removal = Preparation(lambda: never_halved(restore.remove_steps(find_scene(self._scene_uid))), count_updates)
        get_state(context).give_back = self._removal.give_back
        if self._removal.advance(SLICE_SECONDS) is not None:
            return self._conclude(context)
        self._timer = context.window_manager.event_timer_add(FIRST_TIMER_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Until all is removed nothing else reaches the scene."""
        is_there = find_scene(self._scene_uid) is not None
        if is_there and (event.type != "TIMER" or self._removal.advance(SLICE_SECONDS) is None):
            return {"RUNNING_MODAL"}
        context.window_manager.event_timer_remove(self._timer)
        return self._conclude(context)

    def cancel(self, _context: bpy.types.Context) -> None:
        self._removal.close()

    def execute(self, context: bpy.types.Context) -> set[str]:
        remove_state(context.scene)
        restore.remove_bake(context.scene)
        return self._conclude(context)

    def _conclude(self, context: bpy.types.Context) -> set[str]:
        view_shading.restore_views()
        state = get_state(context)
        if state.scene == context.scene.session_uid:  # of another scene's bake the panel goes on telling
            state.forget()
        return {"FINISHED"}


CLASSES = (
    LEAFLIGHT_OT_bake,
    LEAFLIGHT_OT_refine,
    LEAFLIGHT_OT_stop,
    LEAFLIGHT_OT_discard,
    LEAFLIGHT_OT_toggle_preview,
    LEAFLIGHT_OT_remove,
)
