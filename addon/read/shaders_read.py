"""Shader nodes -> diffuse and specular reflectance, glass, emitted radiance and what goes straight through, the nearest there is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...core.scene.gloss import EDGE_COSINE, average_fresnel, find_mean_path, reflect_conductor, reflect_schlick, tint_by_coat
from ...core.scene.sheen import average_sheen
from ...core.util.arrays import FloatArray
from ..nodes.colors_read import ColorReader
from ..nodes.node_colors import BLACK, GREY, WHITE, Color, Rgb, add_rgb, to_rgb
from ..nodes.node_formulas import dim_rough
from ..nodes.node_ports import Port, find_source
from ..nodes.view_nodes import depends_on_view, shows_view

_NOTHING = Color(BLACK)
_LEAST = 1e-5
_COLORS = ("albedo", "emission", "passing", "metal", "glass", "through")  # of a Surface
_NO_SUBSURFACE = "light below the surface comes out where it went in"
_EVEN_ROUGH = "its rough diffuse reflection is baked as alike in all directions"


@dataclass(frozen=True)
class GlossNumbers:
    """As in a Material; evenly over the surface."""

    metal: float = 0.0
    layer: float = 0.0
    roughness: float = 0.5
    ior: float = 1.5
    diffuse: float = 1.0
    multiscatter: bool = True
    layer_tint: float = 1.0
    coat: float = 0.0
    coat_roughness: float = 0.03
    coat_ior: float = 1.5
    coat_tint_rgb: Rgb = WHITE
    metal_edge_rgb: Rgb = WHITE
    metal_flat: bool = False
    sheen_rgb: Rgb = BLACK
    sheen_roughness: float = 0.5

    def times(self, share: float) -> GlossNumbers:
        """On a share of the surface."""
        metal, layer, diffuse, coat = (share * part for part in (self.metal, self.layer, self.diffuse, self.coat))
        red, green, blue = self.sheen_rgb
        return replace(self, metal=metal, layer=layer, diffuse=diffuse, coat=coat, sheen_rgb=(share * red, share * green, share * blue))

    def add(self, other: GlossNumbers) -> GlossNumbers:
        """Both; as rough as the stronger one."""
        main = self if self.metal + self.layer >= other.metal + other.layer else other
        metallic = self if self.metal >= other.metal else other
        main = replace(main, metal_edge_rgb=metallic.metal_edge_rgb, metal_flat=metallic.metal_flat)
        metal, layer, diffuse, coat = (
            min(getattr(self, name) + getattr(other, name), 1.0) for name in ("metal", "layer", "diffuse", "coat")
        )
        fluffy = self if sum(self.sheen_rgb) >= sum(other.sheen_rgb) else other
        main = replace(main, sheen_rgb=add_rgb(self.sheen_rgb, other.sheen_rgb), sheen_roughness=fluffy.sheen_roughness)
        coated = self if self.coat >= other.coat else other
        main = replace(main, coat_roughness=coated.coat_roughness, coat_ior=coated.coat_ior, coat_tint_rgb=coated.coat_tint_rgb)
        return replace(main, metal=metal, layer=layer, diffuse=diffuse, coat=coat)


@dataclass(frozen=True)
class GlassNumbers:
    """As in a Material; evenly over the surface.

    share   of the surface that is glass
    """

    share: float = 0.0
    mirror_rgb: Rgb = BLACK
    fresnel: bool = True
    multiscatter: bool = True
    roughness: float = 0.0
    ior: float = 1.5

    def times(self, share: float) -> GlassNumbers:
        """On a share of the surface."""
        red, green, blue = self.mirror_rgb
        return replace(self, share=share * self.share, mirror_rgb=(share * red, share * green, share * blue))

    def add(self, other: GlassNumbers) -> GlassNumbers:
        """Both; as rough as the stronger one."""
        main = self if self.share >= other.share else other
        return replace(main, share=min(self.share + other.share, 1.0), mirror_rgb=add_rgb(self.mirror_rgb, other.mirror_rgb))


PAINT = GlossNumbers()
NO_GLOSS = GlossNumbers(diffuse=0.0)
NO_GLASS = GlassNumbers()


@dataclass(frozen=True)
class Surface:
    """A shader's reflectance, emitted radiance, and the share of light that goes straight through.

    metal       the part of the albedo that is reflected as in a mirror
    gloss       how
    lobes       roughness, share of metal and share with a layer as channels of an image; None where gloss holds everywhere
    glass       tint of what glass refracts, times the share of the surface that is glass
    bending     how
    through     the part of the albedo that leaves on the other side, diffusely
    """

    albedo: Color = _NOTHING
    emission: Color = _NOTHING
    passing: Color = _NOTHING
    metal: Color = _NOTHING
    gloss: GlossNumbers = NO_GLOSS
    lobes: Color | None = None
    glass: Color = _NOTHING
    bending: GlassNumbers = NO_GLASS
    through: Color = _NOTHING


def read_shader(reader: ColorReader, port: Port) -> Surface:
    """The surface of the shader that a source port gives."""
    shader = _SHADERS.get(port.node.type, _read_other)
    return shader(reader, port)


def read_input_color(reader: ColorReader, port: Port, name: str, default: Rgb = WHITE) -> Color:
    """The colour input of a port's node; the value behind a link stands for a missing image."""
    socket = port.node.inputs.get(name)
    stored = getattr(socket, "default_value", None)
    reader.missing_rgb = default if stored is None or not all(map(math.isfinite, stored)) else to_rgb(stored)
    return reader.read_color(port.sibling(name), default)


