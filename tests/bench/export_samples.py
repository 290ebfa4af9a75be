"""Sample scenes as the core gets them, exported by the add-on under pip's bpy.

python tests/bench/export_samples.py FOLDER NAME[:OBJECT,...] ...     writes FOLDER/NAME.npz and FOLDER/NAME.camera.json
"""

import json
import subprocess
import sys
from pathlib import Path

SAMPLES = Path(__file__).resolve().parents[2] / "sample_blends"


def export_samples(folder: Path, *scenes: str) -> None:
    """Export in a process of its own: bpy would be loaded again by every worker of this one.

    scenes   names of samples, each with the objects that get a lightmap after a colon, if not all of them do
    """
    subprocess.run([sys.executable, __file__, str(folder), *scenes], check=True, stdout=subprocess.DEVNULL)


def main(folder: Path, scenes: list[str]) -> None:
    """What export_samples runs."""
    import bpy
    from leaflight.addon.read.export_scene import export_scene
    from leaflight.core.scene.snapshot import save_snapshot

    for name, _, objects in (scene.partition(":") for scene in scenes):
        bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{name}.blend"))
        exported = export_scene(bpy.context, objects.split(",") if objects else None)
        save_snapshot(folder / f"{name}.npz", exported.snapshot)
        camera = bpy.context.scene.camera
        view = {"matrix": [list(row) for row in camera.matrix_world], "angle_rad": camera.data.angle_x}
        (folder / f"{name}.camera.json").write_text(json.dumps(view), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
