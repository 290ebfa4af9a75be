"""The node tree of a world, or of a lamp -> an equirectangular map of its light, evaluated by Cycles.

Cycles bakes what surrounds a mesh in a temporary scene that holds a copy of the world, so that nothing of the user's is touched and files
made for EEVEE work too. The baked pixel shows the world in the direction of the mesh's position there: a ball bakes the whole sphere, a
square across a direction a part of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import bpy
import numpy as np
from idprop.types import IDPropertyArray
from numpy.typing import NDArray

from ...core.lights.environment_suns import Spot
from ...core.util.arrays import FloatArray
from ...core.util.digest import hash_pieces
from ...core.util.geometry import orthonormal_basis
from ..nodes.image_files import no_threads
from ..nodes.node_ports import give_nodes
from .world_cache import MapCache, print_light

# Seen by diffuse surfaces, which all receivers are; a ray is as long as it likes.
LIGHT_PATH = {"Is Diffuse Ray": 1.0, "Is Reflection Ray": 1.0, "Ray Length": 1e5, "Ray Depth": 1.0, "Diffuse Depth": 1.0}
_WORLD: Mapping[str, Any] = {"type": "ENVIRONMENT"}
_MIRROR: Mapping[str, Any] = {"type": "GLOSSY", "pass_filter": {"DIRECT", "INDIRECT"}}
_LIGHTING: Mapping[str, Any] = {"type": "DIFFUSE", "pass_filter": {"DIRECT"}}
_BALL_ROWS = 128  # of faces; chords are off by a fiftieth of a cell of 1,024 rows
_POLE_RAD = 1e-3  # a quarter of a cell of 1,024 rows
_SPOT_CELLS = 128
_SPOT_SAMPLES = 4
_IMAGE_NODES = ("TEX_ENVIRONMENT", "TEX_IMAGE")
SIZE, LARGE_SIZE, LAMP_SIZE = (1024, 512), (2048, 1024), (512, 256)
_SAMPLES = 4  # of a cell, or a texel of a large image would be missed
_MOST_SAMPLES = 32


class WorldBaker:
    """A temporary scene with a copy of a world in it; see open_world.

    light   print_light of the world, "" where what is baked is not to be kept
    """

    def __init__(self, scene: Any, made: list[Any], light: str = "", kept: MapCache | None = None) -> None:
        self._scene, self._made, self._light, self._kept = scene, made, light, kept

    def bake_sphere(self, size: tuple[int, int], samples: int) -> NDArray[np.float32]:
        """(height, width, 3), W/m^2/sr, for a size (width, height), laid out as core.sphere_map has it."""
        return self._look(*_make_ball(), size, samples)

    def bake_lamp(self, data: Any, matrix: Any, size: tuple[int, int], samples: int) -> NDArray[np.float32]:
        """(height, width, 3): `lighting` by a lamp in the middle of a ball of 1 m."""
        lamp = self._keep(bpy.data.objects.new("Leaflight lamp", data))
        lamp.matrix_world = matrix
        self._scene.collection.objects.link(lamp)
        return self._bake(*_make_ball(), size, samples, _LIGHTING)

    def bake_area(self, data: Any, size_m: tuple[float, float], pixels: int) -> NDArray[np.float32]:
        """(pixels, pixels, 3): the radiance of an area lamp of that size straight on, by its own x and y from its low left corner."""
        lamp = self._keep(bpy.data.objects.new("Leaflight lamp", data))
        self._scene.collection.objects.link(lamp)
        uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
        place = np.column_stack([(uv - 0.5) * size_m, np.full(4, -max(size_m))])
        return self._bake(place, uv, np.arange(4)[None], (pixels, pixels), _SAMPLES, _MIRROR)

    def bake_spot(self, direction: FloatArray, half_angle_rad: float) -> Spot:
        """A square across a direction (3,), seen in fine cells."""
        tangent, bitangent = (axis[0] for axis in orthonormal_basis(np.asarray(direction)[None]))
        reach = math.tan(half_angle_rad)
        uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
        corner = (2 * uv - 1) * reach
        place = direction + corner[:, :1] * tangent + corner[:, 1:] * bitangent
        radiance = self._look(place, uv, np.arange(4)[None], (_SPOT_CELLS, _SPOT_CELLS), _SPOT_SAMPLES).reshape(-1, 3)
        step = 2 * reach / _SPOT_CELLS
        y, x = (grid.ravel() for grid in (np.mgrid[0:_SPOT_CELLS, 0:_SPOT_CELLS] + 0.5) * step - reach)
        toward = direction + x[:, None] * tangent + y[:, None] * bitangent
        length = np.linalg.norm(toward, axis=1)
        return Spot(toward / length[:, None], step**2 / length**3, radiance.astype(np.float64), step)

    def _look(self, place: FloatArray, uv: FloatArray, faces: FloatArray, size: tuple[int, int], samples: int) -> NDArray[np.float32]:
        """(height, width, 3): the world, as an earlier bake has kept it or baked now."""
        if self._kept is None or not self._light:
            return self._bake(place, uv, faces, size, samples)
        parts = (place.astype(np.float32), uv.astype(np.float32), faces.astype(np.int32), np.array([*size, samples]))
        key = hash_pieces([self._light.encode(), *(part.tobytes() for part in parts)])
        found = self._kept.find(key, (size[1], size[0], 3))
        if found is None:
            found = self._bake(place, uv, faces, size, samples)
            self._kept.add(key, found)
        return found

    def _bake(
        self, place: FloatArray, uv: FloatArray, faces: FloatArray, size: tuple[int, int], samples: int, what: Mapping[str, Any] = _WORLD
    ) -> NDArray[np.float32]:
        """(height, width, 3): the world seen from the origin through a mesh, or light on the mesh, in its UV square."""
        mesh = self._keep(bpy.data.meshes.new("Leaflight world"))
        mesh.vertices.add(len(place))
        mesh.vertices.foreach_set("co", place.astype(np.float32).ravel())
        mesh.loops.add(faces.size)
        mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
        mesh.polygons.add(len(faces))
        mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 4, dtype=np.int32))
        mesh.update()
        mesh.uv_layers.new(name="UV").data.foreach_set("uv", uv[faces.ravel()].astype(np.float32).ravel())
        image = self._keep(bpy.data.images.new("Leaflight world", *size, alpha=False, float_buffer=True))
        image.colorspace_settings.name = "Linear Rec.709"
        material = self._keep(bpy.data.materials.new("Leaflight world"))
        give_nodes(material)
        tree = material.node_tree
        surface, end = tree.nodes.new(f"ShaderNodeBsdf{'Glossy' if what is _MIRROR else 'Diffuse'}"), tree.get_output_node("CYCLES")
        if what is _MIRROR:
            surface.inputs["Roughness"].default_value = 0.0
        tree.links.new(surface.outputs["BSDF"], (end or tree.nodes.new("ShaderNodeOutputMaterial")).inputs["Surface"])
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image, node.select = image, True
        tree.nodes.active = node
        mesh.materials.append(material)
        ball = self._keep(bpy.data.objects.new("Leaflight world", mesh))
        self._scene.collection.objects.link(ball)
        self._scene.cycles.samples = samples
        view_layer = self._scene.view_layers[0]
        view_layer.update()
        chosen = {"object": ball, "active_object": ball, "selected_objects": [ball], "selected_editable_objects": [ball]}
        with no_threads(), bpy.context.temp_override(scene=self._scene, view_layer=view_layer, **chosen):
            bpy.ops.object.bake(**what, margin=0, use_clear=True, target="IMAGE_TEXTURES", save_mode="INTERNAL")
        self._scene.collection.objects.unlink(ball)
        pixels = np.empty(size[0] * size[1] * 4, np.float32)
        image.pixels.foreach_get(pixels)
        out = pixels.reshape(size[1], size[0], 4)[:, :, :3]
        return np.maximum(np.nan_to_num(out, nan=0.0, posinf=0.0, neginf=0.0), 0.0)

    def copy(self, block: Any) -> Any:
        """A copy of a data-block, gone when the baker is."""
        return self._keep(block.copy())

    def _keep(self, made: Any) -> Any:
        self._made.append(made)
        return made


def _make_ball() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Vertices (n, 3), UV (n, 2) and faces (m, 4) of a ball of 1 m that looks inwards, unrolled as core.util.sphere_map has directions."""
    columns = 2 * _BALL_ROWS
    v, u = (grid.ravel() for grid in np.mgrid[0 : _BALL_ROWS + 1, 0 : columns + 1] / np.array([_BALL_ROWS, columns])[:, None, None])
    # Triangles without area at the poles would get no light.
    polar, azimuth = np.clip(np.pi * v, _POLE_RAD, np.pi - _POLE_RAD), np.pi * (1 - 2 * u)
    place = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)], axis=1)
    first = (np.arange(_BALL_ROWS)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    faces = first[:, None] + np.array([0, 1, columns + 2, columns + 1])
    return place, np.stack([u, v], axis=1), faces


@contextmanager
def open_world(world: Any, scene: Any, view_layer: Any = None, kept: MapCache | None = None) -> Iterator[WorldBaker]:
    """A baker of a world as a scene has it, or of a lamp where there is none; all that it made is gone when it ends.

    kept   what earlier bakes have evaluated
    """
    made: list[Any] = []
    light = print_light(world, list(walk_nodes(world.node_tree, set()))) if world is not None and kept is not None else ""
    try:
        temporary = bpy.data.scenes.new("Leaflight world")
        made.append(temporary)
        temporary.render.engine = "CYCLES"
        temporary.cycles.device = "CPU"
        temporary.cycles.max_bounces = 0
        temporary.cycles.use_adaptive_sampling = temporary.cycles.use_denoising = False
        temporary.camera = scene.camera
        _copy_properties(scene, temporary)  # its nodes may ask for them
        if view_layer is not None:
            _copy_properties(view_layer, temporary.view_layers[0])
        temporary.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        if world is not None:
            copy = world.copy()
            made.append(copy)
            copy.cycles.sampling_method = "NONE"  # nothing is lit here, and Cycles' own map of where the light is takes a second
            _show_to_diffuse(copy.node_tree, made, {})
            temporary.world = copy
        yield WorldBaker(temporary, made, light, kept)
    finally:
        bpy.data.batch_remove(made)


def _copy_properties(source: Any, target: Any) -> None:
    """Custom properties that a node can read."""
    for name, value in source.items():
        if isinstance(value, int | float | IDPropertyArray):
            target[name] = value


def choose_size(owner: Any, least: tuple[int, int] = SIZE) -> tuple[tuple[int, int], int]:
    """Width and height of a map that shows a world or a lamp, and the samples of each cell: more where an image is finer."""
    nodes = [] if owner.node_tree is None else walk_nodes(owner.node_tree, set())
    images = [node.image for node in nodes if node.type in _IMAGE_NODES]
    widest = max((image.size[0] for image in images if image), default=0)
    size = LARGE_SIZE if widest > SIZE[0] else least
    return size, int(min(max(_SAMPLES, (2 * widest / size[0]) ** 2), _MOST_SAMPLES))


def walk_nodes(tree: Any, seen: set[Any]) -> Iterator[Any]:
    seen.add(tree)
    for node in tree.nodes:
        yield node
        if node.type == "GROUP" and node.node_tree and node.node_tree not in seen:
            yield from walk_nodes(node.node_tree, seen)


def _show_to_diffuse(tree: Any, made: list[Any], copies: dict[Any, Any]) -> None:
    """Replace what Light Path nodes give, in a tree and in copies of the groups it uses, by what a diffuse surface's rays are."""
    for node in list(tree.nodes):
        if node.type == "GROUP" and node.node_tree:
            if node.node_tree not in copies:
                copies[node.node_tree] = node.node_tree.copy()
                made.append(copies[node.node_tree])
                _show_to_diffuse(copies[node.node_tree], made, copies)
            node.node_tree = copies[node.node_tree]
        elif node.type == "LIGHT_PATH":
            for output in node.outputs:
                targets = [link.to_socket for link in output.links]
                for socket in targets:
                    value = tree.nodes.new("ShaderNodeValue")
                    value.outputs[0].default_value = LIGHT_PATH.get(output.name, 0.0)
                    tree.links.new(value.outputs[0], socket)
