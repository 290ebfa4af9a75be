"""Report on a bake's objects, cost and memory."""

import sys
from typing import Any

import numpy as np

from ..atlas.charts import ChartAtlas
from ..integrate.light_field import LightField
from ..scene.scene import SceneSnapshot
from ..util.ablation import list_without
from ..util.arrays import Float32, Int32


def list_objects(
    snapshot: SceneSnapshot, atlas: ChartAtlas, entry_object: Int32, error: dict[int, float], lighting: Float32
) -> list[dict[str, Any]]:
    """Report on each object that receives light.

    entry_object   (n,) int32: the object of each texel entry
    error          LightField.object_error
    lighting       (n,) float32, W/m^2/sr: the pass `lighting` of each texel entry, mean of channels
    """
    texel_count = np.bincount(entry_object, minlength=len(snapshot.objects))
    chart_count = np.bincount(atlas.chart_object, minlength=len(snapshot.objects))
    lit = np.bincount(entry_object, weights=lighting > 0.0, minlength=len(snapshot.objects))
    total = np.bincount(entry_object, weights=lighting, minlength=len(snapshot.objects))
    return [
        {
            "name": one.name,
            "page": int(atlas.object_page[i]),
            "texels": int(texel_count[i]),
            "share": float(texel_count[i] / max(texel_count.sum(), 1)),
            "charts": int(chart_count[i]),
            "estimated_error": error.get(i),
            "lighting": float(total[i] / max(lit[i], 1.0)),
        }
        for i, one in enumerate(snapshot.objects)
        if one.receives
    ]


def describe_light(light: LightField) -> dict[str, Any]:
    """Cost and stated error of the light."""
    direct, ledger, without = light.direct.counters, light.ledger, list_without()
    return {
        **({"without": without} if without else {}),
        "photons": light.photons,
        "rounds": light.rounds,
        "rays": ledger.rays + ledger.gathered + direct.get("rays", 0),
        "direct": direct,
        "gathered": light.gathered.counters if light.gathered else {},
        "leaves": len(light.leaves),
        "nodes": len(light.tree),
        "estimated_error": light.error,
        "stopped_by": light.stopped_by,
        "energy_audit_w": ledger.audit_w(),
    }


def measure_memory_mb() -> dict[str, float]:
    """Peak resident memory of this process and of its largest worker, MB; empty if the system does not provide it."""
    if sys.platform == "win32":
        return {}
    import resource  # not on Windows

    unit = 1e6 if sys.platform == "darwin" else 1e3  # macOS counts bytes, Linux kilobytes
    who = {"core": resource.RUSAGE_SELF, "worker": resource.RUSAGE_CHILDREN}
    return {name: round(resource.getrusage(usage).ru_maxrss / unit, 1) for name, usage in who.items()}
