"""Whole .blend files of others beside Cycles: how much light each object gets, and a picture of each. Fills docs/files.md.

python tests/bench/bench_files.py FOLDER [--size N] [--reference-seconds S] [--docs] [NAME ...]

Of each file the larger visible meshes with a diffuse surface are unwrapped and baked by both on the same layer, see zoo_files.py.
References are kept in the cache folder.
"""

import argparse
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from image_io_path import add_image_io
from leaflight.core.output.image_file import read_image, write_image
from leaflight.core.texels.margin import add_margin
from tables import Table, fill_page
from zoo_bakes import bake_leaflight, find_file
from zoo_reference import PageReference, Subject, find_reference

ROOT = Path(__file__).resolve().parents[2]
DOCS, PICTURES = ROOT / "docs" / "files.md", ROOT / "docs" / "files"
_TARGET = 0.03
_LEAST_TEXELS = 64  # of an object that is compared
_LEAST_LIGHT = 0.01  # of the page's mean, of an object that is compared: what is darker lies within others, and nobody sees it
_MARGIN, _GAP = 8, 6  # texels around charts; pixels between two pictures
_WIDTH, _VIEW_SAMPLES = 400, 32


@dataclass(frozen=True)
class ObjectMeans:
    """An object's mean light, Leaflight's relative to Cycles', and the standard error of Cycles' relative to it."""

    name: str
    texels: int
    off: float
    noise: float


def leave_out(subject: Subject, pages: dict[str, np.ndarray], reference: PageReference) -> PageReference:
    """The reference without objects that Leaflight gives no lightmap, such as those of glass alone."""
    kept = np.array([name in pages or "" in pages for name in subject.objects], bool)[reference.owner]
    covered = reference.covered.copy()
    covered[covered] = kept
    arrays = {name: getattr(reference, name)[kept] for name in ("first", "second", "owner", "opaque")}
    return replace(reference, covered=covered, **arrays)


def join_pages(subject: Subject, pages: dict[str, np.ndarray], reference: PageReference) -> np.ndarray:
    """(n, 3) float32: Leaflight's light at the texels of a reference, of pages (size, size, 4) of each object, or of all under ""."""
    value = np.zeros_like(reference.first)
    for index, name in enumerate(subject.objects):
        own = reference.owner == index
        if own.any():
            value[own] = pages.get(name, pages.get(""))[reference.covered][own, :3]
    return value


def compare_objects(subject: Subject, value: np.ndarray, reference: PageReference) -> list[ObjectMeans]:
    """Of light (n, 3) at the reference's texels, which count by how opaque they are; those whose mean is off the most first."""
    found, every = [], sum(sum_light(reference, seed) for seed in _seeds(reference)) / (6 * float(reference.opaque.sum()))
    for index, name in enumerate(subject.objects):
        own = reference.owner == index
        seen = reference.opaque[own] if own.any() else np.ones(1)  # what is see-through shows little of its light
        ours, first, second = (
            float(np.average(light[own].mean(axis=1), weights=seen)) if own.any() else 0.0 for light in (value, *_seeds(reference))
        )
        mean = (first + second) / 2
        if own.sum() >= _LEAST_TEXELS and mean > _LEAST_LIGHT * every:
            found.append(ObjectMeans(name, int(own.sum()), ours / mean - 1, abs(first - second) / (2 * mean)))
    return sorted(found, key=lambda one: -abs(one.off))


def sum_light(reference: PageReference, light: np.ndarray) -> float:
    """Of light (n, 3) at the reference's texels, by how opaque they are."""
    return float(reference.opaque @ light.sum(axis=1, dtype=np.float64))


def _seeds(reference: PageReference) -> tuple[np.ndarray, np.ndarray]:
    return reference.first, reference.second


def draw_pair(subject: Subject, value: np.ndarray, reference: PageReference, folder: Path, picture: Path) -> None:
    """Both bakes as the file's camera sees them, side by side, Leaflight's on the left; each a process of its own."""
    theirs, views = (reference.first + reference.second) / 2, []
    bright = max(float(np.quantile(theirs.mean(axis=1), 0.9)), 1e-6)
    for name, light in (("leaflight", value), ("cycles", theirs)):
        image, view = folder / f"{name}.exr", folder / f"{name}.png"
        page = np.zeros((*reference.covered.shape, 3), np.float32)
        page[reference.covered] = light * np.float32(0.6 / bright)
        add_margin(page, reference.covered, _MARGIN)
        write_image(image, page, {}, "exr")
        subprocess.run(
            [sys.executable, __file__, "--view", str(subject.folder), str(image), str(view)], check=True, stdout=subprocess.DEVNULL
        )
        views.append(read_image(view)[0][..., :3])
    gap = np.ones((len(views[0]), _GAP, 3), np.float32)
    write_image(picture, np.concatenate([views[0], gap, views[1]], axis=1), {}, "png")


