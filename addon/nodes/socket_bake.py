"""What a socket of a material's nodes gives on a mesh, evaluated by Blender itself: an emission bake in a scene of its own.

Nothing of the user's is touched: object, mesh, material and node groups are copies, and all of them are gone at the end.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.scene.scene import TextureImage
from .color_attributes import Faces
from .image_files import no_threads
from .images_read import ImageTable
from .node_colors import WHITE, Color, to_rgb
from .node_ports import Port, walk_sources
from .object_attributes import RANDOM
from .polygon_atlas import BakedLayer, PolygonAtlas, lay_polygons

TOO_MANY = "takes long to evaluate, so it is replaced by its mean"
_TEXELS_PER_M, _NORMALS_PER_M = 128.0, 64.0
_MOST_TEXELS = 1 << 20  # of one mesh
_SECONDS = 120.0  # of processors' time, for all of one export
_SAMPLES = 4  # of each texel
_NO_TRACE = 1e-30  # a factor that is lost beside 1, and not 0, which Cycles leaves out
_NAME, _UV = "leaflight evaluation", "leaflight evaluation"
# What depends on who looks, or on what a copy of the object has not: its particles; and what EEVEE alone knows.
_UNFIT = ("LIGHT_PATH", "FRESNEL", "LAYER_WEIGHT", "PARTICLE_INFO", "HAIR_INFO", "SHADERTORGB")
_FROM_VIEWER = ("Reflection", "Incoming")  # outputs that depend on who looks, too
HEIGHTS = ("DISPLACEMENT", "VECTOR_DISPLACEMENT")
_BY_OBJECT = ("OBJECT_INFO", "NEW_GEOMETRY", "CAMERA")


@dataclass
class SocketBaker:
    """Evaluates sockets for one export; every mesh has one atlas, so that what is evaluated on it lies alike."""

    images: ImageTable
    _atlases: dict[tuple[int, ...], PolygonAtlas | None] = field(default_factory=dict)
    _known: dict[tuple[Any, ...], Color | None] = field(default_factory=dict)
    _spent_s: float = 0.0

    def find_corners(self, layer: BakedLayer) -> NDArray[np.float64]:
        """(n_corner, 2) texture coordinates."""
        atlas = self._atlases[layer.key]
        assert atlas is not None
        return atlas.uv

    def bake(
        self, port: Port, material: Any, faces: Faces, by_object: bool, by_random: bool = False, is_normal: bool = False
    ) -> Color | None:
        """The colour that an output gives on the faces' mesh; None where Blender cannot tell.

        by_object   whether it differs between objects of one mesh
        by_random   whether it differs by their random number
        is_normal   whether it is a direction, of which a lightmap shows less detail
        """
        if self._spent_s > _SECONDS:
            return None
        begin = time.process_time()
        try:
            return self._bake(port, material, faces, by_object, by_random, is_normal)
        finally:
            self._spent_s += time.process_time() - begin

    @property
    def is_out_of_time(self) -> bool:
        return self._spent_s > _SECONDS

    def _bake(self, port: Port, material: Any, faces: Faces, by_object: bool, by_random: bool, is_normal: bool) -> Color | None:
        matrix = np.eye(4) if faces.matrix is None else np.asarray(faces.matrix)
        key = (id(faces.local), is_normal, *((faces.source.session_uid, faces.shown.original.session_uid) if by_object else ()))
        if key not in self._atlases:
            self._atlases[key] = lay_polygons(faces.local, matrix[:3, :3], _NORMALS_PER_M if is_normal else _TEXELS_PER_M, _MOST_TEXELS)
        atlas = self._atlases[key]
        node = (port.node.as_pointer(), *(group.as_pointer() for group in port.groups))
        asked = (material.session_uid, port.socket.identifier, node, faces.random_level if by_random else 0.0, key)
        if asked not in self._known:
            self._known[asked] = None if atlas is None else self._evaluate(port, material, faces, matrix, atlas, key)
        return self._known[asked]

    def _evaluate(
        self,
        port: Port,
        material: Any,
        faces: Faces,
        matrix: NDArray[np.float64],
        atlas: PolygonAtlas,
        key: tuple[int, ...],
    ) -> Color | None:
        pixels = bake_socket(port, material, faces, matrix, atlas)
        if pixels is None:
            return None
        index = self.images.add(TextureImage(port.node.label or port.node.name, pixels, "EXTEND"))
        return Color(WHITE, index, BakedLayer(key), to_rgb(_find_mean(pixels, atlas)))


def can_evaluate(port: Port) -> bool:
    """Whether an output is the same from wherever it is seen, and on a copy; and does not show an image whose file is missing."""
    return not any(_is_unfit(node) for node in walk_sources(port))


def depends_on_object(port: Port) -> bool:
    """Whether an output may differ between objects that share a mesh."""
    return any(node.type in _BY_OBJECT or (node.type == "TEX_COORD" and _leaves_object(node)) for node in walk_sources(port))


def depends_on_random(port: Port) -> bool:
    """Whether an output may differ by objects' random numbers."""
    return any(map(_shows_random, walk_sources(port)))


