"""Disk space for images: a warning before the bake if it is short, and another folder if writing fails at the end."""

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
_LEAST_PART = 0.1  # of the uncompressed size; no compression of light reaches this
_BYTES = {"exr": 8}  # per texel; 4 for others
_BYTES_FULL = 16  # per texel, for debug passes in EXR


def count_bytes(job: Job, page_count: int, page_size: int) -> int:
    """Size of the images without compression."""
    settings = job.settings
    per_texel = sum(
        _BYTES_FULL if kind == "exr" and name in DEBUG_PASSES else _BYTES.get(kind, 4)
        for name in settings.passes
        for kind in settings.formats
    )
    return page_count * page_size**2 * per_texel


def find_lack(job: Job, atlas: ChartAtlas, names: list[str]) -> str:
    """A sentence if the output folder may have too little room for the images, else "".

    names   names of the files; existing ones are overwritten, which frees their room
    Raises OSError with a sentence if there certainly is too little room.
    """
    folder = Path(job.output)
    try:
        free = shutil.disk_usage(folder).free + sum(file.stat().st_size for name in names if (file := folder / name).is_file())
    except OSError:  # the file system does not report it
        return ""
    wanted = count_bytes(job, atlas.page_count, atlas.page_size)
    found = f"{folder}: has room for {_describe_bytes(free)}, and the images may take {_describe_bytes(wanted)}"
    if free < _LEAST_PART * wanted:
        raise OSError(f"{found}; make room, choose another output folder, or a smaller page size.")
    return f"{found}; make room while the light is computed, or choose another output folder" if free < wanted else ""


def write_somewhere(job: Job, temporary: Path, write: Callable[[Job], list[PageFile]]) -> tuple[list[PageFile], str, str]:
    """Write images into the output folder, or into a spare folder if that fails. Returns the files, the spare folder and a sentence about
    it, or "" for these.

    temporary   folder in which a spare one is made; if that fails too, the home folder
    write       writes the files of a job and returns them
    Raises OSError if they cannot be written anywhere.
    """
    folder = Path(job.output)
    try:
        folder.mkdir(parents=True, exist_ok=True)  # the folder may have been deleted meanwhile
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