def _read_principled(reader: ColorReader, port: Port) -> Surface:
    metallic, transmission = _fraction(reader, port, "Metallic"), _fraction(reader, port, "Transmission Weight")
    subsurface = reader.read_number(port.sibling("Subsurface Weight"), 0.0)
    if subsurface > 0.0:
        reader.note(_NO_SUBSURFACE)
    _note_lobe(reader, port)
    _note_normal(reader, port, is_mirror=metallic.mean[0] > 0.0)
    alpha = _fraction(reader, port, "Alpha", 1.0)
    base = read_input_color(reader, port, "Base Color", GREY)
    diffuse = _roughen(reader, port, base, "Diffuse Roughness")
    if subsurface > 0.0:
        diffuse = reader.mix(port, diffuse, base, min(subsurface, 1.0), "below")
    color = _leave_out(reader, port, diffuse, metallic, "not metal")
    metal = _scale(reader, port, _scale(reader, port, base, metallic, "metal"), alpha, "clear metal")
    albedo = _leave_out(reader, port, color, transmission, "glass")
    emission = _read_radiance(reader, port, "Emission Color", "Emission Strength", 0.0)
    glass, bending = _NOTHING, NO_GLASS
    if transmission.mean[0] > 0.0:
        part = _scale(reader, port, _complement(reader, port, metallic, "glass or paint"), transmission, "of glass")
        part = _scale(reader, port, part, alpha, "seen glass")
        # Cycles tints each of the two sides of a solid by the root of the colour, and what it reflects not at all.
        glass = _scale(reader, port, reader.derive(port, lambda rgb: np.sqrt(np.maximum(rgb, 0.0)), [base], "root"), part, "glass")
        bending = _read_bending(reader, port, WHITE, True).times(part.mean[0])
    gloss = _read_gloss(reader, port, metallic.mean[0], transmission.mean[0])
    surface = Surface(
        reader.add(port, _scale(reader, port, albedo, alpha, "albedo"), metal, "reflecting"),
        _scale(reader, port, emission, alpha, "emission"),
        _complement(reader, port, alpha, "clear"),
        metal,
        gloss.times(alpha.mean[0]),
        _read_lobes(reader, port, metallic, (alpha, transmission), gloss.layer > 0.0),
        glass,
        bending,
    )
    return _add_sheen(reader, port, _add_coat(reader, port, surface, alpha), alpha)


