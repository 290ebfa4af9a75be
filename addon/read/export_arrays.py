"""The arrays of one piece with its materials and textures, and all pieces' arrays in one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.scene.scene import TEXTURE_UVS
from ...core.util.arrays import FloatArray, IntArray
from ..nodes.color_attributes import ColorLayer, Faces
from ..nodes.mesh_arrays import LocalMesh, WorldMesh
from ..nodes.polygon_atlas import BakedLayer
from ..nodes.tangent_normals import lay_tangents
from ..nodes.texture_mapping import GENERATED, OBJECT, UV, WORLD, UvMapping
from .export_mesh import PlacedMesh
from .export_pieces import CURVE, OWN, STRANDS, Piece
from .materials_read import MaterialReading, MaterialTable
from .render_levels import Warnings
from .steps import Pause, Steps
from .tags import find_original


@dataclass(frozen=True)
class PieceArrays:
    """One piece's part of the snapshot's arrays; is_clear tells that none of its faces has anything to show of light."""

    world: WorldMesh
    tri_material: NDArray[np.int32]
    tri_uv: NDArray[np.float64]
    texture_uv: dict[str, NDArray[np.float32]]  # (n_tri, 3, 2) each, by the names of TEXTURE_UVS
    is_clear: bool
    tri_tangents: NDArray[np.float32] | None = None  # None where no material has a normal map in tangent space

    @property
    def n_tri(self) -> int:
        return len(self.tri_material)


@dataclass(frozen=True)
class WornPiece:
    """All that Blender knows of a piece: the rest is computed of this.

    name           of its source
    slot_material  (n_slot,) int32, which of the table's materials each of its slots is
    generated      (n_vertex, 3) float64: what a texture's Generated coordinates are, None where no texture shows them
    """

    name: str
    placed: PlacedMesh
    slot_material: NDArray[np.int32]
    is_strands: bool
    generated: FloatArray | None


def read_piece(piece: Piece, local: LocalMesh, materials: MaterialTable, receives: bool = True) -> WornPiece:
    """A piece with the materials of its slots, which are read."""
    placed = PlacedMesh(local, piece.matrix)
    slots = [materials.override] if materials.override else list_materials(piece.evaluated)
    used = np.flatnonzero(np.bincount(np.clip(local.polygon_slot, 0, len(slots) - 1), minlength=len(slots)))  # as Cycles does
    worn = piece.source, piece.evaluated, piece.kind not in (OWN, CURVE, STRANDS)
    slot_material = np.zeros(len(slots), np.int32)
    for slot in used.tolist():
        faces = Faces(
            piece.source.name, local, placed, slot, len(slots), *worn, piece.matrix, receives, piece.random, piece.maker, piece.number
        )
        slot_material[slot] = materials.index(slots[slot], faces)
    is_strands = piece.kind == STRANDS
    readings = [materials.readings[index] for index in slot_material[used]]
    shows = not is_strands and any(_is_generated(mapping) for reading in readings for _, mapping in _list_mappings(reading))
    generated = _read_generated(piece, local) if shows else None
    return WornPiece(piece.source.name, placed, slot_material, is_strands, generated)


def arrange_piece(worn: WornPiece, materials: MaterialTable, uv_layer: str | None, warnings: Warnings) -> Steps[PieceArrays]:
    """A piece's part of the snapshot; `uv_layer` fills tri_uv, None leaves it zero."""
    local, world = worn.placed.local, (yield from worn.placed.steps())
    n_tri = len(world.tri_slot)
    tri_material = worn.slot_material[np.clip(world.tri_slot, 0, len(worn.slot_material) - 1)]
    texture_uv = {name: np.zeros((n_tri, 3, 2), np.float32) for name in TEXTURE_UVS}
    clear, tangents, laid = [], None, {}
    for index in _list_used(tri_material):
        reading = materials.readings[index]
        clear.append(reading.is_clear)
        here = corner = None
        for name, mapping in _list_mappings(reading):
            if corner is None:
                here = tri_material == index
                corner = world.tri_corner[here]
            texture_uv[name][here] = _texture_uv(worn, corner, mapping, materials, warnings)
            yield Pause.FREE
        if reading.material.normal_strength is not None:
            layer = reading.tangent_layer
            if layer not in laid:
                laid[layer] = lay_tangents(local, local.layers[layer], world, worn.placed.matrix)
            tangents = np.zeros_like(laid[layer]) if tangents is None else tangents
            tangents[here] = laid[layer][here]
            yield Pause.FREE
    tri_uv = np.zeros((n_tri, 3, 2)) if uv_layer is None else np.nan_to_num(local.layers[uv_layer][world.tri_corner])
    return PieceArrays(world, tri_material, tri_uv, texture_uv, bool(clear) and all(clear), tangents)


def _list_used(tri_material: NDArray[np.int32]) -> list[int]:
    return [] if not len(tri_material) else np.flatnonzero(np.bincount(tri_material)).tolist()


def _list_mappings(reading: MaterialReading) -> list[tuple[str, UvMapping | ColorLayer | BakedLayer]]:
    """The texture coordinates that a material needs, by the names of TEXTURE_UVS, and how they are mapped."""
    return [
        (name, getattr(reading, images[0].replace("_image", "_mapping")))
        for name, images in TEXTURE_UVS.items()
        if max(getattr(reading.material, image) for image in images) >= 0
    ]


