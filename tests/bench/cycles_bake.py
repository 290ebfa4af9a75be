"""A sample as Cycles bakes it, on the UV layer that Leaflight makes for it. Needs pip's bpy, and is run in a process of its own.

A texel of Cycles, as cycles_texel.py measures it under 5.0, is a mean over a square half a texel wide around the texel's centre, whatever
the pixel filter, and of that only over what lies on the triangle of the centre. Under 5.2 the square is the texel. A texel whose centre
no triangle covers is not baked. So where light has an edge, or a chart its border, it is not the mean over all that the chart covers of
the texel.
"""

import sys
import time
from collections.abc import Sequence, Set
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from leaflight.addon.app import session
from leaflight.addon.app.arguments import BakeRequest
from leaflight.addon.app.job import library_paths
from leaflight.addon.read.scene_file import open_scene
from leaflight.addon.show import materials_write
from leaflight.core.bake import bake
from leaflight.core.util.job import LAYOUT_FILE
from leaflight.core.util.settings import Settings

BOUNCES = 128
TARGET = "Cycles target"
UV_LAYER = "Leaflight"
SEEDS_APART = 100
LIGHTING = frozenset({"DIRECT", "INDIRECT"})


@dataclass(frozen=True)
class Stage:
    """An open sample whose objects wear Leaflight's UV layer and their own materials.

    objects     those that are baked
    image       square, what Cycles bakes into: the page, or a window of it
    page_size   texels
    page_uv     (n_corner, 2) float32 of each mesh, [0, 1]: its layout on the page
    tri_uv      (n_tri, 3, 2) float64, [0, 1]; none where the layer was there before
    uv_layer    by which the objects are baked
    """

    scene: bpy.types.Scene
    objects: list[bpy.types.Object]
    image: bpy.types.Image
    page_size: int
    page_uv: dict[bpy.types.Mesh, np.ndarray]
    tri_uv: np.ndarray
    uv_layer: str = UV_LAYER


def set_stage(blend: Path, size: int, folder: Path, objects: tuple[str, ...] = (), window: int = 0, uv_layer: str = "") -> Stage:
    """Open a sample and lay it out by a Leaflight bake of no worth, whose materials are taken off again, unless it has a layer.

    folder     an empty one
    objects    that are baked, if not all; must be named where there is a layer
    window     side of what is baked of the page at once, texels, if not the page
    uv_layer   one that the objects have already
    Raises ValueError where the charts do not fit one page.
    """
    sys.path += library_paths()
    open_scene(blend)
    scene = bpy.context.scene
    tri_uv = np.empty((0, 3, 2))
    if uv_layer:
        baked = [scene.objects[name] for name in objects]
    else:
        tri_uv = _lay_out(blend.name, size, folder, objects)
        baked = [obj for obj in scene.objects if materials_write.is_shown(obj)]
        materials_write.hide(baked)
    layer = uv_layer or UV_LAYER
    for obj in bpy.context.view_layer.objects:
        obj.select_set(False)
    image = make_target(window or size)
    for obj in baked:
        aim_at(obj, image, layer)
    _set_cycles(scene)
    page_uv = {obj.data: read_uv(obj.data, layer) for obj in baked}
    return Stage(scene, baked, image, size, page_uv, tri_uv, layer)


def _lay_out(name: str, size: int, folder: Path, objects: tuple[str, ...]) -> np.ndarray:
    """Our layer on the objects of the open scene; (n_tri, 3, 2) float64, [0, 1]."""
    quick = Settings(
        size=size, share_meshes=False, even_out=False, passes=("lighting",), direct="photons", error=1.0, max_photons=1000, workers=1
    )
    work = session.prepare(bpy.context, BakeRequest(quick, objects=objects, output=folder / "images"), folder)
    bake.run_bake(folder, lambda message: None, lambda: False)
    result = session.read_result(work)
    if result["pages"] != 1:
        raise ValueError(f"{name}: has {result['pages']} pages, expected one; choose a larger size.")
    session.assign(bpy.context, work, result)
    return np.load(folder / LAYOUT_FILE)["tri_uv"]


