"""The scene as it is rendered: render levels of detail and render visibility, borrowed for a moment and given back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import bpy

Warnings = list[tuple[str, str]]

# Blender offers scripts only the viewport's evaluation, so the viewport's settings take the render's values meanwhile.
# modifier type -> (viewport property, render property)
_LEVELS = {
    "SUBSURF": ("levels", "render_levels"),
    "MULTIRES": ("levels", "render_levels"),
    "SCREW": ("steps", "render_steps"),
    "OCEAN": ("viewport_resolution", "resolution"),
}


@contextmanager
def evaluate_for_render(scene: Any, view_layer: Any, warnings: Warnings) -> Iterator[Any]:
    """The evaluated depsgraph with render levels and everything shown that renders; all is as before when it ends.

    What renders must still be picked (`find_render_objects`): nothing is hidden that the viewport shows, because hiding deselects.
    """
    borrowed = _Borrowed(warnings)
    selected = [obj for obj in view_layer.objects if obj.select_get(view_layer=view_layer)]
    active = view_layer.objects.active
    try:
        _borrow_levels(scene, borrowed)
        _borrow_visibility(view_layer, borrowed)
        for obj in view_layer.objects:
            if obj.mode == "EDIT":
                obj.update_from_editmode()
        view_layer.update()
        yield view_layer.depsgraph
    finally:
        if borrowed.give_back():
            view_layer.update()
            for obj in selected:
                with suppress(ReferenceError):
                    obj.select_set(True, view_layer=view_layer)
            with suppress(ReferenceError):
                view_layer.objects.active = active


def find_render_objects(view_layer: Any) -> set[Any]:
    """The objects of the view layer that a render shows: neither they nor a collection they are in is hidden in render."""
    found: set[Any] = set()
    pending = [(view_layer.layer_collection, False)]
    while pending:
        layer, hidden = pending.pop()
        hidden = hidden or layer.collection.hide_render
        pending.extend((child, hidden) for child in layer.children)
        if not hidden and not layer.exclude:
            found.update(obj for obj in layer.collection.objects if not obj.hide_render)
    return found


def find_view_layer(context_or_scene: Any, scene: Any) -> Any:
    """The view layer of a context, or that in which a scene is shown, else its first that renders."""
    if context_or_scene is not scene:
        return context_or_scene.view_layer
    if bpy.context.scene == scene:
        return bpy.context.view_layer
    return next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])


def find_set_objects(view_layer: Any) -> set[Any]:
    """The objects of the scene's Background Scene, and of that one's own, which are rendered beside those of the view layer."""
    found: set[Any] = set()
    seen = {view_layer.id_data}
    behind = view_layer.id_data.background_set
    while behind is not None and behind not in seen:
        seen.add(behind)
        found |= find_render_objects(next((layer for layer in behind.view_layers if layer.use), behind.view_layers[0]))
        behind = behind.background_set
    return found


def find_hidden_instances(collection: Any) -> set[Any]:
    """The objects below an instanced collection that a render does not show there."""
    shown: set[Any] = set()
    every: set[Any] = set()
    pending, visited = [(collection, False)], set()
    while pending:
        branch, hidden = pending.pop()
        if (branch, hidden) in visited:
            continue
        visited.add((branch, hidden))
        hidden = hidden or branch.hide_render
        pending.extend((child, hidden) for child in branch.children)
        for obj in branch.objects:
            every.add(obj)
            if not hidden and not obj.hide_render:
                shown.add(obj)
            if obj.instance_type == "COLLECTION" and obj.instance_collection:
                pending.append((obj.instance_collection, hidden or obj.hide_render))
    return every - shown


class _Borrowed:
    """Properties set for a moment, with what they held."""

    def __init__(self, warnings: Warnings) -> None:
        self._warnings = warnings
        self._given: list[tuple[Any, str, Any]] = []

    def set(self, owner: Any, name: str, value: Any, subject: str) -> None:
        before = getattr(owner, name)
        before = tuple(before) if isinstance(value, tuple) else before  # Blender's own arrays change with what they are of
        if before == value:
            return
        try:
            setattr(owner, name, value)
        except (AttributeError, RuntimeError, TypeError):
            self._warnings.append((subject, f"is linked and cannot be edited: its viewport {name} is used in place of the render's"))
            return
        self._given.append((owner, name, before))

    def show(self, obj: Any, view_layer: Any) -> None:
        obj.hide_set(False, view_layer=view_layer)
        self._given.append((obj, "", view_layer))

    def give_back(self) -> bool:
        """Restore everything that is still there, latest first; False when there was nothing to restore."""
        for owner, name, before in reversed(self._given):
            with suppress(ReferenceError):  # a script deleted it between two steps
                if name:
                    setattr(owner, name, before)
                else:
                    owner.hide_set(True, view_layer=before)
        return bool(self._given)


def _borrow_levels(scene: Any, borrowed: _Borrowed) -> None:
    if scene.render.use_simplify:
        borrowed.set(scene.render, "simplify_subdivision", scene.render.simplify_subdivision_render, scene.name)
    for obj in bpy.data.objects:
        for modifier in obj.modifiers:
            borrowed.set(modifier, "show_viewport", modifier.show_render, obj.name)
            if modifier.type in _LEVELS:
                viewport, render = _LEVELS[modifier.type]
                borrowed.set(modifier, viewport, getattr(modifier, render), obj.name)
    for curve in bpy.data.curves:
        # setting a curve's own resolution resets that of every spline in it, so the splines are set; a text has none
        for owner in curve.splines or (curve,):
            for direction in ("u", "v"):
                resolution = getattr(curve, f"render_resolution_{direction}")
                if resolution > 0:
                    borrowed.set(owner, f"resolution_{direction}", resolution, curve.name)
    _borrow_particles(scene, borrowed)
    for tree in bpy.data.node_groups:
        for link in tree.links:
            if link.from_node.bl_idname == "GeometryNodeIsViewport":
                _borrow_false(link, borrowed, tree.name)
    for metaball in bpy.data.metaballs:
        borrowed.set(metaball, "resolution", metaball.render_resolution, metaball.name)


def _borrow_false(link: Any, borrowed: _Borrowed, subject: str) -> None:
    """Mute a link, so that False, its socket's own value, holds. A muted node that has no inputs still gives True in Blender 5.3."""
    value = getattr(link.to_socket, "default_value", None)
    if value is not None:
        borrowed.set(link.to_socket, "default_value", (0.0,) * len(value) if hasattr(value, "__len__") else type(value)(), subject)
    borrowed.set(link, "is_muted", True, subject)


