"""Blender materials -> diffuse reflectance and emission, the nearest there is, with one warning for what was replaced."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..core.scene import Material
from .color_attributes import ColorLayer, ColorTable, Faces
from .colors_read import ColorReader
from .images_read import ImageTable
from .mesh_attributes import list_asked
from .node_colors import BLACK, GREY, WHITE, Color, Rgb, to_rgb
from .node_ports import Port, find_source, find_surface, uses_nodes
from .render_levels import Warnings
from .texture_mapping import UNMAPPED, UvMapping

_NOTHING = Color(BLACK)
PASSING_FRACTION = 0.5  # from here on a surface is glass or gap rather than wall
OPAQUE_ALPHA = 0.999


@dataclass(frozen=True)
class Surface:
    """A shader's diffuse reflectance, emitted radiance, and the fraction of light that goes straight through."""

    albedo: Color = _NOTHING
    emission: Color = _NOTHING
    passing: float = 0.0

    def times(self, factor: float) -> Surface:
        return Surface(self.albedo.times(factor), self.emission.times(factor), self.passing * factor)


@dataclass(frozen=True)
class MaterialReading:
    """A material of the snapshot, the mappings of its images, and whether it is glass or gap rather than wall."""

    material: Material
    albedo_mapping: UvMapping | ColorLayer = UNMAPPED
    emission_mapping: UvMapping | ColorLayer = UNMAPPED
    passes_light: bool = False


class MaterialTable:
    """The materials of a snapshot, each read once; those that show colour attributes once for each mesh, or properties for each object."""

    def __init__(self, warnings: Warnings) -> None:
        self.images = ImageTable()
        self.colors = ColorTable(self.images)
        self.readings: list[MaterialReading] = []
        self.asked = list_asked()
        self._warnings = warnings
        self._index: dict[tuple[int, ...], int] = {}  # by material and mesh, 0 any; or material, object and what it makes an instance of
        self._known: dict[tuple[int, MaterialReading], int] = {}

    def index(self, material: Any, faces: Faces | None = None) -> int:
        """Where a material (or None, an empty slot) is in `readings`, as these faces wear it."""
        uid = material.session_uid if material else 0
        of_any, of_mesh, of_object = (uid, 0), (uid, id(faces.local) if faces else 0), (uid, *_identify(faces))
        known = next((place for place in (of_any, of_mesh, of_object) if place in self._index), None)
        if known is None:
            reader = ColorReader(self.images, faces, self.colors)
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
        images = {"tri_albedo_uv": [one.albedo_image for one in materials], "tri_emission_uv": [one.emission_image for one in materials]}
        self.colors.finish(images, arrays)

    def _read(self, reader: ColorReader, material: Any) -> MaterialReading:
        if material is None:
            return MaterialReading(Material("", GREY))
        surface = read_material(reader, material)
        if reader.replaced:
            self._warnings.append((material.name, f"the material is simplified: {'; '.join(reader.replaced)}"))
        return MaterialReading(
            Material(
                name=material.name,
                albedo_rgb=_clip_negative(surface.albedo.rgb),
                albedo_image=surface.albedo.image,
                emission_rgb=_clip_negative(surface.emission.rgb),
                emission_image=surface.emission.image,
            ),
            surface.albedo.mapping,
            surface.emission.mapping,
            surface.passing > PASSING_FRACTION,
        )


def _identify(faces: Faces | None) -> tuple[int, ...]:
    return (faces.source.session_uid, faces.shown.original.session_uid) if faces else ()


def read_material(reader: ColorReader, material: Any) -> Surface:
    """What the material's active output shows to Cycles; black where nothing is connected, as there."""
    if not uses_nodes(material):
        return Surface(Color(to_rgb(material.diffuse_color)))
    output, source = find_surface(material)
    if output is None:
        reader.note("it has no output node, so it is black")
        return Surface()
    if output.inputs["Displacement"].is_linked and material.displacement_method != "BUMP":
        reader.note("displacement is left out")
    if source is None:
        volume = output.inputs["Volume"].is_linked
        reader.note("its volume is left out" if volume else "nothing is connected to its output, so it is black")
        return Surface(passing=float(volume))
    return read_shader(reader, source)


def read_shader(reader: ColorReader, port: Port) -> Surface:
    """The surface of the shader that a source port gives."""
    shader = _SHADERS.get(port.node.type, _read_other)
    return shader(reader, port)


def read_input_color(reader: ColorReader, port: Port, name: str, default: Rgb = WHITE) -> Color:
    """The colour input of a port's node; the value behind a link stands for a missing image."""
    socket = port.node.inputs.get(name)
    stored = getattr(socket, "default_value", None)
    reader.missing_rgb = default if stored is None else to_rgb(stored)
    return reader.read_color(port.sibling(name), default)


