"""Blender materials -> diffuse reflectance and emission, the nearest there is, with one warning for what was replaced."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ...core.scene.scene import TEXTURE_UVS, Material
from ..nodes.color_attributes import ColorLayer, ColorTable, Faces
from ..nodes.colors_read import SHADOW, ColorReader
from ..nodes.images_read import MAX_TEXTURE_SIDE_TEXELS, ImageTable
from ..nodes.node_colors import GREY, Color, Rgb, to_rgb
from ..nodes.node_ports import find_surface, uses_nodes
from ..nodes.polygon_atlas import BakedLayer
from ..nodes.socket_bake import SocketBaker
from ..nodes.texture_mapping import UNMAPPED, UvMapping
from .mesh_attributes import list_wanted_attributes
from .render_levels import Warnings
from .shaders_read import PAINT, Surface, read_shader

_IMAGES = tuple(image for images in TEXTURE_UVS.values() for image in images)


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
        return any((*self.material.passing_rgb, *self.material.glass_rgb)) and not any(self.material.albedo_rgb)


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
        self._index: dict[tuple[int, ...], int] = {}  # by material and mesh, 0 any; or material, object and what it makes an instance of
        self._known: dict[tuple[int, MaterialReading], int] = {}

    def index(self, material: Any, faces: Faces | None = None) -> int:
        """Where a material (or None, an empty slot) is in `readings`, as these faces wear it."""
        uid = material.session_uid if material else 0
        of_any, of_mesh, of_object = (uid, 0), (uid, id(faces.local) if faces else 0), (uid, *_identify(faces))
        known = next((place for place in (of_any, of_mesh, of_object) if place in self._index), None)
        if known is None:
            reader = ColorReader(self.images, faces, self.colors, self.baker, material)
            reading = self._read(reader, material)
            if (uid, reading) not in self._known:
                self._known[uid, reading] = len(self.readings)
                self.readings.append(reading)
            known = of_object if reader.by_object else of_mesh if reader.by_faces else of_any
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
        shadow: Color | None = None
        if reader.by_ray:
            reader.ray = SHADOW
            shadow = read_material(reader, material).passing
            if shadow.image >= 0 and surface.passing.image >= 0 and shadow.mapping != surface.passing.mapping:
                reader.note("its transparency for shadow rays is replaced by its mean, for it is mapped in another way")
                shadow = Color(shadow.mean)
        if reader.replaced or reader.mended:
            self._warnings.append((material.name, f"the material is simplified: {'; '.join([*reader.replaced, *reader.mended])}"))
        return MaterialReading(
            Material(
                name=material.name,
                albedo_rgb=_clip_negative(surface.albedo.rgb),
                albedo_image=surface.albedo.image,
                emission_rgb=_clip_negative(surface.emission.rgb),
                emission_image=surface.emission.image,
                passing_rgb=_clip_negative(surface.passing.rgb),
                passing_image=surface.passing.image,
                shadow_passing_rgb=None if shadow is None else _clip_negative(shadow.rgb),
                shadow_passing_image=-1 if shadow is None else shadow.image,
                normal_image=-1 if reader.normal is None else reader.normal.image,
                normal_strength=reader.normal_strength,
                metal_rgb=_clip_negative(surface.metal.rgb),
                metal_image=surface.metal.image,
                metal=surface.gloss.metal,
                metal_edge_rgb=surface.gloss.edge_rgb,
                metal_flat=surface.gloss.flat,
                lobe_image=-1 if surface.lobes is None else surface.lobes.image,
                layer=surface.gloss.layer,
                diffuse=surface.gloss.diffuse,
                multiscatter=surface.gloss.multiscatter,
                layer_tint=surface.gloss.layer_tint,
                roughness=surface.gloss.roughness,
                ior=surface.gloss.ior,
                sheen_rgb=surface.gloss.sheen_rgb,
                sheen_roughness=surface.gloss.sheen_roughness,
                coat=surface.gloss.coat,
                coat_roughness=surface.gloss.coat_roughness,
                coat_ior=surface.gloss.coat_ior,
                glass_rgb=_clip_negative(surface.glass.rgb),
                glass_image=surface.glass.image,
                glass_mirror_rgb=_clip_negative(surface.bending.mirror_rgb),
                glass_fresnel=surface.bending.fresnel,
                glass_multiscatter=surface.bending.multiscatter,
                glass_roughness=surface.bending.roughness,
                glass_ior=surface.bending.ior,
                through_rgb=_clip_negative(surface.through.rgb),
                through_image=surface.through.image,
            ),
            surface.albedo.mapping,
            surface.emission.mapping,
            shadow.mapping if shadow and shadow.image >= 0 else surface.passing.mapping,
            UNMAPPED if reader.normal is None else reader.normal.mapping,
            surface.metal.mapping,
            surface.glass.mapping,
            surface.through.mapping,
            UNMAPPED if surface.lobes is None else surface.lobes.mapping,
            reader.tangent_layer,
        )


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
    if output.inputs["Displacement"].is_linked and material.displacement_method != "BUMP":
        reader.note("displacement is left out")
    if source is None:
        volume = output.inputs["Volume"].is_linked
        reader.note("its volume is left out" if volume else "nothing is connected to its output, so it is black")
        return Surface(passing=Color((float(volume),) * 3))
    return read_shader(reader, source)


def _clip_negative(rgb: Rgb) -> Rgb:
    return max(rgb[0], 0.0), max(rgb[1], 0.0), max(rgb[2], 0.0)
