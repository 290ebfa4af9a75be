"""Opens the scene that the command line names: a .blend, or a file of another format through Blender's importers."""

from __future__ import annotations

import json
from pathlib import Path

import bpy

from ..nodes.node_ports import give_nodes
from .blender_output import hold_output

_GLB_JSON = 20  # bytes before it in a .glb, behind its length and kind. Source: Khronos, glTF 2.0 specification, section 4.4
_COMPRESSIONS = {"EXT_meshopt_compression": "meshopt", "KHR_meshopt_compression": "meshopt", "KHR_draco_mesh_compression": "Draco"}
_SCRIPTED = (
    "has a driver that needs Python, which is not run for a file that may be anybody's, so its value is the one that was saved; "
    "--enable-scripts runs it, if you trust the file"
)
_IMPORTERS = {
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".gltf": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    ".fbx": lambda path: bpy.ops.wm.fbx_import(filepath=path),  # the older one in Python stops at lamps in 5.0
    ".usd": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usda": lambda path: bpy.ops.wm.usd_import(filepath=path),
    ".usdc": lambda path: bpy.ops.wm.usd_import(filepath=path),
}


def open_scene(path: Path, scripts: bool = False) -> list[tuple[str, str]]:
    """Make the file the open scene, and give warnings (subject, sentence).

    scripts   whether its drivers and scripts may run

    Raises ValueError with a sentence when the file is missing, of an unknown kind or damaged.
    """
    if not path.is_file():
        raise ValueError(f"{path}: {'is a folder, not a scene' if path.is_dir() else 'no such file'}; check the path.")
    kind = path.suffix.lower()
    if kind != ".blend" and kind not in _IMPORTERS:
        raise ValueError(f"{path.name}: is not a kind of scene that can be read; choose a file of {', '.join(['.blend', *_IMPORTERS])}.")
    try:
        if kind == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False, use_scripts=scripts)
            return [] if scripts else warn_of_drivers()
        bpy.ops.wm.read_factory_settings(use_empty=True)
        with hold_output():  # importers in Python end with a traceback
            _IMPORTERS[kind](str(path.resolve()))
    except RuntimeError as reason:
        told = _describe_compression(path)
        if told:
            raise ValueError(told) from reason
        raise ValueError(f"{path.name}: Blender cannot read it, the file seems damaged ({_find_cause(reason)}); save it again.") from reason
    if not bpy.data.meshes:
        told = _describe_compression(path)
        if told:
            raise ValueError(told)
        raise ValueError(f"{path.name}: Blender finds no mesh in it; check that it is the right file, and save it again.")
    return _light_by_world(path)


def choose_scene(context: bpy.types.Context, scene_name: str, view_layer: str, frame: int | None) -> None:
    """Make a scene of the open file, a view layer of it and a frame the current ones; what is empty stays as it is.

    Raises ValueError with a sentence where there is none of that name.
    """
    window = context.window
    if scene_name:
        if scene_name not in bpy.data.scenes:
            raise ValueError(f"--scene {scene_name}: there is no such scene; the file has: {', '.join(sorted(bpy.data.scenes.keys()))}.")
        window.scene = bpy.data.scenes[scene_name]
    scene = window.scene
    if view_layer:
        if view_layer not in scene.view_layers:
            raise ValueError(f"--view-layer {view_layer}: {scene.name} has no such one; it has: {', '.join(scene.view_layers.keys())}.")
        window.view_layer = scene.view_layers[view_layer]
    if frame is not None:
        scene.frame_set(frame)


def warn_of_drivers() -> list[tuple[str, str]]:
    """A sentence about each thing that has a driver which needs Python, for a file's scripts are not run."""
    kinds = ("scenes", "objects", "meshes", "materials", "lights", "worlds", "shape_keys", "node_groups", "curves", "cameras")
    found = []
    for block in (block for kind in kinds for block in getattr(bpy.data, kind)):
        owners = [(block.name, block), *([(block.name, block.node_tree)] if getattr(block, "node_tree", None) else [])]
        for name, owner in owners:
            drivers = owner.animation_data.drivers if owner.animation_data else ()
            if any(curve.driver.type == "SCRIPTED" and not curve.driver.is_simple_expression for curve in drivers):
                found.append((name, _SCRIPTED))
    return list(dict.fromkeys(found))


def _describe_compression(path: Path) -> str:
    """What to do about a glTF file whose meshes are compressed in a way that cannot be read; "" where they are not."""
    try:
        content = path.read_bytes()
        length = int.from_bytes(content[_GLB_JSON - 8 : _GLB_JSON - 4], "little")
        document = json.loads(content[_GLB_JSON : _GLB_JSON + length] if path.suffix.lower() == ".glb" else content)
        used = {*document.get("extensionsUsed", ()), *document.get("extensionsRequired", ())}
    except (OSError, ValueError, TypeError, AttributeError):
        return ""
    for extension, name in _COMPRESSIONS.items():
        if extension in used:
            return (
                f"{path.name}: its meshes are compressed by {name}, which this Blender cannot unpack; write the file again without that "
                "compression, from the program that made it or with a glTF tool, and bake that."
            )
    return ""


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
