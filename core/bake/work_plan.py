"""Parts of the light that a bake must find, and a report of what it skips."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..atlas.charts import ChartAtlas
from ..integrate.light_field import LightField
from ..scene.materials import SurfaceMaterials
from ..scene.scene import SceneSnapshot
from ..util.settings import Settings

SURFACE_PASSES = ("albedo", "emission")


@dataclass(frozen=True)
class WorkPlan:
    """The light that a bake must find.

    direct     whether any image shows light
    indirect   whether any image shows reflected light
    photons    whether photons are traced
    """

    direct: bool
    indirect: bool
    photons: bool

    @classmethod
    def of(cls, settings: Settings, surfaces: SurfaceMaterials) -> WorkPlan:
        lit = set(settings.passes) - set(SURFACE_PASSES)
        indirect = bool(lit - {"direct"}) and surfaces.reflects and settings.max_depth > 1
        return cls(bool(lit), indirect, indirect or (bool(lit) and settings.direct == "photons"))

    def trim(self, settings: Settings) -> Settings:
        """The settings with photons limited to the bounces that the images need."""
        return settings if self.indirect else replace(settings, max_depth=1)


def count_skipped(
    needs: WorkPlan,
    pruned: Mapping[str, int],
    snapshot: SceneSnapshot,
    atlas: ChartAtlas,
    light: LightField,
    settings: Settings,
    known_charts: int,
) -> dict[str, int]:
    """The report's "skipped".

    pruned         counts from pruning.prune_scene
    known_charts   count from chart_cache.ChartCache
    """
    counters, objects = light.direct.counters, snapshot.objects
    emits = np.array([any(material.emission_rgb) for material in snapshot.materials], bool)[snapshot.tri_material]
    shows = np.bincount(snapshot.tri_object, emits, len(objects)) > 0
    roots = np.flatnonzero(light.tree.parent < 0)
    reached = np.unique(light.tree.chart[roots[light.received[roots] > 0]])
    return {
        "bake": 0,
        **pruned,
        "objects_without_effect": sum(not (one.receives or one.casts_shadow or shows[i]) for i, one in enumerate(objects)),
        "objects_not_unwrapped": sum(one.has_layer for one, page in zip(objects, atlas.object_page, strict=True) if page >= 0),
        "objects_unwrapped_before": known_charts,
        "direct_light": int(not needs.direct),
        "indirect_light": int(not needs.indirect),
        "photons": settings.max_photons - light.photons if light.stopped_by == "error" else 0,
        "charts_without_photons": len(atlas.chart_object) - len(reached) if needs.photons else len(atlas.chart_object),
        "pairs_out_of_reach": counters.get("out_of_reach", 0),  # pairs of a texel and a light, see integrate.direct
        "pairs_settled_early": counters.get("settled", 0),
        "pairs_shared": counters.get("shared", 0),
        "pairs_sampled_together": counters.get("sampled", 0),
    }