def draw_view(folder: Path, image: Path, picture: Path) -> None:
    """The camera's view of a subject whose objects emit a page; nothing else is shown. Needs bpy."""
    import bpy

    subject = Subject.load(folder)
    bpy.ops.wm.open_mainfile(filepath=str(subject.blend))
    scene = bpy.context.scene
    material = bpy.data.materials.new("Baked")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output, emission, texture, layer = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("OutputMaterial", "Emission", "TexImage", "UVMap"))
    texture.image, layer.uv_map = bpy.data.images.load(str(image)), subject.uv_layer
    tree.links.new(layer.outputs[0], texture.inputs[0])
    tree.links.new(texture.outputs[0], emission.inputs[0])
    tree.links.new(emission.outputs[0], output.inputs[0])
    for obj in scene.objects:
        obj.hide_render = obj.hide_render or (obj.name not in subject.objects and obj.type != "EMPTY") or obj.is_instancer
    for name in subject.objects:
        for slot in scene.objects[name].material_slots:
            slot.material = material
    bpy.context.view_layer.material_override = None
    scene.world = None
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = _VIEW_SAMPLES, 0, False
    render = scene.render
    height = min(round(_WIDTH * render.resolution_y / render.resolution_x), _WIDTH)
    render.resolution_x, render.resolution_y, render.resolution_percentage = _WIDTH, height, 100
    render.use_compositing = render.use_sequencer = render.film_transparent = render.use_border = False
    view = scene.view_settings
    view.view_transform, view.look, view.exposure, view.gamma = "Standard", "None", 0.0, 1.0
    view.use_curve_mapping = False
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    render.filepath = str(picture)
    bpy.ops.render.render(write_still=True)


def tabulate(rows: dict[str, tuple[float, list[ObjectMeans]]]) -> dict[str, Table]:
    """Tables of a page by name: one line for each file, and one for each object that is off by more than the target."""
    files, far = [], []
    for name, (whole, objects) in rows.items():
        worst = objects[0]
        missed = [one for one in objects if abs(one.off) > _TARGET]
        median = float(np.median([abs(one.off) for one in objects]))
        files.append((name, str(len(objects)), f"{whole:+.1%}", f"{median:.1%}", f"{worst.name}, {worst.off:+.1%}", str(len(missed))))
        far += [(name, one.name, f"{one.texels:,}", f"{one.off:+.1%}", f"{one.noise:.1%}") for one in missed]
    return {
        "files": Table(("file", "objects", "all light", "median object", "worst object", f"off by more than {_TARGET:.0%}"), files),
        "objects": Table(("file", "object", "texels", "off by", "noise of Cycles"), far),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", help="of files without .blend, if not all")
    parser.add_argument("--size", type=int, default=512, help="of the pages, texels")
    parser.add_argument("--error", default="0.01", help="that Leaflight is asked for")
    parser.add_argument("--time-limit", default="120", help="seconds that a bake of Leaflight may take")
    parser.add_argument("--reference-seconds", type=float, default=200.0, help="of all processors together, that a reference may take")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "zoo", help="folder of scenes and references")
    parser.add_argument("--docs", action="store_true", help="write docs/files.md and its pictures")
    options = parser.parse_args()
    add_image_io()
    rows = {}
    for blend in sorted(options.folder.glob("*.blend")):
        if options.names and blend.stem not in options.names:
            continue
        subject = find_file(blend, options.cache, options.size)
        pages = bake_leaflight(subject, "--error", options.error, "--time-limit", options.time_limit).pages
        reference = find_reference(subject, "", options.size, options.reference_seconds, 0.005, needs_opaque=True)
        reference = leave_out(subject, pages, reference)
        value = join_pages(subject, pages, reference)
        objects = compare_objects(subject, value, reference)
        whole = 2 * sum_light(reference, value) / sum(sum_light(reference, seed) for seed in _seeds(reference)) - 1
        rows[subject.name] = whole, objects
        for one in objects:
            print(f"{subject.name}: {one.name}: {one.off:+.1%} +- {one.noise:.1%}, {one.texels} texels", flush=True)
        print(f"{subject.name}: all {whole:+.1%}", flush=True)
        if options.docs:
            PICTURES.mkdir(exist_ok=True)
            draw_pair(subject, value, reference, subject.folder, PICTURES / f"{subject.name}.png")
            fill_page(DOCS, tabulate(rows))
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--view"]:
        draw_view(*map(Path, sys.argv[2:]))
    else:
        sys.exit(main())
