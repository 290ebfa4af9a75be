"""Any .blend made ready for the zoo's benchmark: what gets a lightmap is chosen, made plain meshes, and unwrapped by Smart UV Project.

python tests/bench/zoo_files.py SCENE.blend FOLDER SIZE     what zoo_bakes.find_file runs, in a process of its own

Chosen are visible meshes with a diffuse surface, the 60 of the greatest area; all other objects cast light and shadow.
"""

import sys
from pathlib import Path
from typing import Any

import bpy
from scene_zoo import BAKED, LIGHTMAP_LAYER, unwrap_smart
from zoo_reference import SCENE, Subject

_MOST_OBJECTS = 60
_DIFFUSE = ("BSDF_PRINCIPLED", "BSDF_DIFFUSE")


def choose_objects() -> list[Any]:
    """Of the open scene, the largest first."""
    from leaflight.addon.read.render_levels import find_render_objects

    found = []
    for obj in find_render_objects(bpy.context.view_layer):
        if obj.type != "MESH" or not obj.visible_get() or obj.library or obj.get(BAKED) is False:
            continue
        scale = abs(obj.matrix_world.determinant()) ** (2.0 / 3.0)
        area = scale * sum(polygon.area for polygon in obj.data.polygons)
        if area > 0.0 and all(map(_is_diffuse, obj.material_slots)):
            found.append((area, obj.name))
    return [bpy.context.scene.objects[name] for _, name in sorted(found, reverse=True)[:_MOST_OBJECTS]]


def _is_diffuse(slot: Any) -> bool:
    tree = slot.material.node_tree if slot.material else None
    return tree is None or any(node.type in _DIFFUSE for node in tree.nodes)


def make_plain(objects: list[Any]) -> None:
    """Meshes of their own, without modifiers, with a material in every slot: Cycles bakes nothing else."""
    for obj in bpy.context.view_layer.objects:
        obj.select_set(False)
    for obj in objects:
        obj.select_set(True)
    bpy.context.view_layer.objects.active = objects[0]
    bpy.ops.object.make_single_user(object=True, obdata=True)
    bpy.ops.object.convert(target="MESH")
    plain = bpy.data.materials.new("Zoo plain")
    if bpy.app.version < (5, 0, 0):
        plain.use_nodes = True
    for obj in objects:
        if not obj.material_slots:
            obj.data.materials.append(plain)
        for slot in obj.material_slots:
            if slot.material is None or slot.material.node_tree is None:
                slot.material = plain


def drop_missing_images() -> None:
    """No node shows an image whose file is missing: Cycles paints such surfaces magenta, Leaflight as the value behind the link."""
    trees = [block.node_tree for kind in (bpy.data.materials, bpy.data.worlds, bpy.data.lights) for block in kind if block.node_tree]
    for tree in (*trees, *bpy.data.node_groups):
        for node in list(tree.nodes):
            if node.type in ("TEX_IMAGE", "TEX_ENVIRONMENT") and (node.image is None or not all(node.image.size)):
                tree.nodes.remove(node)


def main(blend: Path, folder: Path, size: int) -> None:
    from leaflight.addon.read.scene_file import open_scene

    open_scene(blend)
    for obj in bpy.context.view_layer.objects:
        if obj.mode != "OBJECT":
            bpy.context.view_layer.objects.active = obj
            bpy.ops.object.mode_set(mode="OBJECT")
    objects = choose_objects()
    if not objects:
        raise ValueError(f"{blend.name}: has no visible mesh with a diffuse surface; leave it out.")
    drop_missing_images()
    make_plain(objects)
    unwrap_smart(objects)
    bpy.ops.file.make_paths_absolute()
    folder.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / SCENE), compress=True)
    triangles = sum(len(polygon.vertices) - 2 for obj in objects for polygon in obj.data.polygons)
    whole = sum(len(polygon.vertices) - 2 for mesh in bpy.data.meshes for polygon in mesh.polygons)
    about = f"{blend.name}: {len(objects)} objects baked, {triangles:,} triangles in them; smart, {size}²"
    Subject(folder, blend.stem, tuple(obj.name for obj in objects), LIGHTMAP_LAYER, size, whole, about).save()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
