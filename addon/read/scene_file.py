"""Opens the scene that the command line names: a .blend, or a file of another format through Blender's importers."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..nodes.node_ports import give_nodes

_IMPORTERS = {
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".gltf": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    ".fbx": lambda path: bpy.ops.wm.fbx_import(filepath=path),  # the older one in Python stops at lamps in 5.0
    ".usd": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usda": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usdc": lambda path: bpy.ops.wm.usd_import(filepath=path),
}


def open_scene(path: Path) -> list[tuple[str, str]]:
    """Make the file the open scene, and give warnings (subject, sentence).

    Raises ValueError with a sentence when the file is missing, of an unknown kind or damaged.
    """
    if not path.is_file():
        raise ValueError(f"{path}: {'is a folder, not a scene' if path.is_dir() else 'no such file'}; check the path.")
    kind = path.suffix.lower()
    if kind != ".blend" and kind not in _IMPORTERS:
        raise ValueError(f"{path.name}: is not a kind of scene that can be read; choose a file of {', '.join(['.blend', *_IMPORTERS])}.")
    try:
        if kind == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False, use_scripts=False)
            return []
        bpy.ops.wm.read_factory_settings(use_empty=True)
        _IMPORTERS[kind](str(path.resolve()))
    except RuntimeError as reason:
        raise ValueError(f"{path.name}: Blender cannot read it, the file seems damaged ({_find_cause(reason)}); save it again.") from reason
    if not bpy.data.meshes:
        raise ValueError(f"{path.name}: Blender finds no mesh in it; check that it is the right file, and save it again.")
    return _light_by_world(path)


def _find_cause(reason: Exception) -> str:
    """The line of Blender's report that tells most: its first, or what ends a traceback."""
    lines = [line.strip() for line in str(reason).splitlines() if line.strip() and not line.startswith("Location: ")]
    if not lines:
        return "no reason given"
    return lines[-1 if "Traceback" in lines[0] else 0].removeprefix("Error: ")


def _light_by_world(path: Path) -> list[tuple[str, str]]:
    """Light from a plain world, for a model that was made without any."""
    scene = bpy.context.scene
    trees = [material.node_tree for material in bpy.data.materials if material.node_tree is not None]
    emits = any(_may_emit(node) for tree in trees for node in tree.nodes)
    if scene.world is not None or emits or any(thing.type == "LIGHT" for thing in scene.objects):
        return []
    scene.world = bpy.data.worlds.new("World")
    give_nodes(scene.world)
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background.inputs["Strength"].default_value = 1.0
    return [(path.name, f"{path.name}: has no light, so a white world of 1 W/m2/sr lights it; add lights for another look.")]


def _may_emit(node: bpy.types.Node) -> bool:
    if node.type != "BSDF_PRINCIPLED":
        return node.type == "EMISSION"
    strength, color = node.inputs["Emission Strength"], node.inputs["Emission Color"]
    # Importers leave a strength of 1 beside black.
    return (strength.is_linked or strength.default_value > 0.0) and (color.is_linked or any(color.default_value[:3]))
