"""Pixels of 8 bit image files without Blender: decoded in parallel, and only as finely as a page can show."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeAlias

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.output.image_file import can_open, read_bytes, srgb_to_linear
from .node_ports import Port, find_surface, list_shaders, uses_nodes

Bytes: TypeAlias = NDArray[np.uint8]

_KINDS = (".png", ".jpg", ".jpeg")
_SPACES = {"sRGB": True, "Non-Color": False, "Linear Rec.709": False}  # whether bytes are encoded
_COLORS = {"Base Color", "Color", "Emission Color", "Emission Strength", "Strength", "Alpha", "Fac", "Factor", "Metallic"}
_BAND_TEXELS = 1 << 18  # what is converted at once stays in the cache
_MOST_THREADS = 8
_LINEAR = srgb_to_linear(np.arange(256, dtype=np.float32) / np.float32(255))
_PLAIN = np.arange(256, dtype=np.float32) / np.float32(255)


class ImageFiles:
    """Files of images that Blender has not loaded, read ahead by threads.

    most_texels   on a side, that they are reduced to
    """

    def __init__(self, most_texels: int) -> None:
        self._most = most_texels
        self._begun: dict[int, Future[tuple[NDArray[np.float32], NDArray[np.float32] | None] | None]] = {}

    def begin(self, materials: Iterable[Any]) -> None:
        """Begin to read the images that colour materials."""
        paths = {}
        for image in list_images(materials):
            path = find_file(image)
            if path:
                paths[image.session_uid] = path, _SPACES[image.colorspace_settings.name], image.alpha_mode != "NONE"
        if paths and can_open():
            pool = ThreadPoolExecutor(min(len(paths), os.cpu_count() or 1, _MOST_THREADS))
            self._begun |= {uid: pool.submit(read_file, *asked, self._most) for uid, asked in paths.items() if uid not in self._begun}
            pool.shutdown(wait=False)

    def take(self, image: Any) -> tuple[NDArray[np.float32], NDArray[np.float32] | None] | None:
        """Colour (h, w, 3) and alpha (h, w), None where it is 1, of a linear image; None where Blender must read it."""
        begun = self._begun.pop(image.session_uid, None)
        return begun.result() if begun is not None else None

    def close(self) -> None:
        """Nobody asks for the rest."""
        for begun in self._begun.values():
            begun.cancel()


def find_file(image: Any) -> str:
    """The path of an image that is read from its file as it is; "" where Blender has its pixels, or would change them."""
    plain = image.source == "FILE" and not image.has_data and not image.is_dirty and not image.packed_file
    if not plain or image.colorspace_settings.name not in _SPACES or image.alpha_mode == "PREMUL":
        return ""
    path = bpy.path.abspath(image.filepath, library=image.library)
    return path if path.lower().endswith(_KINDS) and os.path.isfile(path) else ""


def read_file(path: str, encoded: bool, has_alpha: bool, most_texels: int) -> tuple[NDArray[np.float32], NDArray[np.float32] | None] | None:
    """Linear colour (h, w, 3) and alpha (h, w), None where it is 1; None where the file is not one of 8 bit colours or greys.

    encoded      its bytes are sRGB
    most_texels  on a side, that it is reduced to by averages of linear light
    """
    stored = read_bytes(path)
    if stored is None:
        return None
    return convert_bytes(stored, encoded, has_alpha, most_texels)


def convert_bytes(
    stored: Bytes, encoded: bool, has_alpha: bool, most_texels: int
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """As read_file, of bytes (h, w, 1, 3 or 4), row 0 at the bottom."""
    table, channels = _LINEAR if encoded else _PLAIN, stored.shape[2]
    color = reduce_bytes(stored[..., :3] if channels >= 3 else stored[..., :1], table, most_texels)
    if channels < 3:
        color = np.repeat(color, 3, axis=2)
    if channels < 4 or not has_alpha or stored[..., 3].min() == 255:
        return color, None
    return color, reduce_bytes(stored[..., 3:], _PLAIN, most_texels)[..., 0]


def reduce_bytes(stored: Bytes, table: NDArray[np.float32], most_texels: int) -> NDArray[np.float32]:
    """Averages (h', w', c) float32 of whole blocks of values that stand in a table, so that no side is above most_texels.

    The last block may be incomplete; it is the average of what it has.

    stored   (h, w, c) uint8
    """
    height, width, channels = stored.shape
    tall, wide = (max(-(-side // most_texels), 1) for side in (height, width))
    out = np.empty((-(-height // tall), -(-width // wide), channels), np.float32)
    many = np.full(out.shape[1], wide, np.float32)
    many[-1] = width - wide * (len(many) - 1)
    step = max(_BAND_TEXELS // (width * tall), 1) * tall
    for low in range(0, height, step):
        band, first = stored[low : low + step], low // tall
        for channel in range(channels):  # one by one: short rows of three are slow to add
            values = table[band[..., channel]]
            total = _add_every(values, tall)
            if len(values) % tall:
                total[-1] *= tall / (len(values) % tall)
            total = _add_every(total.T, wide).T
            out[first : first + len(total), :, channel] = total / (tall * many)
    return out


def _add_every(values: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """Sums of so many rows that follow each other; of fewer at the end."""
    if count == 1:
        return values
    total = values[::count].copy()
    for other in range(1, count):
        rows = values[other::count]
        total[: len(rows)] += rows
    return total


def list_images(materials: Iterable[Any]) -> list[Any]:
    """The images behind what colours materials; not those of normals and roughness, which nobody reads."""
    found: dict[int, Any] = {}
    for material in materials:
        if material is None or not uses_nodes(material):
            continue
        _, source = find_surface(material)
        for port in list_shaders(source) if source else ():
            for image in _walk(port, _COLORS):
                found.setdefault(image.session_uid, image)
    return list(found.values())


def _walk(port: Port, names: set[str] | None) -> Iterator[Any]:
    waiting, seen = [(port, names)], set()
    while waiting:
        port, names = waiting.pop()
        key = (port.node.name, *(group.name for group in port.groups))
        if key in seen:
            continue
        seen.add(key)
        if port.node.type == "TEX_IMAGE" and port.node.image:
            yield port.node.image
        for socket in port.node.inputs:
            if socket.type != "SHADER" and (names is None or socket.name in names):
                source = port.sibling(socket.identifier)
                if source is not None and not source.is_value:
                    waiting.append((source, None))
