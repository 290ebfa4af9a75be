"""A Blender scene -> SceneSnapshot, and what of Blender each of its objects is."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import bpy

from ...core.scene.scene import Light, SceneObject, SceneSnapshot
from ...core.util.messages import Status
from ...core.util.progress import Watch, unwatched
from ..nodes.images_read import MAX_TEXTURE_SIDE_TEXELS
from ..nodes.mesh_arrays import LocalMesh
from .baked_copies import find_users_mesh
from .export_arrays import PieceArrays, WornPiece, arrange_piece, join_arrays, read_piece
from .export_mesh import count_duplicates, read_mesh
from .export_pieces import COLLECTION, CURVE, OWN, STRANDS, Piece, PieceKey, walk_pieces
from .export_receivers import NO_ROOM, Receivers, check_names, describe_nothing, repeats_layer
from .lamp_profile import ProfileTable
from .left_out import warn_left_out
from .light_linking import Linking, read_linking
from .lights_read import PendingArea, PendingLight, read_lamp
from .materials_read import MaterialTable
from .object_settings import BAKE, IGNORE, ObjectChoice, read_choice, registered
from .render_levels import Warnings, evaluate_for_render, find_set_objects, find_view_layer
from .steps import Pause, Steps, run_steps
from .strands import read_strands
from .tags import find_original
from .uv_layer import has_room, name_ours
from .world_cache import MapCache
from .world_read import World, is_textured, read_world

READING = Status("read", "Reading the scene")


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
    read = run_steps(read_scene(context_or_scene, objects, uv_layer, view_layer, until, most_texels))
    return run_steps(read.arrange())


def read_scene(
    context_or_scene: Any,
    objects: Sequence[str] | None,
    uv_layer: str | None,
    view_layer: Any,
    until: float,
    most_texels: int,
    kept: MapCache | None = None,
    watch: Watch = unwatched,
) -> Steps[SceneReading]:
    """The first half of `export_scene`, in steps: all that has to be asked of Blender.

    From its first pause to its last, the scene is as it is rendered; closing the generator puts everything back.
    kept    what earlier bakes have evaluated of the world
    watch   is told how far both halves are
    """
    scene = getattr(context_or_scene, "scene", context_or_scene)
    view_layer = view_layer or find_view_layer(context_or_scene, scene)
    warnings: Warnings = []
    view_layer.update()  # that of a new scene is empty until then
    warn_left_out(view_layer, warnings)
    with registered():
        check_names(scene, view_layer, objects)
        materials = MaterialTable(warnings, view_layer.material_override, most_texels)
        reading = SceneReading(objects, uv_layer, warnings, until, materials, watch)
        yield from reading.read_images(view_layer)
        with evaluate_for_render(scene, view_layer, warnings) as depsgraph:
            yield from reading.read_pieces(view_layer, depsgraph)
        yield Pause.LONG if is_textured(scene, view_layer) else Pause.HOLD
        world = read_world(scene, warnings, view_layer, kept)
        try:
            if kept is not None:
                kept.save()
        except OSError as reason:
            warnings.append(("", f"the world's light cannot be kept ({reason}), so the next bake evaluates it again"))
        yield Pause.HOLD
        reading.resolve_lights(world, ProfileTable(scene, view_layer))
    return reading


def find_objects(exported: Iterable[ExportedObject]) -> list[Any]:
    """The Blender object that is or makes each exported one; None where it is gone."""
    by_uid = {obj.session_uid: obj for obj in bpy.data.objects}
    return [by_uid.get(one.uid) or bpy.data.objects.get((one.source, one.library or None)) for one in exported]


@dataclass(frozen=True)
class _FoundPiece:
    """A piece that was read, and what of Blender is asked about it.

    reason     why it would need a copy, "" where its own mesh carries the lightmap
    has_room   whether that mesh takes another UV layer
    own_size   corners and polygons of the source's own mesh, own_mesh its session_uid; 0 of what is not the source itself
    original_uid   session_uid of what it is an instance of, or of the source itself
    seen_by    as of SceneObject
    """

    worn: WornPiece
    name: str
    exported: ExportedObject
    choice: ObjectChoice
    receives: bool
    has_layer: bool
    has_room: bool
    own_size: tuple[int, int]
    own_mesh: int
    original_uid: int
    casts_shadow: bool
    seen_by: tuple[bool, bool, bool]
    linking: Linking


class SceneReading:
    """What of a scene is exported: its pieces are read while the depsgraph stands, and arranged once Blender is not needed any more."""

    def __init__(
        self, names: Sequence[str] | None, uv_layer: str | None, warnings: Warnings, until: float, materials: MaterialTable, watch: Watch
    ) -> None:
        self._names_asked, self._uv_layer = names, uv_layer
        self._warnings, self._until = warnings, until
        self._materials, self._watch = materials, watch
        self._local: dict[tuple[int, ...], LocalMesh] = {}
        self._names: set[str] = set()
        self._pieces: list[_FoundPiece] = []
        self._found: list[tuple[ExportedObject, SceneObject, PieceArrays, int]] = []
        self._lamps: list[tuple[Light | PendingLight | PendingArea, Linking]] = []
        self._lights: list[tuple[Light, Linking]] = []
        self._profiles: list[Any] = []
        self._curves: set[str] = set()
        self._original_uid: dict[str, int] = {}  # by the object's name in the snapshot: of what it is an instance of
        self._linking: dict[str, Linking] = {}  # the same, of what it emits

    def read_images(self, view_layer: Any) -> Steps[None]:
        """Wait for the images that materials show, where there is something better to do meanwhile."""
        files = self._materials.images.files
        override = self._materials.override
        worn = (find_original(slot.material) for obj in view_layer.objects for slot in obj.material_slots)
        files.begin(
            [override] if override is not None else list({material.session_uid: material for material in worn if material}.values())
        )
        while files.is_reading and (yield Pause.WAIT) is not None:
            pass

    def read_pieces(self, view_layer: Any, depsgraph: Any) -> Steps[None]:
        """Read every piece that a render shows. No piece is held over a pause: the walk begins anew, and passes over what was read."""
        keys, worn, total = [], {}, 0
        for piece in walk_pieces(view_layer, depsgraph):
            total += 1
            if piece.is_mesh:
                keys.append((piece.source, piece.kind, piece.evaluated.original))
            for slot in piece.evaluated.material_slots if piece.evaluated.type != "LIGHT" else ():
                material = find_original(slot.material and slot.material.original)
                if material is not None:
                    worn.setdefault(material.session_uid, material)
        self._receivers = Receivers(self._names_asked, keys, find_set_objects(view_layer), self._warnings)
        if self._materials.override is None:
            self._materials.images.files.begin(worn.values())
        done, paused = 0, True
        while paused:
            paused = False
            for piece in islice(walk_pieces(view_layer, depsgraph), done, None):
                done += 1
                self._watch(READING, 0.5 * done / total, piece.source.name)
                self._read(piece)
                paused = bool((yield Pause.HOLD))
                if paused:
                    break
        if self._curves and self._names_asked is None:
            listed = ", ".join(sorted(self._curves)[:8])
            self._warnings.append(
                ("", f"{listed}: not meshes, so they cast light but get no lightmap; convert them to meshes to bake them")
            )

    def resolve_lights(self, world: World, profiles: ProfileTable) -> None:
        """The last that needs Blender: lamps whose light differs by direction."""
        self._world, lights = world, []
        for found, linking in self._lamps:
            parts = [found] if isinstance(found, Light) else found.resolve(profiles, self._warnings)
            lights += [(light, linking) for light in parts]
        self._lights = sorted(lights, key=lambda entry: (entry[0].name, entry[0].position_m))
        self._profiles = profiles.maps

    def arrange(self) -> Steps[ExportResult]:
        """The second half: the snapshot, its objects in the order of their names, so that it does not depend on Blender's."""
        pieces, self._pieces = self._pieces[::-1], []
        total = len(pieces)
        while pieces:  # what is arranged is not held any longer
            source = pieces[-1].exported.source
            self._watch(READING, 1.0 - 0.5 * len(pieces) / total, source)
            self._check_time(source)
            yield from self._arrange(pieces.pop())
            yield Pause.FREE
        self._check_receivers()
        self._found.sort(key=lambda entry: entry[0].name)
        users = Counter(mesh_uid for *_, mesh_uid in self._found)
        uids = [(one.uid, self._original_uid[one.name]) for one, *_ in self._found]
        number: dict[int, int] = {}  # not Blender's own, which another session would count otherwise
        for *_, uid in self._found:
            if uid and users[uid] > 1:
                number.setdefault(uid, len(number))
        scene_objects = tuple(
            self._linking[exported.name].link(replace(item, mesh=number.get(uid, -1)), uids) for exported, item, _, uid in self._found
        )
        arrays = yield from join_arrays([arrays for _, _, arrays, _ in self._found])
        self._materials.finish(arrays)
        snapshot = SceneSnapshot(
            **arrays,
            objects=scene_objects,
            materials=tuple(reading.material for reading in self._materials.readings),
            images=tuple(self._materials.images.images),
            lights=(*(linking.link(light, uids) for light, linking in self._lights), *self._world.suns),
            world_rgb=self._world.rgb,
            world_map=self._world.map,
            profiles=tuple(self._profiles),
        )
        exported = tuple(entry[0] for entry in self._found)
        warnings = tuple(dict.fromkeys(self._warnings))
        return ExportResult(snapshot, exported, warnings)

    def _check_time(self, name: str) -> None:
        if time.monotonic() > self._until:
            raise ValueError(f"{name}: the time limit ended while the scene was read; raise it, or bake fewer objects.")

    def _read(self, piece: Piece) -> None:
        evaluated, source = piece.evaluated, piece.source
        choice = read_choice(source, evaluated.original)
        if choice.role == IGNORE:
            return
        if evaluated.type == "LIGHT":
            light = read_lamp(evaluated, piece.matrix, evaluated.original.name, self._warnings)
            self._lamps.extend([(light, read_linking(evaluated.original))] if light else [])
            return
        if piece.kind == CURVE:
            self._curves.add(source.name)
        self._check_time(source.name)
        local = self._read_local(piece)
        receives = choice.role == BAKE and self._receivers.receives(piece)
        seen_by = evaluated.visible_diffuse, evaluated.visible_glossy, evaluated.visible_transmission
        unseen = not evaluated.visible_shadow and not any(seen_by)
        if not local.n_polygon or (unseen and not receives):
            if receives:
                self._receivers.warn_no_faces(piece)
            return
        has_layer = receives and self._has_layer(piece, local)
        reason = self._receivers.find_copy_reason(piece, local, self._uv_layer if has_layer else None) if receives else ""
        own = piece.kind == OWN
        library = source.library.filepath if source.library else ""
        exported = ExportedObject(
            "", source.name, library, source.session_uid, piece.key, piece.kind, False, "", local.n_corner, local.n_polygon
        )
        self._pieces.append(
            _FoundPiece(
                worn=read_piece(piece, local, self._materials, receives),
                name=self._find_name(piece),
                exported=replace(exported, reason=reason),
                choice=choice,
                receives=receives,
                has_layer=has_layer,
                has_room=not receives or has_room(source.data if own else evaluated.data),
                own_size=(len(source.data.loops), len(source.data.polygons)) if own else (0, 0),
                own_mesh=find_users_mesh(source).session_uid if own else 0,
                original_uid=evaluated.original.session_uid,
                casts_shadow=evaluated.visible_shadow,
                seen_by=seen_by,
                linking=read_linking(evaluated.original),
            )
        )

    def _arrange(self, found: _FoundPiece) -> Steps[None]:
        source, receives, reason = found.exported.source, found.receives, found.exported.reason
        layer = self._uv_layer if found.has_layer else None
        arrays = yield from arrange_piece(found.worn, self._materials, layer, self._warnings)
        self._warn_faces(source, arrays, receives)
        if not arrays.n_tri:
            return
        if receives and arrays.is_clear:
            receives, reason = False, ""
            self._warnings.append((source, "light passes through it and none is reflected, so it gets no lightmap"))
        if receives and not found.has_layer and not found.has_room:
            receives, reason = False, ""
            self._warnings.append((source, NO_ROOM))
        name, own_mesh = self._make_unique(found.name), found.exported.kind == OWN and not reason
        self._original_uid[name], self._linking[name] = found.original_uid, found.linking
        exported = replace(found.exported, name=name, needs_copy=bool(reason), reason=reason)
        if own_mesh:
            exported = replace(exported, n_corner=found.own_size[0], n_polygon=found.own_size[1])
        if reason:
            self._warnings.append((source, reason))
        scene_object = SceneObject(
            name=name,
            receives=receives,
            has_layer=found.has_layer and receives,
            casts_shadow=found.casts_shadow,
            seen_by=found.seen_by,
            sides=found.choice.sides,
            density_factor=found.choice.density_factor,
        )
        self._found.append((exported, scene_object, arrays, found.own_mesh if own_mesh else 0))

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

    def _find_name(self, piece: Piece) -> str:
        """The source's name; an instance adds what it is an instance of."""
        name: str = piece.source.name
        if piece.hair >= 0:
            return f"{name}.{piece.evaluated.modifiers[piece.hair].particle_system.name}"
        if piece.kind in (OWN, CURVE, STRANDS):
            return name
        own = piece.evaluated.original.name
        return f"{name}.{own if own != name else 'instance'}"

    def _make_unique(self, name: str) -> str:
        """With a number where that is needed."""
        unique, number = name, 1
        while unique in self._names:
            number += 1
            unique = f"{name}.{number:03d}"
        self._names.add(unique)
        return unique

    def _warn_faces(self, name: str, arrays: PieceArrays, receives: bool) -> None:
        count = arrays.world.left_out
        if count:
            what = "every face is" if not arrays.n_tri else "1 face is" if count == 1 else f"{count} faces are"
            self._warnings.append((name, f"{what} left out, for a coordinate is not a finite number; delete or mend what has it"))
        duplicates = count_duplicates(arrays.world) if receives else 0
        if duplicates:
            what = "1 triangle lies exactly on another" if duplicates == 1 else f"{duplicates} triangles lie exactly on others"
            self._warnings.append((name, f"{what}; merge them (Edit Mode, Mesh > Merge > By Distance)"))

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
