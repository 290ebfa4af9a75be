"""References of the zoo: scenes as Cycles bakes them, with two seeds whose noise cancels in the measure (see lightmap_errors.py).

python tests/bench/zoo_reference.py FOLDER OUT.npz SIDE SECONDS NOISE     what find_reference runs, in a process of its own

Each seed is baked in batches, every one twice as long as the one before, until the noise of their mean is small enough or the time is
used up. That is counted in seconds of all processors together, so that a busy machine makes the same references. Of large pages windows
are baked, spread over the page.
"""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))

from lightmap_errors import LightmapErrors, measure_errors, reference_noise

SCENE, ABOUT, OWNERS = "scene.blend", "about.json", "owners.npy"
NO_OWNER = -1
# Windows along either side of a page, of scenes with fewer triangles: Blender sends the whole scene to Cycles for each.
_WINDOWS = ((10_000, 8), (80_000, 4), (math.inf, 2))
_FIRST_SAMPLES = 32
_LEAST_COLOR = 1e-4  # of what reflects diffusely
# Nodes that say another thing once objects are joined: textures without a layer lie over the object's box, say.
_OF_OBJECTS, _OF_LAYERS = {"OBJECT_INFO", "ATTRIBUTE", "NEW_GEOMETRY", "PARTICLE_INFO", "HAIR_INFO"}, {"TEX_IMAGE", "TEX_ENVIRONMENT"}
_MAKING = 3  # raised where references are made in another way, so that older ones in a cache are void
_SEEDS_APART = 100_000  # of batches; windows within one are 100 apart


