"""Mix nodes of colours and numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .color_attributes import ColorLayer
from .node_colors import WHITE, Color, add_rgb, multiply_rgb, to_rgb
from .node_formulas import BLEND, Array, lerp
from .node_ports import Port, describe

if TYPE_CHECKING:
    from .colors_read import ColorReader


def read_mix(reader: ColorReader, port: Port) -> Color:
    node = port.node
    kind = {"RGBA": "Color", "FLOAT": "Float"}.get(node.data_type) if node.type == "MIX" else "Color"
    if kind is None:
        return reader.read_unknown(port)
    names = ("Factor_Float", f"A_{kind}", f"B_{kind}") if node.type == "MIX" else ("Fac", "Color1", "Color2")
    read = reader.read_color if kind == "Color" else reader.read_factor
    fraction = reader.read_factor(port.sibling(names[0]), 0.5)
    first, second = read(port.sibling(names[1]), WHITE), read(port.sibling(names[2]), WHITE)
    blend_type, clamps, clamps_result = _read_options(node)
    layers = {color.mapping for color in (first, second, fraction) if color.image >= 0}
    if len(layers) > 1 and any(isinstance(layer, ColorLayer) for layer in layers):
        if fraction.image >= 0:
            reader.approximate(f"the factor of {describe(node)} is replaced by its mean")
        return _mix_painted(reader, port, first, second, min(max(fraction.mean[0], 0.0), 1.0))
    if fraction.image < 0 and not clamps_result and blend_type in ("MIX", "MULTIPLY"):
        part = min(max(fraction.rgb[0], 0.0), 1.0) if clamps else fraction.rgb[0]
        if blend_type == "MIX" and 0.0 <= part <= 1.0:
            return reader.mix(port, first, second, part)
        if blend_type == "MULTIPLY" and second.image < 0:
            return first.times(to_rgb(lerp(np.ones(3), np.array(second.rgb), part)))
        if blend_type == "MULTIPLY" and first.image < 0 and part == 1.0:
            return second.times(first.rgb)
    operation = BLEND[blend_type]

    def formula(a: Array, b: Array, t: Array) -> Array:
        made = operation(a, b, np.clip(t, 0.0, 1.0) if clamps else t)
        return np.clip(made, 0.0, 1.0) if clamps_result else made

    return reader.derive(port, formula, [first, second, fraction])


def _read_options(node: Any) -> tuple[str, bool, bool]:
    """The blend type, and whether the factor and the result are clamped."""
    if node.type != "MIX":
        return node.blend_type, True, node.use_clamp
    return ("MIX", node.clamp_factor, False) if node.data_type == "FLOAT" else (node.blend_type, node.clamp_factor, node.clamp_result)


def _mix_painted(reader: ColorReader, port: Port, first: Color, second: Color, fraction: float) -> Color:
    """A mix of vertex colours, which are no texture that others lie on."""
    node = port.node
    if node.blend_type == "MIX":
        return reader.mix(port, first, second, fraction)
    if node.blend_type == "ADD":
        return reader.add(port, first, second.times(fraction))
    if node.blend_type != "MULTIPLY":
        reader.approximate(f"blend mode {node.blend_type.replace('_', ' ').lower()} of {describe(node)} is left out")
        return first if fraction < 1.0 or first.image >= 0 else second
    if second.image >= 0 and isinstance(first.mapping, ColorLayer) and fraction >= 1.0:
        first, second = second, first  # a texture tells more
    if second.image >= 0 and (first.image >= 0 or fraction < 1.0):
        vertex = isinstance(second.mapping, ColorLayer)
        reader.approximate("its vertex colours are baked as their mean" if vertex else "a product of textures takes one by its mean")
        second = Color(second.mean)
    if second.image >= 0:
        return second.times(first.rgb)
    return first.times(add_rgb(multiply_rgb(second.rgb, (fraction,) * 3), (1.0 - fraction,) * 3))
