"""Nodes that make a colour or a number of others, by their formulas; what of them is a texture stays one."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from .ies_profile import UNKNOWN, find_mean
from .mix_nodes import read_mix
from .node_colors import WHITE, Color, to_rgb
from .node_formulas import MATH, Array, find_blackbody, from_hsv, lerp, shift_hsv, to_grey, to_hsv
from .node_ports import Port, describe

if TYPE_CHECKING:
    from .colors_read import ColorReader

TABLE_SIZE = 257  # of ramps and curves, as in Cycles
_BY_COMPONENT = ("ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "MULTIPLY_ADD", "MINIMUM", "MAXIMUM", "FLOOR", "CEIL", "MODULO", "ABSOLUTE")
_CHANNELS = {"Green": 1, "G": 1, "Blue": 2, "B": 2}  # by an output's identifier; red is 0


def read_function(reader: ColorReader, port: Port) -> Color | None:
    """What an output gives of its node's inputs; None for a node that is not known."""
    function = _FUNCTIONS.get(port.node.type)
    return function(reader, port) if function else None


def gives_colors(node: Any) -> bool:
    """Whether a node's formula is known."""
    return node.type in _FUNCTIONS


def _color(reader: ColorReader, port: Port, name: str) -> Color:
    return reader.read_color(port.sibling(name), WHITE)


def _number(reader: ColorReader, port: Port, name: str, default: float = 1.0) -> Color:
    return reader.read_factor(port.sibling(name), default)


def _fraction(reader: ColorReader, port: Port) -> Color:
    return _number(reader, port, "Fac" if "Fac" in {socket.identifier for socket in port.node.inputs} else "Factor")


def _read_hue(reader: ColorReader, port: Port) -> Color:
    numbers = [_number(reader, port, name) for name in ("Hue", "Saturation", "Value")]
    return reader.derive(port, shift_hsv, [_color(reader, port, "Color"), *numbers, _fraction(reader, port)])


def _read_gamma(reader: ColorReader, port: Port) -> Color:
    def formula(color: Array, gamma: Array) -> Array:
        return np.where(color > 0.0, np.power(np.maximum(color, 1e-30), gamma), color)

    return reader.derive(port, formula, [_color(reader, port, "Color"), _number(reader, port, "Gamma")])


def _read_invert(reader: ColorReader, port: Port) -> Color:
    return reader.derive(port, lambda color, t: lerp(color, 1.0 - color, t), [_color(reader, port, "Color"), _fraction(reader, port)])


def _read_contrast(reader: ColorReader, port: Port) -> Color:
    def formula(color: Array, bright: Array, contrast: Array) -> Array:
        return np.maximum((1.0 + contrast) * color + bright - contrast / 2.0, 0.0)

    numbers = [_number(reader, port, name, 0.0) for name in ("Bright", "Contrast")]
    return reader.derive(port, formula, [_color(reader, port, "Color"), *numbers])


def _read_grey(reader: ColorReader, port: Port) -> Color:
    return reader.derive(port, to_grey, [_color(reader, port, "Color")])


def _read_curves(reader: ColorReader, port: Port) -> Color:
    mapping = port.node.mapping
    mapping.initialize()
    low, high = float(mapping.clip_min_x), float(mapping.clip_max_x)
    low, high = (low, high) if mapping.use_clip and low < high else (0.0, 1.0)
    place = np.linspace(low, high, TABLE_SIZE)
    shared = [mapping.evaluate(mapping.curves[3], x) for x in place]
    table = np.array([[mapping.evaluate(curve, x) for x in shared] for curve in mapping.curves[:3]])

    def formula(color: Array, fraction: Array) -> Array:
        curved = np.stack([np.interp(color[..., i], place, table[i]) for i in range(3)], axis=-1)
        return lerp(color, curved, fraction)

    return reader.derive(port, formula, [_color(reader, port, "Color"), _fraction(reader, port)])


def _read_float_curve(reader: ColorReader, port: Port) -> Color:
    mapping = port.node.mapping
    mapping.initialize()
    place = np.linspace(0.0, 1.0, TABLE_SIZE)
    table = np.array([mapping.evaluate(mapping.curves[0], x) for x in place])

    def formula(value: Array, fraction: Array) -> Array:
        return lerp(value, np.interp(value, place, table), fraction)

    return reader.derive(port, formula, [_number(reader, port, "Value"), _number(reader, port, "Factor")])


def _read_ramp(reader: ColorReader, port: Port) -> Color:
    """A ramp over what is known; of a procedural texture the mean of the ramp."""
    ramp, source = port.node.color_ramp, port.sibling("Fac")
    known = source is None or source.is_value or gives_colors(source.node) or reader.reads(source)
    channels = slice(3, 4) if port.socket.name == "Alpha" else slice(0, 3)
    table = np.array([np.broadcast_to(ramp.evaluate(i / (TABLE_SIZE - 1))[channels], 3) for i in range(TABLE_SIZE)])
    if not known:
        reader.approximate(f"{describe(port.node)} is replaced by its mean")
        return Color(to_rgb(table.mean(axis=0)))
    fraction = reader.read_factor(source, 0.5)
    if fraction.image < 0:
        return Color(to_rgb(np.broadcast_to(ramp.evaluate(fraction.rgb[0])[channels], 3)))
    stepped = ramp.color_mode == "RGB" and ramp.interpolation == "CONSTANT"

    def formula(factor: Array) -> Array:
        at = np.clip(factor[..., 0], 0.0, 1.0) * (TABLE_SIZE - 1)
        low = at.astype(np.int64)
        return table[low] if stepped else lerp(table[low], table[np.minimum(low + 1, TABLE_SIZE - 1)], (at - low)[..., None])

    return reader.derive(port, formula, [fraction])


