"""Which pieces of a scene get a lightmap, and whether on their own mesh or on a baked copy."""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Container, Sequence
from typing import Any

from ...core.util.user_text import group_warnings
from ..nodes.mesh_arrays import LocalMesh
from .export_mesh import has_corners_of
from .export_pieces import COLLECTION, CURVE, GEOMETRY, OWN, SCATTER, STRANDS, Piece
from .object_settings import BAKE
from .render_levels import Warnings, find_render_objects

MAX_INSTANCES = 100  # more than these of one object share too small a page to be of use
NO_ROOM = "has 8 UV layers, as many as Blender allows; remove one to give it a lightmap"
LINKED = "is linked from another file and cannot be hidden behind a baked copy, so its bake is in the images only; make it local"
_COPY = "a copy of what you see is baked, and stands in its place until Remove"


def check_names(scene: Any, view_layer: Any, names: Sequence[str] | None) -> None:
    """Raises ValueError with a sentence about the first name that cannot get a lightmap."""
    rendered = find_render_objects(view_layer)
    by_name = {obj.name: obj for obj in (*scene.objects, *view_layer.objects)}
    for name in names or ():
        obj = by_name.get(name)
        if obj is None:
            raise ValueError(f"{name}: no such object; {_list_objects(scene, name)}")
        if obj not in rendered:
            raise ValueError(f"{name}: is hidden in render, or its collection is; show it in render, or leave it out of the bake.")
        if obj.leaflight.role != BAKE:
            raise ValueError(f"{name}: its Role (Object properties, Leaflight) is not Bake; choose Bake, or leave it out of the bake.")
        if obj.type != "MESH" and not _makes_instances(obj):
            raise ValueError(f"{name}: is a {obj.type.lower()}, not a mesh; convert it to a mesh, or leave it out of the bake.")


def describe_nothing(warnings: Warnings, only_casting: bool) -> str:
    """A sentence why nothing gets a lightmap, with what was told of single objects."""
    no_room = group_warnings(warning for warning in warnings if warning[1] == NO_ROOM)
    if no_room:
        return f"nothing to bake: {no_room[0].text}."
    left_out = [told.text for told in group_warnings(warning for warning in warnings if "left out" in warning[1] and "face" in warning[1])]
    if only_casting and not left_out:
        return "nothing to bake: what renders only casts light; add a mesh, or choose Bake as the Role of one."
    found = f" ({'; '.join(left_out)})" if left_out else ""
    return f"nothing to bake: no mesh object with faces is shown in render{found}; add one, or show one in render."


def _list_objects(scene: Any, name: str) -> str:
    meshes = sorted(obj.name for obj in scene.objects if obj.type == "MESH")
    if not meshes:
        return "the scene has no mesh object"
    told = difflib.get_close_matches(name, meshes, n=5, cutoff=0.5) or meshes[:8]
    return f"the scene has: {', '.join(told)}{', ...' if len(meshes) > len(told) else ''}"


def _makes_instances(obj: Any) -> bool:
    return obj.instance_type == "COLLECTION" and obj.instance_collection is not None


