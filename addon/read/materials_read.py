"""Blender materials -> diffuse reflectance and emission, the nearest there is, with one warning for what was replaced."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.scene.scene import DIFFUSE, GLOSSY, SEEN_BY_ALL, SHADOW, TEXTURE_UVS, TRANSMISSION, Material
from ..nodes.color_attributes import ColorLayer, ColorTable, Faces
from ..nodes.colors_read import ColorReader
from ..nodes.images_read import MAX_TEXTURE_SIDE_TEXELS, ImageTable
from ..nodes.node_colors import GREY, WHITE, Color, Rgb, add_rgb, to_rgb
from ..nodes.node_ports import Port, find_source, find_surface, uses_nodes
from ..nodes.polygon_atlas import BakedLayer
from ..nodes.socket_bake import HEIGHTS, SocketBaker
from ..nodes.texture_mapping import UNMAPPED, UvMapping
from .mesh_attributes import list_wanted_attributes
from .render_levels import Warnings
from .shaders_read import PAINT, Surface, read_shader

_IMAGES = tuple(image for images in TEXTURE_UVS.values() for image in images)
_ALIKE = 1e-4  # of reflectances
_ALIKE_PATTERN = 0.05  # mean difference of patterns
_VIEWS = np.maximum(np.linspace(0.0, 1.0, 17), 1e-4).tolist()  # cosines with the normal; 0 would be on neither side


@dataclass(frozen=True)
class MaterialReading:
    """A material of the snapshot, the mappings of its images, and the UV layer along whose tangents its normal map is."""

    material: Material
    albedo_mapping: UvMapping | ColorLayer | BakedLayer = UNMAPPED
    emission_mapping: UvMapping | ColorLayer | BakedLayer = UNMAPPED
    passing_mapping: UvMapping | ColorLayer | BakedLayer = UNMAPPED
    normal_mapping: UvMapping | ColorLayer | BakedLayer = UNMAPPED
    metal_mapping: UvMapping | ColorLayer | BakedLayer = UNMAPPED
    glass_mapping: UvMapping | ColorLayer | BakedLayer = UNMAPPED
    through_mapping: UvMapping | ColorLayer | BakedLayer = UNMAPPED
    lobe_mapping: UvMapping | ColorLayer | BakedLayer = UNMAPPED
    tangent_layer: str = ""

    @property
    def is_clear(self) -> bool:
        """Whether light goes through it and none is reflected, so that a lightmap has nothing to show."""
        passes = any((*self.material.passing_rgb, *self.material.glass_rgb))
        return passes and not (any(self.material.albedo_rgb) and any(self.material.seen_rgb[DIFFUSE]))


class MaterialTable:
    """The materials of a snapshot, each read once; those that show colour attributes once for each mesh, or properties for each object."""

    def __init__(self, warnings: Warnings, override: Any = None, most_texels: int = MAX_TEXTURE_SIDE_TEXELS) -> None:
        """Where `override` is a material, all objects wear it; images have no more texels on a side than that."""
        self.override = override
        self.images = ImageTable(most_texels)
        self.colors = ColorTable(self.images)
        self.baker = SocketBaker(self.images)
        self.readings: list[MaterialReading] = []
        self.asked = list_wanted_attributes()
        self._warnings = warnings
        self._index: dict[tuple[float, ...], int] = {}  # by material and mesh, 0 any; or material, object and what it makes an instance of
        self._known: dict[tuple[int, MaterialReading], int] = {}

    def index(self, material: Any, faces: Faces | None = None) -> int:
        """Where a material (or None, an empty slot) is in `readings`, as these faces wear it."""
        uid = material.session_uid if material else 0
        of_any, of_mesh, of_object = (uid, 0), (uid, id(faces.local) if faces else 0), (uid, *_identify(faces))
        of_random = (*of_object, faces.random_level) if faces else of_object
        of_instance = (*of_object, -1.0, faces.number) if faces else of_object
        known = next((place for place in (of_any, of_mesh, of_object, of_random, of_instance) if place in self._index), None)
        if known is None:
            reader = ColorReader(self.images, faces, self.colors, self.baker, material)
            reading = self._read(reader, material)
            if (uid, reading) not in self._known:
                self._known[uid, reading] = len(self.readings)
                self.readings.append(reading)
            ways = ((reader.by_instance, of_instance), (reader.by_random, of_random), (reader.by_object, of_object))
            known = next((place for depends, place in ways if depends), of_mesh if reader.by_faces else of_any)
            self._index[known] = self._known[uid, reading]
        return self._index[known]

    def finish(self, arrays: dict[str, Any]) -> None:
        """Complete a snapshot's arrays once all of its materials are read."""
        materials = [reading.material for reading in self.readings]
        images = {name: [getattr(one, of[0]) for one in materials] for name, of in TEXTURE_UVS.items() if name != "tri_normal_uv"}
        self.colors.finish(images, arrays)
        place = self.images.keep(getattr(one, name) for one in materials for name in _IMAGES if getattr(one, name) >= 0)
        place[-1] = -1
        self.readings = [replace(one, material=_move_images(one.material, place)) for one in self.readings]

    def _read(self, reader: ColorReader, material: Any) -> MaterialReading:
        if material is None:
            return MaterialReading(Material("", GREY))
        surface = read_material(reader, material)
        seen = _read_by_ray(reader, material, surface) if reader.by_ray else _SeenByRay(surface, {}, surface.passing.mapping)
        surface, passing = seen.surface, seen.passing
        sides = _read_sides(reader, material, surface) if reader.by_view else _Sides(surface.passing, surface.emission)
        if reader.replaced or reader.mended:
            self._warnings.append((material.name, f"the material is simplified: {'; '.join([*reader.replaced, *reader.mended])}"))
        colors = {name: getattr(surface, name) for name in ("albedo", "metal", "glass", "through")}
        colors |= {"emission": sides.emission, "passing": sides.passing}
        others = {"normal": reader.normal, "lobe": surface.lobes}
        fields: dict[str, Any] = {f"{name}_rgb": _clip_negative(color.rgb) for name, color in colors.items()}
        fields |= {f"{name}_image": color.image for name, color in (colors | others).items() if color}
        fields |= {f"glass_{name}": value for name, value in vars(surface.bending).items() if name != "share"}
        fields |= vars(surface.gloss) | passing
        mappings = {f"{name}_mapping": color.mapping for name, color in (colors | others).items() if color}
        if sides.passing.image < 0:
            mappings["passing_mapping"] = seen.passing_mapping
        return MaterialReading(
            Material(
                name=material.name,
                passing_views=sides.passing_views,
                back_rgb=sides.back_rgb,
                dark_back=sides.dark_back,
                dark_front=sides.dark_front,
                seen_rgb=seen.seen_rgb,
                glow_rgb=seen.glow_rgb,
                normal_strength=reader.normal_strength,
                **fields,
            ),
            tangent_layer=reader.tangent_layer,
            **mappings,
        )


