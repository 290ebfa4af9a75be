"""How our data is marked, so that it is found without names and taken away again.

Marks are custom properties: they survive saving, undo and duplication. Pointers in them keep the user's data-blocks alive.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import bpy

MADE = "leaflight_made"  # on data-blocks and nodes we created: they may be deleted
ORIGINAL = "leaflight_original"  # on our copy of a material: the user's; absent where the slot was empty
NAME = "Leaflight"
LIVE = "leaflight_live"  # on an image: its page of the bake that runs
STANDS_FOR = "leaflight_stands_for"  # on such an image: that of the earlier bake, whose place it has taken
STATE = "leaflight_state"  # on a scene: the folder, relative to that of the images, which Blender finds again wherever the .blend is saved
STATE_IS = "leaflight_state_is"  # on a scene: digest of the folder's note, for undo and saved files bring back earlier bakes
STATE_OBJECTS = "leaflight_state_objects"  # on a scene: names of the objects that the bake was of, as JSON; none of all
STATE_LACK = "leaflight_state_lack"  # on a scene without one: why nothing was kept of its bake, as a part of a sentence
STATE_OF = "leaflight_state_of"  # on a scene: name of the .blend that the state was kept by, "" where it had none yet


def mark_made(block: Any) -> None:
    """Marks a data-block or node as created by us."""
    block[MADE] = True


def is_made(block: Any) -> bool:
    """Whether we created this data-block, in this file; False for None."""
    return block is not None and MADE in block and not block.library


def find_original(material: bpy.types.Material | None) -> bpy.types.Material | None:
    """The user's material behind ours; a material of the user's is its own original.

    Also behind that of a linked file, which may show its own bake. Nobody has checked that file's marks.
    """
    passed = set()
    while isinstance(material, bpy.types.Material) and MADE in material and material not in passed:
        passed.add(material)
        material = material.get(ORIGINAL)
    return material if isinstance(material, bpy.types.Material) else None


def local_objects(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Those of the objects that belong to this file; another file's may carry that file's bake, which is not ours to remove."""
    return [obj for obj in objects if not obj.library and not obj.override_library]


def remove_mark(block: Any, name: str) -> None:
    """Deletes a custom property where there is one."""
    if name in block:
        del block[name]


def remove_marks(scene: bpy.types.Scene) -> None:
    """Forget the state of the scene's bake."""
    for mark in (STATE, STATE_IS, STATE_LACK, STATE_OBJECTS, STATE_OF):
        remove_mark(scene, mark)


def suffixed_name(name: str) -> str:
    """Name of our copy of something of the user's."""
    return f"{name}.{NAME}"


def remove_unused(blocks: Iterable[Any]) -> None:
    """Deletes those of the data-blocks that we created and nothing uses."""
    remove_blocks([block for block in blocks if is_made(block) and block.users == 0])


def remove_blocks(blocks: Sequence[Any]) -> None:
    """Deletes data-blocks. Even for none of them, Blender would find all of the scene's relations anew: 0.3 s with 2,000 objects."""
    if blocks:
        bpy.data.batch_remove(blocks)


def not_editable_error(obj: bpy.types.Object) -> str:
    """A sentence why the object's slots and UV layers cannot be changed, or ""."""
    if obj.library or obj.override_library:
        return f"{obj.name}: is linked from another file, so its materials stay as they are; make it local to see the bake on it."
    if obj.type != "MESH":
        return f"{obj.name}: is not a mesh; convert it to a mesh to see the bake on it."
    if obj.data.library or obj.data.override_library:
        return f"{obj.name}: its mesh {obj.data.name} is linked from another file; make the mesh local to see the bake on it."
    if obj.data.is_editmode:
        return f"{obj.name}: is in Edit Mode; leave Edit Mode and bake again."
    return ""
