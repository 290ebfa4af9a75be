"""What Cycles has evaluated of a world, kept beside the images: the next bake of the same world need not wait for it.

A file holds the maps of one bake and is replaced by the next one's. It may be anybody's, so that what it holds is checked.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.util.digest import hash_pieces
from ...core.util.file_names import clean_name
from ...core.util.files import load_arrays, save_whole
from ..nodes.node_values import list_nodes

_MOST_BYTES = 1 << 26  # of a file; a large map and eight spots take half of that
_BEYOND = ("ATTRIBUTE", "CAMERA", "SCRIPT", "TEX_IES")  # nodes that read what is neither in the tree nor in an image
_BEYOND_OUTPUTS = ("Object", "Camera", "Window")  # of Texture Coordinate nodes


class MapCache:
    """Maps of an earlier bake, and those of the one under way.

    file       where they are kept, None nowhere
    is_heeded  whether the earlier ones count
    """

    def __init__(self, file: Path | None = None, is_heeded: bool = True) -> None:
        self._file, self._is_heeded = file, is_heeded
        self._earlier: dict[str, NDArray[Any]] | None = None
        self._own: dict[str, NDArray[np.float32]] = {}

    @classmethod
    def beside(cls, output: Path, atlas_name: str, is_heeded: bool) -> MapCache:
        """Of a bake's folder and name."""
        return cls(output / f".leaflight_{clean_name(atlas_name)}.world", is_heeded)

    def find(self, key: str, shape: tuple[int, ...]) -> NDArray[np.float32] | None:
        """The map of a key, which is kept on; None where there is none that could be one."""
        if self._earlier is None:
            self._earlier = self._load()
        found = self._earlier.get(key)
        if found is None or found.dtype != np.float32 or found.shape != shape or not (np.isfinite(found).all() and (found >= 0).all()):
            return None
        self._own[key] = found
        return found

    def add(self, key: str, found: NDArray[np.float32]) -> None:
        """Keep a map that was evaluated."""
        self._own[key] = found

    def save(self) -> None:
        """Keep the maps of this bake in place of the earlier ones.

        Raises OSError where they cannot be written.
        """
        if self._file is not None and self._own and self._own.keys() != (self._earlier or {}).keys():
            save_whole(self._file, self._own)

    def _load(self) -> dict[str, NDArray[Any]]:
        try:
            if self._file is None or not self._is_heeded or self._file.stat().st_size > _MOST_BYTES:
                return {}
            return load_arrays(self._file)
        except (OSError, ValueError):
            return {}


def print_light(world: Any, nodes: list[Any]) -> str:
    """A digest of all that the light of a world depends on; "" where that is more than its nodes and the files of images.

    nodes   of its tree and of all groups in it
    """
    images = []
    for node in nodes:
        outputs = node.outputs if node.type == "TEX_COORD" else ()
        is_beyond = node.type in _BEYOND or any(output.is_linked for output in outputs if output.name in _BEYOND_OUTPUTS)
        if is_beyond or node.id_data.animation_data is not None:
            return ""
        image = getattr(node, "image", None)
        if image is not None:
            images.append(_print_image(image))
    if not all(images):
        return ""
    output = world.node_tree.get_output_node("CYCLES")
    working_space = getattr(getattr(bpy.data, "colorspace", None), "working_space", "")  # new in Blender 5.0
    about = (bpy.app.version_string, working_space, output.name if output else "", images, list_nodes(world.node_tree))
    return hash_pieces([Path(__file__).with_name("world_map.py").read_bytes(), repr(about).encode()])


def _print_image(image: Any) -> tuple[Any, ...]:
    """What an image shows; empty where that is not known by a file."""
    if image.source != "FILE" or image.is_dirty:
        return ()
    read_as = (image.colorspace_settings.name, image.alpha_mode)
    if image.packed_file is not None:
        return (*read_as, hash_pieces([image.packed_file.data]))
    path = Path(bpy.path.abspath(image.filepath, library=image.library))
    try:
        about = path.stat()
    except OSError:
        return ()
    return (*read_as, str(path), about.st_mtime_ns, about.st_size)
