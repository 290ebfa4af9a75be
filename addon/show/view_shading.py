"""Lets a 3D View show the bake: in Blender's default view, Solid with material colours, nobody sees an image.

How a view was is kept on its screen, so that Remove finds it after the file was opened again, too.
"""

from __future__ import annotations

from typing import Any

import bpy

from ..read import uv_layer
from ..read.tags import MADE, is_made, local_objects, remove_mark
from . import materials_write, restore
from .images import is_overexposed

VIEWS = "leaflight_views"  # on a screen: by index of the area, how its view was before we changed it, and how we left it
_KEPT = ("type", "color_type", "light")
_SOLID = {"type": "SOLID", "color_type": "TEXTURE", "light": "FLAT"}
_MATERIAL = {"type": "MATERIAL"}


def hides_bake(context: bpy.types.Context) -> bool:
    """Whether the view that is drawn now cannot show the images that objects wear."""
    shading = getattr(context.space_data, "shading", None)
    if shading is None or shading.type in ("MATERIAL", "RENDERED"):
        return False
    return shading.type == "WIREFRAME" or shading.color_type != "TEXTURE"


def show_bake(screen: bpy.types.Screen, area: bpy.types.Area, scene: bpy.types.Scene) -> None:
    """Switch a view so that it shows the bake of the scene."""
    shading, index = area.spaces.active.shading, str(list(screen.areas).index(area))
    wanted = _SOLID if _suits_solid(scene) else _MATERIAL
    kept = screen[VIEWS].to_dict() if VIEWS in screen else {}
    kept[index] = {"before": _read(shading), "after": {}}
    for name, value in wanted.items():
        setattr(shading, name, value)
    kept[index]["after"] = _read(shading)
    screen[VIEWS] = kept


def _suits_solid(scene: bpy.types.Scene) -> bool:
    """Whether Solid shows the bake as it is: it knows no objects' parts of a page, no gaps, and nothing brighter than white."""
    wearers = [obj for obj in local_objects(scene.objects) if materials_write.is_shown(obj)]
    materials = {slot.material for obj in wearers for slot in obj.material_slots if is_made(slot.material)}
    return not (
        any(uv_layer.PLACE in obj for obj in wearers)
        or any(node.type == "BSDF_TRANSPARENT" and MADE in node for material in materials for node in material.node_tree.nodes)
        or any(is_overexposed(image) for image in set(map(materials_write.find_image, wearers)) if image)
    )


def restore_views() -> None:
    """Views back as they were, where the user has not changed them since; only once no scene wears a bake any more."""
    if any(restore.has_bake(scene) for scene in bpy.data.scenes):
        return
    for screen in bpy.data.screens:
        if VIEWS not in screen:
            continue
        for index, kept in screen[VIEWS].to_dict().items():
            area = screen.areas[int(index)] if int(index) < len(screen.areas) else None
            if area is not None and area.type == "VIEW_3D" and _read(area.spaces.active.shading) == kept["after"]:
                for name, value in reversed(kept["before"].items()):  # the type last: the others are of Solid
                    setattr(area.spaces.active.shading, name, value)
        remove_mark(screen, VIEWS)


def _read(shading: Any) -> dict[str, str]:
    return {name: str(getattr(shading, name)) for name in _KEPT}


class LEAFLIGHT_OT_show_it(bpy.types.Operator):
    bl_idname = "leaflight.show_it"
    bl_label = "Show It"
    bl_description = "Switch this view so that it shows the baked light; Remove switches it back"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"

    def execute(self, context: bpy.types.Context) -> set[str]:
        show_bake(context.screen, context.area, context.scene)
        return {"FINISHED"}


CLASSES = (LEAFLIGHT_OT_show_it,)