def _read_principled(reader: ColorReader, port: Port) -> Surface:
    metallic = _fraction(reader, port, "Metallic")
    transmission = _fraction(reader, port, "Transmission Weight") * (1.0 - metallic)
    if metallic > 0.0:
        reader.note(f"its metallic reflection ({metallic:.0%}) is left out")
    if transmission > 0.0:
        reader.note(f"its transmission ({transmission:.0%}) is left out")
    for name, text in (("Subsurface Weight", "subsurface light stays where it arrives"), ("Coat Weight", "its coat is left out")):
        if _fraction(reader, port, name) > 0.0:
            reader.note(text)
    _note_normal(reader, port)
    alpha = _read_alpha(reader, port)
    # Cycles' diffuse part without the layer of specular reflection above it
    albedo = read_input_color(reader, port, "Base Color", GREY).times((1.0 - metallic) - transmission)
    strength = reader.read_number(port.sibling("Emission Strength"), 0.0)
    emission = read_input_color(reader, port, "Emission Color").times(strength) if strength > 0.0 else _NOTHING
    return Surface(albedo.times(alpha), emission.times(alpha), 1.0 - alpha * (1.0 - transmission))


def _read_alpha(reader: ColorReader, port: Port) -> float:
    source = port.sibling("Alpha")
    alpha = _fraction(reader, port, "Alpha", 1.0)
    if alpha >= OPAQUE_ALPHA:
        return 1.0
    if source is not None and not source.is_value:
        reader.note("its transparent parts are baked as opaque")
        return 1.0
    reader.note(f"its transparency (alpha {alpha:.2f}) is not traced")
    return alpha


def _read_diffuse(reader: ColorReader, port: Port) -> Surface:
    _note_normal(reader, port)
    return Surface(read_input_color(reader, port, "Color", GREY))


def _read_emission(reader: ColorReader, port: Port) -> Surface:
    strength = reader.read_number(port.sibling("Strength"), 1.0)
    return Surface(emission=read_input_color(reader, port, "Color").times(strength))


def _read_mix(reader: ColorReader, port: Port) -> Surface:
    first, second = _read_two(reader, port)
    factor = port.sibling("Fac") or port.sibling("Factor")
    fraction = min(max(reader.read_number(factor, 0.5), 0.0), 1.0)
    linked = factor is not None and not factor.is_value
    if linked and first.passing != second.passing:
        reader.note("its transparent parts are baked as opaque")
        return second if first.passing > second.passing else first
    if linked and 0.0 < fraction < 1.0:
        reader.note("two shaders are mixed evenly over the surface")
    return _add(reader, first.times(1.0 - fraction), second.times(fraction))


def _read_add(reader: ColorReader, port: Port) -> Surface:
    first, second = _read_two(reader, port)
    return _add(reader, first, second)


def _read_transparent(reader: ColorReader, port: Port) -> Surface:
    reader.note("its transparency is not traced")
    return Surface(passing=1.0)


def _read_glass(reader: ColorReader, port: Port) -> Surface:
    reader.note(f"{port.node.name} is baked as diffuse")
    return Surface(read_input_color(reader, port, "Color"), passing=1.0)


def _read_other(reader: ColorReader, port: Port) -> Surface:
    """A shader unknown to us as a diffuse one of its colour."""
    reader.note(f"{port.node.name} is baked as diffuse")
    name = next((name for name in ("Color", "Base Color") if name in port.node.inputs), "")
    return Surface(read_input_color(reader, port, name, GREY) if name else Color(GREY))


def _read_two(reader: ColorReader, port: Port) -> tuple[Surface, Surface]:
    sources = [find_source(Port(socket, port.groups)) for socket in port.node.inputs if socket.type == "SHADER"]
    first, second = (Surface() if source.is_value else read_shader(reader, source) for source in sources[:2])
    return first, second


def _add(reader: ColorReader, first: Surface, second: Surface) -> Surface:
    albedo, emission = reader.add(first.albedo, second.albedo), reader.add(first.emission, second.emission)
    return Surface(albedo, emission, min(first.passing + second.passing, 1.0))


def _fraction(reader: ColorReader, port: Port, name: str, default: float = 0.0) -> float:
    return min(max(reader.read_number(port.sibling(name), default), 0.0), 1.0)


def _note_normal(reader: ColorReader, port: Port) -> None:
    normal = port.sibling("Normal")
    if normal is not None and not normal.is_value:
        reader.note("its normal or bump map is left out")


def _clip_negative(rgb: Rgb) -> Rgb:
    return max(rgb[0], 0.0), max(rgb[1], 0.0), max(rgb[2], 0.0)


_SHADERS: dict[str, Callable[[ColorReader, Port], Surface]] = {
    "BSDF_PRINCIPLED": _read_principled,
    "BSDF_DIFFUSE": _read_diffuse,
    "EMISSION": _read_emission,
    "BACKGROUND": _read_emission,
    "MIX_SHADER": _read_mix,
    "ADD_SHADER": _read_add,
    "BSDF_TRANSPARENT": _read_transparent,
    "BSDF_GLASS": _read_glass,
    "BSDF_REFRACTION": _read_glass,
}
