"""The command line's words, made from core.settings; no bpy here."""

from __future__ import annotations

import argparse
import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.util.settings import Settings


@dataclass(frozen=True)
class BakeRequest:
    """One bake as asked for, by whatever driver."""

    settings: Settings
    scene: Path | None = None  # None: the scene that is open
    objects: tuple[str, ...] = ()  # empty: every visible mesh
    uv_layer: str = ""  # empty: unwrap into our own layer
    output: Path = Path("bake")
    name: str = ""  # of shared pages and of what is kept; empty: the file's
    report: Path | None = None
    save: Path | None = None
    gltf: Path | None = None
    assign: bool = True
    nodes_only: bool = False  # the image is placed in the materials, but linked to nothing
    quiet: bool = False
    preview: bool = False  # pages of the light so far are wanted meanwhile
    resume: Path | None = None  # folder of the state of an earlier bake to go on from
    keep: Path | None = None  # folder to keep the state in
    keep_mb: int = 0  # size beyond which it is not kept; 0: any
    keep_pages: bool = False  # materials name pages that no bake writes over, for undo; else the very files that were asked for
    began: float = 0.0  # time.monotonic() of when it was asked for; 0: now
    scripts: bool = False  # drivers and scripts of the file may run
    dry_run: bool = False  # what the bake would be is told, and nothing is baked
    scene_name: str = ""  # of the file's scenes; empty: the one that is open
    view_layer: str = ""
    frame: int | None = None
    beside: frozenset[str] = frozenset()  # names of the paths that begin in the folder of the .blend, see request.resolve_paths


_MASK = "\0"
_PATHS = ("output", "report", "save", "gltf", "keep", "resume")  # that may


def parse_arguments(argv: list[str], prog: str, with_scene: bool) -> BakeRequest:
    """The request that `argv` (without the program's name) stands for.

    with_scene   the file is an argument; else the open scene is baked
    Raises ValueError with a sentence for a value out of its range; SystemExit(2), after usage, for words that cannot be read.
    """
    arguments = vars(_make_parser(prog, with_scene).parse_args(_mask_names(argv)))
    del arguments["command"]
    knobs = {knob.name: arguments.pop(knob.name) for knob in dataclasses.fields(Settings)}
    knobs = {name: tuple(value) if isinstance(value, list) else value for name, value in knobs.items()}
    beside = _read_paths(arguments)
    save = arguments["save"]
    if save is not None and save.suffix.lower() != ".blend":
        raise ValueError(f"--save {save}: Blender opens only names that end in .blend; add the ending.")
    if arguments["gltf"] is not None and arguments["gltf"].suffix.lower() != ".glb":
        raise ValueError(f"--gltf {arguments['gltf']}: is written as one binary file; give it a name that ends in .glb.")
    return BakeRequest(settings=_make_settings(knobs), beside=beside, **{**arguments, "objects": tuple(map(_unmask, arguments["objects"]))})


def _mask_names(argv: list[str]) -> list[str]:
    """The words, with a mark before names of objects that begin with a single -, which argparse takes for flags; none of ours begins so."""
    out, names = [], False
    for word in argv:
        if word.startswith("--"):
            names = word == "--objects"
        out.append(_MASK + word if names and word.startswith("-") and not word.startswith("--") else word)
    return out


def _unmask(name: str) -> str:
    return name.removeprefix(_MASK)


def _read_paths(arguments: dict[str, Any]) -> frozenset[str]:
    """Words to paths, in place; gives the names of those that began with //. On Windows a path knows no more of that, and has it that of
    another machine begins so.

    Raises ValueError with a sentence for a name that no file can have.
    """
    words = {name: arguments[name] for name in _PATHS if arguments[name] is not None}
    for name, word in words.items():
        if "\0" in word:
            raise ValueError(f"--{name}: holds a character of code 0, which no file name may hold; choose another name.")
    beside = frozenset(name for name, word in words.items() if word.startswith("//"))
    arguments.update((name, Path(word.lstrip("/") if name in beside else word)) for name, word in words.items())
    return beside


def _make_settings(knobs: dict[str, Any]) -> Settings:
    try:
        return Settings(**knobs)
    except ValueError as reason:  # it begins with the knob's name, and here that is a flag
        name, _, found = str(reason).partition(": ")
        knob = next(knob for knob in dataclasses.fields(Settings) if knob.name == name)
        hint = "choose another" if isinstance(knob.default, str) else "choose a value in this range"
        raise ValueError(f"{_flag(knob)}: {found}; {hint}.") from reason


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Shows a default only where it tells something: not of switches, nor of what is empty."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        shown = action.nargs != 0 and action.default not in (None, "", [])
        return super()._get_help_string(action) if shown else action.help


