"""Pages that .blend files show, each in a folder named after its content, so that no later bake overwrites them. No bpy here.

A bake writes its images under the names that users rely on, OUTPUT/room_0.combined.exr, and the next bake replaces those files, while undo
and files saved before bring back the UVs of the earlier bake. Blender therefore reads OUTPUT/.leaflight_pages/<digest>/room_0.combined.exr:
the same file by a second name (a hard link), or a copy where the disk has no links. What such a path names never changes.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Collection, Iterable
from pathlib import Path

from ...core.util.digest import hash_file
from ...core.util.files import write_text_whole

STORE = ".leaflight_pages"
_USERS = "blend_files.txt"  # in each page's folder: the .blend files saved with the page, as seen from OUTPUT
_DIGITS = 16  # of a page's digest


def keep_page(path: Path) -> Path:
    """The kept page with the content of an image file that a bake has just written.

    Raises OSError where neither a link nor a copy can be made.
    """
    digest = read_digest(path)
    kept = find_kept(path, digest)
    if kept.is_file() and (kept.samefile(path) or read_digest(kept) == digest):
        return kept
    kept.parent.mkdir(parents=True, exist_ok=True)
    unfinished = kept.with_name(f".{kept.name}.{os.getpid()}.part")
    try:
        try:
            os.link(path, unfinished)
        except OSError:  # no links on this disk
            shutil.copyfile(path, unfinished)
        os.replace(unfinished, kept)
    finally:
        unfinished.unlink(missing_ok=True)
    return kept


def read_digest(path: Path) -> str:
    """What tells a page's content from others.

    Raises OSError where the file cannot be read.
    """
    return hash_file(path)[:_DIGITS]


def find_kept(path: Path, digest: str) -> Path:
    """Where the page with this content is kept of an image file, there or not."""
    return path.parent / STORE / digest / path.name


def is_kept(path: Path) -> bool:
    """Whether a path names a page in a store, there or not."""
    return path.parent.parent.name == STORE


def find_folder(path: Path) -> Path:
    """The folder that a page's bake wrote its images to."""
    return path.parent.parent.parent if is_kept(path) else path.parent


def recover_page(kept: Path) -> bool:
    """Make a kept page that is missing from the image beside the store, if that has the same content; gives whether it is there."""
    if kept.is_file():
        return True
    image = find_folder(kept) / kept.name
    try:
        return is_kept(kept) and read_digest(image) == kept.parent.name and keep_page(image) == kept
    except OSError:
        return False


def claim_pages(pages: Iterable[Path], blend: Path) -> None:
    """Note that a .blend shows these kept pages; it then keeps them from being deleted. A folder that cannot be written stays as it is."""
    for folder in {page.parent for page in pages if is_kept(page) and page.is_file()}:
        users = _read_users(folder)
        if blend not in users:
            with contextlib.suppress(OSError):
                _write_users(folder, {*users, blend})


def release_pages(output: Path, blend: Path, needed: Collection[Path]) -> None:
    """Delete the pages in a folder's store that this .blend has been saved with and needs no longer, unless another one claims them."""
    folders = {page.parent for page in needed}
    for folder in (output / STORE).glob("*/"):
        users = _read_users(folder)
        if folder in folders or blend not in users:
            continue
        others = {user for user in users - {blend} if user.is_file()}
        with contextlib.suppress(OSError):  # on Windows another program may be reading it
            if others:
                _write_users(folder, others)
            else:
                shutil.rmtree(folder)
    with contextlib.suppress(OSError):
        (output / STORE).rmdir()  # where it is empty


def _read_users(folder: Path) -> set[Path]:
    output = folder.parent.parent
    try:
        lines = (folder / _USERS).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return set()
    return {Path(os.path.normpath(output / line)) for line in lines if line}


def _write_users(folder: Path, users: Collection[Path]) -> None:
    output = folder.parent.parent
    lines = []
    for user in sorted(users):
        try:
            lines.append(Path(os.path.relpath(user, output)).as_posix())  # both may be moved together
        except ValueError:  # another drive
            lines.append(str(user))
    write_text_whole(folder / _USERS, "".join(f"{line}\n" for line in lines))