@dataclass(frozen=True)
class _SeenByRay:
    """What rays of each kind see of a material.

    surface    as diffuse rays see it; what is reflected and bent, where they see nothing of it, as those do that see some
    passing    fields of Material for other rays
    seen_rgb, glow_rgb   of Material
    """

    surface: Surface
    passing: dict[str, Any]
    passing_mapping: UvMapping | ColorLayer | BakedLayer
    seen_rgb: tuple[Rgb, Rgb, Rgb] = SEEN_BY_ALL
    glow_rgb: tuple[Rgb, Rgb, Rgb] = SEEN_BY_ALL


def _read_by_ray(reader: ColorReader, material: Any, diffuse: Surface) -> _SeenByRay:
    """By a reader that has read what diffuse rays see."""
    seen = [diffuse, diffuse, diffuse]
    fields: dict[str, Any] = {}
    mapping = diffuse.passing.mapping if diffuse.passing.image >= 0 else None
    for kind, name in ((GLOSSY, "glossy"), (TRANSMISSION, "transmission"), (SHADOW, "shadow")):
        reader.ray = kind
        surface = read_material(reader, material)
        if kind != SHADOW:
            seen[kind] = surface
        passing = surface.passing
        if passing == diffuse.passing:
            continue
        if passing.image >= 0 and passing.mapping != (mapping or passing.mapping):
            reader.note(f"its transparency for {name} rays is replaced by its mean, for it is mapped in another way")
            passing = Color(passing.mean)
        elif passing.image >= 0:
            mapping = passing.mapping
        fields[f"{name}_passing_rgb"], fields[f"{name}_passing_image"] = _clip_negative(passing.rgb), passing.image
    reader.ray = DIFFUSE
    shown = next((surface for surface in seen if any(_find_sent(surface))), diffuse)
    is_exact = all(_is_scaled(surface, shown) for surface in seen)
    if not is_exact or (not any(diffuse.emission.mean) and any(any(surface.emission.mean) for surface in seen)):
        reader.note("what glossy and transmission rays see of it is approximated")
    seen_rgb, glow_rgb = (
        (_divide(of_each[DIFFUSE], base), _divide(of_each[GLOSSY], base), _divide(of_each[TRANSMISSION], base))
        for of_each, base in (
            ([_find_sent(surface) for surface in seen], _find_sent(shown)),
            ([surface.emission.mean for surface in seen], diffuse.emission.mean),
        )
    )
    surface = replace(shown, passing=diffuse.passing, emission=diffuse.emission)
    return _SeenByRay(surface, fields, mapping or UNMAPPED, seen_rgb, glow_rgb)


@dataclass(frozen=True)
class _Sides:
    """What differs by view: of the side that lets more light pass, and of one that glows; the others are fields of Material."""

    passing: Color
    emission: Color
    passing_views: tuple[tuple[float, ...], ...] = ()
    back_rgb: Rgb = WHITE
    dark_back: bool = False
    dark_front: bool = False


