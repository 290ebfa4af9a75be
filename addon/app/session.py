"""One bake as Blender sees it: the scene goes out to a folder, and what comes back is put on its objects.

Between the two only names and numbers are kept: undo, or a file that is opened meanwhile, makes references invalid.
"""

from __future__ import annotations

import json
import math
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import bpy
from mathutils import Matrix

from ...core.bake.bake_cache import KeptBake, find_kept_bake
from ...core.bake.checkpoint import INFO_FILE, describe_differences, find_differences, keep_layout
from ...core.output import image_file
from ...core.output.image_room import SPARE_PREFIX
from ...core.scene.snapshot import save_snapshot
from ...core.util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from ...core.util.messages import Done, Message, Status, Warning_
from ...core.util.progress import Watch, unwatched
from ..read import baked_copies, export_scene
from ..read.export_pieces import walk_pieces
from ..read.export_receivers import LINKED
from ..read.object_settings import registered
from ..read.render_levels import evaluate_for_render
from ..read.steps import Pause, Steps, run_aside, run_steps
from ..read.tags import local_objects
from ..read.world_cache import MapCache
from ..show import images, materials_write, restore
from ..show.layers_write import write_layers
from ..show.layout import Layout, mark_layout, read_layout, worn_digest
from ..show.page_store import find_folder, keep_page
from ..show.scene_prints import Baked, Prints, describe_changes, mark_prints, read_marked, walk_prints
from . import spare_images
from .arguments import BakeRequest
from .job import library_paths
from .kept_state import mark_state
from .marks_check import drop_broken_marks

Warnings = list[tuple[str, str]]
# Texels of a texture's side for each of a page's: one object fills a page at most, and seldom shows less than a quarter of a texture. And
# texels that any texture may have, for reflected light has the colours of small things too.
_SHOWN_TEXELS, _LEAST_TEXELS = 4, 1024
# Seconds that showing, saving and reporting a bake take, and their part of those of the export: both go over all objects.
_AFTER_S, _AFTER_OF_EXPORT = 0.2, 0.3
_KNOBS_OF_CORE = ("max_depth",)  # which it sets itself, where nobody asks for reflected light
READING_WORLD = "Reading the world's light"
_LEAST_BYTES = 1024  # of a folder that has room


@dataclass(frozen=True)
class Session:
    """A bake under way in `folder`.

    prints  of the scene as it was exported
    kept    the last bake, where nothing has changed since and its result is in the folder already
    """

    folder: Path
    request: BakeRequest
    export: export_scene.ExportResult
    prints: Prints
    kept: KeptBake | None = None


def prepare(context: bpy.types.Context, request: BakeRequest, folder: Path, tell: Callable[[Message], None] = lambda _: None) -> Session:
    """Export the scene and write the job, or what an earlier bake of the same gave.

    tell   is given a message before what takes long
    Raises ValueError with a sentence when there is nothing to bake, OSError when the output folder cannot be written.
    """

    def watch(pause: Pause) -> None:
        if pause is Pause.LONG:
            tell(Status("world", READING_WORLD))

    return run_steps(prepare_steps(context.scene, context.view_layer, request, folder), watch)