class Receivers:
    """The rule for one export: what is named receives light, else every mesh."""

    def __init__(
        self, names: Sequence[str] | None, keys: Sequence[tuple[Any, str, Any]], of_set: Container[Any], warnings: Warnings
    ) -> None:
        """The rule for a scene.

        keys     source and kind of every mesh piece, and the object whose mesh it is
        of_set   sources that are of the Background Scene
        """
        self._names = None if names is None else set(names)
        self._of_set, self._warnings = of_set, warnings
        self._count = Counter((source, kind) for source, kind, _ in keys)
        self._makers = {own: source for source, kind, own in keys if kind != OWN and own != source and self._only_casts(source, kind)}
        self._warned: set[Any] = set()

    def receives(self, piece: Piece) -> bool:
        """Whether a piece gets a lightmap; tells once for each object why it does not."""
        if self._names is not None and piece.source.name not in self._names:
            return False
        if piece.kind in (CURVE, STRANDS):
            return False
        if piece.source in self._of_set:
            self._warn_once(
                piece.source, "is of the Background Scene: it casts light but gets no lightmap; link it into this one to bake it"
            )
            return False
        maker = self._makers.get(piece.source) if piece.kind == OWN else None
        if maker is not None:  # its instances wear its bake, or are hidden with it behind a copy
            found = f"{maker.name} makes instances of it that get no lightmap"
            told = "are shown with its light, or not at all" if self._names else "would be shown with its light, so it gets none either"
            self._warn_once(piece.source, f"{found} and {told}; hide it in render, or bake a copy of it")
            return bool(self._names)
        if piece.kind == SCATTER:
            self._warn_once(piece.source, "particles and instances on its vertices or faces cast light but get no lightmap")
            return False
        if piece.kind != OWN and self._only_casts(piece.source, piece.kind):
            count = self._count[piece.source, piece.kind]
            self._warn_once(piece.source, f"its {count} instances cast light but get no lightmap; realize them to bake them")
            return False
        return True

    def _only_casts(self, source: Any, kind: str) -> bool:
        """Whether what an object makes of this kind is without lightmaps."""
        return kind == SCATTER or self._count[source, kind] > MAX_INSTANCES

    def warn_no_faces(self, piece: Piece) -> None:
        """Tells that a piece is left out, unless all that its object is there for is instances."""
        instanced = any(source == piece.source and kind != OWN for source, kind in self._count)
        if piece.kind == OWN and not instanced:
            self._warnings.append((piece.source.name, "has no faces and is left out"))

    def find_copy_reason(self, piece: Piece, local: LocalMesh, uv_layer: str | None) -> str:
        """Why the piece must be baked as a copy, as a sentence, "" when its own mesh carries the lightmap."""
        obj = piece.source
        if not obj.is_editable or obj.override_library:
            return LINKED
        if piece.kind == COLLECTION:
            return f"is an instance; {_COPY}"
        if piece.kind == GEOMETRY or self._count[piece.source, GEOMETRY] in range(1, MAX_INSTANCES + 1):
            return f"its geometry nodes make instances; {_COPY}"
        has_layer = uv_layer in local.layers
        if not has_corners_of(obj.data, local) and (repeats_layer(obj) or not has_layer):
            return f"its modifiers change its faces; {_COPY}"
        return "" if obj.data.is_editable or has_layer else f"its mesh is linked from another file; {_COPY}"

    def keeps_corners(self, piece: Piece, local: LocalMesh) -> bool:
        """Whether the modifiers left the object's own corners as they are."""
        return has_corners_of(piece.source.data, local)

    def _warn_once(self, source: Any, text: str) -> None:
        if source not in self._warned:
            self._warned.add(source)
            self._warnings.append((source.name, text))


def repeats_layer(obj: Any) -> bool:
    """Whether a modifier lays the UV layer over itself, or makes faces that have none."""
    shown = [modifier for modifier in obj.modifiers if modifier.show_render]
    return any(m.type not in _DEFORMING and m.type not in _LAYER_KEEPING and not _moves_layer(m) for m in shown)


def _moves_layer(modifier: Any) -> bool:
    """Whether an array or mirror puts its repetitions elsewhere in the UV layer."""
    if modifier.type == "ARRAY":
        return bool(getattr(modifier, "offset_u", 0.0) or getattr(modifier, "offset_v", 0.0))
    if modifier.type != "MIRROR":
        return False
    return modifier.use_mirror_u or modifier.use_mirror_v or modifier.use_mirror_udim or bool(modifier.offset_u or modifier.offset_v)


_LAYER_KEEPING = frozenset(("SUBSURF", "MULTIRES", "TRIANGULATE", "EDGE_SPLIT", "MASK", "DECIMATE", "WELD", "BEVEL", "BUILD"))
_DEFORMING = frozenset(
    (
        *("ARMATURE", "CAST", "CURVE", "DISPLACE", "HOOK", "LAPLACIANDEFORM", "LATTICE", "MESH_DEFORM", "SHRINKWRAP", "SIMPLE_DEFORM"),
        *("SMOOTH", "CORRECTIVE_SMOOTH", "LAPLACIANSMOOTH", "SURFACE_DEFORM", "WARP", "WAVE", "CLOTH", "COLLISION", "SOFT_BODY"),
        *("DATA_TRANSFER", "MESH_CACHE", "MESH_SEQUENCE_CACHE", "NORMAL_EDIT", "WEIGHTED_NORMAL", "UV_PROJECT", "UV_WARP"),
        *("VERTEX_WEIGHT_EDIT", "VERTEX_WEIGHT_MIX", "VERTEX_WEIGHT_PROXIMITY", "PARTICLE_SYSTEM", "DYNAMIC_PAINT"),
    )
)