def _read_separate(reader: ColorReader, port: Port) -> Color:
    mode = getattr(port.node, "mode", "RGB")
    channel = _CHANNELS.get(port.socket.identifier, 0)
    if mode == "HSL":
        reader.approximate(f"{describe(port.node)} is approximated")

    def formula(color: Array) -> Array:
        return np.repeat((to_hsv(color) if mode == "HSV" else color)[..., channel, None], 3, axis=-1)

    return reader.derive(port, formula, [_color(reader, port, "Color")])


def _read_combine(reader: ColorReader, port: Port) -> Color:
    mode = getattr(port.node, "mode", "RGB")
    if mode == "HSL":
        reader.approximate(f"{describe(port.node)} is approximated")

    def formula(red: Array, green: Array, blue: Array) -> Array:
        joined = np.stack(np.broadcast_arrays(red[..., 0], green[..., 0], blue[..., 0]), axis=-1)
        return from_hsv(joined) if mode == "HSV" else joined

    return reader.derive(port, formula, [_number(reader, port, name, 0.0) for name in ("Red", "Green", "Blue")])


def _read_math(reader: ColorReader, port: Port) -> Color:
    node = port.node
    values = [reader.read_factor(port.sibling(socket.identifier), 0.0) for socket in node.inputs if socket.enabled]
    operation = MATH.get(node.operation)
    if operation is None:
        reader.approximate(f"{describe(node)} is left out")
        return values[0]
    clamps = node.use_clamp

    def formula(*numbers: Array) -> Array:
        made = operation(*numbers)
        return np.clip(made, 0.0, 1.0) if clamps else made

    return reader.derive(port, formula, values)


def _read_vector_math(reader: ColorReader, port: Port) -> Color:
    """Of operations that work component by component."""
    node = port.node
    if node.operation == "SCALE":
        return reader.derive(port, np.multiply, [_color(reader, port, "Vector"), _number(reader, port, "Scale")])
    operation = MATH.get(node.operation) if node.operation in _BY_COMPONENT else None
    if operation is None:
        return reader.read_unknown(port)
    return reader.derive(port, operation, [reader.read_color(port.sibling(one.identifier), WHITE) for one in node.inputs if one.enabled])


def _read_range(reader: ColorReader, port: Port) -> Color:
    node = port.node
    if node.data_type != "FLOAT":
        return reader.read_unknown(port)
    if node.interpolation_type not in ("LINEAR", "SMOOTHSTEP"):
        reader.approximate(f"{describe(node)} is taken as linear")
    smooth, clamps = node.interpolation_type == "SMOOTHSTEP", node.clamp

    def formula(value: Array, low: Array, high: Array, to_low: Array, to_high: Array) -> Array:
        part = np.where(high != low, (value - low) / np.where(high != low, high - low, 1.0), 0.0)
        if smooth:
            part = np.clip(part, 0.0, 1.0)
            part = (3.0 - 2.0 * part) * part * part
        made = to_low + part * (to_high - to_low)
        return np.clip(made, np.minimum(to_low, to_high), np.maximum(to_low, to_high)) if clamps else made

    return reader.derive(port, formula, [_number(reader, port, name) for name in ("Value", "From Min", "From Max", "To Min", "To Max")])


def _read_clamp(reader: ColorReader, port: Port) -> Color:
    ordered = port.node.clamp_type == "RANGE"

    def formula(value: Array, low: Array, high: Array) -> Array:
        bounds = (np.minimum(low, high), np.maximum(low, high)) if ordered else (low, high)
        return np.minimum(np.maximum(value, bounds[0]), bounds[1])

    return reader.derive(port, formula, [_number(reader, port, name) for name in ("Value", "Min", "Max")])


def _read_blackbody(reader: ColorReader, port: Port) -> Color:
    return Color(find_blackbody(reader.read_number(port.sibling("Temperature"), 6500.0)))


def _read_falloff(reader: ColorReader, port: Port) -> Color:
    """Light falls off with the square of the distance, whichever output is taken."""
    if port.socket.name != "Quadratic" or reader.read_number(port.sibling("Smooth"), 0.0) != 0.0:
        reader.note(f"{describe(port.node)} is taken as a quadratic falloff")
    return _number(reader, port, "Strength")


def _read_ies(reader: ColorReader, port: Port) -> Color:
    """As much light as the profile has, in all directions alike."""
    mean = find_mean(port.node)
    told = "is taken as even in all directions" if mean is not None else "has no IES file of type C that can be read"
    reader.note(f"{describe(port.node)} {told}")
    return _number(reader, port, "Strength").times(UNKNOWN if mean is None else mean)


_FUNCTIONS: dict[str, Callable[[ColorReader, Port], Color]] = {
    "HUE_SAT": _read_hue,
    "GAMMA": _read_gamma,
    "INVERT": _read_invert,
    "BRIGHTCONTRAST": _read_contrast,
    "RGBTOBW": _read_grey,
    "CURVE_RGB": _read_curves,
    "CURVE_FLOAT": _read_float_curve,
    "VALTORGB": _read_ramp,
    "SEPARATE_COLOR": _read_separate,
    "SEPRGB": _read_separate,
    "COMBINE_COLOR": _read_combine,
    "COMBRGB": _read_combine,
    "MATH": _read_math,
    "VECT_MATH": _read_vector_math,
    "MIX": read_mix,
    "MIX_RGB": read_mix,
    "MAP_RANGE": _read_range,
    "CLAMP": _read_clamp,
    "BLACKBODY": _read_blackbody,
    "LIGHT_FALLOFF": _read_falloff,
    "TEX_IES": _read_ies,
}