def prepare_steps(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, request: BakeRequest, folder: Path, watch: Watch = unwatched
) -> Steps[Session]:
    """`prepare` in steps. Between them the scene may look as it is rendered; closing the generator puts everything back."""
    check_folder(request.output)
    drop_broken_marks()
    if request.resume:
        request = replace(request, settings=keep_layout(request.resume, request.settings))
    atlas_name = request.name or Path(bpy.data.filepath).stem or (request.scene.stem if request.scene else "lightmap")
    kept_maps = MapCache.beside(request.output, atlas_name, not request.settings.force)
    start = time.monotonic()
    began, limit = request.began or start, request.settings.time_limit
    with restore.lift_bake(scene):
        until = began + limit if limit else math.inf
        image_file.load_ahead(library_paths())
        most = max(_SHOWN_TEXELS * request.settings.size, _LEAST_TEXELS)
        names, layer = list(request.objects) or None, request.uv_layer or None
        reading = yield from export_scene.read_scene(scene, names, layer, view_layer, until, most, kept_maps, watch)
        prints: Prints = {}
        with registered():
            for name, digest in walk_prints(scene, view_layer, {}):
                prints[name] = digest
                yield Pause.HOLD
    marked = read_marked(scene)
    resume, keep = (str(path.resolve()) if path else "" for path in (request.resume, request.keep))
    blend = bpy.data.filepath or str(request.scene.resolve() if request.scene else "")
    output, taken = request.output.resolve(), _list_taken(scene, request)
    yield Pause.FREE
    export = yield from reading.arrange()
    after_s = _AFTER_S + _AFTER_OF_EXPORT * (time.monotonic() - start)
    job = Job(request.settings, str(output), atlas_name, request.preview, resume, keep, request.keep_mb, blend, taken, began, after_s)
    kept = None if request.settings.force or resume else (yield from run_aside(partial(find_kept_bake, export.snapshot, job)))
    if kept and _lacks_state(job, kept):
        kept = None
    yield Pause.FREE
    try:
        if kept is None:
            yield from run_aside(partial(save_snapshot, folder / SNAPSHOT_FILE, export.snapshot))
            job.save(folder)
            _check_state(marked, request, folder, prints)
        else:
            kept.restore(folder)
    except OSError as reason:
        raise OSError(
            f"{folder}: the scene cannot be kept there ({reason.strerror}); make room, or set TMPDIR to another folder."
        ) from reason
    return Session(folder, request, export, prints, kept)


def _check_state(marked: Baked | None, request: BakeRequest, folder: Path, prints: Prints) -> None:
    """Raises ValueError with a sentence where the state to go on from is of another scene or method; the core finds that much later."""
    if request.resume is None:
        return
    differing = [name for name in find_differences(request.resume, folder, request.settings) if name not in _KNOBS_OF_CORE]
    if not differing:
        return
    changes = marked.list_changes(prints) if marked and "scene" in differing else []
    if changes:
        raise ValueError(f"{describe_changes(changes)}. Refine cannot go on from it: press Bake, or undo the change.")
    raise ValueError(describe_differences(request.resume, differing))


def _list_taken(scene: bpy.types.Scene, request: BakeRequest) -> tuple[str, ...]:
    """Names of images in the output folder that objects show which are not part of this bake."""
    if not request.objects:
        return ()
    others = [obj for obj in local_objects(scene.objects) if baked_copies.find_source(obj).name not in request.objects]
    worn = {image for image in map(materials_write.find_image, others) if image and image.source == "FILE"}
    paths = map(images.find_path, worn)
    return tuple(sorted({path.name for path in paths if find_folder(path) == request.output.resolve()}))


def _lacks_state(job: Job, kept: KeptBake) -> bool:
    """Whether a state is asked for that is not there any more, or never was, and that the bake would give."""
    if not job.keep or Path(job.keep, INFO_FILE).exists():
        return False
    return not (job.keep_mb and kept.stateless)  # the panel keeps a state only if it is small


