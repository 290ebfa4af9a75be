"""The add-on inside Blender: what it registers. bpy is imported when Blender registers it, not before."""

from __future__ import annotations


def register() -> None:
    """Register everything; what fails half-way is taken back."""
    from contextlib import ExitStack

    import bpy

    from .app import changes, live, properties, scene_meter, spare_images
    from .app.bake_state import BakeState
    from .gltf import export_gltf
    from .read import object_settings
    from .show import view_shading
    from .ui import checker, keymap, operators, panels, panels_object, preferences, presets, select_operator

    state = BakeState()
    commands = (*operators.CLASSES, *select_operator.CLASSES, *checker.CLASSES, *export_gltf.CLASSES)
    commands += (*spare_images.CLASSES, *view_shading.CLASSES)
    choices = (*preferences.CLASSES, *presets.CLASSES)
    with ExitStack() as undo:
        for cls in (properties.LeaflightProperties, *choices, *commands, *panels.CLASSES, *panels_object.CLASSES):
            bpy.utils.register_class(cls)
            undo.callback(bpy.utils.unregister_class, cls)
        for part in (object_settings, scene_meter, changes, checker, keymap):
            part.register()
            undo.callback(part.unregister)
        bpy.types.Scene.leaflight = bpy.props.PointerProperty(type=properties.LeaflightProperties)
        undo.callback(delattr, bpy.types.Scene, "leaflight")
        command = bpy.utils.register_cli_command("leaflight", _run_command_line)
        undo.callback(bpy.utils.unregister_cli_command, command)
        handlers = bpy.app.handlers
        for when, handler in (
            (handlers.load_pre, operators.give_scene_back),
            (handlers.load_post, operators.forget_last_bake),
            (handlers.save_pre, operators.take_live_off),
            (handlers.save_post, operators.keep_pages),
            (handlers.undo_pre, operators.take_live_off),
            (handlers.redo_pre, operators.take_live_off),
            (handlers.undo_post, operators.forget_old_light),
            (handlers.redo_post, operators.forget_old_light),
        ):
            when.append(handler)
            undo.callback(when.remove, handler)
        undo.callback(live.take_off)
        undo.callback(state.clear)
        # The only state that outlives a call: the bake, and the pages of all bakes since the file was opened. It belongs to this Blender,
        # not to a file, so it is no Blender property: those are saved, and undo and opening a file would bring an old one back.
        for name, value in (("leaflight_state", state), ("leaflight_pages", set())):
            setattr(bpy.types.WindowManager, name, value)
            undo.callback(delattr, bpy.types.WindowManager, name)
        bpy.types.WindowManager.leaflight_registered = undo.pop_all()


def unregister() -> None:
    """Take back all that `register` did, last first; a bake that runs is ended."""
    import bpy

    registered = bpy.types.WindowManager.leaflight_registered
    del bpy.types.WindowManager.leaflight_registered
    registered.close()


def _run_command_line(argv: list[str]) -> int:
    from .ui import cli

    return cli.main(argv)
