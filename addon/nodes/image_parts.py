"""Images that are more than one file: UDIM tiles and frames of a sequence, each as an image of its own for a moment."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

FIRST_TILE, COLUMNS = 1001, 10  # UDIM: ten tiles a row, from the lower left one on


def find_cell(number: int) -> tuple[int, int]:
    """Column and row of a UDIM tile."""
    return (number - FIRST_TILE) % COLUMNS, (number - FIRST_TILE) // COLUMNS


@contextmanager
def open_tile(image: Any, number: int) -> Iterator[Any]:
    """A UDIM tile as an image, without what was painted on it since it was saved: Blender hands out the first tile's pixels only."""
    column, row = find_cell(number)
    path = bpy.path.abspath(image.filepath, library=image.library)
    path = path.replace("<UDIM>", str(number)).replace("<UVTILE>", f"u{column + 1}_v{row + 1}")
    packed = next((file.packed_file.data for file in image.packed_files if file.tile_number == number), b"")
    with _open_copy(image, path, packed) as one:
        yield one


@contextmanager
def open_frame(image: Any, number: int) -> Iterator[Any]:
    """A frame of a sequence as an image: what scripts see of a sequence has no pixels."""
    path = bpy.path.abspath(image.filepath, library=image.library)
    digits = re.search(r"\d+(?=\D*$)", path)
    if digits:
        path = f"{path[: digits.start()]}{number:0{len(digits.group())}d}{path[digits.end() :]}"
    with _open_copy(image, path, b"") as one:
        yield one


def find_frame(user: Any, scene_frame: int) -> int:
    """The number of the file that a sequence shows.

    Source: Blender, source/blender/blenkernel/intern/image.cc, BKE_image_user_frame_get
    """
    length = user.frame_duration
    if not length:
        return 0
    frame = scene_frame - user.frame_start + 1
    if user.use_cyclic:
        frame = (frame - 1) % length + 1
    return int(min(max(frame, 0), length) + user.frame_offset)


@contextmanager
def _open_copy(image: Any, path: str, packed: bytes) -> Iterator[Any]:
    """An image that reads this file, or these bytes, as `image` reads its own: colour space and alpha are the same."""
    one = image.copy()
    try:
        one.source = "FILE"
        one.filepath = path
        if packed:
            one.pack(data=packed, data_len=len(packed))
        yield one
    finally:
        bpy.data.images.remove(one)
