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
from ..nodes.texture_mapping import OBJECT, UV, WORLD, UvMapping
from .export_mesh import place_mesh
from .export_pieces import CURVE, OWN, STRANDS, Piece
from .materials_read import MaterialTable
from .render_levels import Warnings


@dataclass(frozen=True)
class PieceArrays:
    """One piece's part of the snapshot's arrays; is_clear tells that none of its faces has anything to show of light."""

    world: WorldMesh
    tri_material: NDArray[np.int32]
    tri_uv: NDArray[np.float64]
    texture_uv: dict[str, NDArray[np.float32]]  # (n_tri, 3, 2) each, by the names of TEXTURE_UVS
    is_clear: bool

    @property
    def n_tri(self) -> int:
        return len(self.tri_material)


def read_piece(
    piece: Piece, local: LocalMesh, materials: MaterialTable, uv_layer: str | None, warnings: Warnings, receives: bool = True
) -> PieceArrays:
    """A piece in the world, with the materials of its slots; `uv_layer` fills tri_uv, None leaves it zero."""
    world = place_mesh(local, piece.matrix)
    n_tri = len(world.tri_slot)
    slots = [materials.override] if materials.override else list_materials(piece.evaluated)
    slot = np.clip(world.tri_slot, 0, len(slots) - 1)  # as Cycles does
    used = np.unique(slot)
    slot_material = np.zeros(len(slots), np.int32)
    worn = piece.source, piece.evaluated, piece.kind not in (OWN, CURVE, STRANDS)
    slot_material[used] = [
        materials.index(slots[index], Faces(piece.source.name, local, world, slot == index, *worn, piece.matrix, receives))
        for index in used
    ]
    tri_material = slot_material[slot]
    texture_uv = {name: np.zeros((n_tri, 3, 2), np.float32) for name in TEXTURE_UVS}
    clear = []
    for index in np.unique(tri_material):
        reading = materials.readings[index]
        clear.append(reading.is_clear)
        here = tri_material == index
        corner = world.tri_corner[here]
        for name, images in TEXTURE_UVS.items():
            if max(getattr(reading.material, image) for image in images) >= 0:
                mapping = getattr(reading, images[0].replace("_image", "_mapping"))
                texture_uv[name][here] = _texture_uv(piece, local, corner, mapping, materials, warnings)
    tri_uv = np.zeros((n_tri, 3, 2)) if uv_layer is None else np.nan_to_num(local.layers[uv_layer][world.tri_corner])
    return PieceArrays(world, tri_material, tri_uv, texture_uv, bool(clear) and all(clear))


def list_materials(evaluated: Any) -> list[Any]:
    """The original material of each slot, None for an empty one; at least one."""
    found = list(evaluated.data.materials)
    for index, slot in enumerate(evaluated.material_slots):
        if slot.link == "OBJECT" and index < len(found):
            found[index] = slot.material
    return [material and material.original for material in found] or [None]


def join_arrays(pieces: Sequence[PieceArrays]) -> dict[str, NDArray[Any]]:
    """The arrays of a SceneSnapshot by name; object i is pieces[i]."""
    first_vertex = np.cumsum([0, *(len(piece.world.vertex_position) for piece in pieces)])
    tri_object: IntArray = np.repeat(np.arange(len(pieces), dtype=np.int32), [piece.n_tri for piece in pieces])
    shifted = [piece.world.tri_vertex + np.int32(first) for piece, first in zip(pieces, first_vertex[:-1], strict=True)]
    return {
        "vertex_position": np.concatenate([piece.world.vertex_position for piece in pieces]),
        "tri_vertex": np.concatenate(shifted),
        "tri_object": tri_object,
        "tri_material": np.concatenate([piece.tri_material for piece in pieces]),
        "tri_polygon": np.concatenate([piece.world.tri_polygon for piece in pieces]),
        "tri_corner": np.concatenate([piece.world.tri_corner for piece in pieces]),
        "tri_normal": np.concatenate([piece.world.tri_normal for piece in pieces]),
        "tri_uv": np.concatenate([piece.tri_uv for piece in pieces]),
        **{name: np.concatenate([piece.texture_uv[name] for piece in pieces]) for name in TEXTURE_UVS},
    }


def _texture_uv(
    piece: Piece,
    local: LocalMesh,
    corner: IntArray,
    mapping: UvMapping | ColorLayer | BakedLayer,
    materials: MaterialTable,
    warnings: Warnings,
) -> NDArray[np.float32]:
    """Texture coordinates of triangles' corners; without the layer the texture's origin, as in Cycles."""
    if isinstance(mapping, ColorLayer):
        return materials.colors.place(local, mapping, corner)
    if isinstance(mapping, BakedLayer):
        return materials.baker.find_corners(mapping)[corner].astype(np.float32)
    if mapping.space != UV:
        coordinates = _find_positions(piece, local, mapping.space)[local.corner_vertex[corner]]
    elif (layer := local.layers.get(mapping.layer or local.render_layer)) is not None:
        coordinates = layer[corner]
    else:
        what = f"UV layer {mapping.layer}" if mapping.layer else "UV layer"
        warnings.append(
            (
                piece.source.name,
                f"has no {what}, so its texture shows one colour everywhere; unwrap it, or choose another layer in the material",
            )
        )
        coordinates = np.zeros((*corner.shape, 2))
    normal = _find_normals(local, corner, piece.matrix) if mapping.box else None
    return np.nan_to_num(mapping.apply(coordinates, normal)).astype(np.float32)


def _find_positions(piece: Piece, local: LocalMesh, space: str) -> FloatArray:
    """(n_vertex, 3) float64: what a texture's mapping counts as the place of each vertex."""
    if space == OBJECT or piece.kind == STRANDS:
        return local.position
    if space == WORLD:
        return local.position @ piece.matrix[:3, :3].T + piece.matrix[:3, 3]
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
