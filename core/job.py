"""The folder in which a bake is handed over: what lies in it, and the job itself.

SNAPSHOT_FILE and JOB_FILE are there when the bake starts, LAYOUT_FILE and RESULT_FILE when it is done.
"""

from __future__ import annotations

import dataclasses
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .settings import Settings

SNAPSHOT_FILE = "snapshot.npz"
JOB_FILE = "job.json"
LAYOUT_FILE = "layout.npz"  # tri_uv (n_tri, 3, 2) in [0, 1], tri_chart (n_tri,), object_page (n_object,)
RESULT_FILE = "result.json"

MAX_NAME_BYTES = 180  # of an object in a file's name: systems allow 255 in all, and Blender as many for the object


@dataclass(frozen=True)
class Job:
    """What to bake besides the scene itself.

    output       folder of the images
    atlas_name   file name of shared pages, without page number
    """

    settings: Settings
    output: str
    atlas_name: str

    def save(self, folder: Path) -> None:
        (folder / JOB_FILE).write_text(json.dumps(dataclasses.asdict(self)), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> Job:
        """The job in `folder`.

        Raises OSError where there is none, ValueError with a sentence where it is damaged.
        """
        path = folder / JOB_FILE
        text = path.read_text(encoding="utf-8")
        try:
            fields: dict[str, Any] = json.loads(text)
            knobs: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in fields["settings"].items()}
            return cls(Settings(**knobs), fields["output"], fields["atlas_name"])
        except (KeyError, TypeError, AttributeError, ValueError) as reason:
            raise ValueError(f"{path}: is no Leaflight job or is damaged ({reason}); start the bake again.") from reason


def make_file_name(name: str) -> str:
    """The name, or what is nearest to it that every system allows."""
    short = name.encode()[:MAX_NAME_BYTES].decode(errors="ignore")
    return re.sub(r'[<>:"/\\|?*\x00-\x1f]', "_", short).strip(". ") or "_"