def make_target(side: int) -> bpy.types.Image:
    """An image to bake into, texels a side."""
    image = bpy.data.images.new(TARGET, side, side, alpha=True, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    return image


def bake_cycles(stage: Stage, samples: int, seed: int, parts: Set[str] = LIGHTING) -> tuple[np.ndarray, float]:
    """Lighting of all objects, or other parts of the DIFFUSE bake, and the seconds that Blender's bake took.

    seed  any number; bakes of different ones have independent noise
    out   (size, size, 4) float32, row 0 at the bottom; alpha is 0 where nothing was baked
    """
    stage.scene.cycles.samples = samples
    # Seeds that differ in two bits, as 1 and 2 do, share some of their brightest paths: as the two renderings of a reference they had a
    # third of their noise's variance in common, which counted as an error of every bake.
    stage.scene.cycles.seed = int(np.random.SeedSequence(seed).generate_state(1)[0] >> 1)
    size = stage.image.size[0]
    stage.image.pixels.foreach_set(np.zeros(size * size * 4, np.float32))
    begin = time.perf_counter()
    bpy.ops.object.bake(type="DIFFUSE", pass_filter=set(parts), margin=0, use_clear=False, target="IMAGE_TEXTURES")
    seconds = time.perf_counter() - begin
    pixels = np.empty(size * size * 4, np.float32)
    stage.image.pixels.foreach_get(pixels)
    return pixels.reshape(size, size, 4), seconds


def bake_windows(
    stage: Stage, corners: Sequence[tuple[int, int]], samples: int, seed: int, parts: Set[str] = LIGHTING
) -> tuple[np.ndarray, float]:
    """Lighting of all objects, or other parts, where windows of the stage's size show it, and the seconds that Blender's bakes took.

    corners   left and low ends of the windows, texels
    out       (page_size, page_size, 4) float32, row 0 at the bottom; alpha is 0 where nothing was baked
    """
    page, seconds, side = np.zeros((stage.page_size, stage.page_size, 4), np.float32), 0.0, stage.image.size[0]
    for number, (left, low) in enumerate(corners):
        for mesh, page_uv in stage.page_uv.items():  # a texel of the window is one of the page: Cycles sees the same squares
            shown = (page_uv * stage.page_size - (left, low)) / side
            mesh.uv_layers[stage.uv_layer].uv.foreach_set("vector", shown.astype(np.float32).ravel())
        # Windows of one seed would have the same noise.
        page[low : low + side, left : left + side], of_window = bake_cycles(stage, samples, seed + SEEDS_APART * number, parts)
        seconds += of_window
    return page, seconds


def read_uv(mesh: bpy.types.Mesh, layer: str) -> np.ndarray:
    """(n_corner, 2) float32 of a layer."""
    uv = np.empty((len(mesh.loops), 2), np.float32)
    mesh.uv_layers[layer].uv.foreach_get("vector", uv.ravel())
    return uv


def aim_at(obj: bpy.types.Object, image: bpy.types.Image, layer: str = UV_LAYER) -> None:
    """Every material of the object gets the image as its active node, and the object is selected with the layer active."""
    obj.data.uv_layers.active = obj.data.uv_layers[layer]
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    for slot in obj.material_slots:
        nodes = slot.material.node_tree.nodes
        node = nodes.get(TARGET) or nodes.new("ShaderNodeTexImage")
        node.name, node.image = TARGET, image
        for other in nodes:
            other.select = False
        node.select = True
        nodes.active = node


def _set_cycles(scene: bpy.types.Scene) -> None:
    """Nothing clamped, cut short, filtered or denoised."""
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_fast_gi = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = cycles.light_sampling_threshold = 0.0
    for kind in ("max", "diffuse", "glossy", "transmission", "volume", "transparent_max"):
        setattr(cycles, f"{kind}_bounces", BOUNCES)
    cycles.caustics_reflective = cycles.caustics_refractive = True
    scene.render.bake.margin = 0
    scene.render.bake.use_clear = False
