"""Light by every kind of sky, lamp and matter: a floor in a small scene of each, by Leaflight and by Cycles. Fills docs/matter.md.

python bench_matter.py [--samples N] [--size N] [--docs] [NAME ...]

What was baked is kept in out/matter and taken from there until the scene, or for Leaflight's bakes the code, is another: a run that was
stopped goes on. Of a scene, the pixels of pictures and corner normals are not looked at; remove what is kept after a change of these.
"""

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import cycles_bake
import numpy as np
from cycles_bake import bake_cycles, set_stage
from file_scenes import SCENES as FILE_SCENES
from image_scenes import SCENES as IMAGE_SCENES
from leaflight.addon.read.object_settings import registered
from leaflight.addon.show.scene_prints import print_scene
from leaflight.addon.ui import cli
from leaflight.core.output.image_file import linear_to_srgb, read_image, srgb_to_linear, write_image
from light_scenes import SCENES as LIGHT_SCENES
from lightmap_errors import LightmapErrors, measure_errors
from matter_scenes import CAUSTICS, FLOOR, NOISY, PARTS, WITHOUT_CAUSTICS
from matter_scenes import SCENES as MATTER_SCENES
from ray_scenes import SCENES as RAY_SCENES

SCENES = {**LIGHT_SCENES, **MATTER_SCENES, **RAY_SCENES, **FILE_SCENES, **IMAGE_SCENES}
ROOT = Path(__file__).resolve().parents[2]
PAGE, SHEET = ROOT / "docs" / "matter.md", ROOT / "docs" / "matter.png"
KEPT = ROOT / "out" / "matter"
_MEAN_TARGET, _NRMSE_TARGET = 0.01, 0.04
_COLUMNS, _GAP = 4, 4  # of the sheet, pairs; texels
_SHADES = 85  # of a channel of the sheet: of 255, noise does not compress
_HEAD = """# Light by every kind of sky, lamp and matter

A floor of 4 m in a small scene for each kind of sky, lamp, geometry and matter, baked by Leaflight (`--error 0.01`) and by Cycles
(DIFFUSE, direct and indirect, without colour; all bounces, no clamping, {samples} samples twice, four times as many for caustics, and 16 to
128 times where that is still grainy) on the same UV layer. *mean* is Leaflight's mean light over Cycles', *nrmse* the root mean square
difference over the mean, from which Cycles' own noise is taken off. Targets: 1 % and 4 %.

`make bench-matter` makes this page.

Matter is diffuse, or a metal, mirror or glossy shader (GGX), the layer of the Principled BSDF, glass, transparent, or a mix of these,
each with constants or textures. Glass refracts and reflects by Fresnel's equations, smooth or rough, tinted, solid or of one face. It
casts a shadow, and light comes through it as a caustic, by photons, unless the material lets shadow rays pass (*Is Shadow Ray*). Glass
itself has no lightmap.

Translucent BSDFs send light on to their other side. A texel of such a surface shows the light of both sides, weighted by the colours as in
Cycles' bake: of a Translucent BSDF alone that of the back.

Colours of images are multiplied by alpha and interpolated as in Cycles, but for large images, which have its mean. A volume is left out,
and a warning names it.

What a material shows by the direction to the viewer (*Fresnel*, *Layer Weight*, *Backfacing*) counts exactly for light that goes straight
through, and by side, as the mean over all directions, for light that is reflected or emitted. A warning names a glow that differs by
direction. Rough diffuse surfaces (Oren-Nayar) reflect the right amount of light, alike in all directions.

Metals and glass are as rough as an image says, and as much of a surface is metal, point by point; the roughness of a dielectric layer alone
counts by its mean. The Principled BSDF's Specular Tint tints the edges of metals, and scales what its layer reflects straight on by the
mean of its channels. Normal maps, bumps and displacements that are bumps only count for light that arrives, for photons that go on, and for
what metals and layers reflect. Displacement that moves the surface is left out, and a warning names it; apply it as a modifier.

Rough metal, gloss and glass give back the light that their facets scatter more than once where the shader's distribution is *Multiscatter
GGX*, the default since Blender 4.0; files from before have *GGX*, which loses it.

A coat is a layer above all else but sheen, which is brightest along the surface, by a lobe fitted to Cycles' own. A coat's tint colours
glass by the path that light takes through the coat, and all else that is below by the mean path. Subsurface light leaves where it arrives.

Where the normals of a face's corners face a lamp that stands behind the face, as leaves have them that are shaded like a ball, the lamp
lights the face, as in Cycles; the sky and glowing meshes do not. Where the normals of its corners differ, shadow rays that skim the face
start on the smooth surface over it, as with Cycles' *Shadow Terminator: Geometry Offset* at its default of 0.1.

A material may let shadow rays pass and be glass for all others. That stands in for light that refracts: shadow rays bring it, and no
caustic must bring it again. Leaflight counts it once. Cycles counts it twice unless *Refractive Caustics* are off, as they are in that row.

Materials and *Ray Visibility* count for diffuse, glossy, transmission and shadow rays apart, as in Cycles: a photon carries what each kind
would see of it, for the kind is known only at the surface where it arrives. Lamps, and objects that glow, are seen by each kind of ray,
light objects and have their shadows cast (light and shadow linking) as in Cycles. What glows by *Is Diffuse Ray* Cycles shows in two ways
at once: rays that meet it by chance are diffuse, those that it sends toward lights are of no kind, and it mixes both by how likely each is.
Leaflight shows it as diffuse rays see it; the row compares with Cycles without the second kind (*Emission Sampling: None*; beside the
default, *Auto*, it is 1.444 there).

In the row *glass ball, area lamp* Cycles' texels are means of 4 x 4, for Cycles 5.0 samples the inner quarter of a texel, and the focus is
sharper than that.

What misses its target: rough diffuse walls (Oren and Nayar's) reflect alike in all directions, where rough matter sends more light back to
where it came from. A lightmap holds how much light arrives, and not from where; a warning names the material. Toon and Hair shaders are
baked as diffuse ones of their colour, and a warning names them, too.

A missing image is named, and counts as the value behind its link; Cycles shows magenta. A movie shows the frame that is rendered.

| scene | mean | nrmse | |
| --- | --- | --- | --- |
"""


