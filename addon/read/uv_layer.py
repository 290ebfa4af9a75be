"""Our UV layer on a mesh: written beside the user's layers and taken off again; and where on a page each object puts it."""

from __future__ import annotations

import zlib
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from .tags import NAME, remove_mark

LAYER = "leaflight_uv_layer"  # on a mesh: name, digest and the user's choices of the moment we added our layer
ACTIVE = "leaflight_active_layer"  # on a mesh that shows a bake: the layer active before, and the one active for the bake
PLACE = "leaflight_uv"  # on an object that shares the layer: scale along x and y, offset along x and y; read by the shader
MAX_LAYERS = 8  # Blender's own limit


def write_layer(mesh: bpy.types.Mesh, corner_uv: NDArray[np.floating[Any]], name: str = NAME) -> str:
    """Creates our layer, or overwrites it, and gives the name it got; a layer of the user's with that name is not touched.

    corner_uv   (n_corner, 2) float, [0, 1]
    Raises ValueError with a sentence when the mesh takes no further layer or the shape is wrong.
    """
    if corner_uv.shape != (len(mesh.loops), 2):
        raise ValueError(f"{mesh.name}: expected lightmap UVs of shape ({len(mesh.loops)}, 2), got {corner_uv.shape}.")
    if mesh.is_editmode:
        raise ValueError(f"{mesh.name}: is in Edit Mode; leave Edit Mode and bake again.")
    layer = find_layer(mesh) or _add_layer(mesh, name)
    flat_uv = np.ascontiguousarray(corner_uv, dtype=np.float32).ravel()
    # Not layer.uv, through which Blender before 5.2 writes into arrays that copies of the mesh share with it.
    mesh.attributes[layer.name].data.foreach_set("vector", flat_uv)
    mesh[LAYER]["name"] = layer.name
    mesh[LAYER]["digest"] = _layer_digest(layer)
    mesh.update()
    return str(layer.name)


def write_place(obj: bpy.types.Object, place: NDArray[np.floating[Any]]) -> None:
    """Puts the layer's unit square on the object's own part of its page.

    place   (4,) float, pages: scale along x and y, offset along x and y
    """
    obj[PLACE] = [float(number) for number in place]
    obj.update_tag()


def read_place(obj: bpy.types.Object) -> NDArray[np.float64]:
    """(4,) float64, pages: what write_place gave the object; the whole page without."""
    return np.array(obj.get(PLACE, (1.0, 1.0, 0.0, 0.0)), np.float64)


def find_layer(mesh: bpy.types.Mesh) -> bpy.types.MeshUVLoopLayer | None:
    """Our layer: by its name, else, when the user renamed it, by its coordinates; None when it is gone."""
    if LAYER not in mesh:
        return None
    mark = mesh[LAYER]
    layer = mesh.uv_layers.get(mark["name"])
    if layer is not None:
        return layer
    return next((other for other in mesh.uv_layers if _layer_digest(other) == mark["digest"]), None)


def has_room(mesh: bpy.types.Mesh) -> bool:
    """Whether our layer is there, or there is room for it."""
    return len(mesh.uv_layers) < MAX_LAYERS or find_layer(mesh) is not None


def layer_name(mesh: bpy.types.Mesh) -> str:
    """Name of our layer now, "" without one."""
    layer = find_layer(mesh)
    return layer.name if layer else ""


def name_ours(evaluated: bpy.types.Object, asked: str | None) -> str:
    """Name of our layer on an evaluated object's own mesh, which is no layer of its textures; "" without one, or where it is asked for."""
    name = layer_name(evaluated.original.data)
    return "" if name == asked else name


def activate_layer(mesh: bpy.types.Mesh, name: str) -> None:
    """Makes the bake's layer the active one, through which the Solid view shows images, and remembers the user's."""
    before = mesh[ACTIVE]["before"] if ACTIVE in mesh else _active_names(mesh)[0]
    mesh[ACTIVE] = {"before": before, "shown": name}
    mesh.uv_layers.active = mesh.uv_layers[name]


def release_active(mesh: bpy.types.Mesh) -> None:
    """Gives the layer its place back that was active before the bake was shown, unless the user chose another since."""
    if ACTIVE not in mesh:
        return
    mark = mesh[ACTIVE].to_dict()
    remove_mark(mesh, ACTIVE)
    active = mesh.uv_layers.active
    if active and active.name in (mark["shown"], layer_name(mesh)):
        _set_active(mesh, mark["before"], "")


def remove_layer(mesh: bpy.types.Mesh) -> None:
    """Takes our layer off, if we added one, and gives the user's active layers back their place."""
    if LAYER not in mesh:
        return
    layer, mark = find_layer(mesh), mesh[LAYER].to_dict()
    if layer is not None:
        layers, own_name = mesh.uv_layers, layer.name
        active, render = _active_names(mesh)
        layers.remove(layer)
        _set_active(mesh, mark["active"] if active == own_name else active, mark["render"] if render == own_name else render)
    remove_mark(mesh, LAYER)
    mesh.update()


def _add_layer(mesh: bpy.types.Mesh, name: str) -> bpy.types.MeshUVLoopLayer:
    if len(mesh.uv_layers) >= MAX_LAYERS:
        raise ValueError(f"{mesh.name}: has {len(mesh.uv_layers)} UV layers, as many as Blender allows; remove one and bake again.")
    active, render = _active_names(mesh)
    layer = mesh.uv_layers.new(name=name, do_init=False)
    mesh[LAYER] = {"name": layer.name, "digest": "", "active": active, "render": render}
    return layer


def _active_names(mesh: bpy.types.Mesh) -> tuple[str, str]:
    layers = mesh.uv_layers
    render = next((layer.name for layer in layers if layer.active_render), "")
    return (layers.active.name if layers.active else ""), render


def _set_active(mesh: bpy.types.Mesh, active: str, render: str) -> None:
    layers = mesh.uv_layers
    if active in layers:
        layers.active = layers[active]
    if render in layers:
        layers[render].active_render = True


def _layer_digest(layer: bpy.types.MeshUVLoopLayer) -> str:
    flat_uv = np.empty(2 * len(layer.uv), dtype=np.float32)
    layer.uv.foreach_get("vector", flat_uv)
    return f"{zlib.crc32(flat_uv.tobytes()):08x}"  # a string: custom properties hold signed 32-bit integers only
