"""What a render shows, piece by piece: objects themselves and the instances they make."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..nodes.object_attributes import find_random
from .render_levels import find_hidden_instances, find_render_objects, find_set_objects

PieceKey = tuple[int, ...]  # source uid, evaluated object's uid, then the instance's persistent id

OWN = "OWN"  # the object's own evaluated mesh
COLLECTION = "COLLECTION"
GEOMETRY = "GEOMETRY"  # made by geometry nodes
SCATTER = "SCATTER"  # made by particles, or by the vertices or faces of a parent
CURVE = "CURVE"  # the evaluated mesh of a curve, text, surface or metaball
STRANDS = "STRANDS"  # hair, hair curves and point clouds

_NO_NUMBER = 2**31 - 1  # of a level that an instance has not
_SCATTERING = ("VERTS", "FACES")
_STRANDED = ("CURVES", "POINTCLOUD")


@dataclass(frozen=True)
class Piece:
    """One evaluated mesh or light at one place; holds only while the iteration stands on it.

    source      original object of the scene that it is, or that makes it
    evaluated   evaluated object with the data, of type MESH or LIGHT; of kind STRANDS also CURVES or POINTCLOUD
    matrix      (4, 4) float64, object to world
    random      [0, 1], what an Object Info node calls Random
    maker       evaluated object that makes the instance, None of what is none; and
    number      which of its instances it is, or is in
    hair        which of its modifiers makes the strands of a mesh, -1 none
    """

    key: PieceKey
    kind: str
    source: Any
    evaluated: Any
    matrix: NDArray[np.float64]
    random: float
    maker: Any = None
    number: int = 0
    hair: int = -1

    @property
    def is_mesh(self) -> bool:
        """Whether its faces are those of the evaluated object."""
        return self.kind != STRANDS and self.evaluated.type == "MESH"


def walk_pieces(view_layer: Any, depsgraph: Any) -> Iterator[Piece]:
    """Meshes and lights that a render of the view layer shows; `depsgraph` comes from `evaluate_for_render`."""
    rendered = find_render_objects(view_layer) | find_set_objects(view_layer)
    hidden: dict[Any, set[Any]] = {}
    for instance in depsgraph.object_instances:
        evaluated = instance.object
        if evaluated.type not in ("MESH", "LIGHT", *_STRANDED):
            continue  # curves and metaballs come a second time, as the mesh they are rendered by
        source = (instance.parent or evaluated).original
        if source not in rendered:
            continue
        kind = _find_kind(instance, source)
        original = evaluated.original
        identity = tuple(instance.persistent_id) if instance.is_instance else ()
        key = (source.session_uid, original.session_uid, *identity)
        matrix = np.array(instance.matrix_world, np.float64)
        random = (instance.random_id % 2**32) / (2**32 - 1) if instance.is_instance else find_random(source.name)
        of_maker = instance.parent, next((one for one in reversed(identity) if one != _NO_NUMBER), 0)
        if kind == SCATTER and not instance.particle_system and original.hide_render:
            continue
        if kind == COLLECTION:
            if source not in hidden:
                hidden[source] = find_hidden_instances(source.instance_collection)
            if original in hidden[source]:
                continue
        if instance.show_particles and evaluated.type == "MESH" and view_layer.use_strand:
            for number in _list_hair(evaluated):  # which grows on an object that is not shown itself, too
                yield Piece((*key, -1 - number), STRANDS, source, evaluated, matrix, random, *of_maker, number)
        if evaluated.type == "CURVES" and not view_layer.use_strand:
            continue
        if not instance.show_self or (kind == OWN and _is_hidden_original(source)):
            continue
        yield Piece(key, STRANDS if evaluated.type in _STRANDED else kind, source, evaluated, matrix, random, *of_maker)


def _list_hair(evaluated: Any) -> list[int]:
    """Which modifiers make hair that a render shows as strands."""
    return [number for number, modifier in enumerate(evaluated.modifiers) if _makes_strands(modifier)]


def _makes_strands(modifier: Any) -> bool:
    if modifier.type != "PARTICLE_SYSTEM" or not modifier.show_render or modifier.particle_system is None:
        return False
    settings = modifier.particle_system.settings
    return bool(settings.type == "HAIR" and settings.render_type == "PATH" and settings.count)


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
