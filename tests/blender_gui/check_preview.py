"""Checks what only a Blender with a window can show of Preview and Remove: the same view before and after, in each kind of shading.

    blender sample_blends/cornell_box.blend --python tests/blender_gui/check_preview.py

The extension must be installed, and ImageMagick there. KINDS names some of the shadings, default all. Prints a line for each check, and
at last how many failed.
"""

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import gui_script
from gui_script import bake, check, check_all, press, settle, start, view, window

FOLDER = Path(tempfile.mkdtemp(prefix="leaflight_views_"))
# Not Cycles: there a good bake looks as the scene itself does; tests/blender/test_materials_write.py renders that.
SHADINGS = {"SOLID": "", "MATERIAL": "", "EEVEE": "BLENDER_EEVEE"}
BLOCK = 32  # pixels along a side, over which noise is taken out
ALIKE = 0.02  # mean difference of two pictures of one view, of 1
OTHER = 0.04
STILL = 0.002
PLAIN = 0.01  # standard deviation of a picture with nothing in it yet, of 1
GIVE_UP_SECONDS = 600.0  # shaders compile by software, beside others' work


def shade(kind: str) -> None:
    shading = view().spaces.active.shading
    shading.type = "RENDERED" if SHADINGS[kind] else kind
    shading.light, shading.color_type = "FLAT", "TEXTURE"
    if SHADINGS[kind]:
        bpy.context.scene.render.engine = SHADINGS[kind]


def picture(name: str) -> Iterator[float]:
    """The middle of the view as means of blocks, 0 to 1, kept in PICTURE once it shows something and is the same twice.

    Shaders compile meanwhile, and until the first of them has, the view is plain grey.
    """
    give_up = time.monotonic() + GIVE_UP_SECONDS
    while time.monotonic() < give_up:
        yield from take_picture("earlier")
        yield from take_picture(name)
        if differ("earlier", name) < STILL and PICTURE[name].std() > PLAIN:
            return
    print(f"{name}: the view does not come to rest", flush=True)


def take_picture(name: str) -> Iterator[float]:
    yield from settle(2.0)
    area, path = view(), FOLDER / f"{name}.png"
    width, height = area.width // 3, area.height // 2
    crop = f"{width}x{height}+{area.x + width}+{window().height - area.y - area.height + height // 2}"
    yield from gui_script.take_picture(path, crop)
    image = bpy.data.images.load(str(path))
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    rows, columns = image.size[1] // BLOCK, image.size[0] // BLOCK
    pixels = values.reshape(image.size[1], image.size[0], -1)[
        : rows * BLOCK, : columns * BLOCK, :3
    ]  # with alpha a grey picture has two values
    bpy.data.images.remove(image)
    PICTURE[name] = pixels.reshape(rows, BLOCK, columns, BLOCK, -1).mean(axis=(1, 3))


PICTURE: dict[str, np.ndarray] = {}


def differ(first: str, second: str) -> float:
    return float(np.abs(PICTURE[first] - PICTURE[second]).mean())


def check_mode(kind: str, main_pass: str, materials: str) -> Iterator[float]:
    chosen = bpy.context.scene.leaflight
    chosen.main_pass, chosen.materials = main_pass, materials
    name = f"{kind} {main_pass} {materials}"
    yield from bake()
    yield from picture("on")
    press("toggle_preview")
    yield from picture("off")
    press("toggle_preview")
    yield from picture("again")
    press("remove")
    yield from picture("removed")
    found = {other: differ("before", other) for other in ("on", "off", "again", "removed")}
    told = ", ".join(f"{other} {value:.4f}" for other, value in found.items())
    hidden = materials == "NODES" and kind != "SOLID"  # Solid view shows the active image, linked or not
    check(
        f"{name}: the bake is {'placed only' if hidden else 'shown'} ({told})", (found["on"] < ALIKE) if hidden else (found["on"] > OTHER)
    )
    check(f"{name}: Preview shows it again", differ("on", "again") < ALIKE)
    check(f"{name}: Preview off and Remove show the original", found["off"] < ALIKE and found["removed"] < ALIKE)


def steps() -> Iterator[float]:
    space = view().spaces.active
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_overlays = space.show_gizmo = False
    chosen = bpy.context.scene.leaflight
    chosen.size, chosen.quality, chosen.output = 128, "DRAFT", tempfile.mkdtemp(prefix="leaflight_images_")
    yield 2.0
    for kind in os.environ.get("KINDS", " ".join(SHADINGS)).split():
        shade(kind)
        yield 4.0  # shaders compile
        yield from picture("before")
        for main_pass, materials in (("combined", "SHOW"), ("lighting", "SHOW"), ("combined", "NODES")):
            yield from check_all(check_mode(kind, main_pass, materials), f"{kind} {main_pass} {materials}")


start(steps())
