"""Use of earlier bakes' notes: whose images a bake must not overwrite, and which old pages it leaves behind."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..output.image_file import suffix_of
from ..output.pages import PageFile, find_first_page
from ..util.digest import hash_file
from ..util.file_names import clean_name, fill_pattern
from ..util.job import Job
from .bake_cache import find_note, read_header

_NAMED = 3  # files in one line


@dataclass(frozen=True)
class NotedBake:
    """A bake that noted its images, all of them in the folder of the note.

    note    path of the note
    blend   the .blend that was baked, None if it is not known
    files   name -> digest of the content as written
    """

    note: Path
    blend: Path | None
    files: dict[str, str]

    def holds(self, name: str) -> bool:
        """Whether `name` is a file of this bake that is still as it was written."""
        path = self.note.parent / name
        try:
            return name in self.files and path.is_file() and hash_file(path) == self.files[name]
        except OSError:
            return False


def read_notes(folder: Path) -> list[NotedBake]:
    """The bakes noted in a folder; damaged notes are left out."""
    found = []
    for note in sorted(folder.glob(".leaflight_*.npz")):
        header = read_header(note) or {}
        try:
            rows = zip(header["result"]["files"], header["contents"], strict=True)
            files = {str(file["path"]): str(content) for file, content in rows}
            blend = Path(os.path.normpath(folder / header["blend"])) if header["blend"] else None
            found.append(NotedBake(note, blend, {name: content for name, content in files.items() if name == Path(name).name}))
        except (KeyError, TypeError, ValueError):
            continue
    return found


def find_others(job: Job, names: Sequence[str]) -> dict[Path, list[str]]:
    """Those of the files `names` in a job's output folder that are images of other .blend files which still exist; by .blend."""
    others: dict[Path, list[str]] = {}
    for bake in read_notes(Path(job.output)):
        held = [name for name in names if bake.holds(name)] if _is_another(bake.blend, job) else []
        if bake.blend and held:
            others.setdefault(bake.blend, []).extend(held)
    return others


def _is_another(blend: Path | None, job: Job) -> bool:
    return blend is not None and blend.is_file() and blend != (Path(job.blend).resolve() if job.blend else None)


def refuse_others(job: Job, names: Sequence[str]) -> None:
    """Raises ValueError with a sentence if images of another .blend would be overwritten."""
    for blend, held in find_others(job, names).items():
        raise ValueError(
            f"{blend.name} has its lightmaps in this folder, and this bake would overwrite {name_some(held)} in {job.output}. "
            "Choose another folder; or delete these images first, if that file no longer needs them."
        )


def find_left_over(job: Job, files: Sequence[PageFile], page_count: int) -> list[str]:
    """Files named like further pages of this bake, which an earlier one with more pages left; it is unknown who uses them."""
    if not job.settings.atlas:  # an image of an object that is not baked this time is no further page
        return []
    others = [bake for bake in read_notes(Path(job.output)) if bake.note != find_note(job) or _is_another(bake.blend, job)]
    kinds = sorted({(file.pass_name, file.kind) for file in files})
    first = find_first_page(job, page_count)
    further = [name for kind in kinds for name in _list_further(job, *kind, first + page_count)]
    return [name for name in further if name not in job.taken and not any(one.holds(name) for one in others)]


def describe_left_over(job: Job, names: Sequence[str]) -> list[str]:
    """A sentence about the left-over files that the last bake has not reported."""
    header = read_header(find_note(job)) or {}
    noted = header.get("left_over", [])
    new = [name for name in names if name not in noted]
    return (
        [f"{name_some(new)} in {job.output}: old lightmap from an earlier bake; you can delete it if no other file uses it"] if new else []
    )


def _list_further(job: Job, pass_name: str, kind: str, page_count: int) -> list[str]:
    """Existing files with the names of pages from `page_count` on, up to the first gap in their numbers."""
    names: list[str] = []
    for page in itertools.count(page_count):
        stem = fill_pattern(job.settings.name_pattern, f"{clean_name(job.atlas_name)}_{page}", pass_name, page)
        name = f"{stem}{suffix_of(kind)}"
        if not (Path(job.output) / name).is_file():
            break
        names.append(name)
    return names


def name_some(names: Sequence[str]) -> str:
    """The names of the first files, and the number of the others."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"