@dataclass(frozen=True)
class Subject:
    """A scene to be baked, in a folder of its own.

    folder     with SCENE and ABOUT
    objects    names of those that get a lightmap
    uv_layer   the layer they have, or "" where Leaflight makes one
    size       side of the page, texels
    triangles  of the whole scene
    about      one line for people
    """

    folder: Path
    name: str
    objects: tuple[str, ...]
    uv_layer: str
    size: int
    triangles: int
    about: str

    @property
    def blend(self) -> Path:
        return self.folder / SCENE

    def save(self) -> None:
        about = {name: value for name, value in vars(self).items() if name != "folder"}
        (self.folder / ABOUT).write_text(json.dumps(about), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> Subject:
        """Raises OSError where the folder has none."""
        about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        return cls(folder, **{**about, "objects": tuple(about["objects"])})


@dataclass(frozen=True)
class PageReference:
    """One scene as Cycles bakes it.

    covered         (size, size) bool, row 0 at the bottom: texels that were baked
    first, second   (n, 3) float32, of the covered texels in the order of rows
    owner           (n,) int16, index of the object of each covered texel in Subject.objects
    samples         of each seed
    seconds         of both, and of all processors together
    opaque          (n,) float32, share of each covered texel's samples that met its surface and did not go on through it; None in files
                    of old, in which all texels count alike
    """

    covered: np.ndarray
    first: np.ndarray
    second: np.ndarray
    owner: np.ndarray
    samples: int
    seconds: float
    opaque: np.ndarray | None = None

    @classmethod
    def load(cls, path: Path) -> PageReference:
        """Raises OSError where there is none."""
        with np.load(path) as file:
            arrays = (file[key] for key in ("covered", "first", "second", "owner"))
            return cls(*arrays, int(file["samples"]), float(file["seconds"]), file.get("opaque"))

    @property
    def noise(self) -> float:
        """Of the mean of both seeds, as `rel` counts it."""
        return reference_noise(self.first, self.second)

    def measure(self, pages: dict[str, np.ndarray], objects: tuple[str, ...]) -> LightmapErrors:
        """Errors of a bake.

        pages   (size, size, 3 or 4) float of each object, or of all under ""
        """
        if "" in pages:
            return measure_errors(pages[""][self.covered][:, :3], self.first, self.second, noisy=True)
        value = np.zeros_like(self.first)
        for index, name in enumerate(objects):
            mine = self.owner == index
            if mine.any():
                value[mine] = pages[name][self.covered][mine, :3]
        return measure_errors(value, self.first, self.second, noisy=True)


def find_reference(subject: Subject, layout: str, side: int, seconds: float, noise: float, needs_opaque: bool = False) -> PageReference:
    """The reference of the cache, made or made better where it is not good enough.

    layout   of the UV layer that Leaflight makes: references of another one are void; "" where the scene has one
    side     of the windows that are baked of the page, texels; see spread_windows
    seconds  that a new one may take, of all processors together
    needs_opaque   whether one without `opaque` is made anew
    """
    path = reference_path(subject, layout, side)
    if path.exists():
        found = PageReference.load(path)
        if (found.seconds >= 0.8 * seconds or found.noise <= noise) and not (needs_opaque and found.opaque is None):
            return found
    command = [sys.executable, __file__, str(subject.folder), str(path), str(side), str(seconds), str(noise)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return PageReference.load(path)


def reference_path(subject: Subject, layout: str, side: int) -> Path:
    """Where the reference is kept; see find_reference."""
    key = hashlib.sha256(f"{layout} {subject.size} {side} {_MAKING}".encode()).hexdigest()[:12]
    return subject.folder / f"reference_{key}.npz"


def spread_windows(size: int, side: int, triangles: int) -> tuple[int, list[tuple[int, int]]]:
    """Side of the windows, and the left and low end of each, one somewhere in each cell of a grid; the whole page where they would fill it.

    side        of 64 windows, texels; fewer ones are larger, with as many texels in all
    triangles   of the scene
    """
    count = next(count for most, count in _WINDOWS if triangles < most)
    pitch, side = size // count, side * _WINDOWS[0][1] // count
    if side >= pitch:
        return size, [(0, 0)]
    places = np.random.default_rng(1).integers(0, pitch - side + 1, (count, count, 2))
    cells = [(i, k) for k in range(count) for i in range(count)]
    return side, [(i * pitch + int(places[i, k, 0]), k * pitch + int(places[i, k, 1])) for i, k in cells]


def next_samples(last: int, spent_s: float, last_s: float, limit_s: float) -> int:
    """Samples of the next batch: twice those of the last, or as many as still fit in the time; 0 where hardly any do.

    spent_s, last_s   seconds of all batches so far and of the last
    """
    left_s = limit_s - spent_s
    samples = min(2 * last, math.floor(last * left_s / last_s)) if last_s > 0.0 else 2 * last
    return samples if 2 * samples >= last else 0


def main(folder: Path, path: Path, side: int, limit_s: float, noise: float) -> None:
    """Bakes the reference in this process, which loads bpy."""
    from cycles_bake import bake_windows, set_stage

    subject = Subject.load(folder)
    window, corners = spread_windows(subject.size, side, subject.triangles)
    with tempfile.TemporaryDirectory() as work:
        stage = set_stage(subject.blend, subject.size, Path(work), subject.objects, window, subject.uv_layer)
    owner = _find_owners(stage, [obj.name for obj in stage.objects]) if subject.uv_layer and len(stage.objects) > 1 else None
    stage = _join(stage)
    # With its light tree, Cycles finds too much light from linked lamps on what they light: 4 to 24 % on three things of one room.
    stage.scene.cycles.use_light_tree = not _has_light_links(stage.scene)
    reflects = _find_diffuse(stage, corners)
    # Light times opacity, and opacity: a batch of which no sample met the surface of a texel knows nothing about it.
    sums, done, samples, spent_s, batch = [np.zeros((subject.size, subject.size, 4)) for _ in range(2)], 0, _FIRST_SAMPLES, 0.0, 0
    while samples:
        begin = time.process_time()
        for index, seed in enumerate((1, 2)):
            page, _ = bake_windows(stage, corners, samples, seed + _SEEDS_APART * batch)
            opaque = page[..., 3:].astype(np.float64)
            sums[index] += samples * np.concatenate([page[..., :3] * opaque, opaque], axis=2)
        done, batch = done + samples, batch + 1
        last_s = time.process_time() - begin
        spent_s += last_s
        covered = (sums[0][..., 3] > 0.0) & (sums[1][..., 3] > 0.0) & reflects
        if owner is not None:
            covered &= owner != NO_OWNER
        first, second = ((total[covered][:, :3] / total[covered][:, 3:]).astype(np.float32) for total in sums)
        if batch > 1 and reference_noise(first, second) <= noise:
            break
        samples = next_samples(samples, spent_s, last_s, limit_s)
    of_texel = np.zeros(int(covered.sum()), np.int16) if owner is None else owner[covered]
    opaque = ((sums[0] + sums[1])[covered][:, 3] / (2 * done)).astype(np.float32)
    temporary = path.with_suffix(".part.npz")
    np.savez(temporary, covered=covered, first=first, second=second, owner=of_texel, samples=done, seconds=spent_s, opaque=opaque)
    temporary.replace(path)
    print(
        f"reference of {subject.name}: {done} samples, {spent_s:.0f} s, {covered.sum()} texels, noise {reference_noise(first, second):.2%}",
        file=sys.stderr,
        flush=True,
    )


def _join(stage):
    """The stage with one object: Blender bakes objects one by one, and sends the whole scene to Cycles anew for each and each window."""
    import bpy
    from cycles_bake import aim_at, read_uv

    plain = all(obj.matrix_world.determinant() > 0.0 and not obj.modifiers and obj.data.users == 1 for obj in stage.objects)
    if len(stage.objects) < 2 or not plain or _tell_objects_apart(stage):
        return stage
    bpy.ops.object.join()
    joined = bpy.context.view_layer.objects.active
    aim_at(joined, stage.image, stage.uv_layer)  # another layer may be active now
    return replace(stage, objects=[joined], page_uv={joined.data: read_uv(joined.data, stage.uv_layer)})


def _tell_objects_apart(stage) -> bool:
    """Whether light depends on which object a face belongs to: by light links, ray visibility, or coordinates over the object."""
    flags = {(obj.visible_diffuse, obj.visible_glossy, obj.visible_transmission, obj.visible_shadow) for obj in stage.objects}
    if len(flags) > 1 or _has_light_links(stage.scene):
        return True
    trees = [slot.material.node_tree for obj in stage.objects for slot in obj.material_slots if slot.material and slot.material.node_tree]
    while trees:
        for node in trees.pop().nodes:
            if node.type in _OF_OBJECTS or (node.type.startswith("TEX_") and node.type not in _OF_LAYERS):
                return True
            if node.type == "GROUP" and node.node_tree:
                trees.append(node.node_tree)
    return False


def _has_light_links(scene) -> bool:
    return any(obj.light_linking.receiver_collection or obj.light_linking.blocker_collection for obj in scene.objects)


def _find_diffuse(stage, corners: list[tuple[int, int]]) -> np.ndarray:
    """(size, size) bool: where a surface reflects diffusely, as metal does not; of other texels Cycles' bake has no light."""
    from cycles_bake import bake_windows

    color, _ = bake_windows(stage, corners, _FIRST_SAMPLES, 1, {"COLOR"})
    return color[..., :3].max(axis=2) > _LEAST_COLOR


def _find_owners(stage, names: list[str]) -> np.ndarray:
    """(size, size) int16: which of the objects is baked at each texel; NO_OWNER where none or several are."""
    import bpy
    from cycles_bake import aim_at, make_target

    target, side = make_target(stage.page_size), stage.page_size
    owner = np.full((side, side), NO_OWNER, np.int16)
    seen = np.zeros((side, side), np.int16)
    pixels = np.empty(side * side * 4, np.float32)
    for obj in stage.objects:
        obj.select_set(False)
    for index, obj in enumerate(stage.objects):
        aim_at(obj, target, stage.uv_layer)
        target.pixels.foreach_set(np.zeros_like(pixels))
        stage.scene.cycles.samples = 1
        bpy.ops.object.bake(type="EMIT", margin=0, use_clear=False, target="IMAGE_TEXTURES")
        target.pixels.foreach_get(pixels)
        covers = pixels.reshape(side, side, 4)[..., 3] > 0.0
        owner[covers] = index
        seen += covers
        obj.select_set(False)
    for obj in stage.objects:
        aim_at(obj, stage.image, stage.uv_layer)
    bpy.data.images.remove(target)
    owner[seen != 1] = NO_OWNER
    return owner


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]), float(sys.argv[5]))
