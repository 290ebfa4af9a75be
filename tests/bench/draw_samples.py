"""Pictures for docs/samples: each sample baked with the defaults, and seen through its own camera by the baked light alone.

python tests/bench/draw_samples.py [NAME ...]     needs pip's bpy, whose Cycles draws the views; about a minute for all
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "docs" / "samples"
WIDTH, HEIGHT, VIEW_SAMPLES = 640, 480, 16


def bake(scene: Path, folder: Path) -> None:
    """Bake with the defaults; leaves SCENE.blend, its images and report.json in the folder."""
    command = [sys.executable, "-m", "leaflight", "bake", str(scene), "--output", str(folder), "--format", "exr", "png"]
    subprocess.run([*command, "--save", str(folder / scene.name), "--report", str(folder / "report.json")], check=True)


def draw_view(blend: Path, picture: Path) -> None:
    """The camera's view of a baked scene: no lamp, no bounce, only what the lightmaps emit."""
    import bpy

    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    for thing in scene.objects:
        thing.hide_render = thing.hide_render or thing.type == "LIGHT"
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = VIEW_SAMPLES, 0, False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.compression = 90
    scene.render.filepath = str(picture)
    bpy.ops.render.render(write_still=True)


def main(names: list[str]) -> None:
    """Bake, draw and tabulate the named samples, or all."""
    OUT.mkdir(parents=True, exist_ok=True)
    rows = {}
    for scene in sorted((ROOT / "sample_blends").glob("*.blend")):
        if names and scene.stem not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            bake(scene, Path(folder))
            draw_view(Path(folder) / scene.name, OUT / f"{scene.stem}.png")
            rows[scene.stem] = json.loads((Path(folder) / "report.json").read_text(encoding="utf-8"))
    if not names:
        write_table(rows)


def write_table(rows: dict[str, dict]) -> None:
    """docs/samples/README.md: what each bake took."""
    lines = [
        "# The samples, baked with the defaults",
        "",
        "Made by `make pictures`, one run. Views show the baked light alone. Error is what the bake says of itself.",
        "",
        "| scene | baked | photons | leaves | stated error | direct s | photons s | all s | peak MB core / worker |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, r in rows.items():
        seconds, memory = r["seconds"], r["peak_memory_mb"]
        texels = sum(one["texels"] for one in r["objects"])
        lines.append(
            f"| {name} | {texels:,} texels | {r['photons'] / 1e6:.2f} M | {r['leaves']:,} | {r['estimated_error']:.1%} "
            f"| {seconds['direct']:.2f} | {seconds['photons']:.2f} | {seconds['total']:.2f} "
            f"| {memory.get('core', 0):.0f} / {memory.get('worker', 0):.0f} |"
        )
    lines += ["", *(f"![{name}]({name}.png)" for name in rows), ""]
    (OUT / "README.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
