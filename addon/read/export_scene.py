"""A Blender scene -> SceneSnapshot, and what of Blender each of its objects is."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy

from ...core.scene.scene import Light, SceneObject, SceneSnapshot
from ..nodes.images_read import MAX_TEXTURE_SIDE_TEXELS
from ..nodes.mesh_arrays import LocalMesh
from .baked_copies import find_users_mesh
from .export_arrays import PieceArrays, join_arrays, read_piece
from .export_mesh import count_duplicates, read_mesh
from .export_pieces import COLLECTION, CURVE, OWN, STRANDS, Piece, PieceKey, walk_pieces
from .export_receivers import NO_ROOM, Receivers, check_names, describe_nothing, repeats_layer
from .lamp_profile import ProfileTable
from .left_out import warn_left_out
from .lights_read import PendingLight, read_lamp
from .materials_read import MaterialTable
from .object_settings import BAKE, IGNORE, ObjectChoice, read_choice, registered
from .render_levels import Warnings, evaluate_for_render, find_set_objects, find_view_layer
from .strands import read_strands
from .uv_layer import has_room, name_ours
from .world_read import World, read_world


@dataclass(frozen=True)
class ExportedObject:
    """What of Blender an object of the snapshot is; holds no reference into Blender's data, so it outlives undo.

    name         the SceneObject's, unique
    source       name of the object of the scene that it is, or that makes it
    library      file that the source is linked from, "" none
    uid          the source's session_uid
    key, kind    which piece of the source (see export_pieces)
    needs_copy   its lightmap goes on a copy made from the evaluated mesh, whose corners and polygons the snapshot then counts
    reason       why it needs a copy, "" otherwise
    n_corner, n_polygon   of the mesh that is to carry the lightmap, its own or the copy's, to check before writing; where the own mesh
                          carries an existing layer through modifiers, tri_corner and tri_polygon still count the evaluated mesh
    """

    name: str
    source: str
    library: str
    uid: int
    key: PieceKey
    kind: str
    needs_copy: bool
    reason: str
    n_corner: int
    n_polygon: int


@dataclass(frozen=True)
class ExportResult:
    """A snapshot and what is needed to bring a bake of it back.

    objects    one for each of snapshot.objects, in the same order
    warnings   (subject, text)
    """

    snapshot: SceneSnapshot
    objects: tuple[ExportedObject, ...]
    warnings: tuple[tuple[str, str], ...]


def export_scene(
    context_or_scene: Any,
    objects: Sequence[str] | None = None,
    uv_layer: str | None = None,
    view_layer: Any = None,
    until: float = math.inf,
    most_texels: int = MAX_TEXTURE_SIDE_TEXELS,
) -> ExportResult:
    """The snapshot of a scene as a render shows it; nothing of the user's is changed.

    objects      names of those that get a lightmap, None for every mesh
    uv_layer     existing UV layer to use as it is
    view_layer   None for the current one, or the scene's first that renders
    until        time.monotonic() beyond which it is too late to read more
    most_texels  on a side of a texture: more than pages can show need not be read
    Raises ValueError with a sentence where there is nothing to bake.
    """
    scene = getattr(context_or_scene, "scene", context_or_scene)
    view_layer = view_layer or find_view_layer(context_or_scene, scene)
    warnings: Warnings = []
    view_layer.update()  # that of a new scene is empty until then
    warn_left_out(view_layer, warnings)
    with registered():
        check_names(scene, view_layer, objects)
        with evaluate_for_render(scene, view_layer, warnings) as depsgraph:
            export = _Export(view_layer, depsgraph, objects, uv_layer, warnings, until, most_texels)
        return export.finish(read_world(scene, warnings, view_layer), ProfileTable(scene, view_layer))


def find_objects(exported: Iterable[ExportedObject]) -> list[Any]:
    """The Blender object that is or makes each exported one; None where it is gone."""
    by_uid = {obj.session_uid: obj for obj in bpy.data.objects}
    return [by_uid.get(one.uid) or bpy.data.objects.get((one.source, one.library or None)) for one in exported]


def list_worn(pieces: Iterable[Piece], override: Any) -> list[Any]:
    """The materials that pieces wear, each once."""
    found = {}
    for piece in pieces:
        for slot in piece.evaluated.material_slots if piece.evaluated.type != "LIGHT" else ():
            if slot.material is not None:
                found.setdefault(slot.material.session_uid, slot.material)
    return [override] if override is not None else list(found.values())


class _Export:
    """The pieces of one export, gathered while the depsgraph stands."""

    def __init__(
        self,
        view_layer: Any,
        depsgraph: Any,
        names: Sequence[str] | None,
        uv_layer: str | None,
        warnings: Warnings,
        until: float,
        most_texels: int,
    ) -> None:
        self._uv_layer = uv_layer
        self._warnings = warnings
        self._materials = MaterialTable(warnings, view_layer.material_override, most_texels)
        self._local: dict[tuple[int, ...], LocalMesh] = {}
        self._names: set[str] = set()
        self._found: list[tuple[ExportedObject, SceneObject, PieceArrays, int]] = []
        self._lights: list[Light | PendingLight] = []
        keys = [(p.source, p.kind, p.evaluated.original) for p in walk_pieces(view_layer, depsgraph) if p.is_mesh]
        self._receivers = Receivers(names, keys, find_set_objects(view_layer), warnings)
        self._materials.images.files.begin(list_worn(walk_pieces(view_layer, depsgraph), view_layer.material_override))
        curves: list[str] = []
        for piece in walk_pieces(view_layer, depsgraph):
            choice = read_choice(piece.source, piece.evaluated.original)
            if choice.role == IGNORE:
                continue
            if piece.evaluated.type == "LIGHT":
                light = read_lamp(piece.evaluated, piece.matrix, piece.evaluated.original.name, warnings)
                self._lights.extend([light] if light else [])
                continue
            if piece.kind == CURVE:
                curves.append(piece.source.name)
            if time.monotonic() > until:
                raise ValueError(f"{piece.source.name}: the time limit ended while the scene was read; raise it, or bake fewer objects.")
            self._add(piece, choice)
        if curves and names is None:
            listed = ", ".join(sorted(set(curves))[:8])
            warnings.append(("", f"{listed}: not meshes, so they cast light but get no lightmap; convert them to meshes to bake them"))

    def finish(self, world: World, profiles: ProfileTable) -> ExportResult:
        """The result, its objects in the order of their names, so that it does not depend on Blender's."""
        self._check_receivers()
        self._found.sort(key=lambda entry: entry[0].name)
        users = Counter(mesh_uid for *_, mesh_uid in self._found)
        number: dict[int, int] = {}  # not Blender's own, which another session would count otherwise
        for *_, uid in self._found:
            if uid and users[uid] > 1:
                number.setdefault(uid, len(number))
        scene_objects = tuple(replace(item, mesh=number.get(uid, -1)) for _, item, _, uid in self._found)
        lights: list[Light] = []
        for found in self._lights:
            lights += found.resolve(profiles, self._warnings) if isinstance(found, PendingLight) else [found]
        arrays = join_arrays([arrays for _, _, arrays, _ in self._found])
        self._materials.finish(arrays)
        snapshot = SceneSnapshot(
            **arrays,
            objects=scene_objects,
            materials=tuple(reading.material for reading in self._materials.readings),
            images=tuple(self._materials.images.images),
            lights=(*sorted(lights, key=lambda light: (light.name, light.position_m)), *world.suns),
            world_rgb=world.rgb,
            world_map=world.map,
            profiles=tuple(profiles.maps),
        )
        exported = tuple(entry[0] for entry in self._found)
        warnings = tuple(dict.fromkeys(self._warnings))
        return ExportResult(snapshot, exported, warnings)

    def _add(self, piece: Piece, choice: ObjectChoice) -> None:
        local = self._read_local(piece)
        receives = choice.role == BAKE and self._receivers.receives(piece)
        unseen = not piece.evaluated.visible_shadow and not piece.evaluated.visible_diffuse
        if not local.n_polygon or (unseen and not receives):
            if receives:
                self._receivers.warn_no_faces(piece)
            return
        has_layer = receives and self._has_layer(piece, local)
        arrays = read_piece(piece, local, self._materials, self._uv_layer if has_layer else None, self._warnings, receives)
        self._warn_faces(piece, arrays, receives)
        if not arrays.n_tri:
            return
        self._warn_linking(piece, arrays)
        if receives and arrays.is_clear:
            receives = False
            self._warnings.append((piece.source.name, "light passes through it and none is reflected, so it gets no lightmap"))
        reason = self._receivers.find_copy_reason(piece, local, self._uv_layer if has_layer else None) if receives else ""
        if receives and not has_layer and not has_room(piece.source.data if piece.kind == OWN else piece.evaluated.data):
            receives, reason = False, ""
            self._warnings.append((piece.source.name, NO_ROOM))
        name, source = self._unique_name(piece), piece.source
        library = source.library.filepath if source.library else ""
        own_mesh = piece.kind == OWN and not reason
        size = (len(source.data.loops), len(source.data.polygons)) if own_mesh else (local.n_corner, local.n_polygon)
        exported = ExportedObject(name, source.name, library, source.session_uid, piece.key, piece.kind, bool(reason), reason, *size)
        if reason:
            self._warnings.append((source.name, reason))
        scene_object = SceneObject(
            name=name,
            receives=receives,
            has_layer=has_layer and receives,
            casts_shadow=piece.evaluated.visible_shadow,
            reflects=piece.evaluated.visible_diffuse,
            sides=choice.sides,
            density_factor=choice.density_factor,
        )
        mesh_uid = find_users_mesh(source).session_uid if own_mesh else 0
        self._found.append((exported, scene_object, arrays, mesh_uid))

    def _read_local(self, piece: Piece) -> LocalMesh:
        """The piece's mesh, read once for all that share it."""
        evaluated, data = piece.evaluated, piece.evaluated.data
        if piece.kind == STRANDS:
            return self._read_strands(piece)
        key = (data.as_pointer(), len(data.vertices), len(data.loops), len(data.polygons))
        if key not in self._local:
            self._local[key] = read_mesh(evaluated.to_mesh(), self._materials.asked, name_ours(evaluated, self._uv_layer))
            evaluated.to_mesh_clear()
        return self._local[key]

    def _read_strands(self, piece: Piece) -> LocalMesh:
        key = (piece.evaluated.data.as_pointer(), piece.evaluated.original.session_uid, piece.hair)
        if key not in self._local:
            self._local[key] = read_strands(piece, self._warnings)
        return self._local[key]

    def _has_layer(self, piece: Piece, local: LocalMesh) -> bool:
        if self._uv_layer is None or self._uv_layer not in local.layers or piece.kind not in (OWN, COLLECTION):
            return False
        original = piece.evaluated.original
        return not repeats_layer(original) or (piece.kind == OWN and self._receivers.keeps_corners(piece, local))

    def _unique_name(self, piece: Piece) -> str:
        """The source's name; an instance adds what it is an instance of, and a number where that is not enough."""
        name = piece.source.name
        if piece.hair >= 0:
            name = f"{name}.{piece.evaluated.modifiers[piece.hair].particle_system.name}"
        elif piece.kind not in (OWN, CURVE, STRANDS):
            own = piece.evaluated.original.name
            name = f"{name}.{own if own != name else 'instance'}"
        unique, number = name, 1
        while unique in self._names:
            number += 1
            unique = f"{name}.{number:03d}"
        self._names.add(unique)
        return unique

    def _warn_linking(self, piece: Piece, arrays: PieceArrays) -> None:
        linking = piece.evaluated.light_linking
        if linking is None or not (linking.receiver_collection or linking.blocker_collection):
            return
        if any(any(self._materials.readings[index].material.emission_rgb) for index in set(arrays.tri_material.tolist())):
            self._warnings.append((piece.source.name, "its light linking is left out: what glows lights every object"))

    def _warn_faces(self, piece: Piece, arrays: PieceArrays, receives: bool) -> None:
        count = arrays.world.left_out
        if count:
            what = "every face is" if not arrays.n_tri else "1 face is" if count == 1 else f"{count} faces are"
            self._warnings.append(
                (piece.source.name, f"{what} left out, for a coordinate is not a finite number; delete or mend what has it")
            )
        duplicates = count_duplicates(arrays.world) if receives else 0
        if duplicates:
            what = "1 triangle lies exactly on another" if duplicates == 1 else f"{duplicates} triangles lie exactly on others"
            self._warnings.append((piece.source.name, f"{what}; merge them to bake them well"))

    def _check_receivers(self) -> None:
        receivers = [item for _, item, _, _ in self._found if item.receives]
        if not receivers:
            raise ValueError(describe_nothing(self._warnings, only_casting=bool(self._found)))
        if self._uv_layer is None:
            return
        if not any(item.has_layer for item in receivers):
            layers = sorted({layer for local in self._local.values() for layer in local.layers})
            known = f"the layers there are: {', '.join(layers)}" if layers else "there are no UV layers"
            raise ValueError(f"no object has a UV layer named {self._uv_layer} that can be used: {known}.")
        missing = [item.name for item in receivers if not item.has_layer]
        self._warnings.extend((name, f"has no UV layer {self._uv_layer} to use and is unwrapped anew") for name in missing)
