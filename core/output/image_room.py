"""Disk space for images: a warning before the bake where it is short, and another folder where writing fails at the end."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..atlas.charts import ChartAtlas
from ..util.job import Job
from ..util.settings import DEBUG_PASSES
from .pages import PageFile

SPARE_PREFIX = "leaflight_images_"
_LEAST_PART = 0.1  # of the room that numbers take as they are: no compression makes less of light
_BYTES = {"exr": 8}  # a texel; of others 4
_BYTES_FULL = 16  # of debug passes in EXR


def count_bytes(job: Job, page_count: int, page_size: int) -> int:
    """What the images take where nothing compresses them."""
    settings = job.settings
    per_texel = sum(
        _BYTES_FULL if kind == "exr" and name in DEBUG_PASSES else _BYTES.get(kind, 4)
        for name in settings.passes
        for kind in settings.formats
    )
    return page_count * page_size**2 * per_texel


def find_lack(job: Job, atlas: ChartAtlas, names: list[str]) -> str:
    """A sentence where the images of a bake may find too little room in the output folder, "" where there is enough.

    names   of the files; those that are there already make room
    Raises OSError with a sentence where they can find none.
    """
    folder = Path(job.output)
    try:
        free = shutil.disk_usage(folder).free + sum(file.stat().st_size for name in names if (file := folder / name).is_file())
    except OSError:  # a file system that does not say
        return ""
    wanted = count_bytes(job, atlas.page_count, atlas.page_size)
    found = f"{folder}: has room for {_describe_bytes(free)}, and the images may take {_describe_bytes(wanted)}"
    if free < _LEAST_PART * wanted:
        raise OSError(f"{found}; make room, choose another output folder, or a smaller page size.")
    return f"{found}; make room while the light is computed, or choose another output folder" if free < wanted else ""


def write_somewhere(job: Job, temporary: Path, write: Callable[[Job], list[PageFile]]) -> tuple[list[PageFile], str, str]:
    """The files that `write` made in the output folder, or in a spare one where it cannot: with that folder and a sentence, else "".

    temporary   folder in which a spare one is made; the home folder is the next
    write       gives the files of a job with another output folder too
    Raises OSError where they can be written nowhere.
    """
    folder = Path(job.output)
    try:
        folder.mkdir(parents=True, exist_ok=True)  # it may have been deleted meanwhile
        return write(job), "", ""
    except OSError as failed:
        for place in (temporary, Path.home()):
            try:
                spare = Path(tempfile.mkdtemp(prefix=SPARE_PREFIX, dir=place))
            except OSError:
                continue
            try:
                files = write(replace(job, output=str(spare)))
            except OSError:
                shutil.rmtree(spare, ignore_errors=True)
                continue
            why = str(failed.strerror or failed).removesuffix(".")
            why = why if str(folder) in why else f"{folder}: the images cannot be written there ({why})"
            return files, str(spare), f"{why}. They are safe in {spare}, as long as the computer runs"
        raise


def _describe_bytes(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.0f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"
