"""Nodes that show from where a surface is seen: Fresnel, Layer Weight, and Geometry's Backfacing.

A view is the signed cosine between the direction to the viewer and the normal: negative from behind.
Source: Blender, intern/cycles/kernel/svm/fresnel.h; Fresnel's equations for dielectrics, Born & Wolf, "Principles of optics", section 1.5.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.scene import ggx
from .color_nodes import gives_colors
from .node_colors import Color
from .node_formulas import Array
from .node_ports import Port, walk_sources

if TYPE_CHECKING:
    from .colors_read import ColorReader

_BY_ANGLE = ("FRESNEL", "LAYER_WEIGHT")
_CONSTANTS = ("RGB", "VALUE", "GROUP", "GROUP_INPUT", "GROUP_OUTPUT", "REROUTE", "FRAME", "NEW_GEOMETRY")
_LEAST = 1e-5  # as in Cycles
# Where light that leaves a diffuse surface goes: the cosines of equal shares of a cosine-weighted hemisphere.
HEMISPHERE = np.sqrt((np.arange(32) + 0.5) / 32).tolist()


def shows_view(port: Port) -> bool:
    """Whether an output itself differs by view."""
    return port.node.type in _BY_ANGLE or (port.node.type == "NEW_GEOMETRY" and port.socket.name == "Backfacing")


def depends_on_view(port: Port) -> bool:
    """Whether an output may differ by view."""
    return any(
        node.type in _BY_ANGLE or (node.type == "NEW_GEOMETRY" and node.outputs["Backfacing"].is_linked) for node in walk_sources(port)
    )


def is_even(port: Port) -> bool:
    """Whether an output is alike all over the surface, as far as its nodes are known to be."""
    nodes = list(walk_sources(port))
    others = {name for node in nodes if node.type == "NEW_GEOMETRY" for name, output in node.outputs.items() if output.is_linked}
    return others <= {"Backfacing"} and all(node.type in _BY_ANGLE + _CONSTANTS or gives_colors(node) for node in nodes)


def read_view(reader: ColorReader, port: Port, view: float) -> Color:
    """What an output that differs by view gives at one."""
    cosine, is_back = min(abs(view), 1.0), view < 0.0
    if port.node.type == "NEW_GEOMETRY":
        return Color((float(is_back),) * 3)
    if port.node.type == "FRESNEL":

        def fresnel(ior: Array) -> Array:
            return _reflect(cosine, np.maximum(ior, _LEAST), is_back)

        return reader.derive(port, fresnel, [reader.read_factor(port.sibling("IOR"), 1.5)], f"{view}")
    facing = port.socket.name == "Facing"

    def weigh(blend: Array) -> Array:
        if not facing:
            return _reflect(cosine, 1.0 / np.maximum(1.0 - blend, _LEAST), is_back)
        blend = np.clip(blend, 0.0, 1.0 - _LEAST)
        power = np.where(blend < 0.5, 2.0 * blend, 0.5 / (1.0 - blend))
        return 1.0 - np.asarray(cosine) ** power

    return reader.derive(port, weigh, [reader.read_factor(port.sibling("Blend"), 0.5)], f"{view}")


def _reflect(cosine: float, ior: Array, is_back: bool) -> Array:
    """Share that a dielectric reflects of light that meets it at a cosine, from behind from within it."""
    eta = np.asarray(1.0 / ior if is_back else ior, np.float64)
    share: Any = ggx.reflectance(np.full(eta.size, cosine), eta.ravel())[0]
    return np.asarray(share).reshape(eta.shape)
