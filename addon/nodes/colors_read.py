"""Colours and numbers of a shader node tree as a constant times an image, made of others if need be; else the nearest there is."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from ...core.scene.scene import DIFFUSE, GLOSSY, SHADOW, TRANSMISSION
from .color_attributes import ColorLayer, ColorTable, Faces
from .color_nodes import read_function
from .derived_images import AT_CORNERS, Formula, derive, derive_painted, lie_alike
from .image_parts import find_frame
from .images_read import ImageTable, find_sphere_mean
from .node_colors import BLACK, GREY, WHITE, Color, Rgb, add_rgb, find_brightness, to_rgb
from .node_formulas import lerp, to_grey
from .node_ports import Port, describe, is_used, walk_sources
from .object_attributes import NOTHING, RANDOM, can_read_instances, find_shown, pick_output, shows_object, shows_view_layer
from .socket_bake import TOO_MANY, SocketBaker, can_evaluate, depends_on_object, depends_on_random
from .tangent_normals import thin_out
from .texture_mapping import UV, UvMapping, read_mapping
from .view_nodes import HEMISPHERE, depends_on_view, is_even, read_view, shows_view

FACING: Rgb = (0.5, 0.5, 1.0)  # of a normal map that changes nothing
TEXTURE_COLOR: Rgb = (0.5, 0.5, 0.5)  # mean of a procedural texture, roughly
# Outputs of Light Path nodes that are not 0, by the kind of ray. The first ray of all leaves what is baked, and is a diffuse one.
_FIRST = {"Ray Depth": 1.0, "Diffuse Depth": 1.0}
_LATER = {"Ray Depth": 2.0, "Diffuse Depth": 1.0}
_LIGHT_PATH: dict[int, dict[str, float]] = {
    DIFFUSE: {"Is Diffuse Ray": 1.0, "Is Reflection Ray": 1.0, **_FIRST},
    GLOSSY: {"Is Glossy Ray": 1.0, "Is Reflection Ray": 1.0, "Glossy Depth": 1.0, **_LATER},
    TRANSMISSION: {"Is Transmission Ray": 1.0, "Is Glossy Ray": 1.0, "Transmission Depth": 1.0, **_LATER},
    SHADOW: {"Is Shadow Ray": 1.0, **_FIRST},
}
_KNOWN_RAYS = {name for outputs in _LIGHT_PATH.values() for name in outputs if name.startswith("Is ")}
REPLACED_BY_GREY = "is replaced by a grey of 0.5"


class ColorReader:
    """Reads the colours and numbers of one material, light or world.

    faces      that wear the material; None of a light or world
    colors     where their colour attributes go
    baker      evaluates what is not known here; of the material
    normal     unit vectors in the world in place of colours, None where the surface is shaded as it is; or a normal map of
    normal_strength   along tangents of the UV layer tangent_layer
    replaced   what could not be taken as it is, for one warning; with it
    mended     what was no number, in order
    by_faces   whether what was read depends on the faces, or
    by_object  on the object that they are of, and
    by_random  on its random number, which differs between instances, and
    by_instance   on what geometry nodes give to instances
    ray        the kind of ray that sees the surface, of core.scene; by_ray tells whether what was read depends on it
    view       from where the surface is seen, see view_nodes; then images count by their means. None for the mean of all views of its
               front, or of its back (is_back); by_view tells whether what was read depends on it
    sky        of a world alone: reads an environment texture, None where it cannot, and what Light Path nodes give
    """

    def __init__(
        self,
        images: ImageTable,
        faces: Faces | None = None,
        colors: ColorTable | None = None,
        baker: SocketBaker | None = None,
        material: Any = None,
        sky: tuple[Callable[[ColorReader, Port], Color | None], Mapping[str, float]] | None = None,
    ) -> None:
        self.images, self.faces, self.colors = images, faces, colors
        self.by_faces = self.by_object = self.by_random = self.by_instance = self.by_ray = self.by_view = self.is_back = False
        self.view: float | None = None
        self.sky = sky
        self.ray = DIFFUSE
        self._baker, self._material, self._depth, self._inexact = baker, material, 0, False
        self.replaced: list[str] = []
        self.mended: dict[str, None] = {}
        self.normal: Color | None = None
        self.tangent_layer, self.normal_strength = "", None
        self.missing_rgb = GREY  # what stands for a missing image; Blender's magenta would tint the room

    def note(self, text: str) -> None:
        if text not in self.replaced:
            self.replaced.append(text)

    def approximate(self, text: str) -> None:
        """Note what Blender can evaluate, and this reader cannot take as it is."""
        self._inexact = True
        self.note(text)

    def read_color(self, port: Port | None, default: Rgb = WHITE) -> Color:
        """The colour that a source port gives; evaluated by Blender where its nodes are not all known here."""
        if self._depth or port is None or self.faces is None or self._baker is None or not can_evaluate(port):
            return self._read_color(port, default)
        if self.view is not None or (self.is_back and depends_on_view(port)):  # Blender would show the front, straight on
            return self._read_color(port, default)
        self._depth, self._inexact, before = 1, False, list(self.replaced)
        try:
            color = self._read_color(port, default)
        finally:
            self._depth = 0
        if not self._inexact:
            return color
        by_object, by_random = depends_on_object(port), depends_on_random(port)
        evaluated = self._baker.bake(port, self._material, self.faces, by_object, by_random)
        if evaluated is None:
            if self._baker.is_out_of_time:
                self.note(f"{describe(port.node)} {TOO_MANY}")
            return color
        self.by_faces, self.by_object, self.replaced = True, self.by_object or by_object, before
        if any(node.type == "AMBIENT_OCCLUSION" and not node.only_local for node in walk_sources(port)):
            self.note("what other objects occlude (Ambient Occlusion) is left out")
        self.by_random = self.by_random or by_random
        return evaluated

    def read_normal(self, port: Port, is_mirror: bool = False) -> bool:
        """Evaluate the normal that an output gives, as `normal`; whether that is done, or nobody would see it.

        is_mirror   the surface reflects light by its normal, so that others see what it does where none is baked, too
        """
        if self.faces is None or self._baker is None or not can_evaluate(port):
            return False
        if not (self.faces.receives or is_mirror):
            self.by_faces = self.by_object = True  # another object may show it
            return True
        color = self._read_normal_map(port)
        if color is not None and color.image < 0 and color.rgb == FACING:
            return True
        strength, is_map = port.sibling("Strength"), color is not None and color.image >= 0 and color.rgb == WHITE
        found = color if is_map else self._read_image(port)
        if found is None:
            found = self._baker.bake(port, self._material, self.faces, by_object=True, is_normal=True)
        if found is None:
            return False
        self.by_faces = self.by_object = True
        if self.normal is None and is_map:
            self.normal = replace(found, image=thin_out(self.images, found.image))
            self.tangent_layer = port.node.uv_map or self.faces.local.render_layer
            self.normal_strength = 1.0 if strength is None else max(float(strength.socket.default_value), 0.0)
        self.normal = self.normal or found
        return True

    def read_bump(self, port: Port, is_mirror: bool) -> bool:
        """As read_normal for what a displacement node gives as a bump; a normal of the shader goes before."""
        if self.normal is not None:
            return True
        if self.faces is None or self._baker is None or not can_evaluate(port):
            return False
        if self.faces.receives or is_mirror:
            self.normal = self._baker.bake(port, self._material, self.faces, by_object=True, is_normal=True)
            if self.normal is None:
                return False
        self.by_faces = self.by_object = True
        return True

    def _read_normal_map(self, port: Port) -> Color | None:
        """The colour of a Normal Map node in tangent space, None where it, or another node, has to be evaluated by Blender."""
        node, strength, faces = port.node, port.sibling("Strength"), self.faces
        if node.type != "NORMAL_MAP" or node.space != "TANGENT" or getattr(node, "convention", "OPENGL") != "OPENGL" or faces is None:
            return None
        local = faces.local
        if (node.uv_map or local.render_layer) not in local.layers or (strength is not None and not strength.is_value):
            return None
        return self._read_on_layer(port.sibling("Color"))

    def _read_image(self, port: Port) -> Color | None:
        """An image that is the normal in the world itself, as where its colours go into Normal without a Normal Map node."""
        color = self._read_on_layer(port) if port.node.type == "TEX_IMAGE" and port.socket.type == "RGBA" else None
        return color if color is not None and color.image >= 0 and color.rgb == WHITE else None

    def _read_on_layer(self, port: Port | None) -> Color | None:
        """The colour that an output gives, if it is known exactly, and is constant or lies along a UV layer; None otherwise."""
        assert self.faces is not None
        local, before, self._depth, self._inexact = self.faces.local, list(self.replaced), 1, False
        try:
            color = self._read_color(port, FACING)
        finally:
            self._depth, self.replaced = 0, before
        if self._inexact or not (color.image < 0 or isinstance(color.mapping, UvMapping)):
            return None
        lies = color.image < 0 or (color.mapping.space == UV and not color.mapping.box)
        return color if lies and (color.image < 0 or (color.mapping.layer or local.render_layer) in local.layers) else None

    def _read_color(self, port: Port | None, default: Rgb) -> Color:
        if port is None:
            return Color(default)
        if port.is_value:
            return Color(self.read_value(port.socket, default))
        if shows_view_layer(port) or (self.faces is not None and shows_object(port)):
            return _read_property(self, port)
        if self.view is None and (shows_view(port) or (depends_on_view(port) and is_even(port))):
            return self._average_views(port, default)
        reader = _COLOR_READERS.get(port.node.type)
        if self.view is not None and shows_view(port):
            color: Color | None = read_view(self, port, self.view)
        else:
            color = reader(self, port) if reader else read_function(self, port)
        color = self.read_unknown(port) if color is None else color
        return color if self.view is None else Color(color.mean)

    def _average_views(self, port: Port, default: Rgb) -> Color:
        """The mean of what an output gives over all directions in which diffuse light leaves the side that is read."""
        self.by_view = True
        found = []
        for cosine in HEMISPHERE:
            self.view = -cosine if self.is_back else cosine
            found.append(self._read_color(port, default).rgb)
        self.view = None
        return Color(to_rgb(np.mean(found, axis=0)))

    def read_value(self, socket: Any, default: Rgb) -> Rgb:
        """The value of a socket that nothing feeds."""
        value = getattr(socket, "default_value", default)
        return self.mend(to_rgb(value) if hasattr(value, "__len__") else (float(value),) * 3, default, socket)

    def mend(self, rgb: Rgb, default: Rgb, place: Any) -> Rgb:
        """A value of a material at a socket or by itself, the default where it is not finite. (Lights are left out then.)"""
        if self._material is None or all(map(math.isfinite, rgb)):
            return rgb
        what = f"{place.name} of {describe(place.node)}" if place else "its colour"
        self.mended[f"{what} is not a number, {max(default):g} is used; type one"] = None
        return default

    def read_factor(self, port: Port | None, default: float) -> Color:
        """The number that a source port gives, an image of it where it differs over the surface."""
        color = self.read_color(port, (default,) * 3)
        if port is None or port.socket.type != "RGBA" or (color.image < 0 and color.rgb[0] == color.rgb[1] == color.rgb[2]):
            return color
        return self.derive(port, to_grey, [color], "grey")

    def read_number(self, port: Port | None, default: float) -> float:
        """The number that a source port gives, or its mean over an image."""
        color = self.read_color(port, (default,) * 3)
        if port is not None and color.image >= 0:
            self.approximate(f"{describe(port.node)} is replaced by its mean")
        return find_brightness(color.mean)

    def read_unknown(self, port: Port) -> Color:
        """A node unknown to us: the mean of its colour inputs, or the one textured input."""
        found = [port.sibling(socket.identifier) for socket in port.node.inputs if socket.type == "RGBA" and socket.enabled]
        colors = [self.read_color(source) for source in found]
        if not colors:
            self.approximate(f"{describe(port.node)} {REPLACED_BY_GREY}")
            return Color(TEXTURE_COLOR)
        self.approximate(f"{describe(port.node)} is approximated")
        textured = next((color for color in colors if color.image >= 0), None)
        return textured or Color(to_rgb(np.mean([color.mean for color in colors], axis=0)))

    def reads(self, port: Port) -> bool:
        """Whether the node of a source port is told by itself, as an image is and a procedural texture is not."""
        return (
            port.node.type in _COLOR_READERS
            or shows_view(port)
            or shows_view_layer(port)
            or (self.faces is not None and shows_object(port))
        )

    def derive(self, port: Port, formula: Formula, colors: Sequence[Color], what: str = "") -> Color:
        """What a formula makes of colours on the node of a port; `what` tells several formulas of one node."""
        key = (port.node.as_pointer(), port.socket.identifier, what)
        layer = derive_painted(key, formula, colors)
        found = self.faces.find_range(layer) if layer and self.faces is not None else None
        if layer and found and self.colors:
            self.approximate(AT_CORNERS)
            return Color(WHITE, self.colors.index(), layer, to_rgb(found[1]))
        color, replaced = derive(self.images, key, formula, colors, port.node.label or port.node.name)
        if replaced:
            self.approximate(replaced)
        return color

    def blend(self, port: Port, first: Color, second: Color, fraction: Color, what: str) -> Color:
        """(1 - fraction) first + fraction second."""
        if fraction.image < 0:
            return self.mix(port, first, second, min(max(fraction.rgb[0], 0.0), 1.0), what)
        if max(first.mean) <= 0.0 and max(second.mean) <= 0.0:
            return first
        return self.derive(port, lambda a, b, t: lerp(a, b, np.clip(t, 0.0, 1.0)), [first, second, fraction], what)

    def mix(self, port: Port, first: Color, second: Color, fraction: float, what: str = "") -> Color:
        """(1 - fraction) first + fraction second."""
        return self.add(port, first.times(1.0 - fraction), second.times(fraction), what)

    def add(self, port: Port, first: Color, second: Color, what: str = "") -> Color:
        """The sum; of two images that are mapped in different ways the brighter one stands for both."""
        if max(second.mean) <= 0.0:
            return first
        if max(first.mean) <= 0.0:
            return second
        if first.image == second.image and first.mapping == second.mapping:
            mean = None if first.mean_rgb is None else add_rgb(first.mean, second.mean)
            return replace(first, rgb=add_rgb(first.rgb, second.rgb), mean_rgb=mean)
        if lie_alike(self.images, first, second):
            return self.derive(port, np.add, [first, second], what)
        self.approximate("a mix of textures is replaced by the brighter one")
        main, other = (first, second) if sum(first.mean) >= sum(second.mean) else (second, first)
        total = add_rgb(main.mean, other.mean)
        scale = [t / m if m > 0.0 else 1.0 for t, m in zip(total, main.mean, strict=True)]
        return main.times((scale[0], scale[1], scale[2]))


def _read_image(reader: ColorReader, port: Port) -> Color:
    node = port.node
    panorama = reader.sky[0](reader, port) if reader.sky and node.type == "TEX_ENVIRONMENT" else None
    if panorama is not None:
        return panorama
    if node.image and node.image.source == "MOVIE" and all(node.image.size):
        reader.approximate(f"image {node.image.name} is a movie, a constant is used; choose a sequence of images in its place")
        return Color(reader.missing_rgb)
    sequence = node.image is not None and node.image.source == "SEQUENCE"
    frame = find_frame(node.image_user, bpy.context.scene.frame_current) if sequence else 0
    pixels = reader.images.read(node.image, frame) if node.image else None
    if pixels is None:
        reader.note(_describe_missing(node.image, frame))
        return Color(reader.missing_rgb)
    if pixels.note:
        reader.approximate(pixels.note)
    alpha = port.socket.name == "Alpha"
    if alpha and pixels.alpha is None:
        return Color(WHITE)
    mean = (pixels.mean[3],) * 3 if alpha else pixels.mean[:3]
    if node.type == "TEX_ENVIRONMENT":
        reader.note(f"image {node.image.name} is replaced by its mean over the sphere")
        return Color(to_rgb(find_sphere_mean(pixels.pixels)))
    mapping = read_mapping(port.sibling("Vector")) if node.projection in ("FLAT", "BOX") else None
    if mapping is None:
        reader.approximate(f"image {node.image.name} is replaced by its mean, for neither a UV layer nor positions map it")
        return Color(mean)
    if pixels.grid != (0, 0, 1, 1):
        if node.projection == "BOX":
            reader.approximate(f"image {node.image.name} is replaced by its mean, for a box shows no tiles")
            return Color(mean)
        mapping = mapping.into_grid(pixels.grid)
    if node.projection == "BOX":
        mapping = replace(mapping, box=True)
        if node.projection_blend > 0.0:
            reader.approximate(f"the sides of the box projection of image {node.image.name} are not blended")
    uses_alpha = is_used(node.outputs["Alpha"])
    index = reader.images.index(node.image, frame, node.extension, node.interpolation == "Closest", port.socket.name, uses_alpha)
    if pixels.alpha is not None and not alpha:
        mean = to_rgb(reader.images.images[index].pixels.mean(axis=(0, 1), dtype=np.float64))
    return Color(WHITE, index, mapping, mean)


def _describe_missing(image: Any, frame: int) -> str:
    if image is None:
        return "an image texture has no image"
    which = f"frame {frame} of image {image.name}" if image.source == "SEQUENCE" else f"image {image.name}"
    return f"{which} is missing (File > External Data finds it), a constant is used"


def _read_sky(reader: ColorReader, port: Port) -> Color:
    reader.note(f"{describe(port.node)} {REPLACED_BY_GREY}, far from a clear sky's light; take a colour and a sun lamp in its place")
    return Color(TEXTURE_COLOR)


def _read_attribute(reader: ColorReader, port: Port) -> Color:
    """An attribute of the mesh; black where it has none, as in Cycles."""
    node = port.node
    name = node.layer_name if node.type == "VERTEX_COLOR" else node.attribute_name
    reader.by_faces = True
    if reader.faces is None or reader.colors is None or (node.type == "ATTRIBUTE" and node.attribute_type != "GEOMETRY"):
        reader.note(f"{describe(node)} {REPLACED_BY_GREY}")
        return Color(TEXTURE_COLOR)
    layer = ColorLayer(name, port.socket.identifier if port.socket.identifier in ("Fac", "Alpha") else "Color")
    found = reader.faces.find_range(layer) if name or node.type == "VERTEX_COLOR" else None
    if found is None and name in reader.faces.local.attributes:
        reader.approximate(f"{describe(node)} {REPLACED_BY_GREY}, for attribute {name} is of a kind that is not read")
        return Color(TEXTURE_COLOR)
    if found is None:
        reader.note(
            f"{reader.faces.name} has no {f'colour attribute {name}' if name else 'colour attribute'}, so it is black there, as in Blender"
        )
        return Color(BLACK)
    low, mean, high = found
    if (low == high).all():
        return Color(to_rgb(low))
    return Color(WHITE, reader.colors.index(), layer, to_rgb(mean))


def _read_property(reader: ColorReader, port: Port) -> Color:
    """A property of the object, or of the view layer; black where it has none, as in Cycles."""
    owner = None if shows_view_layer(port) else reader.faces
    reader.by_object = reader.by_object or owner is not None
    reader.by_random = reader.by_random or port.socket.name == RANDOM
    by_nodes = owner is not None and owner.is_instance and any(one.type == "NODES" for one in owner.source.modifiers)
    reader.by_instance = reader.by_instance or (by_nodes and port.node.type == "ATTRIBUTE")
    rgba = find_shown(owner, port)
    if not rgba and by_nodes and not can_read_instances():
        reader.note(
            f"{describe(port.node)} {REPLACED_BY_GREY}, for what geometry nodes give instances is not read before Blender 5.0; realize them"
        )
        return Color(TEXTURE_COLOR)
    if not rgba:
        name, path = owner.name if owner else "the view layer", port.node.attribute_name
        reader.note(f"{name} has no property {path} of numbers, so it is black there, as in Blender")
    return Color(pick_output(rgba or NOTHING, port.socket.name))


def _read_output_value(reader: ColorReader, port: Port) -> Color:
    return Color(reader.read_value(port.socket, WHITE))


def _read_light_path(reader: ColorReader, port: Port) -> Color:
    """As a ray of the reader's kind sees it."""
    reader.by_ray = True
    name = port.socket.name
    if reader.sky:
        return Color((reader.sky[1].get(name, 0.0),) * 3)
    if name not in _KNOWN_RAYS:
        reader.note(f"{describe(port.node)} is taken as diffuse rays see it")
    return Color((_LIGHT_PATH[reader.ray].get(name, 0.0),) * 3)


_COLOR_READERS: dict[str, Callable[[ColorReader, Port], Color]] = {
    "TEX_IMAGE": _read_image,
    "TEX_ENVIRONMENT": _read_image,
    "TEX_SKY": _read_sky,
    "VERTEX_COLOR": _read_attribute,
    "ATTRIBUTE": _read_attribute,
    "RGB": _read_output_value,
    "VALUE": _read_output_value,
    "LIGHT_PATH": _read_light_path,
}
