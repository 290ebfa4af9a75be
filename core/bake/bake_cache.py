"""Notes of finished bakes beside their images, so that the same bake need not be done again.

A note is a hidden .npz in the folder of the images: the arrays of the layout file, and a JSON header.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.scene import SceneSnapshot
from ..scene.snapshot import hash_bake
from ..util.digest import hash_file
from ..util.file_names import clean_name
from ..util.files import load_arrays, parse_json, save_whole
from ..util.job import LAYOUT_FILE, RESULT_FILE, Job
from .note_check import fits_scene, is_sound

FORMAT = "leaflight-kept-bake"
_HEADER = "header"


@dataclass(frozen=True)
class KeptBake:
    """A bake whose images are still as they were written.

    result     result of the bake, with the present paths of its files
    warnings   (subject, sentence) of the core
    layout     arrays of the layout file
    stateless  whether a state was requested but the bake had none to keep; repeated, it would have none either
    """

    result: dict[str, Any]
    warnings: tuple[tuple[str, str], ...]
    layout: dict[str, NDArray[Any]]
    stateless: bool = False

    def restore(self, folder: Path) -> None:
        """Write into a job's folder the files that the bake would leave there.

        Raises OSError if they cannot be written.
        """
        save_whole(folder / LAYOUT_FILE, self.layout)
        (folder / RESULT_FILE).write_text(json.dumps(self.result), encoding="utf-8")


def find_note(job: Job) -> Path:
    """Path of a job's note."""
    part = "+" if job.taken else ""  # a bake of some objects does not replace the note of the others
    return Path(job.output) / f".leaflight_{clean_name(job.atlas_name)}{part}.npz"


def note_bake(
    folder: Path,
    snapshot: SceneSnapshot,
    job: Job,
    result: dict[str, Any],
    warnings: Sequence[tuple[str, str]],
    stateless: bool = False,
    left_over: Sequence[str] = (),
) -> None:
    """Note a bake whose files are written and whose layout is in `folder`.

    stateless   see KeptBake
    left_over   names of an earlier bake's images that were reported; the next bake does not report them again
    Raises OSError if the note cannot be written.
    """
    files = [{**file, "path": Path(file["path"]).relative_to(job.output).as_posix()} for file in result["files"]]
    header = {
        "format": FORMAT,
        "bake": hash_bake(snapshot, job),
        "contents": [hash_file(Path(file["path"])) for file in result["files"]],
        "result": {**result, "files": files},
        "warnings": list(warnings),
        "stateless": stateless,
        "left_over": list(left_over),
        "blend": _find_blend(job),
    }
    with np.load(folder / LAYOUT_FILE) as layout:
        arrays = {name: layout[name] for name in layout.files}
    arrays[_HEADER] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    save_whole(find_note(job), arrays)


def _find_blend(job: Job) -> str:
    """Path of the .blend relative to its images, so that both may be moved together; "" if there is none."""
    if not job.blend:
        return ""
    blend = Path(job.blend).resolve()
    try:
        return Path(os.path.relpath(blend, Path(job.output).resolve())).as_posix()
    except ValueError:  # another drive
        return str(blend)


def read_header(note: Path) -> dict[str, Any] | None:
    """Header of a note; None if it is missing or damaged."""
    found = _read_note(note)
    return None if found is None else found[0]


def find_kept_bake(snapshot: SceneSnapshot, job: Job) -> KeptBake | None:
    """The noted bake that this job would repeat; None if there is none, or if one of its files is missing or altered."""
    found = _read_note(find_note(job))
    if found is None:  # the bake is then done again
        return None
    header, layout = found
    if header.get("bake") != hash_bake(snapshot, job) or not (is_sound(header) and fits_scene(layout, snapshot, header["result"]["pages"])):
        return None
    result = header["result"]
    try:
        for file, content in zip(result["files"], header["contents"], strict=True):
            file["path"] = str(Path(job.output) / file["path"])
            if hash_file(Path(file["path"])) != content:
                return None
    except (OSError, ValueError):
        return None
    seconds = dict.fromkeys(result["seconds"], 0.0)
    skipped = {**result["skipped"], "bake": 1}
    warnings = tuple((subject, text) for subject, text in header["warnings"])
    return KeptBake({**result, "seconds": seconds, "skipped": skipped}, warnings, layout, header["stateless"])


def _read_note(note: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]] | None:
    """Header and layout of a note, whose content is not trusted; None if it is missing or damaged."""
    try:
        arrays = load_arrays(note)
        header = parse_json(arrays.pop(_HEADER).tobytes())
        return (header, arrays) if header["format"] == FORMAT else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