def _add_coat(reader: ColorReader, port: Port, surface: Surface, alpha: Color) -> Surface:
    """A Principled BSDF's clear coat above a surface; its tint colours what is below by the mean path through the coat."""
    coat = _read_share(reader, port, "Coat Weight", 0.0)
    if coat <= 0.0:
        return surface
    ior = max(reader.read_number(port.sibling("Coat IOR"), 1.5), 1.0 + 1e-4)
    roughness = _read_share(reader, port, "Coat Roughness", 0.03)
    tint = _clip(read_input_color(reader, port, "Coat Tint").mean)
    below = _dim(reader, port, surface, to_rgb(tint_by_coat(np.array(tint), coat, find_mean_path(ior))))
    emission = below.emission.times(1.0 - coat * average_fresnel(ior))
    gloss = replace(below.gloss, coat=coat * alpha.mean[0], coat_roughness=roughness, coat_ior=ior, coat_tint_rgb=tint)
    return replace(below, emission=emission, gloss=gloss)


def _add_sheen(reader: ColorReader, port: Port, surface: Surface, alpha: Color) -> Surface:
    """A Principled BSDF's sheen above a surface; the albedo holds what it reflects of even light."""
    weight = max(reader.read_number(port.sibling("Sheen Weight"), 0.0), 0.0)
    if weight <= 0.0:
        return surface
    roughness = _read_share(reader, port, "Sheen Roughness", 0.5)
    color = Color(read_input_color(reader, port, "Sheen Tint").mean).times(min(weight, 1.0))
    sheen = color.times(average_sheen(roughness))
    below = _dim(reader, port, surface, (1.0 - min(max(*sheen.rgb), 1.0),) * 3)
    gloss = replace(below.gloss, sheen_rgb=_clip(color.times(alpha.mean[0]).rgb), sheen_roughness=roughness)
    return replace(below, albedo=reader.add(port, below.albedo, _scale(reader, port, sheen, alpha, "sheen"), "with sheen"), gloss=gloss)


def _dim(reader: ColorReader, port: Port, surface: Surface, rgb: Rgb) -> Surface:
    """What is left of all that a surface sends, where something above it lets that share of each channel through."""
    mean = sum(rgb) / 3.0
    albedo, emission, metal, glass = (color.times(rgb) for color in (surface.albedo, surface.emission, surface.metal, surface.glass))
    gloss, bending, lobes = surface.gloss.times(mean), surface.bending.times(mean), surface.lobes
    if lobes is not None and mean != 1.0:
        lobes = reader.derive(port, lambda shares: shares * np.float32([1.0, mean, mean]), [lobes], f"dimmed to {mean}")
    return replace(surface, albedo=albedo, emission=emission, metal=metal, glass=glass, gloss=gloss, lobes=lobes, bending=bending)


def _read_sheen(reader: ColorReader, port: Port) -> Surface:
    """The albedo is what it reflects of even light."""
    _note_normal(reader, port)
    roughness = _read_share(reader, port, "Roughness", 0.5)
    color = read_input_color(reader, port, "Color")
    gloss = replace(NO_GLOSS, sheen_rgb=_clip(color.mean), sheen_roughness=roughness)
    return Surface(Color(color.mean).times(average_sheen(roughness)), gloss=gloss)


def _read_subsurface(reader: ColorReader, port: Port) -> Surface:
    reader.note(_NO_SUBSURFACE)
    _note_normal(reader, port)
    return Surface(read_input_color(reader, port, "Color", GREY), gloss=PAINT)


def _read_bending(reader: ColorReader, port: Port, mirror_rgb: Rgb, fresnel: bool) -> GlassNumbers:
    """Of a surface that is all glass."""
    ior = reader.read_number(port.sibling("IOR"), 1.5)
    return GlassNumbers(1.0, mirror_rgb, fresnel, _scatters_often(port), _read_roughness(reader, port), ior)