class _Extend(argparse.Action):
    """All words behind a flag, which may be there several times, each word once and in place of the default.

    argparse's own would take the last flag alone, or add to the default.
    """

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option_string: str | None = None) -> None:
        so_far = getattr(namespace, self.dest)
        told = [*values] if so_far is self.default else [*so_far, *values]
        setattr(namespace, self.dest, list(dict.fromkeys(told)))


def _make_parser(prog: str, with_scene: bool) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=prog, description="Bakes diffuse global illumination to textures.", allow_abbrev=False)
    commands = parser.add_subparsers(dest="command", required=True)
    bake = commands.add_parser("bake", help="bake a scene", formatter_class=_HelpFormatter, allow_abbrev=False)
    if with_scene:
        bake.add_argument("scene", type=Path, help=".blend, .glb, .gltf, .obj, .fbx or .usd")
    scene = bake.add_argument_group("scene")
    scene.add_argument(
        "--objects", nargs="+", action=_Extend, default=[], metavar="NAME", help="what gets a lightmap; without it every visible mesh"
    )
    if with_scene:
        scene.add_argument(
            "--enable-scripts",
            dest="scripts",
            action="store_true",
            help="run the file's drivers and scripts; only for files that you trust",
        )
    scene.add_argument(
        "--scene", dest="scene_name", default="", metavar="NAME", help="the scene to bake, in place of the one that was saved open"
    )
    scene.add_argument("--view-layer", default="", metavar="NAME", help="the view layer to bake")
    scene.add_argument("--frame", type=int, metavar="N", help="the frame to bake")
    scene.add_argument("--uv-layer", default="", metavar="NAME", help="use this UV layer as it is; without it xatlas unwraps")
    output = bake.add_argument_group("output")
    output.add_argument("--output", default="bake", metavar="DIR", help="folder of the images; // is that of the .blend")
    output.add_argument("--report", metavar="FILE", help="write a JSON report")
    output.add_argument("--save", metavar="FILE", help="save the .blend with the bake in its materials")
    output.add_argument("--gltf", metavar="FILE", help="export a .glb that shows the first pass, combined or lighting")
    output.add_argument("--no-assign", dest="assign", action="store_false", help="leave materials as they are")
    output.add_argument(
        "--dry-run",
        action="store_true",
        help="only say what would be baked: objects, pages, memory, a rough time, and what takes most of the page",
    )
    output.add_argument("--quiet", action="store_true", help="no progress, only warnings and errors")
    output.add_argument("--keep", metavar="DIR", help="keep the state of the bake there, to go on from")
    output.add_argument("--resume", metavar="DIR", help="go on from the state that a bake of the same scene kept there")
    groups = {"Output": output}
    for knob in dataclasses.fields(Settings):
        name = knob.metadata["group"]
        if name not in groups:
            groups[name] = bake.add_argument_group(name.lower())
        _add_knob(groups[name], knob)
    return parser


def _add_knob(group: Any, knob: dataclasses.Field[Any]) -> None:
    about = knob.metadata
    flag = _flag(knob)
    text = f"{about['help']}, in {about['unit']}" if about["unit"] else about["help"]
    if isinstance(knob.default, bool):
        if about["off_flag"]:
            group.add_argument(
                about["off_flag"], dest=knob.name, action="store_false", default=knob.default, help=f"the opposite of {flag}"
            )
        group.add_argument(flag, dest=knob.name, action="store_true", default=knob.default, help=text)
    elif isinstance(knob.default, tuple):
        default = list(knob.default)
        group.add_argument(flag, dest=knob.name, nargs="+", action=_Extend, choices=about["choices"], default=default, help=text)
    elif about["choices"]:
        group.add_argument(flag, dest=knob.name, choices=about["choices"], default=knob.default, help=text)
    else:
        group.add_argument(flag, dest=knob.name, type=type(knob.default), default=knob.default, metavar=about["metavar"], help=text)


def _flag(knob: dataclasses.Field[Any]) -> str:
    return knob.metadata["flag"] or "--" + knob.name.replace("_", "-")