def list_materials(evaluated: Any) -> list[Any]:
    """The user's material of each slot, though it shows a bake; None for an empty one; at least one."""
    found = list(evaluated.data.materials)
    for index, slot in enumerate(evaluated.material_slots):
        if slot.link == "OBJECT" and index < len(found):
            found[index] = slot.material
    return [material and find_original(material.original) for material in found] or [None]


def join_arrays(pieces: Sequence[PieceArrays]) -> Steps[dict[str, NDArray[Any]]]:
    """The arrays of a SceneSnapshot by name; object i is pieces[i]."""
    first_vertex = np.cumsum([0, *(len(piece.world.vertex_position) for piece in pieces)])
    tri_object: IntArray = np.repeat(np.arange(len(pieces), dtype=np.int32), [piece.n_tri for piece in pieces])
    shifted = [piece.world.tri_vertex + np.int32(first) for piece, first in zip(pieces, first_vertex[:-1], strict=True)]
    joined: dict[str, NDArray[Any]] = {"tri_vertex": np.concatenate(shifted), "tri_object": tri_object}
    for name in ("vertex_position", "tri_polygon", "tri_corner", "tri_normal"):
        joined[name] = np.concatenate([getattr(piece.world, name) for piece in pieces])
        yield Pause.FREE
    for name in ("tri_material", "tri_uv"):
        joined[name] = np.concatenate([getattr(piece, name) for piece in pieces])
        yield Pause.FREE
    for name in TEXTURE_UVS:
        joined[name] = np.concatenate([piece.texture_uv[name] for piece in pieces])
        yield Pause.FREE
    if any(piece.tri_tangents is not None for piece in pieces):
        none = np.zeros((1, 3, 3, 3), np.float32)
        shapes = [(piece.n_tri, 3, 3, 3) for piece in pieces]
        of_pieces = [none if piece.tri_tangents is None else piece.tri_tangents for piece in pieces]
        joined["tri_tangents"] = np.concatenate([np.broadcast_to(one, shape) for one, shape in zip(of_pieces, shapes, strict=True)])
        yield Pause.FREE
    return joined


def _texture_uv(
    worn: WornPiece,
    corner: IntArray,
    mapping: UvMapping | ColorLayer | BakedLayer,
    materials: MaterialTable,
    warnings: Warnings,
) -> NDArray[np.float32]:
    """Texture coordinates of triangles' corners; without the layer the texture's origin, as in Cycles."""
    local = worn.placed.local
    if isinstance(mapping, ColorLayer):
        return materials.colors.place(local, mapping, corner)
    if isinstance(mapping, BakedLayer):
        return materials.baker.find_corners(mapping)[corner].astype(np.float32)
    if mapping.space != UV:
        coordinates = _find_positions(worn, mapping.space)[local.corner_vertex[corner]]
    elif (layer := local.layers.get(mapping.layer or local.render_layer)) is not None:
        coordinates = layer[corner]
    else:
        what = f"UV layer {mapping.layer}" if mapping.layer else "UV layer"
        warnings.append(
            (
                worn.name,
                f"has no {what}, so its texture shows one colour everywhere; unwrap it, or choose another layer in the material",
            )
        )
        coordinates = np.zeros((*corner.shape, 2))
    normal = _find_normals(local, corner, worn.placed.matrix) if mapping.box else None
    return np.nan_to_num(mapping.apply(coordinates, normal)).astype(np.float32)


def _is_generated(mapping: UvMapping | ColorLayer | BakedLayer) -> bool:
    return isinstance(mapping, UvMapping) and mapping.space == GENERATED


def _find_positions(worn: WornPiece, space: str) -> FloatArray:
    """(n_vertex, 3) float64: what a texture's mapping counts as the place of each vertex."""
    local, matrix = worn.placed.local, worn.placed.matrix
    if space == OBJECT or worn.is_strands:
        return local.position
    if space == WORLD:
        return local.position @ matrix[:3, :3].T + matrix[:3, 3]
    assert worn.generated is not None
    return worn.generated


def _read_generated(piece: Piece, local: LocalMesh) -> FloatArray:
    mesh, own = piece.evaluated.data, piece.evaluated.original.data
    if hasattr(own, "vertices") and len(own.vertices) == len(local.position):
        mesh = own  # as it is before modifiers move it
    place = np.empty(local.position.shape, np.float32)
    mesh.vertices.foreach_get("undeformed_co", place.reshape(-1))
    low = np.array(mesh.texspace_location) - np.array(mesh.texspace_size)
    size = 2.0 * np.array(mesh.texspace_size)
    return np.where(size > 0.0, (place - low) / np.where(size > 0.0, size, 1.0), 0.5)


def _find_normals(local: LocalMesh, corner: IntArray, matrix: FloatArray) -> FloatArray:
    """(n, 3) float64: of triangles in the object's space, not unit; a mirroring matrix has turned the order of their corners."""
    one, two, three = np.moveaxis(local.position[local.corner_vertex[corner]], 1, 0)
    return np.cross(two - one, three - one) * (-1.0 if np.linalg.det(matrix[:3, :3]) < 0.0 else 1.0)