def _read_gloss(reader: ColorReader, port: Port, metallic: float, transmission: float) -> GlossNumbers:
    """Of a Principled BSDF. Its Specular IOR Level scales what the layer reflects straight on, as Cycles has it.

    So does its Specular Tint, here by the mean of its channels. Of a metal it is the tint at the edge.
    """
    level = max(reader.read_number(port.sibling("Specular IOR Level"), 0.5), 0.0)
    ior = max(reader.read_number(port.sibling("IOR"), 1.5), 1.0)
    straight_on = min(2.0 * level * ((ior - 1.0) / (ior + 1.0)) ** 2, 0.98)
    root = math.sqrt(straight_on)
    layer = (1.0 - metallic) * (1.0 - transmission) if straight_on > 0.0 else 0.0
    diffuse = (1.0 - metallic) * (1.0 - transmission)
    numbers = GlossNumbers(metallic, layer, _read_roughness(reader, port), (1.0 + root) / (1.0 - root), diffuse)
    tint = _clip(read_input_color(reader, port, "Specular Tint").mean)
    return replace(numbers, layer_tint=sum(tint) / 3.0, metal_edge_rgb=tint, multiscatter=_scatters_often(port))


def _read_lobes(
    reader: ColorReader, port: Port, metallic: Color, others: tuple[Color, Color], has_layer: bool, name: str = "Roughness"
) -> Color | None:
    """As of a Surface. What is rough in one place and not in another matters of metals and glass: a layer reflects little.

    others   shares of the surface that are there, and that are glass where it is not metal
    """
    if metallic.mean[0] <= 0.0 and others[1].mean[0] <= 0.0:
        return None
    rough = reader.read_factor(port.sibling(name), 0.5)
    if rough.image < 0 and metallic.image < 0:
        return None

    def join(rough: FloatArray, metal: FloatArray, seen: FloatArray, glass: FloatArray) -> FloatArray:
        metal, seen = np.clip(metal[..., 0], 0.0, 1.0), np.clip(seen[..., 0], 0.0, 1.0)
        layer = (1.0 - metal) * (1.0 - np.clip(glass[..., 0], 0.0, 1.0)) * has_layer
        return np.stack(np.broadcast_arrays(rough[..., 0], metal * seen, layer * seen), axis=-1)

    return reader.derive(port, join, [rough, metallic, *others], "lobes")


def _read_share(reader: ColorReader, port: Port, name: str, default: float) -> float:
    """The mean of a number from 0 to 1."""
    return min(max(reader.read_number(port.sibling(name), default), 0.0), 1.0)


def _clip(rgb: Rgb) -> Rgb:
    red, green, blue = (min(max(channel, 0.0), 1.0) for channel in rgb)
    return red, green, blue


def _read_roughness(reader: ColorReader, port: Port) -> float:
    """The mean, without a note: a layer reflects a twentieth of the light, and metals and glass have _read_lobes."""
    noted = len(reader.replaced)
    roughness = _read_share(reader, port, "Roughness", 0.5)
    del reader.replaced[noted:]
    return roughness


def _scatters_often(port: Port) -> bool:
    """Whether light is scattered several times by rough facets: by the distribution "Multiscatter GGX" alone, the default since 4.0."""
    return getattr(port.node, "distribution", "") == "MULTI_GGX"


def _read_glossy(reader: ColorReader, port: Port) -> Surface:
    """A Glossy BSDF reflects its colour at all angles."""
    _note_lobe(reader, port)
    _note_normal(reader, port, is_mirror=True)
    color = read_input_color(reader, port, "Color")
    gloss = GlossNumbers(1.0, 0.0, _read_roughness(reader, port), diffuse=0.0, multiscatter=_scatters_often(port), metal_flat=True)
    return Surface(color, metal=color, gloss=gloss, lobes=_read_lobes(reader, port, Color(WHITE), (Color(WHITE), _NOTHING), False))


