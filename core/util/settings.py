"""Every knob of a bake, once: name, default, unit, range and help.

The command line (addon/app/arguments.py) and the panel (addon/app/properties.py) are generated from these fields.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from .encodings import ENCODINGS
from .file_names import DEFAULT_PATTERN, find_pattern_error, has_pass

DEBUG_PASSES = ("leaf_edges", "level", "photons", "charts")  # not light: how the bake came about
PASSES = ("combined", "lighting", "direct", "indirect", "diffuse", "emission", "albedo", "stderr", *DEBUG_PASSES)
IMAGE_FORMATS = ("exr", "hdr", "png", *ENCODINGS)
VIEW_TRANSFORMS = ("standard", "scene")
BASES = ("constant", "linear", "quadratic")
ORACLES = ("significance", "paper")
ERROR_OF = ("bake", "objects")
DIRECT_MODES = ("rays", "photons")
AUTOMATIC, FRONT, BOTH = SIDES = ("automatic", "front", "both")  # which side of a face a lightmap shows

MAX_PAGE_SIZE_TEXELS = 16384


def _knob(
    default: Any,
    help: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    group: str = "Research",
    flag: str = "",
    off_flag: str = "",
    find_error: Callable[[str], str] | None = None,
    label: str = "",
    metavar: str = "N",
    decides_images: bool = True,  # or only how, and where, they are computed
) -> Any:
    return field(default=default, metadata={name: value for name, value in locals().items() if name != "default"})


_ALL_LIGHT_DEPTH = 100  # surfaces


@dataclass(frozen=True)
class Settings:
    """What a user can choose about one bake; frozen, validated when made.

    Raises ValueError with a sentence naming the knob, the value found and the range that holds.
    """

    # Lightmap
    size: int = _knob(
        512, "page size: side of a square page", unit="texels", low=4, high=MAX_PAGE_SIZE_TEXELS, group="Lightmap", label="Page Size"
    )
    density: float = _knob(
        0.0, "density: texels per metre of surface; 0 lets the page size decide", unit="texels/m", low=0.0, high=1e6, group="Lightmap"
    )
    atlas: bool = _knob(
        True, "share a set of pages between all objects, instead of one image per object", group="Lightmap", off_flag="--per-object"
    )
    even_out: bool = _knob(
        True,
        "small objects whose density nobody chose get more of the page than by their area, so that they keep usable texels",
        group="Lightmap",
        off_flag="--no-even-out",
    )
    max_pages: int = _knob(
        0, "shared pages that a bake may make; 0 makes as many as are needed", unit="pages", low=0, high=10_000, group="Lightmap"
    )
    share_meshes: bool = _knob(
        True,
        "objects that share a mesh keep sharing it, each with its own place on a page; off gives each a mesh of its own",
        group="Lightmap",
        off_flag="--own-meshes",
    )
    sides: str = _knob(
        AUTOMATIC,
        "side of a face that its lightmap shows: the front, both added up, or automatic, the back where the front looks into a solid",
        choices=SIDES,
        group="Lightmap",
    )
    padding: int = _knob(4, "least distance between two charts", unit="texels", low=1, high=64, group="Lightmap")
    margin: int = _knob(8, "how far colour runs on beyond a chart's edge", unit="texels", low=0, high=256, group="Lightmap")
    # Output
    passes: tuple[str, ...] = _knob(("combined",), "what the images hold", choices=PASSES, group="Output", flag="--pass")
    formats: tuple[str, ...] = _knob(("exr",), "kinds of file that are written", choices=IMAGE_FORMATS, group="Output", flag="--format")
    value_range: float = _knob(
        0.0, "greatest value an RGBM or RGBD file holds; 0 takes each page's own", low=0.0, high=1e6, group="Output", flag="--range"
    )
    view_transform: str = _knob(
        "standard",
        "how PNG files show light: as plain sRGB, or as the scene's colour management does",
        choices=VIEW_TRANSFORMS,
        group="Output",
        flag="--png-view",
    )
    name_pattern: str = _knob(
        DEFAULT_PATTERN,
        "names of the files: {name} is the object or atlas_page, {pass} and {page} may be used too",
        group="Output",
        metavar="TEXT",
        find_error=find_pattern_error,
    )
    pack: bool = _knob(
        False, "keep the images that the objects show inside the .blend, besides their files", group="Output", decides_images=False
    )
    force: bool = _knob(False, "bake even if nothing has changed since the last bake", group="Output", decides_images=False)
    # Quality
    error: float = _knob(0.05, "relative error at which the bake stops", low=1e-4, high=1.0, group="Quality", label="Target Error")
    error_of: str = _knob(
        "bake",
        "whose error: of the bake as a whole, or of each object by its own brightness, for dim rooms and small things",
        choices=ERROR_OF,
        group="Quality",
    )
    max_photons: int = _knob(64_000_000, "photons after which the bake stops", unit="photons", low=1000, high=10**12, group="Quality")
    time_limit: float = _knob(
        0.0,
        "seconds from the start after which the best light so far is written; 0 is no limit",
        unit="s",
        low=0.0,
        high=1e7,
        group="Quality",
    )
    # Method
    direct: str = _knob(
        "rays", "how direct light is found: shadow rays, or photons as in the paper", choices=DIRECT_MODES, label="Direct Light"
    )
    basis: str = _knob("linear", "functions in each leaf", choices=BASES)
    oracle: str = _knob("significance", "rule that splits a leaf", choices=ORACLES)
    hierarchical: bool = _knob(True, "adaptive leaves; off is a fixed mesh at the finest level, for comparison", off_flag="--flat")
    threshold: float = _knob(0.1, "oracle paper: relative difference to the preview above which a leaf is split", low=0.0, high=10.0)
    stability: int = _knob(8, "photons a node must have been shot to be stable", unit="photons", low=1, high=10**6)
    preview_depth: int = _knob(2, "levels between the current and the preview nodes", unit="levels", low=1, high=3)
    min_level: int = _knob(0, "level every quadtree starts with; 0 is the chart's root", unit="levels", low=0, high=14)
    contact: bool = _knob(
        True,
        "where other geometry touches the surface, or nearly: cut charts, finer leaves, light told apart within texels",
        off_flag="--no-contact",
    )
    denoise: bool = _knob(True, "average grain over like neighbours within a chart", off_flag="--no-denoise", group="Advanced")
    seams: bool = _knob(True, "bring light together where a smooth surface is cut between charts", off_flag="--no-seams", group="Advanced")
    finest_texels: int = _knob(1, "side of the smallest leaf", unit="texels", low=1, high=1024)
    max_depth: int = _knob(1000, "surfaces that light may meet", unit="hits", low=1, high=100_000)
    seed: int = _knob(1, "same seed, same bytes", low=0, high=2**31 - 1, group="Advanced")
    workers: int = _knob(0, "processes that trace; 0 takes one per core", low=0, high=1024, group="Advanced", decides_images=False)
    cluster: str = _knob(
        "",
        "trace on the workers of the dask scheduler at this address, host:port",
        metavar="ADDRESS",
        group="Advanced",
        decides_images=False,
    )

    @property
    def wants_all_light(self) -> bool:
        """Whether the greatest number of bounces is so high that all light is wanted; a lower one is a deliberate limit."""
        return self.max_depth >= _ALL_LIGHT_DEPTH

    def __post_init__(self) -> None:
        for knob in dataclasses.fields(self):
            error = _range_error(knob, getattr(self, knob.name))
            if error:
                raise ValueError(error)
        if len(self.passes) > 1 and not has_pass(self.name_pattern):
            raise ValueError(f"name_pattern: expected {{pass}} in it, for there are {len(self.passes)} passes, got {self.name_pattern!r}")


def _range_error(knob: dataclasses.Field[Any], value: Any) -> str:
    choices, low, high = knob.metadata["choices"], knob.metadata["low"], knob.metadata["high"]
    if knob.metadata["find_error"]:
        error = knob.metadata["find_error"](value)
        return f"{knob.name}: {error}" if error else ""
    if isinstance(knob.default, tuple) and (not isinstance(value, tuple) or not value):
        return f"{knob.name}: expected at least one of {', '.join(choices)}, as a tuple, got {value!r}"
    if choices:
        unknown = [one for one in (value if isinstance(value, tuple) else (value,)) if one not in choices]
        return f"{knob.name}: expected one of {', '.join(choices)}, got {unknown[0]!r}" if unknown else ""
    if low is None or isinstance(value, bool):
        return ""
    if not math.isfinite(value) or not low <= value <= high:
        unit = f" {knob.metadata['unit']}" if knob.metadata["unit"] else ""
        return f"{knob.name}: expected {low:g} to {high:g}{unit}, got {value:g}"
    return ""
