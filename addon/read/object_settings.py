"""What one chooses for a single object, kept on it: whether it is baked, how finely, and on which sides.

No `from __future__ import annotations` here: Blender reads properties out of annotations.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import bpy

from .tags import local_objects, remove_mark

BAKE, CAST, IGNORE = "BAKE", "CAST", "IGNORE"

_ROLES = [
    (BAKE, "Bake", "It gets a lightmap"),
    (CAST, "Only Cast Light", "It casts light and shadow, but gets no lightmap"),
    (IGNORE, "Ignore", "The bake takes place as if it was not there"),
]
_SIDES = [
    ("SCENE", "As Scene", "As it is chosen for all objects"),
    ("AUTOMATIC", "Automatic", "The front, or the back where the front looks into a solid"),
    ("FRONT", "Front", "The light on the front of each face, to which its normal points"),
    ("BOTH", "Both", "The light on both sides added up, as for leaves and paper without a Translucent BSDF"),
]


class LeaflightObject(bpy.types.PropertyGroup):
    """One object's own choices."""

    role: bpy.props.EnumProperty(name="Role", description="What the object does in a bake", items=_ROLES)
    density_factor: bpy.props.FloatProperty(
        name="Density Factor",
        description="Texels per metre of this object, relative to the others: 2 is twice as fine; not for a UV layer of your own",
        default=1.0,
        min=0.01,
        max=100.0,
        soft_min=0.25,
        soft_max=4.0,
        precision=2,
    )
    sides: bpy.props.EnumProperty(name="Sides", description="Which side of a face its lightmap shows", items=_SIDES)


@dataclass(frozen=True)
class ObjectChoice:
    """The choices that hold for one piece of the scene; sides as in core.scene.SceneObject."""

    role: str = BAKE
    density_factor: float = 1.0
    sides: str = ""


def read_choice(*objects: bpy.types.Object) -> ObjectChoice:
    """What holds for a piece that all these objects make: what is instanced, and what instances it."""
    chosen: list[Any] = [obj.leaflight for obj in dict.fromkeys(objects)]
    roles = {one.role for one in chosen}
    factor = 1.0
    for one in chosen:
        factor *= float(f"{one.density_factor:.7g}")  # Blender's are float32
    role = next(role for role in (IGNORE, CAST, BAKE) if role in roles)
    sides = {one.sides for one in chosen}
    return ObjectChoice(role, factor, next((side.lower() for side in ("BOTH", "FRONT", "AUTOMATIC") if side in sides), ""))


def register() -> None:
    """Objects have choices from now on."""
    bpy.utils.register_class(LeaflightObject)
    bpy.types.Object.leaflight = bpy.props.PointerProperty(type=LeaflightObject)


def unregister() -> None:
    """Takes back what `register` did; what was chosen stays in the file."""
    del bpy.types.Object.leaflight
    bpy.utils.unregister_class(LeaflightObject)


@contextmanager
def registered() -> Iterator[None]:
    """Choices can be read meanwhile, also where the add-on is not enabled: on pip's bpy."""
    if hasattr(bpy.types.Object, "leaflight"):
        yield
        return
    register()
    try:
        yield
    finally:
        unregister()
        if bpy.app.version < (5, 0, 0):
            _remove_empty()


def _remove_empty() -> None:
    """Before Blender 5.0 a look at an object's choices makes a custom property on it, which stays; empty where nothing was chosen."""
    for obj in local_objects(bpy.data.objects):
        if "leaflight" in obj and not obj["leaflight"].keys():
            remove_mark(obj, "leaflight")