def _read_metallic(reader: ColorReader, port: Port) -> Surface:
    """A Metallic BSDF: its colour straight on and a tint at the edge, or what a conductor's indices of refraction make of both."""
    _note_lobe(reader, port)
    _note_normal(reader, port, is_mirror=True)
    if getattr(port.node, "fresnel_type", "F82") == "PHYSICAL_CONDUCTOR":
        ior, extinction = (read_input_color(reader, port, name).mean for name in ("IOR", "Extinction"))
        straight_on, at_edge = (reflect_conductor(cosine, np.array(ior), np.array(extinction)) for cosine in (1.0, EDGE_COSINE))
        color, edge = Color(to_rgb(straight_on)), _clip(to_rgb(at_edge / reflect_schlick(EDGE_COSINE, straight_on)))
    else:
        color, edge = read_input_color(reader, port, "Base Color"), _clip(read_input_color(reader, port, "Edge Tint").mean)
    often = _scatters_often(port)
    gloss = GlossNumbers(1.0, 0.0, _read_roughness(reader, port), diffuse=0.0, metal_edge_rgb=edge, multiscatter=often)
    return Surface(color, metal=color, gloss=gloss, lobes=_read_lobes(reader, port, Color(WHITE), (Color(WHITE), _NOTHING), False))


def _read_diffuse(reader: ColorReader, port: Port) -> Surface:
    _note_normal(reader, port)
    return Surface(_roughen(reader, port, read_input_color(reader, port, "Color", GREY), "Roughness"), gloss=PAINT)


def _roughen(reader: ColorReader, port: Port, color: Color, name: str) -> Color:
    """What a diffuse surface of a colour reflects, as rough as an input of a port's node says."""
    roughness = reader.read_factor(port.sibling(name), 0.0)
    if max(roughness.mean) <= 0.0:
        return color
    reader.note(_EVEN_ROUGH)
    return reader.derive(port, dim_rough, [color, roughness], "rough")


def _read_translucent(reader: ColorReader, port: Port) -> Surface:
    _note_normal(reader, port)
    color = read_input_color(reader, port, "Color", GREY)
    return Surface(color, through=color)


def _read_emission(reader: ColorReader, port: Port) -> Surface:
    return Surface(emission=_read_radiance(reader, port, "Color", "Strength", 1.0))


def _read_radiance(reader: ColorReader, port: Port, color: str, strength: str, default: float) -> Color:
    factor = reader.read_factor(port.sibling(strength), default)
    if max(factor.mean) <= 0.0:
        return _NOTHING
    radiance = read_input_color(reader, port, color)
    return radiance.times(factor.rgb) if factor.image < 0 else reader.derive(port, np.multiply, [radiance, factor], "radiance")


def _leave_out(reader: ColorReader, port: Port, albedo: Color, fraction: Color, what: str) -> Color:
    """What of an albedo is left where a fraction of the surface is something else."""
    if fraction.image < 0:
        return albedo.times(1.0 - fraction.rgb[0])
    return reader.derive(port, lambda color, part: color * (1.0 - np.clip(part, 0.0, 1.0)), [albedo, fraction], what)


def _read_mix(reader: ColorReader, port: Port) -> Surface:
    first, second = _read_two(reader, port)
    factor = port.sibling("Fac") or port.sibling("Factor")
    layered = None if factor is None else _read_layer(reader, factor, first, second)
    if layered is not None:
        return layered
    part = reader.read_factor(factor, 0.5)
    fraction = min(max(part.mean[0], 0.0), 1.0)
    linked = factor is not None and not factor.is_value
    if linked and part.image < 0 and 0.0 < fraction < 1.0 and not depends_on_view(factor):
        reader.note("two shaders are mixed evenly over the surface")
    return Surface(
        **{name: reader.blend(port, getattr(first, name), getattr(second, name), part, name) for name in _COLORS},
        gloss=first.gloss.times(1.0 - fraction).add(second.gloss.times(fraction)),
        lobes=_join_lobes(reader, port, first, second, part),
        bending=first.bending.times(1.0 - fraction).add(second.bending.times(fraction)),
    )


