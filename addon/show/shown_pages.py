"""Sees to it that objects wear the page that belongs to their UVs, or their own materials: after undo, redo, opening and saving a file.

An image of a bake by the panel names a page that never changes (see page_store), so undo and a saved file bring back the right light by
themselves. What is left to do: images that name a bake's own file, as those of the command line do; pages that are missing; and deleting
pages that no file needs any more.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path

import bpy

from ..read.tags import is_made, local_objects, remove_mark
from . import materials_write, restore
from .images import PAGE, find_path, relative_path
from .page_store import claim_pages, find_folder, find_kept, is_kept, keep_page, read_digest, recover_page, release_pages

MISSING = restore.MISSING


def check_pages() -> None:
    """Takes bakes off whose page is missing, and says so on their scenes; a page that can be made again is."""
    missing = set()
    for image in _list_images():
        path = find_path(image)
        if path.is_file() or image.packed_file:
            continue
        if recover_page(path):
            image.reload()
        else:
            missing.add(image)
    for scene in bpy.data.scenes:
        wearers = [obj for obj in local_objects(scene.objects) if materials_write.find_image(obj) in missing]
        if any(materials_write.is_shown(obj) for obj in wearers):
            restore.toggle_preview(scene, False)
            scene[MISSING] = _describe_missing({materials_write.find_image(obj) for obj in wearers})
        elif not wearers:
            remove_mark(scene, MISSING)


def keep_named_pages() -> None:
    """Images that name a file which bakes write over, as the command line and earlier versions save them, name a kept page from now on.

    Where another bake has written over it already, that is the page kept when the file was saved, which may be missing.
    """
    for image in _list_images():
        path, digest = find_path(image), image.get(PAGE, "")
        if is_kept(path) or image.packed_file or not (path.is_file() or digest):
            continue
        with contextlib.suppress(OSError):  # what cannot be written cannot be replaced by a bake either
            same = path.is_file() and digest in ("", read_digest(path))
            image.filepath = relative_path(keep_page(path) if same else find_kept(path, digest))


def list_pages() -> set[Path]:
    """The kept pages that images of the open file name."""
    return {path for path in map(find_path, _list_images()) if is_kept(path)}


def note_pages(seen: set[Path]) -> None:
    """Add the pages that images name to those `seen` since the file was opened, and keep them for the file, if it is one already."""
    seen |= list_pages()
    if bpy.data.filepath:
        claim_pages(seen, Path(bpy.data.filepath))


def keep_for_file(blend: Path, spared: Iterable[Path] = ()) -> None:
    """After a .blend was saved: its pages are kept for it, and those that it needs no longer are deleted.

    spared   pages that undo may still bring back
    """
    needed = list_pages() | set(spared)
    for path in map(find_path, _list_images()):
        if not is_kept(path) and path.is_file():
            with contextlib.suppress(OSError):
                needed.add(keep_page(path))
    claim_pages(needed, blend)
    for output in {find_folder(page) for page in needed}:
        release_pages(output, blend, needed)


def _list_images() -> list[bpy.types.Image]:
    return [image for image in bpy.data.images if is_made(image) and image.source == "FILE"]


def _describe_missing(images: Iterable[bpy.types.Image]) -> str:
    paths = sorted(find_path(image) for image in images)
    more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
    return (
        f"{paths[0].name}{more}: the baked image is missing from {find_folder(paths[0])}, so the objects show their own materials. "
        "Put the folder back, with all that is in it, and press Show Bake; or bake again."
    )
