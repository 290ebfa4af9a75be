"""Mechanisms that can be switched off by name, so that a benchmark can measure what each is worth.

This is a development setting, not an option for users: the environment variable LEAFLIGHT_WITHOUT=name,name switches mechanisms off in a
bake, and all of its processes inherit it. MECHANISMS lists the names; `make bench-ablation` bakes without each of them.
"""

import os
from dataclasses import replace
from functools import lru_cache

from .settings import Settings

VARIABLE = "LEAFLIGHT_WITHOUT"

# What each mechanism does. Without it, a bake does the simplest thing that still gives light.
MECHANISMS = {
    # light on leaves
    "coefficient_shrinkage": "slopes of leaves are shrunk by how noisy they are",
    "scarce_charts": "charts that hardly any photon meets share their light with those beside them",
    "grain_filter": "noise of photons and of rays is averaged by non-local means (--no-denoise)",
    "seams": "light is matched across seams by least squares (--no-seams)",
    # where charts and trees are cut
    "contacts": "all that follows from contacts: cuts, split texels, finer nodes (--no-contact)",
    "contact_cuts": "charts are cut where other surfaces stand on them",
    "split_texels": "texels that a contact crosses share their light with the next one",
    "contact_nodes": "nodes that something touches are split whatever the oracle says",
    "crease_cuts": "charts are cut at creases, and where a wall shares an edge with the floor",
    # direct light by rays
    "near_field_quadrature": "the closed form is integrated adaptively over texels that a light nearly touches",
    "lamp_crowd": "of more than 16 lamps those that give little are sampled together",
    "emitter_pool": "of more than 12 emitting triangles some are sampled; textured ones always are",
    "openings": "where little of the sky is seen, rays go to where neighbours saw it",
    "tiles": "tiles of 8 x 8 texels share their first rays to a light",
    "dark_leaders": "of neighbours that see nothing of a light one goes on for all",
    "block_agreement": "the first rays of 16 neighbours have to agree before any of them stops",
    # indirect light by rays
    "bright_places": "as many gather rays again are aimed at bright places",
    "hit_light": "on texels and cells that are wide beside their distance direct light comes from shadow rays at the hit",
    "surface_cells": "sides without a lightmap keep their light in cells; without them, one value for a triangle's side",
    "batches": "batches of further rays grow geometrically",
    # photons
    "coincident_faces": "hits on faces that lie in one place are shared out among them",
    "splitting": "8 photons go together to the first surface and part there",
    "photons_ahead": "photons of the first rounds are traced while charts are made",
    "rays_ahead": "some shadow rays are sent before the first photons are read",
    "late_shards": "the last shards of a large round are traced while it is read",
    # what the scene is simplified to
    "pruning": "lights that reach nothing and textures of one colour are left out",
    "sealed_solids": "faces of closed solids send no light inwards",
    "slender_cutting": "slender emitting triangles are cut across",
}
# Mechanisms that a setting switches, and the setting.
_OF_SETTINGS = {"grain_filter": "denoise", "seams": "seams", "contacts": "contact"}


def list_without() -> tuple[str, ...]:
    """Names of the mechanisms that are switched off, in the order of MECHANISMS.

    Raises ValueError with a sentence if one is unknown.
    """
    return _read_names(os.environ.get(VARIABLE, ""))


@lru_cache(maxsize=4)
def _read_names(text: str) -> tuple[str, ...]:
    names = {name.strip() for name in text.split(",")} - {""}
    unknown = sorted(names - set(MECHANISMS))
    if unknown:
        raise ValueError(f"{VARIABLE}: {', '.join(unknown)} is no mechanism; known are {', '.join(MECHANISMS)}.")
    return tuple(name for name in MECHANISMS if name in names)


def uses(mechanism: str) -> bool:
    """Whether a mechanism of MECHANISMS is not switched off."""
    if mechanism not in MECHANISMS:
        raise KeyError(mechanism)
    return mechanism not in list_without()


def trim_settings(settings: Settings) -> Settings:
    """The settings with those of switched-off mechanisms set to False.

    Raises ValueError with a sentence if a name is unknown, or if a cluster is used, whose workers do not inherit the variable.
    """
    if settings.cluster and list_without():
        raise ValueError(f"{VARIABLE}: workers of a cluster do not inherit it; bake without --cluster.")
    off = {field: False for name, field in _OF_SETTINGS.items() if not uses(name)}
    return replace(settings, **off)  # type: ignore[arg-type]


def describe_without() -> str:
    """The warning of a bake without some mechanisms; "" if none is switched off."""
    names = list_without()
    return f"{VARIABLE}: baked without {', '.join(names)}; this is for measuring only, so unset it for a real bake" if names else ""
