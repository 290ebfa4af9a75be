"""The folder of a bake: its files, and the job.

SNAPSHOT_FILE and JOB_FILE exist when the bake starts, LAYOUT_FILE before there is any light, RESULT_FILE when it is done.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .settings import Settings

SNAPSHOT_FILE = "snapshot.npz"
JOB_FILE = "job.json"
LAYOUT_FILE = "layout.npz"  # tri_uv (n_tri, 3, 2) in [0, 1], tri_chart (n_tri,), object_page, _block and _place as in charts.ChartAtlas
RESULT_FILE = "result.json"
VIEWS_FOLDER = "views"  # linear images to which Blender applies the scene's view transform, see pages.PageFile


@dataclass(frozen=True)
class Job:
    """The parameters of a bake besides the scene.

    output       folder of the images
    atlas_name   file name of shared pages, without page number
    preview      whether preview pages are written during the bake, see bake.preview
    resume       folder with the state of an earlier bake to continue, "" for none; see checkpoint
    keep         folder in which the state is kept at the end, "" for none
    keep_mb      greatest size of a state that is kept, 0 for any
    blend        path of the .blend that is baked, "" if it has none; see earlier_bakes
    taken        names of images in `output` that objects show which are not baked now: no page gets one of these names
    began        time.monotonic() of the request for the bake, 0 for now; see deadline
    after_s      seconds that Blender will take to show and save the images
    """

    settings: Settings
    output: str
    atlas_name: str
    preview: bool = False
    resume: str = ""
    keep: str = ""
    keep_mb: int = 0
    blend: str = ""
    taken: tuple[str, ...] = ()
    began: float = 0.0
    after_s: float = 0.0

    def save(self, folder: Path) -> None:
        (folder / JOB_FILE).write_text(json.dumps(dataclasses.asdict(self)), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> Job:
        """Read the job in `folder`.

        Raises OSError if there is none, ValueError with a sentence if it is damaged.
        """
        path = folder / JOB_FILE
        text = path.read_text(encoding="utf-8")
        try:
            fields: dict[str, Any] = json.loads(text)
            knobs: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in fields["settings"].items()}
            return cls(**(fields | {"settings": Settings(**knobs), "taken": tuple(fields["taken"])}))
        except (KeyError, TypeError, AttributeError, ValueError) as reason:
            raise ValueError(f"{path}: is no Leaflight job or is damaged ({reason}); start the bake again.") from reason