def check_folder(folder: Path) -> None:
    """Make the folder and try it, before minutes go into a bake.

    Raises OSError with a sentence when nothing can be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(bytes(_LEAST_BYTES))  # a full disk still makes empty files
    except OSError as reason:
        raise OSError(f"{folder}: is no folder that can be written ({reason.strerror}); choose another one.") from reason


def check_file(file: Path) -> None:
    """The same for a file that is to be written.

    Raises OSError with a sentence when it cannot be.
    """
    check_folder(file.parent)
    if file.is_dir():
        raise OSError(f"{file}: is a folder; give the name of a file.")
    if file.exists() and not os.access(file, os.W_OK):
        raise OSError(f"{file}: is write-protected; choose another name, or make it writable.")


def list_kept_messages(session: Session) -> list[Message]:
    """The messages of a bake that need not be done."""
    assert session.kept is not None
    count = len(session.kept.result["files"])
    said = Status("kept", f"Unchanged since the last bake: {count} file{'s' if count > 1 else ''} kept")
    return [said, *(Warning_(*warning) for warning in session.kept.warnings), Done(str(session.folder / RESULT_FILE), False)]


def has_result(session: Session) -> bool:
    """Whether the core left one: a bake that was stopped before there was any light has none."""
    return (session.folder / RESULT_FILE).exists()


def read_result(session: Session) -> dict[str, Any]:
    """The result that the core left."""
    result: dict[str, Any] = json.loads((session.folder / RESULT_FILE).read_text(encoding="utf-8"))
    return result


def finish_files(scene: bpy.types.Scene, result: dict[str, Any]) -> None:
    """Write what only Blender can: images through the scene's view transform.

    Raises OSError with a sentence when one cannot be written.
    """
    for file in result["files"]:
        linear = file.pop("linear")
        if linear:
            spare_images.finish_view(file, Path(linear), scene)
    result.setdefault("spare", "")  # of a bake that an earlier version kept


def assign(context: bpy.types.Context, session: Session, result: dict[str, Any]) -> Warnings:
    """`assign_steps` at once."""
    return run_steps(assign_steps(context, session, result))


def assign_steps(context: bpy.types.Context, session: Session, result: dict[str, Any]) -> Steps[Warnings]:
    """Put UV layers and images on the baked objects, in place of any earlier bake; gives what could not be done.

    A bake of objects that were named leaves the others the bake that they carry.
    """
    layout, scene, view_layer = get_layout(session), context.scene, context.view_layer  # between two steps the user may show another scene
    part, baked = _find_part(session, layout) if session.request.objects else None, compare_prints(scene, session, layout)
    if (yield from restore.remove_steps(scene, part)):
        view_layer.update()  # with thousands of objects it takes as long as all else here
    others = part is not None and restore.has_bake(scene)
    warnings = yield from show_pages(scene, view_layer, session, layout, load_pages(session.request, result))
    if others:
        warnings += restore.toggle_preview(scene, True)
    mark_bake(scene, session, result, baked)
    return warnings


def mark_bake(scene: bpy.types.Scene, session: Session, result: dict[str, Any], baked: Baked) -> None:
    """Remember of a bake that the scene wears where its state and its images are, and what the scene was like."""
    mark_state(scene, session.request, result)
    spare_images.mark_spare(scene, result.get("spare", ""))
    mark_prints(scene, baked)


def compare_prints(scene: bpy.types.Scene, session: Session, layout: Layout) -> Baked:
    """What is to be remembered of the scene as it was baked, before the new bake takes the place of the last."""
    marked = read_marked(scene)
    if not session.request.objects or marked is None:
        return Baked(session.prints)
    part = _find_part(session, layout)
    wearers = {baked_copies.find_source(obj) for obj in local_objects(scene.objects) if materials_write.BAKE in obj}
    if not wearers - part:
        return Baked(session.prints)
    return Baked(session.prints, tuple(dict.fromkeys([*marked.older, *marked.list_changes(session.prints)])))


def _find_part(session: Session, layout: Layout) -> set[bpy.types.Object]:
    """The objects of the user's that a bake is of: those that were named, and those that have a page."""
    named = {obj for obj in bpy.data.objects if obj.name in session.request.objects and not obj.library}
    baked = [one for one, page in zip(session.export.objects, layout.object_page, strict=True) if page >= 0]
    return named | {obj for obj in export_scene.find_objects(baked) if obj is not None}


def show_pages(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, session: Session, layout: Layout, page_image: dict[int, bpy.types.Image]
) -> Steps[Warnings]:
    """Put UV layers and these images on the baked objects, which carry no bake; gives what could not be done.

    Whoever closes the generator takes off what was put on until then.
    """
    export = session.export
    baked = [i for i, page in enumerate(layout.object_page) if page in page_image]
    targets, warnings = _find_targets(scene, view_layer, [export.objects[i] for i in baked])
    found = [(i, obj) for i in baked if (obj := targets.get(export.objects[i].name))]
    to_write = [(i, obj) for i, obj in found if not export.snapshot.objects[i].has_layer]
    failed, told = yield from write_layers(export, layout, to_write, session.request.settings.share_meshes)
    pairs = [(i, (obj, page_image[int(layout.object_page[i])])) for i, obj in found if i not in failed]
    ours = [pair for i, pair in pairs if not export.snapshot.objects[i].has_layer]
    theirs = [pair for i, pair in pairs if export.snapshot.objects[i].has_layer]
    warnings += told
    mode = _pick_mode(session.request)
    warnings += yield from materials_write.assign_steps(ours, mode, "")
    warnings += yield from materials_write.assign_steps(theirs, mode, session.request.uv_layer)
    warnings += _warn_shared(scene, [obj for _, obj in found])
    mark_layout(scene, layout, page_image, warnings)
    return warnings