def _borrow_particles(scene: Any, borrowed: _Borrowed) -> None:
    if scene.render.use_simplify:
        borrowed.set(scene.render, "simplify_child_particles", scene.render.simplify_child_particles_render, scene.name)
    for settings in bpy.data.particles:
        borrowed.set(settings, "display_percentage", 100, settings.name)
        if settings.type == "HAIR":
            borrowed.set(settings, "display_step", settings.render_step, settings.name)
            if settings.display_method == "NONE":  # Blender makes no paths for those
                borrowed.set(settings, "display_method", "RENDER", settings.name)
        if settings.child_type != "NONE":
            borrowed.set(settings, "child_percent", settings.rendered_child_count, settings.name)


def _borrow_visibility(view_layer: Any, borrowed: _Borrowed) -> None:
    for obj in bpy.data.objects:
        if obj.hide_viewport and not obj.hide_render:
            borrowed.set(obj, "hide_viewport", False, obj.name)
        if obj.show_instancer_for_render and not obj.show_instancer_for_viewport:
            borrowed.set(obj, "show_instancer_for_viewport", True, obj.name)
    for collection in bpy.data.collections:
        if collection.hide_viewport and not collection.hide_render:
            borrowed.set(collection, "hide_viewport", False, collection.name)
    pending = [view_layer.layer_collection]
    while pending:
        layer = pending.pop()
        pending.extend(layer.children)
        if layer.hide_viewport and not layer.exclude:
            borrowed.set(layer, "hide_viewport", False, layer.name)
    for obj in view_layer.objects:
        if obj.hide_get(view_layer=view_layer):
            borrowed.show(obj, view_layer)