def _read_layer(reader: ColorReader, factor: Port, below: Surface, above: Surface) -> Surface | None:
    """A glossy shader mixed over a diffuse one by Fresnel's equations, which is a dielectric layer; None for any other mix.

    The layer has the mean of the glossy colour's channels. What that takes from its reflection, the light below does not get.
    """
    name = "IOR" if factor.node.type == "FRESNEL" else "Blend"
    source = factor.sibling(name)
    if not (shows_view(factor) and factor.socket.name != "Facing") or reader.view is not None or source is None or not source.is_value:
        return None
    gloss = below.gloss
    is_paint = not any(
        (gloss.metal, gloss.layer, gloss.coat, *gloss.sheen_rgb, *below.passing.mean, *below.glass.mean, *below.emission.mean)
    )
    is_gloss = above.gloss.metal_flat and above.albedo == above.metal and above.albedo.image < 0 and above.lobes is None
    if not (is_paint and is_gloss) or gloss.diffuse < 1.0 or any(above.passing.mean):
        return None
    number = reader.read_number(source, 1.5)
    ior = max(number if name == "IOR" else 1.0 / max(1.0 - number, _LEAST), 1.0)
    share, mean = sum(_clip(above.albedo.rgb)) / 3.0, average_fresnel(ior)
    other = above.gloss
    layer = replace(gloss, layer=share, roughness=other.roughness, ior=ior, multiscatter=other.multiscatter, layer_tint=1.0)
    return replace(below, albedo=below.albedo.times((1.0 - mean) / (1.0 - share * mean)), gloss=layer)


def _read_add(reader: ColorReader, port: Port) -> Surface:
    first, second = _read_two(reader, port)
    return Surface(
        **{name: reader.add(port, getattr(first, name), getattr(second, name), name) for name in _COLORS},
        gloss=first.gloss.add(second.gloss),
        lobes=_join_lobes(reader, port, first, second, None),
        bending=first.bending.add(second.bending),
    )


def _join_lobes(reader: ColorReader, port: Port, first: Surface, second: Surface, part: Color | None) -> Color | None:
    """Of two shaders mixed by a part, or added where that is None; as rough as the stronger one, as of GlossNumbers."""
    varies = first.lobes is not None or second.lobes is not None
    if not (varies or (part is not None and part.image >= 0 and first.gloss.metal + second.gloss.metal > 0.0)):
        return None
    glass, other_glass = first.bending.share, second.bending.share

    def join(one: FloatArray, two: FloatArray, part: FloatArray, rest: FloatArray) -> FloatArray:
        part, rest = np.clip(part[..., :1], 0.0, 1.0), np.clip(rest[..., :1], 0.0, 1.0)
        here, there = rest * one[..., 1:], part * two[..., 1:]
        is_first = here.sum(axis=-1) + rest[..., 0] * glass >= there.sum(axis=-1) + part[..., 0] * other_glass
        rough = np.where(is_first, one[..., 0], two[..., 0])
        return np.concatenate([rough[..., None], here + there], axis=-1)

    both = [one.lobes or Color((_find_roughness(one), one.gloss.metal, one.gloss.layer)) for one in (first, second)]
    parts = [Color(WHITE), Color(WHITE)] if part is None else [part, _complement(reader, port, part, "rest")]
    return reader.derive(port, join, [*both, *parts], "lobes")


def _find_roughness(surface: Surface) -> float:
    """Of what reflects or bends the most light."""
    is_glass = surface.bending.share > surface.gloss.metal + surface.gloss.layer
    return surface.bending.roughness if is_glass else surface.gloss.roughness


def _read_transparent(reader: ColorReader, port: Port) -> Surface:
    return Surface(passing=read_input_color(reader, port, "Color"))


def _read_portal(reader: ColorReader, port: Port) -> Surface:
    """Light goes straight on where nothing says whereto."""
    if any(not port.sibling(name).is_value for name in ("Position", "Direction")):
        reader.note(f"{port.node.name} is taken as transparent: light does not come out elsewhere")
    return Surface(passing=read_input_color(reader, port, "Color"))


def _read_holdout(reader: ColorReader, port: Port) -> Surface:
    """It reflects nothing and stops all light."""
    return Surface()


