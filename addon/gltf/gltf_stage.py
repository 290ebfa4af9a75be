"""A scene of copies for the glTF exporter: the user's objects, meshes and materials are only read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.util.file_names import clean_name, make_unique
from ..read.baked_copies import SOURCE, place_copy
from ..read.export_pieces import Piece, walk_pieces
from ..read.render_levels import evaluate_for_render
from ..read.tags import NAME, find_original
from ..read.uv_layer import MAX_LAYERS, layer_name, read_place
from ..show.materials_write import BAKE, Sentences
from ..show.node_groups import remove_unused_groups
from . import gltf_materials, gltf_textures
from .gltf_colors import GltfColors, has_gaps

# What holds an attribute's numbers, and how many each has.
_FLOATS = {"FLOAT": ("value", 1), "FLOAT2": ("vector", 2), "FLOAT_VECTOR": ("vector", 3), "FLOAT_COLOR": ("color", 4)}


class Stage:
    """What was copied, and under what names it belongs into the file.

    names    kind in glTF -> name here -> name wanted
    ranges   name here of a material with a lightmap -> linear value of the lightmap's brightest byte
    """

    def __init__(self, scene: bpy.types.Scene, folder: Path, view_transform: str) -> None:
        self.scene = bpy.data.scenes.new(NAME)
        self.names: dict[str, dict[str, str]] = {"nodes": {}, "meshes": {}, "materials": {}, "scenes": {self.scene.name: scene.name}}
        self.ranges: dict[str, float] = {}
        self.warnings: Sentences = []
        self._source, self._folder, self._view_transform = scene, folder, view_transform
        self._made: list[Any] = []
        self._bare: list[tuple[Any, bpy.types.Mesh, list[Any]]] = []
        self._materials: dict[tuple[Any, ...], bpy.types.Material] = {}
        self._textures: dict[tuple[Any, bool], tuple[bpy.types.Image, float]] = {}
        self._colors = GltfColors(folder)
        self._plain: dict[Any, bpy.types.Material | None] = {}
        self._group: bpy.types.NodeTree | None = None

    def add(self, piece: Piece) -> None:
        """A copy of an evaluated mesh, still without its materials; holds beyond the iteration."""
        original, mesh = piece.evaluated.original, bpy.data.meshes.new_from_object(piece.evaluated)
        obj = bpy.data.objects.new(NAME, mesh)
        self._made += [mesh, obj]
        if not np.isfinite(piece.matrix).all():
            self.warnings.append((original.name, f"{original.name}: its place or size is no number, so it is not in the .glb; mend it."))
            return
        place_copy(obj, Matrix(piece.matrix.tolist()))
        if _clear_numbers(mesh):
            self.warnings.append((original.name, f"{original.name}: has values that are no numbers, which are 0 in the .glb; mend them."))
        self.scene.collection.objects.link(obj)
        names = [original.name, original.data.name]
        if SOURCE in original:
            names = ["".join(name.rpartition(f".{NAME}")[::2]) for name in names]  # of several instances each has a number behind it
        self.names["nodes"][obj.name], self.names["meshes"][mesh.name] = names
        slots = [find_original(slot.material.original) if slot.material else None for slot in piece.evaluated.material_slots]
        self._bare.append((original, mesh, slots))

    def dress(self) -> None:
        """Give every copy the materials that show its bake, or those of its own.

        Raises ValueError or OSError with a sentence when a texture cannot be made.
        """
        for original, mesh, slots in self._bare:
            bake = original.get(BAKE)
            worn = [self._wear_plain(slot) for slot in slots] if bake is None else self._show_bake(mesh, original, bake, slots or [None])
            for index, material in enumerate(worn):
                if index < len(mesh.materials):
                    mesh.materials[index] = material
                else:
                    mesh.materials.append(material)
        self.warnings += dict.fromkeys(self._colors.warnings)

    def close(self) -> None:
        """Delete all copies."""
        bpy.data.scenes.remove(self.scene)
        bpy.data.batch_remove([*self._made, *self._colors.made])
        remove_unused_groups()

    def _show_bake(self, mesh: bpy.types.Mesh, original: Any, bake: Any, slots: list[Any]) -> list[Any]:
        """The slots with materials that show the bake; gives them as they are, with a warning, where it cannot be shown."""
        image, layer = bake.get("image"), bake["uv_layer"] or layer_name(original.data)
        if image is None or layer not in mesh.uv_layers:
            self.warnings.append((original.name, f"{original.name}: its baked image or UV layer was deleted; bake it again."))
            return slots
        lit = bake["mode"] == "lighting"
        _order_layers(mesh, layer, lit, read_place(original))
        return [self._material(slot, image, layer, lit) for slot in slots]

    def _material(self, original: bpy.types.Material | None, image: bpy.types.Image, layer: str, lit: bool) -> bpy.types.Material:
        key = (original, image, layer, lit)
        if key not in self._materials:
            texture, value_range = self._texture(image, lit)
            if lit and self._group is None:
                self._group = gltf_materials.make_group()
                self._made.append(self._group)
            if lit:
                made = gltf_materials.make_lightmapped(original, texture, layer, self._group, self._colors)
                self.ranges[made.name] = value_range
            else:
                made = gltf_materials.make_unlit(original, texture, layer)
                if original is not None and has_gaps(original):
                    why = "its gaps are closed in the .glb, whose unlit colour is the baked image; bake the pass lighting to keep them"
                    self.warnings.append((original.name, f"{original.name}: {why}."))
            self._made.append(made)
            self._materials[key] = made
            self._name(made, original)
        return self._materials[key]

    def _wear_plain(self, original: bpy.types.Material | None) -> bpy.types.Material | None:
        """What shows a material where nothing is baked."""
        if original not in self._plain:
            made = self._plain[original] = gltf_materials.make_plain(original, self._colors)
            if made != original:
                self._made.append(made)
                self._name(made, original)
        return self._plain[original]

    def _name(self, made: Any, original: bpy.types.Material | None) -> None:
        name, taken = original.name if original else NAME, self.names["materials"].values()
        self.names["materials"][made.name] = make_unique([*taken, name])[-1]  # a material on two pages is two in the file

    def _texture(self, image: bpy.types.Image, lit: bool) -> tuple[bpy.types.Image, float]:
        key = (image, lit)
        if key not in self._textures:
            folder = self._folder / str(len(self._textures))
            folder.mkdir()
            path = folder / f"{clean_name(image.name)}.png"
            if self._view_transform == "scene" and not lit:
                self._textures[key] = gltf_textures.write_view(image, path, self._source), 1.0
            else:
                self._textures[key] = gltf_textures.write_texture(image, path, own_range=lit)
            self._made.append(self._textures[key][0])
        return self._textures[key]


def _clear_numbers(mesh: bpy.types.Mesh) -> bool:
    """Sets to 0 what is no finite number, which no glTF file may hold; gives whether there was any."""
    found = False
    for attribute in mesh.attributes:
        name, width = _FLOATS.get(attribute.data_type, ("", 0))
        if not name:
            continue
        values = np.empty(width * len(attribute.data), np.float32)
        attribute.data.foreach_get(name, values)
        odd = ~np.isfinite(values)
        if odd.any():
            values[odd] = 0.0
            attribute.data.foreach_set(name, values)
            found = True
    if found:
        mesh.update()
    return found


@contextmanager
def open_stage(context: bpy.types.Context, folder: Path, view_transform: str) -> Iterator[Stage]:
    """A stage with everything that the scene renders; it is the window's scene meanwhile.

    folder   for textures
    Raises ValueError or OSError with a sentence when a texture cannot be made.
    """
    stage = Stage(context.scene, folder, view_transform)
    window, scene, view_layer = context.window, context.scene, context.view_layer
    try:
        ignored: Sentences = []  # the export of the bake has told them
        with evaluate_for_render(scene, view_layer, ignored) as depsgraph:
            for piece in walk_pieces(view_layer, depsgraph):
                if piece.is_mesh and len(piece.evaluated.data.polygons):
                    stage.add(piece)
        stage.dress()
        window.scene = stage.scene  # the exporter takes its scene from there
        yield stage
    finally:
        window.scene = scene
        window.view_layer = view_layer
        stage.close()


def _order_layers(mesh: bpy.types.Mesh, ours: str, lit: bool, place: NDArray[np.float64]) -> None:
    """TEXCOORD_0 is the baked layer alone where it is all one sees; else the layer that materials use, and the baked one is TEXCOORD_1.

    Where materials use the baked layer too, there is a copy of it.

    place   (4,) float64, pages: of the object in the baked layer (see uv_layer.read_place), which a viewer knows nothing of
    """
    layers = mesh.uv_layers
    coordinates = {}
    for layer in layers:
        coordinates[layer.name] = np.empty(2 * len(mesh.loops), np.float32)
        layer.uv.foreach_get("vector", coordinates[layer.name])
    used = next((layer.name for layer in layers if layer.active_render), ours)
    order = [(ours, ours)]
    if lit:
        first = (f"{ours} copy", ours) if used == ours else (used, used)
        order = [first, *order, *((name, name) for name in coordinates if name not in (ours, used))][:MAX_LAYERS]
    for name in coordinates:
        layers.remove(layers[name])
    coordinates[ours] = (coordinates[ours].reshape(-1, 2) * place[:2] + place[2:]).astype(np.float32).ravel()
    for name, source in order:
        layers.new(name=name, do_init=False).uv.foreach_set("vector", coordinates[source])
    layers[0].active_render = True