def _warn_shared(scene: bpy.types.Scene, objects: list[bpy.types.Object]) -> Warnings:
    """A sentence for each object that other scenes with a bake of their own show as well."""
    others = [one for one in bpy.data.scenes if one != scene and worn_digest(one)]
    return [
        (obj.name, f"{obj.name}: is in the scene {one.name} too, which now shows this bake on it; give each scene a copy of its own.")
        for one in others
        for obj in objects
        if one.objects.get(obj.name) == obj
    ]


def get_layout(session: Session) -> Layout:
    """The layout of the bake, once the core has made it."""
    return read_layout(session.folder, session.export.objects, f"{_pick_mode(session.request)} {session.request.uv_layer}")


def _pick_mode(request: BakeRequest) -> str:
    return "nodes" if request.nodes_only else "lighting" if request.settings.passes[0] == "lighting" else "combined"


def load_pages(request: BakeRequest, result: dict[str, Any]) -> dict[int, bpy.types.Image]:
    """The first pass asked for, in the first format asked for that can be shown, by page.

    Raises OSError with a sentence where no page can be kept.
    """
    wanted = (request.settings.passes[0], images.find_shown_format(request.settings))
    files = [file for file in result["files"] if (file["pass_name"], file["kind"]) == wanted]
    paths = {file["page"]: Path(file["path"]).resolve() for file in files}
    if request.keep_pages:
        try:
            paths = {page: _keep(path) for page, path in paths.items()}
        except OSError as reason:
            raise OSError(f"{request.output}: pages cannot be kept for undo ({reason.strerror}); make room and bake again.") from reason
    return {page: images.load_image(path, pack=request.settings.pack) for page, path in paths.items()}


def _keep(path: Path) -> Path:
    """The page to show of a file; no bake writes into another's spare folder, so what is there needs no other name."""
    return path if path.parent.name.startswith(SPARE_PREFIX) else keep_page(path)


def _find_targets(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, exported: list[export_scene.ExportedObject]
) -> tuple[dict[str, bpy.types.Object], Warnings]:
    """The objects that carry the bake, by name in the snapshot: the user's own, or copies made now."""
    targets: dict[str, bpy.types.Object] = {}
    warnings: Warnings = []
    copies = {one.key: one for one in exported if one.needs_copy}
    own = [one for one in exported if not one.needs_copy]
    for one, obj in zip(own, find_carriers(own), strict=True):
        if obj is None:
            warnings.append((one.source, f"{one.source}: was deleted or edited during the bake, so its lightmap fits nothing; bake again."))
            continue
        targets[one.name] = obj
    if copies:
        ignored: Warnings = []  # the export has told them already
        with evaluate_for_render(scene, view_layer, ignored) as depsgraph:
            for piece in walk_pieces(view_layer, depsgraph):
                if piece.key not in copies:
                    continue
                one = copies[piece.key]
                if one.reason == LINKED:  # as the export has told
                    continue
                try:
                    matrix = Matrix(piece.matrix.tolist())
                    targets[one.name] = baked_copies.make_copy(scene, piece.source, piece.evaluated, matrix)
                except ValueError as reason:
                    warnings.append((one.source, str(reason)))
        baked_copies.set_copies_visible(scene, True)  # only now: evaluate_for_render had lent itself their visibility
    return targets, warnings


def find_carriers(exported: list[export_scene.ExportedObject]) -> list[Any]:
    """The user's own objects that carry the bake, None for what was deleted or edited meanwhile."""
    found = zip(exported, export_scene.find_objects(exported), strict=True)
    return [obj if obj is not None and obj.type == "MESH" and len(obj.data.loops) == one.n_corner else None for one, obj in found]
