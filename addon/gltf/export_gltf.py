"""A .glb of the baked scene, by Blender's own exporter: light as unlit colour, or as lightmaps with a manifest beside the file."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import tempfile
from pathlib import Path

import addon_utils
import bpy
from bpy_extras.io_utils import ExportHelper

from ..read.blender_output import hold_output
from ..show import restore
from ..show.materials_write import Sentences
from .gltf_file import clear_numbers, make_manifest, read_document, rename, replace_document
from .gltf_stage import Stage, open_stage

_EXPORTER = "io_scene_gltf2"


def export_gltf(context: bpy.types.Context, path: Path, view_transform: str = "standard") -> Sentences:
    """Write the baked scene as `path`, and gives what could not be done.

    Objects baked with a pass that materials show as it is get it as unlit base colour (KHR_materials_unlit). With the pass `lighting` they
    keep their materials and get it as lightmap, on TEXCOORD_1 in the occlusion slot; NAME.lightmap.json says how to read it.

    view_transform   standard or scene, of unlit colours
    Raises ValueError or OSError with a sentence when there is nothing to export or the file cannot be written.
    """
    scene = context.scene
    if not addon_utils.check(_EXPORTER)[1]:
        raise ValueError("Blender's glTF exporter is switched off: switch on the add-on glTF 2.0 format in the Preferences.")
    if not restore.has_bake(scene):
        raise ValueError("nothing is baked yet: bake the scene first.")
    shown = restore.is_preview_on(scene)
    warnings = [] if shown else restore.toggle_preview(scene, True)
    try:
        with tempfile.TemporaryDirectory(prefix="leaflight_") as folder, open_stage(context, Path(folder), view_transform) as stage:
            exported = Path(folder) / "scene.glb"
            _run_exporter(exported, stage)
            glb = exported.read_bytes()
            document = read_document(glb)
            glb = clear_numbers(glb, document)
            materials = enumerate(document.get("materials", ()))
            ranges = {index: stage.ranges[material["name"]] for index, material in materials if material["name"] in stage.ranges}
            rename(document, stage.names)
            _write_file(path, replace_document(glb, document))
            if ranges:
                text = json.dumps(make_manifest(path.name, document, ranges), indent=2) + "\n"
                _write_file(manifest_path(path), text.encode())
            return warnings + stage.warnings
    finally:
        if not shown:
            restore.toggle_preview(scene, False)


def manifest_path(path: Path) -> Path:
    """Where the manifest of a .glb is."""
    return path.with_suffix(".lightmap.json")


def _run_exporter(path: Path, stage: Stage) -> None:
    before = logging.root.manager.disable
    logging.disable(logging.INFO)  # its steps are of no interest here, and it has no switch that works
    try:
        with hold_output() if bpy.app.background else contextlib.nullcontext():  # it ends with a traceback
            bpy.ops.export_scene.gltf(
                filepath=str(path),
                export_format="GLB",
                use_active_scene=True,
                export_animations=False,
                export_current_frame=True,  # else it sets the frame
                export_image_format="AUTO",
            )
    except RuntimeError as reason:
        told = f"Blender's glTF exporter failed ({_find_last_line(str(reason))}): export the scene by File > Export in Blender to see why."
        raise ValueError(_find_fileless_tile(stage) or told) from reason
    finally:
        logging.disable(before)


def _find_fileless_tile(stage: Stage) -> str:
    """A sentence about a UDIM image, which Blender's exporter reads from files and nowhere else; "" where all have theirs."""
    materials = {slot.material for obj in stage.scene.objects for slot in obj.material_slots if slot.material and slot.material.node_tree}
    for material in sorted(materials, key=lambda material: material.name):
        for image in _list_images(material.node_tree):
            if image.source != "TILED":
                continue
            path = bpy.path.abspath(image.filepath, library=image.library)
            if not all(os.path.isfile(path.replace("<UDIM>", str(tile.number))) for tile in image.tiles):
                name = stage.names["materials"].get(material.name, material.name)
                return (
                    f"{image.name}: has a UDIM tile without a file, which Blender's glTF exporter cannot read; "
                    f"save the image (Image > Save As in the Image Editor), or take it out of the material {name}."
                )
    return ""


def _list_images(tree: bpy.types.NodeTree) -> list[bpy.types.Image]:
    """Images of a node tree and of the groups in it."""
    found = [node.image for node in tree.nodes if node.type == "TEX_IMAGE" and node.image]
    return found + [image for node in tree.nodes if node.type == "GROUP" and node.node_tree for image in _list_images(node.node_tree)]


def _find_last_line(report: str) -> str:
    """What a report of Blender's ends with; a traceback's other lines stand in the console, where Blender has written them."""
    lines = [line.strip() for line in report.splitlines() if line.strip() and not line.startswith("Location: ")]
    return lines[-1].removeprefix("Error: ").rstrip(".") if lines else "without a word"


def _write_file(path: Path, content: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    except OSError as reason:
        raise OSError(f"{path}: cannot be written ({reason.strerror}); choose a folder that can be written to.") from reason
    finally:
        with contextlib.suppress(OSError):  # where it could not be made it cannot be taken away either
            temporary.unlink(missing_ok=True)


class LEAFLIGHT_OT_export_gltf(bpy.types.Operator, ExportHelper):
    """The same from the panel."""

    bl_idname = "leaflight.export_gltf"
    bl_label = "Export Baked glTF"
    bl_description = "Write the baked scene as .glb: unlit where it shows combined light, with lightmaps where it shows lighting"
    filename_ext = ".glb"
    filter_glob: bpy.props.StringProperty(default="*.glb", options={"HIDDEN"})  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave this mode for Object Mode first")
            return False
        return restore.has_bake(context.scene) and not context.window_manager.leaflight_state.running

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            warnings = export_gltf(context, Path(self.filepath), context.scene.leaflight.view_transform)
        except (ValueError, OSError) as reason:
            self.report({"ERROR"}, str(reason))
            return {"CANCELLED"}
        for _, sentence in warnings:
            self.report({"WARNING"}, sentence)
        self.report({"INFO"}, f"{Path(self.filepath).name} written")
        return {"FINISHED"}


CLASSES = (LEAFLIGHT_OT_export_gltf,)