def bake_leaflight(blend: Path, size: int, folder: Path) -> np.ndarray:
    """(size, size, 4) float32 of the floor's lighting."""
    words = ["bake", str(blend), "--objects", FLOOR, "--uv-layer", "UVMap", "--size", str(size), "--pass", "lighting", "--error", "0.01"]
    code = cli.main([*words, "--per-object", "--no-assign", "--quiet", "--output", str(folder)], "leaflight", with_scene=True)
    if code:
        raise RuntimeError(f"{blend.stem}: Leaflight gave {code}")
    pixels, _ = read_image(next(folder.glob("*.lighting.exr")))
    return np.asarray(pixels)


def compare(name: str, size: int, samples: int) -> tuple[LightmapErrors, float, np.ndarray, np.ndarray]:
    """Errors of a scene's floor, the means' quotient, and both pictures."""
    with tempfile.TemporaryDirectory() as folder:
        blend = Path(folder) / "scene.blend"
        SCENES[name]()
        import bpy

        with registered():
            what = [print_scene(bpy.context.scene, bpy.context.view_layer), bpy.app.version_string, size]
        bpy.ops.wm.save_as_mainfile(filepath=str(blend))
        (ours,) = recall(name, [*what, digest_code()], lambda: [bake_leaflight(blend, size, Path(folder) / "out")])
        how = [samples, PARTS.get(name, 1), Path(cycles_bake.__file__).read_text(encoding="utf-8")]
        first, second = recall(name, [*what, *how], lambda: bake_reference(name, blend, size, samples))
    baked = (first[..., 3] > 0) & (ours[..., 3] > 0)
    is_number = np.isfinite(first + second).all(axis=-1)  # of millions of samples of a mirror Cycles makes one not a number
    if (baked & ~is_number).sum() > baked.sum() / 100:
        raise RuntimeError(f"{name}: Cycles' light is not a number in more than a hundredth of the texels")
    baked &= is_number
    value, one, two = (pixels[baked][:, :3] for pixels in (ours, first, second))
    return measure_errors(value, one, two, noisy=True), float(2 * value.mean() / (one.mean() + two.mean())), ours, (first + second) / 2