def _leaves_object(node: Any) -> bool:
    """Whether texture coordinates are those of another object, or of the camera."""
    return node.object is not None or any(node.outputs[name].is_linked for name in ("Camera", "Window"))


def _shows_random(node: Any) -> bool:
    return node.type == "OBJECT_INFO" and node.outputs[RANDOM].is_linked


def _is_unfit(node: Any) -> bool:
    if node.type in _UNFIT or (_shows_random(node) and not node.id_data.is_embedded_data):
        return True
    if node.type == "ATTRIBUTE" and node.attribute_type == "INSTANCER":
        return True
    if any(output.name in _FROM_VIEWER and output.is_linked for output in node.outputs):
        return True
    return node.type in ("TEX_IMAGE", "TEX_ENVIRONMENT") and (node.image is None or (not node.image.has_data and not all(node.image.size)))


def bake_socket(port: Port, material: Any, faces: Faces, matrix: NDArray[np.float64], atlas: PolygonAtlas) -> NDArray[np.float32] | None:
    """(height, width, 3) float32: what an output of a material gives on a mesh; None where Blender does not evaluate it."""
    with _Copies() as copies:
        mesh = copies.copy_mesh(faces)
        if mesh is None or len(mesh.loops) != faces.local.n_corner:
            return None
        layer = mesh.uv_layers.new(name=_UV, do_init=False)
        if layer is None:
            return None
        rendered = next((one.name for one in mesh.uv_layers if one.active_render), None)
        mesh.uv_layers[layer.name].data.foreach_set("uv", atlas.uv.astype(np.float32).ravel())
        image = copies.keep(bpy.data.images, bpy.data.images.new(_NAME, atlas.width, atlas.height, float_buffer=True, is_data=True))
        copy = copies.copy_material(material)
        _fix_random(copy.node_tree, faces.random_level)
        if not _show_output(copy, port, image, copies):
            return None
        _use_alphas(copy.node_tree)
        mesh.materials.clear()
        mesh.materials.append(copy)
        mesh.polygons.foreach_set("material_index", np.zeros(len(mesh.polygons), np.int32))
        mesh.uv_layers.active = mesh.uv_layers[layer.name]
        if rendered:
            mesh.uv_layers[rendered].active_render = True
        if not _bake_emission(copies.copy_object(faces, mesh, matrix), copies):
            return None
        flat = np.empty(atlas.width * atlas.height * 4, np.float32)
        image.pixels.foreach_get(flat)
    pixels = np.nan_to_num(flat.reshape(atlas.height, atlas.width, 4)[..., :3], posinf=0.0, neginf=0.0)
    return np.ascontiguousarray(pixels)


def _fix_random(tree: Any, random: float) -> None:
    """Has a tree show this random number: Cycles takes that of an object by its name, and a copy has another one."""
    for node in [node for node in tree.nodes if _shows_random(node)]:
        value = tree.nodes.new("ShaderNodeValue")
        value.outputs[0].default_value = random
        for link in list(node.outputs[RANDOM].links):
            tree.links.new(value.outputs[0], link.to_socket)


