"""Build the sample scenes beside this file: python make_samples.py [NAME ...], on pip's bpy.

Build with the oldest supported Blender, 4.5: newer ones open its files, not the other way round.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import scenes_plain
import scenes_rooms
from blend_kit import save

SCENES = {
    make.__name__: make
    for make in (
        scenes_plain.cornell_box,
        scenes_plain.figure2_square,
        scenes_rooms.furnished_room,
        scenes_plain.furnace,
        scenes_rooms.two_rooms,
        scenes_plain.bent_quads,
        scenes_plain.instances,
    )
}


def main() -> None:
    """Build the named scenes, or all."""
    parser = argparse.ArgumentParser(description="Build Leaflight's sample scenes.")
    parser.add_argument("name", nargs="*", metavar="NAME", help=", ".join(SCENES))
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parent, help="folder, default: beside this script")
    options = parser.parse_args()
    if unknown := set(options.name) - set(SCENES):
        parser.error(f"no sample named {', '.join(sorted(unknown))}; there are {', '.join(SCENES)}")
    for name in options.name or SCENES:
        SCENES[name]()
        save(options.output / f"{name}.blend")


if __name__ == "__main__":
    main()
