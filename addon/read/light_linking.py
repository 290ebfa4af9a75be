"""Light linking and shadow linking: the objects that a lamp or a glowing mesh lights, and those that cast its shadows.

An object is chosen where a collection includes it, or where it excludes some objects and this one is not among them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from ...core.scene.scene import Light, SceneObject

_Linked = TypeVar("_Linked", Light, SceneObject)


@dataclass(frozen=True)
class Linking:
    """What the collections of a lamp or mesh say, by session_uid of objects; None where they say nothing.

    receivers, blockers   the objects that are chosen, or with `not_` in front those that are not
    """

    receivers: frozenset[int] | None = None
    not_receivers: frozenset[int] = frozenset()
    blockers: frozenset[int] | None = None
    not_blockers: frozenset[int] = frozenset()

    def link(self, light: _Linked, objects: Sequence[tuple[int, ...]]) -> _Linked:
        """The light, or object that glows, with numbers of objects, of which each is known by some uids: its own, and that of what it is
        an instance of.
        """
        lit, blocking = (_choose(objects, *chosen) for chosen in ((self.receivers, self.not_receivers), (self.blockers, self.not_blockers)))
        return replace(light, lights=lit, blocked_by=blocking)


def read_linking(obj: Any) -> Linking:
    """What the light linking of an object says of the light that it sends out."""
    linking = obj.light_linking
    return Linking(*_read_collection(linking.receiver_collection), *_read_collection(linking.blocker_collection))


def list_linked(obj: Any) -> list[tuple[str, str, str]]:
    """(which collection, object, state) of all that an object's linking names, in order."""
    named = []
    for kind in ("receiver", "blocker"):
        collection = getattr(obj.light_linking, f"{kind}_collection")
        named += [(kind, one.name_full, state) for one, state in _walk(collection)] if collection else []
    return sorted(named)


def _read_collection(collection: Any) -> tuple[frozenset[int] | None, frozenset[int]]:
    members = list(_walk(collection)) if collection else []
    included, excluded = (frozenset(one.session_uid for one, state in members if state == kind) for kind in ("INCLUDE", "EXCLUDE"))
    return included or None, excluded


def _walk(collection: Any) -> Iterator[tuple[Any, str]]:
    """Objects of a linking collection, of those in it too, with their states."""
    for obj, about in zip(collection.objects, collection.collection_objects, strict=True):
        yield obj, about.light_linking.link_state
    for child, about in zip(collection.children, collection.collection_children, strict=True):
        for obj in child.all_objects:
            yield obj, about.light_linking.link_state


def _choose(objects: Sequence[tuple[int, ...]], included: frozenset[int] | None, excluded: frozenset[int]) -> tuple[int, ...] | None:
    if included is None and not excluded:
        return None
    chosen = [
        number for number, uids in enumerate(objects) if (included is None or not included.isdisjoint(uids)) and excluded.isdisjoint(uids)
    ]
    return None if len(chosen) == len(objects) else tuple(chosen)
