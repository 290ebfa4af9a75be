"""What a user chooses once: the preferences, the shortcut and the tone."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

import leaflight
from leaflight.addon.ui import keymap, preferences, sound


@pytest.fixture(autouse=True)
def _registered():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    leaflight.register()
    yield
    leaflight.unregister()


def list_shortcuts():
    """Keys of Bake in the add-ons' key configuration."""
    keys = bpy.context.window_manager.keyconfigs.addon
    items = [item for keymap in keys.keymaps for item in keymap.keymap_items] if keys else []
    return [(item.type, item.ctrl, item.shift) for item in items if item.idname == "leaflight.bake"]


def test_the_shortcut_goes_with_the_extension():
    if bpy.context.window_manager.keyconfigs.addon is None:
        pytest.skip("no keys in the background")
    assert list_shortcuts() == [("F12", True, True)]
    keymap.unregister()
    assert list_shortcuts() == []
    keymap.register()
    assert list_shortcuts() == [("F12", True, True)]


def test_preferences_are_named_as_blender_names_the_extension():
    assert preferences.ADDON == "leaflight"
    assert preferences.LeaflightPreferences.bl_idname == "leaflight"


def test_nothing_is_switched_on_by_itself():
    assert not preferences.wants(bpy.context, "sound")
    off = SimpleNamespace(preferences=SimpleNamespace(research=False, sound=False))
    on = SimpleNamespace(preferences=SimpleNamespace(research=False, sound=True))
    for addon, heard in ((off, False), (on, True)):
        context = SimpleNamespace(preferences=SimpleNamespace(addons={"leaflight": addon}))
        assert preferences.wants(context, "sound") is heard
        assert not preferences.wants(context, "research")


def test_a_machine_without_sound_is_silent():
    """Whatever it has: a bake must not end with an error for a tone's sake."""
    assert sound.play_tones() in (True, False)
