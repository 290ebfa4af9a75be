"""What must hold after any run of the command line, whatever it was given."""

from __future__ import annotations

import json
import os
import re
import struct
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from leaflight.core.output.image_file import read_image
from leaflight.core.util.digest import hash_file

MARK = "LEAFLIGHT_FUZZ_CASE"  # in the environment of all processes of a case
_PATIENCE_S = 10.0  # in which the last of them end
_FAULTS = ("Traceback (most recent call last)", "fault of Leaflight", "RuntimeWarning", "Segmentation fault", "Internal error")
_BLENDERS = "blender_"  # its own folder, which it makes anew as it opens a file, and takes away when it ends
_PAGES = (".exr", ".hdr", ".png")
_FLOAT = 5126  # componentType of a glTF accessor


def list_content(folder: Path) -> dict[str, str]:
    """Digest of each file below a folder by its name from there; where a link leads."""
    content = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            content[name] = f"-> {os.readlink(path)}"
        elif path.is_file():
            content[name] = hash_file(path)
    return content


def judge(code: int, told: str, folder: Path, before: dict[str, str], outputs: Iterable[str], temporary: Path) -> list[str]:
    """Sentences about what is wrong; empty for a run as it should be.

    told       all that was printed
    before     content of the folder before the run
    outputs    names in the folder that the run may make or change
    temporary  folder of temporary files, empty before
    """
    wrong = [*_judge_words(code, told)]
    after = list_content(folder)
    wrong += _judge_files(before, after, tuple(outputs))
    left = sorted(path.name for path in temporary.iterdir() if not (path.name.startswith(_BLENDERS) or _is_told(path.name, told)))
    wrong += [f"left in the temporary folder: {', '.join(left)}"] if left else []
    if code == 0:
        wrong += _judge_report(folder / "report.json")
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix in _PAGES and path.is_file() and before.get(name) != after[name]:
            wrong += _judge_page(path)
    glb = folder / "scene.glb"
    return wrong + (_judge_glb(glb) if glb.is_file() else [])


def _is_told(name: str, told: str) -> bool:
    """Whether it is a folder of images that could not be written elsewhere, and a sentence names it."""
    return name.startswith("leaflight_images_") and name in told


def _judge_words(code: int, told: str) -> list[str]:
    wrong = [] if code in (0, 1, 2) else [f"exit code {code}"]
    wrong += [f"printed: {fault}" for fault in _FAULTS if fault in told]
    errors = [line.partition("error: ")[2] for line in told.splitlines() if re.match(r"leaflight.*error: ", line)]
    if code == 1 and not errors:
        wrong.append("exit code 1 without a sentence")
    if code == 1 and any(len(error.split()) < 4 for error in errors):
        wrong.append(f"no sentence: {errors}")
    if code == 2 and "usage: " not in told:
        wrong.append("exit code 2 without usage")
    if code == 0 and errors:
        wrong.append(f"exit code 0 with an error: {errors}")
    return wrong


def _judge_files(before: dict[str, str], after: dict[str, str], outputs: tuple[str, ...]) -> list[str]:
    wrong = []
    for name in sorted(before.keys() | after.keys()):
        mine = name.split("/")[0] in outputs
        if name in before and not mine and after.get(name) != before[name]:
            wrong.append(f"{name}: a file of the user's was {'changed' if name in after else 'deleted'}")
        elif name not in before and not mine:
            wrong.append(f"{name}: left behind")
        elif name not in before and re.search(r"\.part|probe|tmp|~$|@$", name):
            wrong.append(f"{name}: half a file")
    return wrong


def _judge_report(path: Path) -> list[str]:
    if not path.is_file():
        return []  # of a dry run

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    try:
        json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    except ValueError as reason:
        return [f"report: {reason}"]
    return []


def _judge_page(path: Path) -> list[str]:
    try:
        pixels, _ = read_image(path)
    except (OSError, ValueError) as reason:
        return [f"{path.name}: cannot be read: {reason}"]
    return [] if np.isfinite(pixels).all() else [f"{path.name}: has values that are no numbers"]


def _judge_glb(path: Path) -> list[str]:
    data = path.read_bytes()
    if data[:4] != b"glTF" or struct.unpack("<I", data[8:12])[0] != len(data):
        return [f"{path.name}: is not whole"]
    length = struct.unpack("<I", data[12:16])[0]
    document = json.loads(data[20 : 20 + length])
    binary = data[28 + length :]
    wrong = []
    for number, accessor in enumerate(document.get("accessors", ())):
        if accessor["componentType"] == _FLOAT and "bufferView" in accessor:
            view = document["bufferViews"][accessor["bufferView"]]
            start = view.get("byteOffset", 0)
            if not np.isfinite(np.frombuffer(binary[start : start + view["byteLength"] // 4 * 4], "<f4")).all():
                wrong.append(f"{path.name}: accessor {number} has values that are no numbers")
    return wrong


def find_left(case: str) -> list[str]:
    """Command lines of processes of a case that still run when patience ends, the asking one not counted."""
    limit = time.monotonic() + _PATIENCE_S
    while True:
        found = _list_processes(f"{MARK}={case}".encode())
        if not found or time.monotonic() > limit:
            return found
        time.sleep(0.05)


def _list_processes(mark: bytes) -> list[str]:
    found = []
    for entry in Path("/proc").iterdir() if Path("/proc/self/environ").exists() else ():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            if mark in (entry / "environ").read_bytes().split(b"\0") and (entry / "stat").read_text().rsplit(")", 1)[1].split()[0] != "Z":
                found.append((entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip())
        except OSError:  # it has just ended, or is another user's
            continue
    return found
