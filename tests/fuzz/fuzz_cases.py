"""One case from a seed: files in a folder, and the words of a command line. Needs bpy for scenes; see run_fuzz.py."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import bpy
from leaflight.addon.ui import cli
from leaflight.core.util.settings import Settings
from odd_files import copy_tree, damage_bytes, damage_file, damage_json, lay_traps
from odd_scene import build_scene
from odd_values import NAMES, draw_name

QUICK = ["--size", "32", "--max-photons", "2000", "--workers", "1", "--error", "0.3"]
_FORMATS = {".blend": 3, ".glb": 3, ".gltf": 1, ".obj": 1, ".fbx": 1, ".usda": 1, ".usdc": 1}
_STATE_WORDS = [["--resume", "state"], ["--resume", "state", "--keep", "state"], [], ["--keep", "state"], ["--force", "--keep", "state"]]
# What a case of a few seconds cannot be asked for: beyond these it is only planned, or gets a time limit.
_MOST_SIZE, _MOST_DENSITY = 512, 60.0


@dataclass(frozen=True)
class Case:
    """What is run.

    words    of the command line, `bake` included
    outputs  names in the folder that the bake may make or change
    about    what is odd about it
    """

    seed: int
    words: tuple[str, ...]
    outputs: tuple[str, ...]
    about: str


def draw_case(seed: int, folder: Path, kit: Path) -> Case:
    """Prepare the case of a seed in an empty folder; `kit` is of make_kit."""
    rng = Random(seed)
    (folder / "victim.txt").write_text("a file of the user's, which nobody may touch\n", encoding="utf-8")
    draw: Callable[[int, Random, Path, Path], Case] = rng.choices(
        [_draw_scene, _draw_damaged_scene, _draw_damaged_state, _draw_words], [55, 15, 20, 10]
    )[0]
    return draw(seed, rng, folder, kit)


def _draw_scene(seed: int, rng: Random, folder: Path, kit: Path) -> Case:
    build_scene(rng)
    names = [obj.name for obj in bpy.context.scene.objects]
    scene = _save_blend(rng, folder)
    words, outputs = _draw_outputs(rng)
    words += _draw_knobs(rng, rng.choice([0, 0, 1, 3]), odd=False)
    if names and rng.random() < 0.25:
        chosen = [rng.choice([*names, *NAMES]) for _ in range(rng.choice([1, 2]))]
        words += ["--objects", *chosen]
    if rng.random() < 0.15:
        layers = [layer.name for mesh in bpy.data.meshes for layer in mesh.uv_layers]
        words.append(f"--uv-layer={rng.choice([*layers, 'UVMap'])}")
    return Case(seed, ("bake", scene, *QUICK, *words), outputs, "odd scene")


def _save_blend(rng: Random, folder: Path) -> str:
    name = "scene" if rng.random() < 0.8 else draw_name(rng).replace("/", "_").replace("\0", "_").strip() or "_"
    path = folder / f"{name}.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False, compress=rng.random() < 0.3)
    found = [one.name for one in folder.iterdir() if one.suffix == ".blend"]  # Blender may call it otherwise
    return f"./{found[0]}"


def _draw_damaged_scene(seed: int, rng: Random, folder: Path, kit: Path) -> Case:
    suffix = rng.choices(list(_FORMATS), list(_FORMATS.values()))[0]
    for file in kit.glob("room.*"):
        if file.suffix == suffix or (suffix, file.suffix) in ((".gltf", ".bin"), (".obj", ".mtl")):
            (folder / file.name).write_bytes(file.read_bytes())
    files = [file for file in folder.glob("room.*") if file.suffix == suffix or rng.random() < 0.5]
    for path in files:
        if path.suffix == ".gltf" and rng.random() < 0.7:
            path.write_text(damage_json(rng, path.read_text(encoding="utf-8")), encoding="utf-8")
        else:
            path.write_bytes(damage_bytes(rng, path.read_bytes()))
    words, outputs = _draw_outputs(rng)
    return Case(seed, ("bake", f"room{suffix}", *QUICK, *words), outputs, f"damaged {suffix}")


def _draw_damaged_state(seed: int, rng: Random, folder: Path, kit: Path) -> Case:
    copy_tree(kit / "baked", folder)
    output, victim = folder / "maps", folder / "victim.txt"
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix != ".blend" and path != victim)
    told = [damage_file(rng, path, victim) for path in rng.sample(files, rng.choice([1, 1, 1, 2]))]
    if rng.random() < 0.15:
        lay_traps(rng, output, victim)
        told.append("traps")
    words = rng.choice(_STATE_WORDS)
    scene = rng.choice(["room.blend", "room.blend", "saved.blend"])
    outputs = ("maps", "state", "report.json", "saved2.blend")
    save = ["--save", "saved2.blend"] if rng.random() < 0.3 else []
    words = ["bake", scene, *QUICK, "--output", "maps", "--report", "report.json", *words, *save]
    return Case(seed, tuple(words), outputs, f"damaged {', '.join(told)}; {' '.join(words[1:2] + words[-4:])}")


def _draw_words(seed: int, rng: Random, folder: Path, kit: Path) -> Case:
    (folder / "room.blend").write_bytes((kit / "room.blend").read_bytes())
    words, outputs = _draw_outputs(rng)
    words += _draw_knobs(rng, rng.choice([1, 2, 6]), odd=True)
    if rng.random() < 0.3:
        word = rng.choice(["--scene", "--view-layer", "--objects", "--frame", "--cluster", "--nonsense", "--uv-layer", "--name-pattern"])
        words += [word, rng.choice([*NAMES, "1", "-1", "99999999999"])]
    if rng.random() < 0.2:
        words += [rng.choice(["--report", "--save", "--gltf", "--keep", "--resume", "--output"]), _draw_path(rng)]
    scene = "room.blend" if rng.random() < 0.9 else rng.choice(["", ".", "none.blend", "victim.txt", "a\0b", "//room.blend", "x" * 300])
    return Case(seed, ("bake", scene, *QUICK, *words), outputs, f"odd words: {' '.join(words)!r}")


def _draw_path(rng: Random) -> str:
    """A path that cannot be written to, or that lies in `maps`."""
    return rng.choice(
        ["victim.txt", "victim.txt/below", "", "maps/a b.blend", "maps/" + "x" * 300, "maps/nul\0.glb", "maps/-x.glb", "/proc/x.blend"]
    )


def _draw_outputs(rng: Random) -> tuple[list[str], tuple[str, ...]]:
    words = ["--output", "maps", "--report", "report.json"]
    outputs = ["maps", "report.json"]
    for word, name, chance in (("--save", "saved.blend", 0.3), ("--gltf", "scene.glb", 0.2), ("--keep", "state", 0.2)):
        if rng.random() < chance:
            words += [word, name]
            outputs.append(name)
    return words, (*outputs, "scene.lightmap.json")


def _draw_knobs(rng: Random, count: int, odd: bool) -> list[str]:
    """Words of so many settings; with `odd` at their bounds, beyond, or of another kind, otherwise within."""
    words: list[str] = []
    values: dict[str, Any] = {}
    for knob in rng.sample(dataclasses.fields(Settings), count):
        if knob.name == "cluster":
            continue
        flag = knob.metadata["flag"] or "--" + knob.name.replace("_", "-")
        if isinstance(knob.default, bool):
            words.append(rng.choice([flag, knob.metadata["off_flag"] or flag]))
            continue
        value = _draw_odd_value(rng, knob) if odd else _draw_value(rng, knob)
        values[knob.name] = value
        words += [flag, *map(str, value if isinstance(value, list) else [value])]
    if not 0 <= _number(values.get("size")) <= _MOST_SIZE or not 0 <= _number(values.get("density")) <= _MOST_DENSITY:
        words.append("--dry-run")
    elif values.keys() & {"error", "max_photons", "workers", "stability", "min_level", "padding", "margin"} and "time_limit" not in values:
        words += ["--time-limit", "4"]
    return words


def _number(value: Any) -> float:
    try:
        return float(value or 0.0)
    except (TypeError, ValueError):
        return 0.0


def _draw_value(rng: Random, knob: Any) -> Any:
    about = knob.metadata
    if about["choices"]:
        return rng.sample(about["choices"], rng.choice([1, 2])) if isinstance(knob.default, tuple) else rng.choice(about["choices"])
    if isinstance(knob.default, str):
        return rng.choice(["{name}.{pass}", "{page}-{pass}", "x{name}{pass}"])
    if knob.name in ("size", "density", "error", "max_photons", "workers", "time_limit"):
        return {"size": 64, "density": 20.0, "error": 0.1, "max_photons": 20_000, "workers": 2, "time_limit": 3.0}[knob.name]
    low, high = about["low"], about["high"]
    if isinstance(knob.default, int):
        return min(low + rng.choice([0, 1, 2, 7]), high)
    return min(low + rng.choice([0.0, 0.1, 3.0]), high)


def _draw_odd_value(rng: Random, knob: Any) -> Any:
    about = knob.metadata
    if about["choices"]:
        return rng.choice([rng.choice(about["choices"]), "", "nonsense", "-1"])
    if isinstance(knob.default, str):
        return rng.choice([*NAMES, "{name}", "{pass}", "{}", "{{name}}", "{name}" * 9, "a/../{name}.{pass}"])
    low, high = about["low"], about["high"]
    near = [low, high, low - 1, high + 1, math.nan, math.inf, -math.inf, 1e308, -0.0, "0x10", "1e3", "1_000", "²", " 5 ", "9" * 5000]
    return rng.choice(near)


def make_kit(kit: Path) -> None:
    """Files that cases damage: a small room in every format, and a bake of it with its state, notes and pages."""
    from blend_rooms import open_room

    kit.mkdir(parents=True, exist_ok=True)
    open_room()
    _paint_room()
    for suffix in _FORMATS:
        path = str(kit / f"room{suffix}")
        if suffix == ".blend":
            bpy.ops.wm.save_as_mainfile(filepath=path)
        elif suffix in (".glb", ".gltf"):
            bpy.ops.export_scene.gltf(filepath=path, export_format="GLB" if suffix == ".glb" else "GLTF_SEPARATE", export_lights=True)
        elif suffix == ".obj":
            bpy.ops.wm.obj_export(filepath=path)
        elif suffix == ".fbx":
            bpy.ops.export_scene.fbx(filepath=path)
        else:
            bpy.ops.wm.usd_export(filepath=path)
    baked = kit / "baked"
    baked.mkdir()
    (baked / "room.blend").write_bytes((kit / "room.blend").read_bytes())
    places = {"--output": "maps", "--keep": "state", "--save": "saved.blend"}
    words = [word for flag, name in places.items() for word in (flag, str(baked / name))]
    assert cli.main(["bake", str(baked / "room.blend"), *QUICK, *words, "--quiet"], with_scene=True) == 0


def _paint_room() -> None:
    """An image on the floor, packed, so that files hold more than meshes."""
    material = bpy.data.materials.new("Tiles")
    if material.node_tree is None:  # Blender 4.5
        material.use_nodes = True
    image = bpy.data.images.new("tiles", 16, 16)
    image.pixels.foreach_set([((i // 4) % 7) / 7 for i in range(4 * 16 * 16)])
    image.pack()
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    material.node_tree.links.new(texture.outputs[0], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    bpy.data.objects["Floor"].data.materials.append(material)
