"""What earlier bakes noted beside their images: whose those are that a bake writes over, and which pages it leaves over."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from .file_names import clean_name, fill_pattern
from .identity import hash_file
from .image_file import suffix_of
from .job import Job
from .kept_bake import find_note, read_header
from .pages import PageFile

_NAMED = 3  # files in one line


@dataclass(frozen=True)
class NotedBake:
    """A bake that noted its images, all of them in the folder of the note.

    note    the file
    blend   the .blend that was baked, None where that is not known
    pages   whether they are pages that objects share
    files   name -> (pass, kind, digest as it was written)
    """

    note: Path
    blend: Path | None
    pages: bool
    files: dict[str, tuple[str, str, str]]

    def holds(self, name: str) -> bool:
        """Whether a file is still as it was written. Nothing is said of a link, which stands for a file elsewhere."""
        path = self.note.parent / name
        try:
            return name in self.files and not path.is_symlink() and path.is_file() and hash_file(path) == self.files[name][2]
        except OSError:
            return False


def read_notes(folder: Path) -> list[NotedBake]:
    """The bakes noted in a folder, less what is damaged."""
    found = []
    for note in sorted(folder.glob(".leaflight_*.npz")):
        header = read_header(note) or {}
        try:
            rows = zip(header["result"]["files"], header["contents"], strict=True)
            files = {str(file["path"]): (str(file["pass_name"]), str(file["kind"]), str(content)) for file, content in rows}
            blend = Path(os.path.normpath(folder / header["blend"])) if header["blend"] else None
            found.append(
                NotedBake(note, blend, bool(header["pages"]), {name: told for name, told in files.items() if name == Path(name).name})
            )
        except (KeyError, TypeError, ValueError):
            continue
    return found


def find_others(job: Job, names: Sequence[str]) -> dict[Path, list[str]]:
    """Which of the files `names` of a job's folder are images of other .blend files that are still there, by .blend."""
    own = Path(job.blend).resolve() if job.blend else None
    others: dict[Path, list[str]] = {}
    for bake in read_notes(Path(job.output)):
        if bake.blend is None or bake.blend == own or not bake.blend.is_file():
            continue
        held = [name for name in names if bake.holds(name)]
        if held:
            others.setdefault(bake.blend, []).extend(held)
    return others


def describe_others(job: Job, names: Sequence[str]) -> list[str]:
    """A sentence for each of them."""
    return [
        f"{name_some(held)} in {job.output}: of the bake of {blend}, which this one writes over; choose another output folder, or bake "
        "that file again into one of its own"
        for blend, held in find_others(job, names).items()
    ]


@dataclass(frozen=True)
class LeftOver:
    """Files that are called like further pages of a bake, and are none of it.

    own        written by the last bake of the same name and .blend, and still as they were written
    doubtful   of which that is not known
    """

    own: list[str]
    doubtful: list[str]


def find_left_over(job: Job, files: Sequence[PageFile], page_count: int) -> LeftOver:
    """What is left of an earlier bake with more shared pages, once the files of a bake are written and before it is noted."""
    if not job.settings.atlas:  # an image of an object that is not baked this time is nobody's further page
        return LeftOver([], [])
    folder, blend = Path(job.output), Path(job.blend).resolve() if job.blend else None
    written = {Path(file.path).name.lower() for file in files}
    kinds = {(file.pass_name, file.kind) for file in files}
    notes = read_notes(folder)
    earlier = [bake for bake in notes if bake.note == find_note(job) and bake.pages and blend is not None and bake.blend == blend]
    others = {name for bake in notes if bake not in earlier for name in bake.files}
    noted = [name for bake in earlier for name, (*kind, _) in bake.files.items() if tuple(kind) in kinds]
    called = [name for kind in sorted(kinds) for name in _list_further(job, *kind, page_count)]
    found = [name for name in dict.fromkeys(noted + called) if name.lower() not in written and os.path.lexists(folder / name)]
    own = [name for name in found if name not in others and any(bake.holds(name) for bake in earlier)]
    return LeftOver([str(folder / name) for name in own], [str(folder / name) for name in found if name not in own])


def _list_further(job: Job, pass_name: str, kind: str, page_count: int) -> list[str]:
    """Files that are called like pages from `page_count` on; an earlier bake wrote them without a gap."""
    names: list[str] = []
    while not names or (Path(job.output) / names[-1]).is_file():
        page = page_count + len(names)
        stem = fill_pattern(job.settings.name_pattern, f"{clean_name(job.atlas_name)}_{page}", pass_name, page)
        names.append(f"{stem}{suffix_of(kind)}")
    return names[:-1]


def name_some(names: Sequence[str]) -> str:
    """The first of the files, and how many more there are."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"