def _show_output(material: Any, port: Port, image: Any, copies: _Copies) -> bool:
    """Has a material emit what an output gives, and bake into an image; whether the output was found in it."""
    tree = material.node_tree
    source = _bring_up(tree, port, copies)
    if source is None:
        return False
    if port.node.type in HEIGHTS:
        source = _add_bump(tree, source)
    for node in [node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial"]:
        tree.nodes.remove(node)
    output, emission, target = (tree.nodes.new(kind) for kind in ("ShaderNodeOutputMaterial", "ShaderNodeEmission", "ShaderNodeTexImage"))
    tree.links.new(source, emission.inputs["Color"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    target.image = image
    for node in tree.nodes:
        node.select = False
    target.select = True  # since Blender 5.0 the active node alone does not do
    tree.nodes.active = target
    return True


def _add_bump(tree: Any, displacement: Any) -> Any:
    """The normal where a displacement is a bump only. Source: Blender, intern/cycles/scene/shader_graph.cpp, bump_from_displacement."""
    geometry, along, bump = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("NewGeometry", "VectorMath", "Bump"))
    along.operation = "DOT_PRODUCT"
    tree.links.new(displacement, along.inputs[0])
    tree.links.new(geometry.outputs["Normal"], along.inputs[1])
    tree.links.new(along.outputs["Value"], bump.inputs["Height"])
    bump.inputs["Distance"].default_value = bump.inputs["Strength"].default_value = 1.0
    return bump.outputs["Normal"]


def _use_alphas(tree: Any) -> None:
    """Has the emission use all alphas that are used, without a trace: Cycles would show the colours beside them multiplied by them else."""
    emission = next(node for node in reversed(tree.nodes) if node.type == "EMISSION")
    for output in [node.outputs["Alpha"] for node in tree.nodes if node.type == "TEX_IMAGE" and node.outputs["Alpha"].is_linked]:
        total = tree.nodes.new("ShaderNodeMath")
        total.operation, total.inputs[1].default_value, total.inputs[2].default_value = "MULTIPLY_ADD", _NO_TRACE, 1.0
        before = emission.inputs["Strength"].links
        if before:
            tree.links.new(before[0].from_socket, total.inputs[2])
        tree.links.new(output, total.inputs[0])
        tree.links.new(total.outputs[0], emission.inputs["Strength"])


def _bring_up(tree: Any, port: Port, copies: _Copies) -> Any:
    """The output of a port in a copied tree, through copies of the groups that it lies in."""
    trees, holders = [tree], []
    for group in port.groups:
        holder = trees[-1].nodes.get(group.name)
        if holder is None or holder.node_tree is None:
            return None
        holder.node_tree = copies.keep(bpy.data.node_groups, holder.node_tree.copy())
        holders.append(holder)
        trees.append(holder.node_tree)
    node = trees[-1].nodes.get(port.node.name)
    socket = node and next((one for one in node.outputs if one.identifier == port.socket.identifier), None)
    for inner, outer in zip(reversed(trees[1:]), reversed(holders), strict=True):
        if socket is None:
            return None
        inner.interface.new_socket(_NAME, in_out="OUTPUT", socket_type="NodeSocketColor")
        ends = [one for one in inner.nodes if one.type == "GROUP_OUTPUT"]
        end = next((one for one in ends if one.is_active_output), None) or inner.nodes.new("NodeGroupOutput")
        inner.links.new(socket, end.inputs[_NAME])
        socket = outer.outputs.get(_NAME)
    return socket


def _bake_emission(obj: Any, copies: _Copies) -> bool:
    scene = copies.keep(bpy.data.scenes, bpy.data.scenes.new(_NAME))
    try:
        scene.render.engine = "CYCLES"
    except TypeError:  # the add-on is switched off
        return False
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = _SAMPLES, False, "CPU"
    scene.cycles.use_adaptive_sampling = False
    scene.render.bake.margin, scene.render.bake.margin_type, scene.render.bake.use_clear = 2, "EXTEND", True
    scene.render.bake.target = "IMAGE_TEXTURES"
    shown = bpy.context.scene
    scene.frame_set(shown.frame_current)
    scene.camera = shown.camera
    for name in ("resolution_x", "resolution_y", "pixel_aspect_x", "pixel_aspect_y"):
        setattr(scene.render, name, getattr(shown.render, name))
    scene.collection.objects.link(obj)
    view_layer = scene.view_layers[0]
    view_layer.objects.active = obj
    obj.select_set(True, view_layer=view_layer)
    view_layer.update()
    with bpy.context.temp_override(
        scene=scene,
        view_layer=view_layer,
        object=obj,
        active_object=obj,
        selected_objects=[obj],
        selected_editable_objects=[obj],
    ):
        try:
            with no_threads():
                return "FINISHED" in bpy.ops.object.bake(type="EMIT")
        except RuntimeError:  # with a report of what it lacks
            return False


def _find_mean(pixels: NDArray[np.float32], atlas: PolygonAtlas) -> NDArray[np.float64]:
    """(3,) mean of the texels at polygons, which are what is not black beside them."""
    covered = pixels.any(axis=2)
    mean: NDArray[np.float64] = pixels[covered].mean(axis=0, dtype=np.float64) if covered.any() else np.zeros(3)
    return mean


class _Copies:
    """Data-blocks of one evaluation, removed at its end, the latest first."""

    def __init__(self) -> None:
        self._made: list[tuple[Any, Any]] = []

    def __enter__(self) -> _Copies:
        return self

    def __exit__(self, *_: object) -> None:
        for blocks, block in reversed(self._made):
            with suppress(ReferenceError):
                blocks.remove(block)

    def keep(self, blocks: Any, block: Any) -> Any:
        self._made.append((blocks, block))
        return block

    def copy_mesh(self, faces: Faces) -> Any:
        if not isinstance(faces.shown.data, bpy.types.Mesh):
            return None
        mesh = self.keep(bpy.data.meshes, faces.shown.data.copy())  # with attributes, and places before modifiers
        with suppress(AttributeError):  # what is no mesh itself has none
            mesh.use_auto_texspace = False
            mesh.texspace_location, mesh.texspace_size = faces.shown.data.texspace_location, faces.shown.data.texspace_size
        return mesh

    def copy_material(self, material: Any) -> Any:
        return self.keep(bpy.data.materials, material.copy())

    def copy_object(self, faces: Faces, mesh: Any, matrix: NDArray[np.float64]) -> Any:
        """An object with the properties of the one that is shown, without what moves or changes it."""
        original = faces.shown.original
        if original.type == "MESH":
            obj = self.keep(bpy.data.objects, original.copy())
            obj.animation_data_clear()
            obj.modifiers.clear()
            obj.constraints.clear()
            obj.parent = None
            obj.data = mesh
            for slot in obj.material_slots:
                slot.link = "DATA"
        else:
            obj = self.keep(bpy.data.objects, bpy.data.objects.new(_NAME, mesh))
        obj.hide_render = obj.hide_viewport = False
        obj.matrix_world = Matrix(matrix.tolist())  # a plain list would be taken as columns
        return obj
