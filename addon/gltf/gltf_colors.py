"""Materials that Blender's glTF exporter would write as white metal, with the colours that the bake has read of them.

The exporter knows the Principled BSDF, and base colours that are a constant, an image or a vertex colour, or a product of those.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.output.image_file import linear_to_srgb
from ...core.util.file_names import clean_name
from ..nodes.colors_read import ColorReader
from ..nodes.images_read import ImageTable
from ..nodes.node_colors import GREY, Color, add_rgb
from ..nodes.node_ports import Port, find_source, find_surface, give_nodes, list_shaders, uses_nodes
from ..nodes.texture_mapping import UV, UvMapping
from ..read.materials_read import read_material
from ..read.shaders_read import Surface, read_input_color
from ..show.material_nodes import DIFFUSE_NODES, feed
from ..show.node_groups import bring_out

_PRINCIPLED = "BSDF_PRINCIPLED"
_KNOWN = {"RGB", "TEX_IMAGE", "VERTEX_COLOR", "ATTRIBUTE", "AMBIENT_OCCLUSION"}  # that the exporter reads as a base colour
_NO_SHEAR = 1e-4


class GltfColors:
    """Writes what was read of materials into copies of them.

    made       data-blocks that the caller deletes after the export
    warnings   (material, sentence)
    """

    def __init__(self, folder: Path) -> None:
        self.made: list[Any] = []
        self.warnings: list[tuple[str, str]] = []
        self._folder, self._images = folder, ImageTable(is_refined=False)
        self._textures: dict[Any, bpy.types.Image] = {}

    def needs(self, material: bpy.types.Material) -> bool:
        """Whether the exporter would not see the colour of a material."""
        if not uses_nodes(material):
            return True
        _, source = find_surface(material)
        if source is None:
            return False
        if source.node.type == _PRINCIPLED:
            return not _is_known(source.sibling("Base Color"))
        return not any(port.node.type == _PRINCIPLED for port in list_shaders(source))

    def write(self, copy: bpy.types.Material, original: bpy.types.Material) -> None:
        """Gives a copy of a material a Principled BSDF of the colours that were read of the original.

        Raises OSError when a texture cannot be written.
        """
        if not uses_nodes(copy):
            give_nodes(copy)
            copy.node_tree.nodes.clear()
        tree = copy.node_tree
        output, source = find_surface(copy)
        reader = ColorReader(self._images)
        if source is not None and source.node.type == _PRINCIPLED and not source.groups:
            albedo = read_input_color(reader, source, "Base Color", GREY)
            self._put(copy, original, source.node.inputs["Base Color"], albedo)
            return
        shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
        shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 0.0, 1.0
        base = source.sibling("Color") if source is not None and source.node.type in DIFFUSE_NODES else None
        surface = read_material(reader, original)
        if base is not None and _is_known(base):
            feed(tree, base, shader.inputs["Base Color"])
        else:
            self._put(copy, original, shader.inputs["Base Color"], _tint(surface))
        if surface.bending.share > 0.0:
            for name, value in (("Transmission Weight", surface.bending.share), ("Roughness", surface.bending.roughness)):
                shader.inputs[name].default_value = value
            shader.inputs["IOR"].default_value = surface.bending.ior
        strength = max(surface.emission.mean)
        if strength > 0.0:
            self._put(copy, original, shader.inputs["Emission Color"], surface.emission.times(1.0 / strength))
            shader.inputs["Emission Strength"].default_value = strength
        alpha = _find_alpha(source) if source is not None else None
        if alpha is not None:
            tree.links.new(shader.inputs["Alpha"], bring_out(tree, alpha))
        output = output or tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(output.inputs["Surface"], shader.outputs[0])

    def _put(self, copy: bpy.types.Material, original: bpy.types.Material, socket: bpy.types.NodeSocket, color: Color) -> None:
        """A constant, or a texture of what was read, into an input of a node in the copy."""
        tree = copy.node_tree
        for link in list(socket.links):
            tree.links.remove(link)
        mapping = color.mapping if color.image >= 0 and isinstance(color.mapping, UvMapping) else None
        place = _find_transform(mapping) if mapping is not None else None
        if mapping is None or place is None:
            if color.image >= 0:
                why = "its colours do not follow a UV layer, so the .glb has their mean; bake the pass combined to keep them"
                self.warnings.append((original.name, f"{original.name}: {why}."))
            socket.default_value = (*color.mean, 1.0)
            return
        image = self._images.images[color.image]
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image, node.extension = self._texture(color), image.extension
        node.interpolation = "Closest" if image.closest else "Linear"
        tree.links.new(socket, node.outputs["Color"])
        uv_map, move = tree.nodes.new("ShaderNodeUVMap"), tree.nodes.new("ShaderNodeMapping")
        uv_map.uv_map = mapping.layer
        for name, value in zip(("Location", "Rotation", "Scale"), place, strict=True):
            move.inputs[name].default_value = value
        tree.links.new(move.inputs["Vector"], uv_map.outputs["UV"])
        tree.links.new(node.inputs["Vector"], move.outputs["Vector"])

    def _texture(self, color: Color) -> bpy.types.Image:
        key = (color.image, color.rgb)
        if key not in self._textures:
            image = self._images.images[color.image]
            height, width = image.pixels.shape[:2]
            pixels = np.ones((height, width, 4), np.float32)
            pixels[..., :3] = linear_to_srgb(np.clip(image.pixels * np.asarray(color.rgb, np.float32), 0.0, 1.0))
            folder = self._folder / f"color_{len(self._textures)}"
            folder.mkdir()
            path = folder / f"{clean_name(image.name)}.png"
            texture = bpy.data.images.new(path.stem, width, height, alpha=False, float_buffer=False)
            self.made.append(texture)
            texture.pixels.foreach_set(pixels.ravel())
            texture.filepath_raw, texture.file_format = str(path), "PNG"
            texture.save()
            self._textures[key] = texture
        return self._textures[key]


def _tint(surface: Surface) -> Color:
    """The base colour; glTF has one for glass and paint together, so it is the sum of both."""
    if surface.bending.share <= 0.0:
        return surface.albedo
    red, green, blue = add_rgb(surface.albedo.mean, surface.glass.mean)
    return Color((min(red, 1.0), min(green, 1.0), min(blue, 1.0)))


def has_gaps(material: bpy.types.Material | None) -> bool:
    """Whether an image cuts gaps into a material, as into leaves."""
    if material is None or not uses_nodes(material):
        return False
    source = find_surface(material)[1]
    if source is None:
        return False
    alphas = [port.sibling("Alpha") for port in list_shaders(source) if port.node.type == _PRINCIPLED]
    return _find_alpha(source) is not None or any(alpha is not None and not alpha.is_value for alpha in alphas)


def _is_known(source: Port | None) -> bool:
    """Whether the exporter reads a base colour of this source."""
    if source is None or source.is_value or source.node.type in _KNOWN:
        return True
    node = source.node
    if node.type != "MIX" or node.data_type != "RGBA" or node.blend_type != "MULTIPLY":
        return False
    factor = source.sibling("Factor_Float")
    whole = factor is not None and factor.is_value and factor.socket.default_value == 1.0
    return whole and all(_is_known(source.sibling(name)) for name in ("A_Color", "B_Color"))


def _find_alpha(source: Port) -> Port | None:
    """The image that cuts gaps into a surface, where it is 0; None where there is none, or where it is 1 in the gaps."""
    for port in _list_mixes(source):
        first = find_source(Port(port.node.inputs[1], port.groups))
        fraction = find_source(Port(port.node.inputs[0], port.groups))
        if not first.is_value and first.node.type == "BSDF_TRANSPARENT" and not fraction.is_value and fraction.node.type == "TEX_IMAGE":
            return fraction
    return None


def _list_mixes(source: Port) -> Iterator[Port]:
    return (port for port in list_shaders(source) if port.node.type == "MIX_SHADER")


def _find_transform(mapping: UvMapping) -> tuple[tuple[float, float, float], ...] | None:
    """Location, rotation and scale of a mapping that moves, turns and scales UVs; None of any other."""
    if mapping.space != UV or mapping.box:
        return None
    affine = np.array(mapping.affine)
    across, up = affine[:2, 0], affine[:2, 1]
    wide, high = np.hypot(*across), np.hypot(*up)
    if not wide or not high or abs(across @ up) > _NO_SHEAR * wide * high:
        return None
    if across[0] * up[1] - across[1] * up[0] < 0.0:
        high = -high
    turn = float(np.arctan2(across[1], across[0]))
    return (float(affine[0, 3]), float(affine[1, 3]), 0.0), (0.0, 0.0, turn), (float(wide), float(high), 1.0)
