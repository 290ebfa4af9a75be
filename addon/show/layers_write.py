"""The UVs that a bake was laid out with, onto meshes; those of linked duplicates once, with a place for each object."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ..read import baked_copies, uv_layer
from ..read.export_scene import ExportResult
from ..read.steps import Pause, Steps
from . import materials_write
from .layout import Layout

Sentences = list[tuple[str, str]]  # (subject, sentence)


def write_layers(
    export: ExportResult, layout: Layout, objects: list[tuple[int, bpy.types.Object]], tell_copies: bool
) -> Steps[tuple[set[int], Sentences]]:
    """Gives meshes their layer, and which objects' could not be written, and why.

    objects       index in the snapshot, and who carries its lightmap
    tell_copies   say who could not keep the mesh that it shared
    """
    block = layout.object_block
    worn = {i: (int(block[i]), i if block[i] < 0 else -1) for i, _ in objects}
    taken = materials_write.find_worn_meshes()
    shared = {obj: obj.data for _, obj in objects}
    left = baked_copies.part_meshes([(obj, worn[i]) for i, obj in objects], taken)
    warnings = [(obj.name, _describe_copy(obj, shared[obj] in taken)) for obj in left if tell_copies]
    failed: set[int] = set()
    # An export has triangles in the order of objects.
    first_tri = np.searchsorted(export.snapshot.tri_object, np.arange(len(block) + 1, dtype=export.snapshot.tri_object.dtype))
    errors: dict[tuple[bpy.types.Mesh, tuple[int, int]], str] = {}  # "" where the layer is written
    for i, obj in objects:
        key = (obj.data, worn[i])
        if key not in errors:
            try:
                uv_layer.write_layer(obj.data, _corner_uv(export, layout, i, first_tri[i], first_tri[i + 1]))
                errors[key] = ""
            except ValueError as reason:
                errors[key] = str(reason)
        if errors[key]:
            warnings.append((obj.name, errors[key]))
            failed.add(i)
        elif block[i] >= 0:
            uv_layer.write_place(obj, layout.object_place[i])
        yield Pause.HOLD
    return failed, warnings


def _describe_copy(obj: bpy.types.Object, is_taken: bool) -> str:
    why = "its mesh shows another bake" if is_taken else "its shape or size is too unlike the others that share its mesh"
    return f"{obj.name}: {why}, so it shows the bake on a copy of the mesh; Remove gives the mesh back."


def _corner_uv(export: ExportResult, layout: Layout, index: int, first: int, end: int) -> NDArray[np.float32]:
    """(n_corner, 2) float32: UVs of an object, before its place on the page is put to them; 0 where nothing is baked.

    first, end   its triangles in the snapshot
    """
    place = layout.object_place[index]
    rows = first + np.flatnonzero(layout.tri_chart[first:end] >= 0)
    uv = np.zeros((export.objects[index].n_corner, 2), np.float32)
    uv[export.snapshot.tri_corner[rows]] = (layout.tri_uv[rows] - place[2:]) / place[:2]
    return uv