def _read_glass(reader: ColorReader, port: Port) -> Surface:
    _note_lobe(reader, port)
    color = read_input_color(reader, port, "Color")
    return Surface(glass=color, bending=_read_bending(reader, port, _clip(color.mean), True), lobes=_read_glass_lobes(reader, port))


def _read_refraction(reader: ColorReader, port: Port) -> Surface:
    """It reflects nothing, not even totally."""
    bending = _read_bending(reader, port, BLACK, False)
    return Surface(glass=read_input_color(reader, port, "Color"), bending=bending, lobes=_read_glass_lobes(reader, port))


def _read_glass_lobes(reader: ColorReader, port: Port) -> Color | None:
    return _read_lobes(reader, port, _NOTHING, (Color(WHITE), Color(WHITE)), False)


def _read_other(reader: ColorReader, port: Port) -> Surface:
    """A shader unknown to us as a diffuse one of its colour."""
    reader.note(f"{port.node.name} is baked as diffuse")
    name = next((name for name in ("Color", "Base Color") if name in port.node.inputs), "")
    return Surface(read_input_color(reader, port, name, GREY) if name else Color(GREY), gloss=PAINT)


def _read_two(reader: ColorReader, port: Port) -> tuple[Surface, Surface]:
    sources = [find_source(Port(socket, port.groups)) for socket in port.node.inputs if socket.type == "SHADER"]
    first, second = (Surface() if source.is_value else read_shader(reader, source) for source in sources[:2])
    return first, second


def _fraction(reader: ColorReader, port: Port, name: str, default: float = 0.0) -> Color:
    """A number from 0 to 1, or an image of it."""
    found = reader.read_factor(port.sibling(name), default)
    return found if found.image >= 0 else Color((min(max(found.rgb[0], 0.0), 1.0),) * 3)


def _scale(reader: ColorReader, port: Port, color: Color, fraction: Color, what: str) -> Color:
    """A fraction of a color."""
    if fraction.image < 0:
        return color.times(fraction.rgb)
    return color if max(color.mean) <= 0.0 else reader.derive(port, np.multiply, [color, fraction], what)


def _complement(reader: ColorReader, port: Port, fraction: Color, what: str) -> Color:
    """What is left of 1."""
    return _leave_out(reader, port, Color(WHITE), fraction, what)


def _note_lobe(reader: ColorReader, port: Port) -> None:
    """Note what changes the direction or the colour of reflections and is not read."""
    for name in ("Anisotropic", "Anisotropy"):
        if reader.read_number(port.sibling(name), 0.0) != 0.0:
            reader.note("its reflections are baked as round (no Anisotropic)")
    if reader.read_number(port.sibling("Thin Film Thickness"), 0.0) > 0.0:
        reader.note("its thin film is left out")


def _note_normal(reader: ColorReader, port: Port, is_mirror: bool = False) -> None:
    normal = port.sibling("Normal")
    if normal is not None and not normal.is_value and not reader.read_normal(normal, is_mirror):
        reader.note("its normal or bump map is left out")


_SHADERS: dict[str, Callable[[ColorReader, Port], Surface]] = {
    "BSDF_PRINCIPLED": _read_principled,
    "BSDF_DIFFUSE": _read_diffuse,
    "BSDF_TRANSLUCENT": _read_translucent,
    "BSDF_SHEEN": _read_sheen,
    "SUBSURFACE_SCATTERING": _read_subsurface,
    "EMISSION": _read_emission,
    "BACKGROUND": _read_emission,
    "MIX_SHADER": _read_mix,
    "ADD_SHADER": _read_add,
    "BSDF_TRANSPARENT": _read_transparent,
    "BSDF_GLOSSY": _read_glossy,
    "BSDF_ANISOTROPIC": _read_glossy,
    "BSDF_METALLIC": _read_metallic,
    "BSDF_GLASS": _read_glass,
    "HOLDOUT": _read_holdout,
    "BSDF_RAY_PORTAL": _read_portal,
    "BSDF_REFRACTION": _read_refraction,
}
