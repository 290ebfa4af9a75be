"""Objects that a bake found no light on, named with the reason."""

from __future__ import annotations

import numpy as np

from ..integrate.light_field import LightField
from ..scene.dark_places import describe_dark
from ..scene.light_probe import LightProbe
from ..scene.scene import SceneSnapshot
from ..texels.texel_map import TexelMap


def name_dark(snapshot: SceneSnapshot, texels: TexelMap, light: LightField) -> list[tuple[str, str]]:
    """(name, sentence) of each object with texels of which none has any light, nor would any get some by more photons."""
    if light.stopped_by == "interrupted":
        return []
    texel_object = snapshot.tri_object[texels.texel_tri]
    is_dark = np.zeros(len(snapshot.objects), bool)
    is_dark[texel_object] = True
    is_dark[texel_object[light.direct.irradiance.any(axis=1)]] = False
    lit = light.leaves[light.solution.flux[:, light.leaves].any(axis=0)]
    is_dark[texel_object[light.tree.start[lit]]] = False
    dark = np.flatnonzero(is_dark)
    return describe_dark(LightProbe(snapshot), dark.tolist()) if len(dark) else []