def recall(name: str, what: list[object], make: Callable[[], list[np.ndarray]]) -> list[np.ndarray]:
    """Pictures that are kept for a scene and all that decides them, made first if there are none."""
    path = KEPT / f"{name} {hashlib.sha256(json.dumps(what).encode()).hexdigest()[:12]}.npz"
    if not path.exists():
        pictures = make()
        KEPT.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, *pictures)
    with np.load(path) as kept:
        return list(kept.values())


def digest_code() -> str:
    code = sorted(path for package in ("core", "addon") for path in (ROOT / package).rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in code)).hexdigest()


def bake_reference(name: str, blend: Path, size: int, samples: int) -> list[np.ndarray]:
    """Two pictures by Cycles, (size, size, 4) each."""
    parts = PARTS.get(name, 1)
    with tempfile.TemporaryDirectory() as folder:
        stage = set_stage(blend, parts * size, Path(folder), (FLOOR,), uv_layer="UVMap")
        cycles = stage.scene.cycles
        cycles.caustics_refractive = name not in WITHOUT_CAUSTICS
        cycles.glossy_bounces = cycles.transmission_bounces = cycles.transparent_max_bounces = 64
        baked = [bake_cycles(stage, samples // parts**2, seed)[0] for seed in (1, 2)]
    return [one.reshape(size, parts, size, parts, 4).mean(axis=(1, 3)) for one in baked]


def draw_sheet(pairs: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(height, width, 3): Leaflight's picture left of Cycles' in each pair, row by row from the top, each pair to its own brightness."""
    size = len(pairs[0][0])
    rows = -(-len(pairs) // _COLUMNS)
    sheet = np.ones((rows * (size + _GAP), _COLUMNS * (2 * size + 2 * _GAP), 3), np.float32)
    for number, pair in enumerate(pairs):
        row, column = divmod(number, _COLUMNS)
        scale = 0.9 / max(float(np.quantile(pair[1][..., :3], 0.99)), 1e-9)
        for k, picture in enumerate(pair):
            low, left = (rows - 1 - row) * (size + _GAP), column * (2 * size + 2 * _GAP) + k * (size + 1)
            sheet[low : low + size, left : left + size] = picture[..., :3] * scale
    return reduce_shades(sheet)


def reduce_shades(picture: np.ndarray) -> np.ndarray:
    """A linear picture with so few shades that its PNG is small."""
    return srgb_to_linear(np.rint(linear_to_srgb(np.clip(picture, 0, 1)) * _SHADES) / _SHADES)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[[], *SCENES], default=[])
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--docs", action="store_true")
    options = parser.parse_args()
    lines, pairs, missed = [], [], 0
    for name in options.names or SCENES:
        errors, mean, ours, theirs = compare(name, options.size, options.samples * NOISY.get(name, 4 if name in CAUSTICS else 1))
        good = abs(mean - 1) <= _MEAN_TARGET and errors.nrmse <= _NRMSE_TARGET
        missed += not good
        lines.append(f"| {name} | {mean:.3f} | {errors.nrmse:.1%} | {'' if good else 'missed'} |")
        print(lines[-1], flush=True)
        pairs.append((ours, theirs))
    if options.docs:
        write_image(SHEET, draw_sheet(pairs), {}, "png")
        picture = f"\nLeft of each pair Leaflight, right Cycles, in the order of the table:\n\n![Pairs of floors]({SHEET.name})\n"
        PAGE.write_text(_HEAD.format(samples=options.samples) + "\n".join(lines) + "\n" + picture, encoding="utf-8")
    print(f"{len(lines) - missed} of {len(lines)} scenes within the targets")
    return 0


if __name__ == "__main__":
    sys.exit(main())
