"""Writes pages as image files: every pass in every requested format, and their entries in the report."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..atlas.charts import ChartAtlas
from ..scene.scene import SceneSnapshot
from ..util.arrays import Float32
from ..util.file_names import clean_name, fill_pattern, make_unique
from ..util.job import VIEWS_FOLDER, Job
from ..util.settings import DEBUG_PASSES, PASSES, Settings
from . import image_file

_FLOAT_MAX = float(np.finfo(np.float32).max)
_MOST_PAGES = 1000  # page numbers that are compared with taken names
_ENCODING = {"exr": "linear, half float", "hdr": "linear, shared exponent", "png": "sRGB"}

Page = Float32


@dataclass(frozen=True)
class PageFile:
    """One image file: a page of a pass.

    objects    indices into the snapshot's objects
    encoding   how its numbers encode light
    range      the greatest value that the file can hold
    maximum    the greatest value of the page, which may exceed the range
    linear     EXR from which Blender makes the file by the scene's view transform; "" if the file is written already
    """

    path: str
    pass_name: str
    kind: str
    page: int
    objects: list[int]
    encoding: str
    range: float
    maximum: float
    linear: str = ""


def write_pages(
    job: Job,
    folder: Path,
    snapshot: SceneSnapshot,
    atlas: ChartAtlas,
    metadata: dict[str, str | int | float],
    draw: Callable[[str, int, bool], Page],
) -> list[PageFile]:
    """Write all files of a bake; if one fails, all are removed.

    folder   folder of the job, for files that Blender is to finish
    draw     returns a page, given pass, page number, and whether the look of a debug pass is wanted
    """
    settings = job.settings
    files: list[PageFile] = []
    try:
        for page, name, stem in _list_stems(job, snapshot, atlas):
            owners = np.flatnonzero(atlas.object_page == page).tolist()
            pixels = draw(name, page, False)
            maximum = _find_maximum(pixels)
            for kind in settings.formats:
                shown = draw(name, page, True) if kind == "png" and name in DEBUG_PASSES else pixels
                path = Path(job.output) / f"{stem}{image_file.suffix_of(kind)}"
                encoding, greatest, linear = _write_file(settings, folder, path, name, kind, shown, metadata)
                files.append(PageFile(str(path), name, kind, page, owners, encoding, greatest, maximum, linear))
    except (OSError, ValueError):
        for file in files:  # half of the images could be taken for a whole bake
            Path(file.path).unlink(missing_ok=True)
        raise
    return files


def list_names(job: Job, snapshot: SceneSnapshot, atlas: ChartAtlas) -> list[str]:
    """Names of all files of a bake."""
    stems = _list_stems(job, snapshot, atlas)
    return [f"{stem}{image_file.suffix_of(kind)}" for _, _, stem in stems for kind in job.settings.formats]


def _list_stems(job: Job, snapshot: SceneSnapshot, atlas: ChartAtlas) -> list[tuple[int, str, str]]:
    """Page, pass, and name without suffix of every image."""
    first, taken = find_first_page(job, atlas.page_count), _list_taken(job)
    names = name_pages(job, snapshot, atlas, first)
    images = [(page, name) for page in range(atlas.page_count) for name in job.settings.passes]
    unique = make_unique((fill_pattern(job.settings.name_pattern, names[page], name, first + page) for page, name in images), taken)
    return [(page, name, stem) for (page, name), stem in zip(images, unique, strict=True)]


def _write_file(
    settings: Settings, folder: Path, path: Path, name: str, kind: str, pixels: Page, metadata: dict[str, str | int | float]
) -> tuple[str, float, str]:
    """Write one file; returns PageFile's encoding, range and linear."""
    debug = name in DEBUG_PASSES
    if kind == "png" and settings.view_transform == "scene" and not debug:
        linear = folder / VIEWS_FOLDER / f"{path.stem}.exr"
        linear.parent.mkdir(exist_ok=True)
        image_file.write_image(linear, pixels, {}, "exr")
        return "the scene's view transform", 1.0, str(linear)
    full = debug and kind == "exr"  # counts may exceed half floats
    image_file.write_image(path, pixels, {"leaflight:pass": name, **metadata}, kind, settings.value_range, full)
    if full:
        return "linear, float", _FLOAT_MAX, ""
    encoding = "a picture, sRGB" if debug and kind == "png" else _ENCODING.get(kind, kind)
    return encoding, image_file.range_of(pixels, kind, settings.value_range), ""


def _find_maximum(pixels: Page) -> float:
    # Whole texels are reduced first: numpy is slow on three of four channels.
    by_column: Page = pixels.max(axis=0, initial=0.0)
    return float(by_column[:, :3].max(initial=0.0))


def find_first_page(job: Job, page_count: int) -> int:
    """Number of the bake's first shared page, so that none of its pages, in any pass, has the name of a taken image."""
    taken = set(_list_taken(job))

    def is_taken(page: int) -> bool:
        name = f"{clean_name(job.atlas_name)}_{page}"
        return any(fill_pattern(job.settings.name_pattern, name, one, page) in taken for one in PASSES)

    last = max((page for page in range(_MOST_PAGES) if is_taken(page)), default=-1) if taken else -1
    free = (first for first in range(last + 1) if not any(is_taken(first + page) for page in range(page_count)))
    return next(free, last + 1)


def _list_taken(job: Job) -> list[str]:
    """Names of the taken images without suffixes."""
    return [Path(name).stem for name in job.taken]


def name_pages(job: Job, snapshot: SceneSnapshot, atlas: ChartAtlas, first: int = 0) -> list[str]:
    """One name for each page, unique even if objects' names differ only in characters that file names cannot have."""
    names: list[str] = []
    for page in range(atlas.page_count):
        owners = np.flatnonzero(atlas.object_page == page)
        alone = not job.settings.atlas and len(owners) == 1
        names.append(clean_name(snapshot.objects[owners[0]].name) if alone else f"{clean_name(job.atlas_name)}_{first + page}")
    return make_unique(names)
