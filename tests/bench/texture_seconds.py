"""How long the textures of a scene take to be read: one of 4096^2, and sixty of 2048^2.

python tests/bench/texture_seconds.py      prints seconds by the clock and of the processor; needs an idle machine

Sixty PNGs of 2048^2 do not come within 3 s on two cores: of 0.115 CPU s for one of them, inflating takes 0.066 with zlib. The wheels of
isal (0.029) and zlib-ng (0.039) inflate faster, but read no PNG, and most filters of its rows (Average, Paeth) need the pixel to the left,
so numpy cannot undo them by whole rows. So OpenImageIO, which Blender has, reads them.
"""

import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
from leaflight.addon.app.job import library_paths
from leaflight.addon.nodes.images_read import ImageTable
from leaflight.core.output import image_file

CASES = ((1, 4096, 0.3), (60, 2048, 3.0))  # images, texels on a side, seconds that are asked for
PAGE_TEXELS = 512  # of a bake by default


def write_picture(path: Path, side: int, seed: int) -> None:
    """A picture of bricks: structure at several sizes, and grain, as a photograph has them."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side].astype(np.float32) / side
    light = 0.5 + 0.2 * np.sin(40 * x) * np.sin(60 * y) + 0.1 * np.sin(300 * (x + y)) + rng.normal(0, 0.01, (side, side))
    rgb = np.clip(np.stack([light, 0.8 * light, 0.6 * light], axis=-1), 0, 1).astype(np.float32)
    image_file.write_image(path, rgb, {}, "png")


def make_materials(folder: Path, count: int, side: int) -> list[bpy.types.Material]:
    """As many materials, each with a picture of its own as Base Color; four pictures in all, under other names."""
    materials = []
    for number in range(count):
        path = folder / f"picture_{number}.png"
        source = folder / f"picture_{number % 4}.png"
        if path == source:
            write_picture(path, side, number)
        else:
            path.write_bytes(source.read_bytes())
        material = bpy.data.materials.new(path.stem)
        if material.node_tree is None:
            material.use_nodes = True
        tree = material.node_tree
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = bpy.data.images.load(str(path))
        tree.links.new(tree.nodes["Principled BSDF"].inputs["Base Color"], node.outputs["Color"])
        materials.append(material)
    return materials


def read_all(materials: list[bpy.types.Material], most_texels: int) -> float:
    """Seconds to read the textures of materials."""
    begin = time.perf_counter()
    table = ImageTable(most_texels)
    table.files.begin(materials)
    for material in materials:
        image = next(node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE")
        assert table.read(image, 0) is not None
    return time.perf_counter() - begin


def main() -> int:
    image_file.load_ahead(library_paths())
    late = False
    for count, side, asked in CASES:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        with tempfile.TemporaryDirectory() as folder:
            materials = make_materials(Path(folder), count, side)
            of_processor, seconds = time.process_time(), read_all(materials, 4 * PAGE_TEXELS)
            of_processor = time.process_time() - of_processor
            print(f"{count} of {side} x {side}: {seconds:.2f} s, {of_processor:.2f} s of the processor; asked for {asked} s")
            late = late or seconds > asked
    return int(late)


if __name__ == "__main__":
    sys.exit(main())