def _read_sides(reader: ColorReader, material: Any, front: Surface) -> _Sides:
    """What differs between views. The reader has read the front as the mean of all views, and some of its nodes depend on the view."""
    before = list(reader.replaced)
    reader.is_back = True
    back = read_material(reader, material)
    reader.is_back = False
    of_views: list[list[Surface]] = [[], []]
    for side, found in zip((-1.0, 1.0), of_views, strict=True):
        for cosine in _VIEWS:
            reader.view = side * cosine
            found.append(read_material(reader, material))
    reader.view, reader.replaced = None, before
    passing = max(front.passing, back.passing, key=lambda color: sum(color.mean))
    views = tuple(tuple(_divide_means(surface.passing, passing) for surface in found) for found in of_views)
    is_even = max(map(max, views)) - min(map(min, views)) < _ALIKE
    glows = [[sum(surface.emission.mean) for surface in found] for found in of_views]
    dark_back, dark_front = (max(each) <= 0.0 for each in glows)
    emission = back.emission if dark_front and not dark_back else front.emission
    if any(max(each) - min(each) > _ALIKE * max(each) for each in glows):
        reader.note("it glows more in some directions than in others, and is baked as glowing equally in all")
    if not (dark_back or dark_front) and abs(sum(back.emission.mean) - sum(front.emission.mean)) > _ALIKE * sum(back.emission.mean):
        reader.note("its back glows in another way than its front, and both are baked as the front")
    sent, at_back = _find_sent(front), _find_sent(back)
    if any(there > 0.0 and here <= 0.0 for here, there in zip(sent, at_back, strict=True)):
        reader.note("its back reflects light of a colour that its front does not, and that is left out")
    if any(at_back) and not _look_alike(reader, front.albedo, back.albedo):
        reader.note("its back shows the pattern of its front")
    back_rgb = _divide(at_back, sent)
    is_lamp = any(emission.mean)
    return _Sides(passing, emission, () if is_even else views, back_rgb, dark_back and is_lamp, dark_front and is_lamp)


def _look_alike(reader: ColorReader, one: Color, other: Color) -> bool:
    """Whether two colours have the same pattern, but for a factor."""
    if one.image == other.image:
        return True
    shown = [np.ones((1, 1, 3)) if color.image < 0 else reader.images.images[color.image].pixels for color in (one, other)]
    if shown[0].shape != shown[1].shape and one.image >= 0 and other.image >= 0:
        return False
    first, second = (pixels / np.maximum(pixels.mean(axis=(0, 1)), 1e-9) for pixels in shown)
    return float(np.abs(first - second).mean()) < _ALIKE_PATTERN


def _divide_means(part: Color, whole: Color) -> float:
    """1 where the whole is 0."""
    return sum(part.mean) / sum(whole.mean) if sum(whole.mean) > 0.0 else 1.0


def _find_sent(surface: Surface) -> Rgb:
    """What it sends on, on average."""
    return add_rgb(surface.albedo.mean, surface.glass.mean)


def _is_scaled(surface: Surface, shown: Surface) -> bool:
    """Whether it sends on what `shown` does but for a factor."""
    factor = _divide(_find_sent(surface), _find_sent(shown))
    parts = ((getattr(surface, name), getattr(shown, name)) for name in ("albedo", "metal", "glass", "through"))
    return not any(_find_sent(surface)) or all(
        own.image == other.image and max(abs(a - f * b) for a, f, b in zip(own.mean, factor, other.mean, strict=True)) < _ALIKE
        for own, other in parts
    )


def _divide(rgb: Rgb, base: Rgb) -> Rgb:
    """1 where the base is 0."""
    r, g, b = (own / of if of > 0.0 else 1.0 for own, of in zip(rgb, base, strict=True))
    return r, g, b


def _move_images(material: Material, place: dict[int, int]) -> Material:
    return replace(material, **{name: place[getattr(material, name)] for name in _IMAGES})


def _identify(faces: Faces | None) -> tuple[int, ...]:
    return (faces.source.session_uid, faces.shown.original.session_uid) if faces else ()


def read_material(reader: ColorReader, material: Any) -> Surface:
    """What the material's active output shows to Cycles; black where nothing is connected, as there."""
    if not uses_nodes(material):
        return Surface(Color(reader.mend(to_rgb(material.diffuse_color), GREY, None)), gloss=PAINT)
    output, source = find_surface(material)
    if output is None:
        reader.note("it has no output node, so it is black")
        return Surface()
    volume = output.inputs["Volume"].is_linked
    if volume or source is None:
        reader.note("its volume is left out" if volume else "nothing is connected to its output, so it is black")
    if source is None:
        return Surface(passing=Color((float(volume),) * 3))
    surface = read_shader(reader, source)
    height = find_source(Port(output.inputs["Displacement"]))
    if not height.is_value:
        if material.displacement_method != "BUMP":
            reader.note("displacement is left out")
        if material.displacement_method != "DISPLACEMENT" and not _read_bump(reader, height, surface):
            reader.note("its bump by displacement is left out")
    return surface


def _read_bump(reader: ColorReader, height: Port, surface: Surface) -> bool:
    return height.node.type in HEIGHTS and reader.read_bump(height, is_mirror=any(surface.metal.mean))


def _clip_negative(rgb: Rgb) -> Rgb:
    return max(rgb[0], 0.0), max(rgb[1], 0.0), max(rgb[2], 0.0)
