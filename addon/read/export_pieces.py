"""What a render shows, piece by piece: objects themselves and the instances they make."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .render_levels import find_hidden_instances, find_render_objects, find_set_objects

PieceKey = tuple[int, ...]  # source uid, evaluated object's uid, then the instance's persistent id

OWN = "OWN"  # the object's own evaluated mesh
COLLECTION = "COLLECTION"
GEOMETRY = "GEOMETRY"  # made by geometry nodes
SCATTER = "SCATTER"  # made by particles, or by the vertices or faces of a parent
CURVE = "CURVE"  # the evaluated mesh of a curve, text, surface or metaball

_SCATTERING = ("VERTS", "FACES")


@dataclass(frozen=True)
class Piece:
    """One evaluated mesh or light at one place; holds only while the iteration stands on it.

    source      original object of the scene that it is, or that makes it
    evaluated   evaluated object with the data, of type MESH or LIGHT
    matrix      (4, 4) float64, object to world
    """

    key: PieceKey
    kind: str
    source: Any
    evaluated: Any
    matrix: NDArray[np.float64]


def walk_pieces(view_layer: Any, depsgraph: Any) -> Iterator[Piece]:
    """Meshes and lights that a render of the view layer shows; `depsgraph` comes from `evaluate_for_render`."""
    rendered = find_render_objects(view_layer) | find_set_objects(view_layer)
    hidden: dict[Any, set[Any]] = {}
    for instance in depsgraph.object_instances:
        evaluated = instance.object
        if evaluated.type not in ("MESH", "LIGHT"):
            continue  # curves and metaballs come a second time, as the mesh they are rendered by
        source = (instance.parent or evaluated).original
        if source not in rendered:
            continue
        kind = _find_kind(instance, source)
        original = evaluated.original
        if kind == OWN and _is_hidden_original(source):
            continue
        if not instance.show_self or (kind == SCATTER and not instance.particle_system and original.hide_render):
            continue
        if kind == COLLECTION:
            if source not in hidden:
                hidden[source] = find_hidden_instances(source.instance_collection)
            if original in hidden[source]:
                continue
        identity = tuple(instance.persistent_id) if instance.is_instance else ()
        key = (source.session_uid, original.session_uid, *identity)
        yield Piece(key, kind, source, evaluated, np.array(instance.matrix_world, np.float64))


def _find_kind(instance: Any, source: Any) -> str:
    if source.type in ("CURVE", "SURFACE", "FONT", "META"):
        return CURVE
    if not instance.is_instance:
        return OWN
    if instance.particle_system or source.instance_type in _SCATTERING:
        return SCATTER
    return COLLECTION if source.instance_type == "COLLECTION" and source.instance_collection else GEOMETRY


def _is_hidden_original(obj: Any) -> bool:
    """Whether a render shows an object's instances only: those it makes, or those made of it by its parent.

    The viewport shows the latter's original, Cycles does not.
    """
    if not obj.show_instancer_for_render and (obj.instance_type in _SCATTERING or obj.particle_systems):
        return True
    return obj.parent is not None and obj.parent.instance_type in _SCATTERING
