"""Colour attributes of meshes, as one texture in which each triangle has texels of its own."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...core.scene.scene import TextureImage
from ...core.util.arrays import FloatArray, IntArray
from .images_read import ImageTable
from .mesh_arrays import LocalMesh, WorldMesh

IMAGE_NAME = "vertex colours"
_RANDOM_LEVELS = 64
BLOCKS_PER_ROW = 2048  # of 2 x 2 texels
_CORNER_TEXEL = np.array([(0.5, 0.5), (1.5, 0.5), (0.5, 1.5)])  # where a block has the colours of a triangle's corners, in texels


@dataclass(frozen=True)
class ColorLayer:
    """A colour attribute ("" the one active for render), and what a node gives of it: Color, Fac or Alpha.

    formula   what other nodes make of that, (..., 3) to (..., 3); key tells it from others
    """

    name: str
    output: str = "Color"
    key: Hashable = None
    formula: Callable[[FloatArray], FloatArray] | None = field(default=None, compare=False)

    def find(self, local: LocalMesh) -> NDArray[np.float32] | None:
        """(n_corner, 3) float32, linear; None where the mesh has no such colours."""
        rgba = local.colors.get(self.name)
        if rgba is None:
            return None
        rgb = rgba[:, :3]
        if self.output == "Alpha":
            rgb = np.repeat(rgba[:, 3:], 3, axis=1)
        elif self.output == "Fac":
            rgb = np.repeat(rgba[:, :1] if self.name in local.short else rgb.mean(axis=1, keepdims=True), 3, axis=1)
        if self.formula is None:
            return rgb
        with np.errstate(all="ignore"):
            return np.nan_to_num(self.formula(rgb), posinf=0.0, neginf=0.0).astype(np.float32)


class Placed(Protocol):
    """A mesh at its place, which is only computed where it is asked for."""

    @property
    def world(self) -> WorldMesh: ...


@dataclass(frozen=True)
class Faces:
    """The triangles of an object that wear a material.

    name         the object's
    placed       gives its triangles in the world
    slot         which of its n_slot material slots they have; faces of a higher number have the last
    source       the object, or the one that makes an instance of what is shown
    shown        evaluated object
    matrix       (4, 4) float, object to world; None is the identity
    receives     whether they get a lightmap
    random       [0, 1], what an Object Info node calls Random
    maker        evaluated object that makes the instance, None of what is none; number tells which of its instances it is
    """

    name: str
    local: LocalMesh
    placed: Placed
    slot: int
    n_slot: int
    source: Any
    shown: Any
    is_instance: bool
    matrix: Any = None
    receives: bool = True
    random: float = 0.0
    maker: Any = None
    number: int = 0

    @property
    def random_level(self) -> float:
        """One of few values near `random`: each makes a material of its own, and there may be instances by the thousand."""
        return (min(int(self.random * _RANDOM_LEVELS), _RANDOM_LEVELS - 1) + 0.5) / _RANDOM_LEVELS

    @property
    def world(self) -> WorldMesh:
        """All triangles of the object."""
        return self.placed.world

    @property
    def tri(self) -> NDArray[np.bool_]:
        """(n_tri,) which of those of the world mesh these are."""
        found: NDArray[np.bool_] = np.clip(self.world.tri_slot, 0, self.n_slot - 1) == self.slot
        return found

    def find_range(self, layer: ColorLayer) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """The least, mean by area, and greatest of a layer's colours, (3,) each; None where the mesh has no such colours."""
        rgb = layer.find(self.local)
        if rgb is None:
            return None
        corner = self.world.vertex_position[self.world.tri_vertex[self.tri]]
        with np.errstate(over="ignore", invalid="ignore"):
            area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
        if not (np.isfinite(area).all() and area.any()):
            area = np.ones(len(area))
        tri_rgb = rgb[self.world.tri_corner[self.tri]].astype(np.float64)
        return tri_rgb.min(axis=(0, 1)), area @ tri_rgb.mean(axis=1) / area.sum(), tri_rgb.max(axis=(0, 1))


class ColorTable:
    """The texels of all triangles that show a colour attribute, in one image: a material needs no more for many meshes.

    A block holds a triangle's corners c0 and c1, above them c2 and c1 + c2 - c0: bilinear interpolation is linear then, as in Cycles.
    """

    def __init__(self, images: ImageTable) -> None:
        self._images = images
        self._index = -1
        self._blocks: list[NDArray[np.float32]] = []
        self._count = 0
        self._first: dict[tuple[Any, ...], int] = {}

    def index(self) -> int:
        """Where the image is in the ImageTable."""
        if self._index < 0:
            self._index = self._images.add(TextureImage(IMAGE_NAME, np.zeros((0, 0, 3), np.float32)))
        return self._index

    def place(self, local: LocalMesh, layer: ColorLayer, corner: IntArray) -> NDArray[np.float32]:
        """(n, 3, 2) float32: where the image has the colours of triangles' corners (n, 3), in texels until `finish`."""
        key = (id(local), layer, hashlib.blake2b(np.ascontiguousarray(corner)).digest())  # of instances, too
        if key not in self._first:
            self._first[key] = self._count
            rgb = layer.find(local)
            assert rgb is not None
            one, two, three = np.moveaxis(rgb[corner], 1, 0)
            self._blocks.append(np.stack([one, two, three, two + three - one], axis=1).reshape(-1, 2, 2, 3))
            self._count += len(corner)
        block = self._first[key] + np.arange(len(corner))
        place = np.stack([block % BLOCKS_PER_ROW, block // BLOCKS_PER_ROW], axis=1)
        return (2 * place[:, None] + _CORNER_TEXEL).astype(np.float32)

    def finish(self, materials_images: dict[str, list[int]], arrays: dict[str, NDArray[Any]]) -> None:
        """Make the image, and texels to texture coordinates in a snapshot's arrays.

        materials_images   of each of these arrays the materials' images
        """
        if not self._count:
            return
        n_column = min(self._count, BLOCKS_PER_ROW)
        n_row = -(-self._count // n_column)
        block = np.concatenate(self._blocks)
        block = np.concatenate([block, np.repeat(block[-1:], n_row * n_column - len(block), axis=0)])  # of one colour, if all are
        pixels = np.ascontiguousarray(block.reshape(n_row, n_column, 2, 2, 3).swapaxes(1, 2).reshape(2 * n_row, 2 * n_column, 3))
        self._images.images[self._index] = TextureImage(IMAGE_NAME, pixels, "EXTEND", per_triangle=True)
        for name, image in materials_images.items():
            rows = np.array(image)[arrays["tri_material"]] == self._index
            arrays[name][rows] /= np.array([2 * n_column, 2 * n_row], np.float32)
