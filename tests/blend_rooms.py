"""A small lit room in Blender, and quick bakes of it by the command line."""

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import leaflight
import numpy as np
from leaflight.addon.app.job import library_paths
from leaflight.addon.ui import cli

QUICK = ("--size", "32", "--error", "0.5", "--max-photons", "20000", "--workers", "1")


class PanelContext:
    """Blender's context, with what it has in a window only."""

    region = SimpleNamespace(width=10_000)
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0), addons={})
    space_data = SimpleNamespace(shading=SimpleNamespace(type="SOLID", color_type="MATERIAL"))

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)


@contextmanager
def use_addon() -> Iterator[None]:
    """The add-on is registered within."""
    leaflight.register()
    yield
    leaflight.unregister()


def open_room(lamp_w: float = 100.0) -> None:
    """The open scene: a floor of 4 m x 4 m and a cube of 1 m, both with the layer UVMap, and a lamp above; no world."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_plane_add(size=4.0)
    bpy.context.object.name = bpy.context.object.data.name = "Floor"
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0.0, 0.0, 0.6))
    bpy.context.object.name = "Cube"
    bpy.ops.object.light_add(type="POINT", location=(1.0, 1.0, 2.0))
    bpy.context.object.name = "Lamp"
    bpy.context.object.data.energy = lamp_w


def ask_quick_bake(folder: Path | str, scene: Any = None) -> None:
    """Sets a scene, the open one if none is named, for a quick small bake whose images go to `folder`."""
    chosen = (scene or bpy.context.scene).leaflight
    chosen.size, chosen.error, chosen.workers, chosen.output = 32, 0.5, 1, str(folder)


def save_baked(folder: Path, size: int, max_photons: int = 5000) -> Path:
    """Save the open scene in `folder` as room.blend, with a coarse bake by the button whose images lie in `maps` beside it."""
    save_scene(folder / "room.blend")
    ask_quick_bake("//maps")
    bpy.context.scene.leaflight.size, bpy.context.scene.leaflight.max_photons = size, max_photons
    bpy.ops.leaflight.bake()
    bpy.ops.wm.save_mainfile()
    return folder


def add_twin() -> None:
    """Another object of the floor's mesh, beside it."""
    add_copy(bpy.data.objects["Floor"], name="Twin").location.x = 5.0


def add_mesh(name: str, vertices: Sequence[Sequence[float]], faces: Sequence[Sequence[int]]) -> Any:
    """A mesh object in the open scene."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    return add_object(name, mesh)


def add_object(name: str, data: Any, collection: Any = None, **properties: Any) -> Any:
    """An object with that data and properties, in the open scene unless it belongs into a collection."""
    obj = bpy.data.objects.new(name, data)
    (collection or bpy.context.scene.collection).objects.link(obj)
    for key, value in properties.items():
        setattr(obj, key, value)
    return obj


def add_copy(obj: Any, **properties: Any) -> Any:
    """A linked duplicate with those properties, in the open scene."""
    copy = obj.copy()
    bpy.context.scene.collection.objects.link(copy)
    for key, value in properties.items():
        setattr(copy, key, value)
    return copy


def add_plane(name: str, collection: Any = None, **properties: Any) -> Any:
    """An object of one face of a square metre, with the layer UVMap."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.array([0, 0, 1, 0, 1, 1, 0, 1], np.float32))
    return add_object(name, mesh, collection, **properties)


def make_quads(name: str = "Mesh", layers: Sequence[str] = ("UVMap",)) -> Any:
    """A mesh of two quads side by side; layer k of the first is [0, 0.5] x [0, 0.5] shifted by k."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (2, 1, 0)], [], [(0, 1, 2, 3), (1, 4, 5, 2)])
    for shift, layer in enumerate(layers):
        uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [1, 0], [2, 0], [2, 1], [1, 1]], np.float32) * 0.5 + shift
        mesh.uv_layers.new(name=layer).uv.foreach_set("vector", uv.ravel())
    return mesh


def make_material(name: str) -> Any:
    """A material with nodes, which Blender 4.5 does not give it by itself."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    return material


def make_geometry_nodes(kind: str) -> tuple[Any, Any]:
    """A group for a Geometry Nodes modifier that passes the geometry through one node of a kind; with that node."""
    tree = bpy.data.node_groups.new("Geometry Nodes", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    given, node, result = (tree.nodes.new(name) for name in ("NodeGroupInput", kind, "NodeGroupOutput"))
    tree.links.new(given.outputs[0], node.inputs[0])
    tree.links.new(node.outputs[0], result.inputs[0])
    return tree, node


def save_scene(path: Path) -> Path:
    """Save the open scene."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def bake(scene: Path, *words: str, output: Path | None = None) -> int:
    """Exit code of a quick bake into `output`, by default the folder `maps` beside the scene, with a report in it."""
    output = output or scene.parent / "maps"
    argv = ["bake", str(scene), *QUICK, "--output", str(output), "--report", str(scene.parent / "report.json"), *words]
    return cli.main(argv, "leaflight", with_scene=True)


def read_report(scene: Path) -> dict[str, Any]:
    """The report of `bake`, read as strictly as JSON is meant."""

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    report: dict[str, Any] = json.loads((scene.parent / "report.json").read_text(encoding="utf-8"), parse_constant=refuse)
    return report


def list_files(folder: Path) -> list[str]:
    """Names of what lies in a folder, hidden files too but for the note of a kept bake; none where it does not exist."""
    found = folder.iterdir() if folder.exists() else []
    return sorted(path.name for path in found if not path.name.startswith(".leaflight_"))


def read_pixels(path: Path) -> np.ndarray:
    """Linear pixels of an image file."""
    from leaflight.core.output.image_file import read_image

    before = list(sys.path)
    sys.path.extend(library_paths())
    try:
        return read_image(path)[0]
    finally:
        sys.path[:] = before
