"""A checker of texels over the objects that would be baked, as arrays to draw."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..app.request import list_objects
from ..app.scene_meter import read_corners, walk_meshes
from ..read.object_settings import read_choice
from ..read.uv_layer import layer_name, read_place
from ..show.materials_write import BAKE


@dataclass(frozen=True)
class CheckerArrays:
    """Corners of triangles, three for each.

    position   (n, 3) float32, m
    texel      (n, 2) float32   texel coordinates; where charts are not made yet, in each face's own plane
    ratio      (n,) float32     texels per metre relative to what is wanted
    """

    position: NDArray[np.float32]
    texel: NDArray[np.float32]
    ratio: NDArray[np.float32]


class CheckerMaker:
    """Makes the checker of all objects that would be baked, a little at a time: Blender must stay smooth.

    density   the wanted one, texels/m
    factor    by the name of an object that will have another density than the wanted one: that, relative to it
    """

    def __init__(self, density: float, factor: Mapping[str, float]) -> None:
        self._density, self._factor = density, factor
        self._parts: dict[int, CheckerArrays] = {}  # by session_uid: an undo meanwhile makes references invalid

    def work(self, context: bpy.types.Context, seconds: float = math.inf) -> CheckerArrays | None:
        """Go on for so long at most; gives the checker once it is whole."""
        until = time.monotonic() + seconds
        depsgraph, objects = context.evaluated_depsgraph_get(), list_objects(context)
        for obj in objects:
            if obj.session_uid not in self._parts:
                if time.monotonic() > until:
                    return None
                self._parts[obj.session_uid] = _make_part(context, obj, depsgraph, self._density, self._factor.get(obj.name, 1.0))
        parts = [self._parts[obj.session_uid] for obj in objects] or [_join([])]
        return CheckerArrays(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("position", "texel", "ratio")))


def _make_part(
    context: bpy.types.Context, obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, density: float, times: float
) -> CheckerArrays:
    chosen, factor = context.scene.leaflight, read_choice(obj).density_factor * times
    layer, side = _find_layer(obj, chosen.uv_layer, chosen.size)
    found = []
    for mesh, matrix in walk_meshes(obj, depsgraph):
        corner, uv = read_corners(mesh, matrix), _read_uv(mesh, layer)
        texel = project_faces(corner, density * factor) if uv is None else uv * side
        found.append((corner, texel, compare_density(corner, texel, density)))
    return _join(found)


def _join(found: list[tuple[NDArray[np.float64], ...]]) -> CheckerArrays:
    if not found:
        return CheckerArrays(*(np.zeros(shape, np.float32) for shape in ((0, 3), (0, 2), 0)))
    corner, texel, ratio = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    finite = np.isfinite(corner).all(axis=(1, 2)) & np.isfinite(texel).all(axis=(1, 2))
    flat = (corner[finite].reshape(-1, 3), texel[finite].reshape(-1, 2), np.repeat(ratio[finite], 3))
    return CheckerArrays(*(np.ascontiguousarray(array, np.float32) for array in flat))


def project_faces(corner: NDArray[np.float64], density: float) -> NDArray[np.float64]:
    """(n, 3, 2) float64, texels: corners in the plane of their face, by one frame for all faces that lie alike.

    corner   (n, 3, 3) float64, m
    """
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        upright = np.abs(normal[:, 2:]) < 0.999
        along = np.cross(np.where(upright, (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), normal)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        frame = np.stack([along, np.cross(normal, along)], axis=1)
        projected: NDArray[np.float64] = np.einsum("nij,nkj->nki", frame, np.nan_to_num(corner)) * density
    return projected


def compare_density(corner: NDArray[np.float64], texel: NDArray[np.float64], density: float) -> NDArray[np.float64]:
    """(n,) float64: texels per metre on each triangle, relative to `density`; 1 where it has no area."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
        first, second = texel[:, 1] - texel[:, 0], texel[:, 2] - texel[:, 0]
        texels = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        ratio = np.sqrt(texels / area) / density
    return np.where(np.isfinite(ratio), ratio, 1.0)


def _find_layer(obj: bpy.types.Object, wanted: str, size: int) -> tuple[str, NDArray[np.float64]]:
    """The UV layer that holds the object's texels, "" before there is one, and how many lie along its sides, (2,) float64."""
    if obj.type != "MESH":
        return "", np.zeros(2)
    if wanted and wanted in obj.data.uv_layers:
        return wanted, np.full(2, float(size))
    image: Any = obj[BAKE].get("image") if BAKE in obj else None
    return (layer_name(obj.data), image.size[0] * read_place(obj)[:2]) if image else ("", np.zeros(2))


def _read_uv(mesh: bpy.types.Mesh, layer: str) -> NDArray[np.float64] | None:
    """(n_tri, 3, 2) float64, [0, 1]; None without the layer."""
    if not layer or layer not in mesh.uv_layers:
        return None
    loop = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("loops", loop.reshape(-1))
    uv = np.empty((len(mesh.loops), 2), np.float32)
    mesh.uv_layers[layer].uv.foreach_get("vector", uv.reshape(-1))
    return uv[loop].astype(np.float64)
