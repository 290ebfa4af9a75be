"""Pixels of 8 bit image files without Blender: decoded in parallel, and only as finely as a page can show."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias
from weakref import WeakSet

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.output.image_file import can_open, read_bytes, srgb_to_linear
from .node_ports import Port, find_surface, list_shaders, uses_nodes
from .srgb_filtering import measure_between

Bytes: TypeAlias = NDArray[np.uint8]

_KINDS = (".png", ".jpg", ".jpeg")
_SPACES = {"sRGB": True, "Non-Color": False, "Linear Rec.709": False}  # whether bytes are encoded
_COLORS = {"Base Color", "Color", "Emission Color", "Emission Strength", "Strength", "Alpha", "Fac", "Factor", "Metallic"}
_MAGIC = {".png": b"\x89PNG\r\n\x1a\n", ".jpg": b"\xff\xd8\xff"}  # what files begin with
_BAND_NUMBERS = 1 << 17  # what is converted at once stays in the cache
_SUM_ROWS = 64  # of float32 that are added before they become float64
_MOST_THREADS = 8
_LINEAR = srgb_to_linear(np.arange(256, dtype=np.float32) / np.float32(255))
_PLAIN = np.arange(256, dtype=np.float32) / np.float32(255)


@dataclass(frozen=True)
class ImagePixels:
    """An image as the renderer sees it.

    pixels   (height, width, 3) float32, linear Rec.709, row 0 at the bottom
    alpha    (height, width) float32, None where it is 1 everywhere
    mean     RGBA over the image
    note     what of it was replaced, "" nothing
    is_encoded   it is of sRGB bytes, which Cycles interpolates as they are
    between_rgb   the mean light that Cycles has between the pixels, relative to that of the pixels
    is_associated   colours are multiplied by alpha
    grid     the UDIM tiles that lie in it: the first one's column and row, then how many columns and rows
    """

    pixels: NDArray[np.float32]
    alpha: NDArray[np.float32] | None
    mean: tuple[float, float, float, float]
    note: str = ""
    grid: tuple[int, int, int, int] = (0, 0, 1, 1)
    is_encoded: bool = False
    between_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    is_associated: bool = False

    @classmethod
    def of(cls, color: NDArray[np.float32], alpha: NDArray[np.float32] | None, note: str = "") -> ImagePixels:
        """With the mean, which is added up by whole rows: sums over three numbers are slow."""
        height, width = color.shape[:2]
        rows = color.reshape(height, -1)
        total = np.zeros(3 * width)
        for low in range(0, height, _SUM_ROWS):
            total += rows[low : low + _SUM_ROWS].sum(axis=0)
        red, green, blue = (float(x) for x in total.reshape(width, 3).sum(axis=0) / (height * width))
        return cls(color, alpha, (red, green, blue, 1.0 if alpha is None else float(alpha.mean(dtype=np.float64))), note)

    @classmethod
    def of_bytes(cls, stored: Bytes, encoded: bool, has_alpha: bool, most_texels: int, note: str = "") -> ImagePixels:
        """Of values (h, w, 1, 3 or 4) of 8 bits, which are sRGB where `encoded`."""
        made = cls.of(*convert_bytes(stored, encoded, has_alpha, most_texels), note)
        return replace(made, is_encoded=True, between_rgb=measure_between(stored)) if encoded else made


class ImageFiles:
    """Image files, packed or not, read ahead by threads.

    most_texels   on a side, that they are reduced to
    """

    def __init__(self, most_texels: int) -> None:
        self._most = most_texels
        self._asked: dict[int, tuple[str | bytes, bool, bool]] = {}  # by the image, as read_file wants it
        self._begun: dict[int, Future[ImagePixels | None]] = {}
        self._pools: list[ThreadPoolExecutor] = []
        _EVERY.add(self)

    def begin(self, materials: Iterable[Any]) -> None:
        """Begin to read the images that colour materials."""
        asked = {}
        for image in list_images(materials):
            source = find_source(image)
            if source and image.session_uid not in self._begun:
                asked[image.session_uid] = source, *_find_meaning(image)
        if asked and can_open():
            self._asked |= asked
            self._submit(list(asked))

    def _submit(self, images: list[int]) -> None:
        pool = ThreadPoolExecutor(min(len(images), os.cpu_count() or 1, _MOST_THREADS))
        self._begun |= {image: pool.submit(read_file, *self._asked[image], self._most) for image in images}
        pool.shutdown(wait=False)
        self._pools.append(pool)

    def pause(self) -> None:
        """End all threads, once each has read what it is at."""
        for pool in self._pools:
            pool.shutdown(cancel_futures=True)
        self._pools.clear()

    def go_on(self) -> None:
        """Read what `pause` left."""
        left = [image for image, begun in self._begun.items() if begun.cancelled()]
        if left:
            self._submit(left)

    @property
    def is_reading(self) -> bool:
        """Whether threads are at work yet."""
        return not all(begun.done() for begun in self._begun.values())

    def take(self, image: Any) -> ImagePixels | None:
        """The pixels of an image; None where Blender must read it."""
        begun = self._begun.pop(image.session_uid, None)
        self._asked.pop(image.session_uid, None)
        if begun is not None:
            return begun.result()
        source = find_source(image)
        return read_file(source, *_find_meaning(image), self._most) if source and can_open() else None

    def close(self) -> None:
        """Nobody asks for the rest."""
        for begun in self._begun.values():
            begun.cancel()
        self._begun.clear()


_EVERY: WeakSet[ImageFiles] = WeakSet()


@contextmanager
def no_threads() -> Iterator[None]:
    """No images are read meanwhile: Blender crashes now and then where Python's threads run while Cycles bakes.

    In a file with image textures and a glowing checker 5 of 150 exports crashed.
    """
    for files in _EVERY:
        files.pause()
    try:
        yield
    finally:
        for files in _EVERY:
            files.go_on()


def find_source(image: Any) -> str | bytes:
    """The path of an image's file, or the file itself where it is packed; "" where only Blender has its pixels, or would change them.

    A file is read even where Blender has its pixels, as Cycles does: copies of those take longer, and hold everything else up.
    """
    if image.source != "FILE" or image.is_dirty or image.colorspace_settings.name not in _SPACES or image.alpha_mode == "PREMUL":
        return ""
    if image.packed_file:
        data: bytes = image.packed_file.data
        return data if any(data.startswith(magic) for magic in _MAGIC.values()) else ""
    path = bpy.path.abspath(image.filepath, library=image.library)
    return path if path.lower().endswith(_KINDS) and os.path.isfile(path) else ""


def _find_meaning(image: Any) -> tuple[bool, bool]:
    """Whether its bytes are sRGB, and whether it has alpha."""
    return _SPACES[image.colorspace_settings.name], image.alpha_mode != "NONE"


def read_file(source: str | bytes, encoded: bool, has_alpha: bool, most_texels: int) -> ImagePixels | None:
    """The pixels of an image file; None where it is not one of 8 bit colours or greys.

    source       its path, or all of its bytes
    encoded      its bytes are sRGB
    most_texels  on a side, that it is reduced to by averages of linear light
    """
    if isinstance(source, str):
        stored = read_bytes(source)
    else:
        kind = next(kind for kind, magic in _MAGIC.items() if source.startswith(magic))
        with tempfile.TemporaryDirectory() as folder:  # OpenImageIO's Python reads nothing else than files
            path = Path(folder, f"packed{kind}")
            path.write_bytes(source)
            stored = read_bytes(str(path))
    return None if stored is None else ImagePixels.of_bytes(stored, encoded, has_alpha, most_texels)


def convert_bytes(
    stored: Bytes, encoded: bool, has_alpha: bool, most_texels: int
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Linear colour (h, w, 3) and alpha (h, w), None where it is 1, of bytes (h, w, 1, 3 or 4), row 0 at the bottom."""
    table, channels = _LINEAR if encoded else _PLAIN, stored.shape[2]
    color = reduce_bytes(stored, table, most_texels)  # with alpha, which is quicker than to leave it out
    color = np.repeat(color, 3, axis=2) if channels < 3 else np.ascontiguousarray(color[..., :3])
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
    many = np.full((out.shape[1], 1), wide, np.float32)
    many[-1] = width - wide * (len(many) - 1)
    pairs = np.add.outer(table, table).ravel() if tall % 2 == 0 else None
    step = max(_BAND_NUMBERS // (width * channels * tall), 1) * tall
    for low in range(0, height, step):
        band, first = stored[low : low + step].reshape(-1, width * channels), low // tall
        rows = -(-len(band) // tall)
        if wide == tall == 1:
            table.take(band, out=out[first : first + rows].reshape(rows, -1), mode="clip")
            continue
        if pairs is not None and len(band) % tall == 0:  # one look for the sum of two rows
            two = band.reshape(-1, 2, band.shape[1])
            place = two[:, 0].astype(np.uint16)
            place <<= 8
            place |= two[:, 1]
            total = _add_every(pairs.take(place, mode="clip"), tall // 2)
        else:
            total = _add_every(table.take(band, mode="clip"), tall)
            if len(band) % tall:
                total[-1] *= tall / (len(band) % tall)
        _add_columns(total, wide, out[first : first + rows])
        out[first : first + rows] /= tall * many
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


def _add_columns(values: NDArray[np.float32], wide: int, out: NDArray[np.float32]) -> None:
    """Sums of so many texels that follow each other in a row, of fewer at its end.

    values   (h, w c)
    out      (h, w', c), to be written
    """
    height, _, channels = out.shape
    whole = values.shape[1] // (wide * channels)
    if whole:
        length = ((whole - 1) * wide + 1) * channels
        total = values[:, :length].copy()  # from every texel on: whole rows are quicker to add than every other texel
        for other in range(1, wide):
            total += values[:, other * channels : other * channels + length]
        texel = np.dtype((np.void, 4 * channels))
        out.reshape(height, -1).view(texel)[:, :whole] = total.view(texel)[:, ::wide]
    if whole < out.shape[1]:
        out[:, -1] = values[:, whole * wide * channels :].reshape(height, -1, channels).sum(axis=1)


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
