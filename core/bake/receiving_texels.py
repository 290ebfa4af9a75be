"""Surfaces that receive light: charts on pages and their texels, cut where light is discontinuous."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..atlas import chart_search
from ..atlas.chart_cache import ChartCache, find_charts_file
from ..atlas.charts import ChartAtlas, make_charts
from ..output import pages
from ..parallel import executors, folders, shared_arrays
from ..radiosity import basis
from ..scene.scene import SceneSnapshot, swap_corners
from ..texels import creases, texels
from ..texels.texel_map import TexelMap
from ..transport import contact_map, contact_search, traced_scene
from ..util.ablation import uses
from ..util.files import save_whole
from ..util.job import LAYOUT_FILE
from ..util.messages import Status, Warning_
from ..util.settings import Settings
from ..util.user_text import group_warnings
from . import earlier_bakes
from .deadline import OutOfTime
from .run import Run

_NO_CONTACTS = (
    "where things touch was not looked for, to keep the time limit: light may leak under walls and furniture; raise the time limit"
)
_TREE = Status("scene", "Preparing the scene for rays")


@dataclass(frozen=True)
class Receivers:
    """Receiving surfaces.

    facets    the charts, cut at creases and contacts
    texels    their texels; mapped read-only, as in all processes
    touched   (n,) bool: as in ContactMap; all False without a search for contacts
    """

    facets: ChartAtlas
    texels: TexelMap
    touched: NDArray[np.bool_]


def lay_out(
    run: Run, snapshot: SceneSnapshot, settings: Settings, kept: ChartCache, tri_turned: NDArray[np.bool_] | None = None
) -> ChartAtlas:
    """The charts of all objects that receive light. Also writes the layout file, from which Blender gets their UVs.

    kept         charts of an earlier bake; new ones are added and kept for the next bake, also if this one is stopped
    tri_turned   (n_tri,) bool: triangles whose corners are in another order than in Blender, see sides
    Raises ValueError with a sentence if there are no charts, if they do not fit on the pages, or if images of another .blend
    would be overwritten.
    """
    with run.stage(chart_search.UNWRAPPING):
        is_whole = False
        try:
            atlas = make_charts(snapshot, settings, run.watch(), kept)
            is_whole = True
        finally:  # after a stop, or if charts do not fit, they need not be unwrapped again
            _keep_charts(run, kept, is_whole)
        if not atlas.page_count:
            reasons = "; ".join(one.text.removesuffix(".") for one in group_warnings(atlas.warnings))
            raise ValueError(f"nothing to bake: no object has a face that takes light ({reasons}).")
        layout = {name: getattr(atlas, name) for name in ("tri_chart", "object_page", "object_block", "object_place")}
        tri_uv = atlas.tri_uv / atlas.page_size
        layout["tri_uv"] = tri_uv if tri_turned is None else swap_corners(tri_uv, tri_turned)
        save_whole(run.folder / LAYOUT_FILE, layout)
        run.warn(atlas.warnings)
        earlier_bakes.refuse_others(run.job, pages.list_names(run.job, snapshot, atlas))
    return atlas


def _keep_charts(run: Run, kept: ChartCache, is_whole: bool) -> None:
    try:
        kept.save(find_charts_file(run.job), is_whole)
    except OSError as reason:
        run.tell(Warning_("", f"the charts cannot be kept in {run.job.output} ({reason}), so the next bake unwraps all meshes again"))


def find_receivers(
    run: Run, snapshot: SceneSnapshot, settings: Settings, atlas: ChartAtlas, executor: executors.ShardExecutor, lit: bool, by_photons: bool
) -> Receivers:
    """The texels of the charts, saved for traced_scene.open_tracing.

    lit          whether the images show light, so that rays are traced
    by_photons   whether leaves will hold light, so that charts are cut along contacts
    """
    place = run.folder / folders.TEXELS_FOLDER
    began = time.process_time()
    with run.stage(texels.MEASURING):
        facets = creases.cut_at_creases(snapshot, atlas) if uses("crease_cuts") else atlas
        shared_arrays.remove_struct(place)  # left by an earlier bake in the same folder
        room, degree = shared_arrays.Room(place), 2 * basis.DEGREES[settings.basis]
        texel_map = texels.build_texel_map(snapshot, facets, degree, room, run.watch())
    seconds, of_processor = run.seconds[texels.MEASURING.stage], time.process_time() - began
    run.deadline.note_texels(seconds, atlas.page_count * atlas.page_size**2, seconds / max(of_processor, 1e-3))
    touched = np.zeros(len(texel_map), bool)
    is_cut = False
    if lit:
        with run.stage(_TREE):
            opened = traced_scene.open_scene(str(run.folder))
        run.warn(opened.warnings)
        if settings.contact and by_photons:
            with run.stage(contact_map.LOOKING), suppress(OutOfTime):
                watch, threads = run.deadline.watch_contacts(run.watch()), executors.count_processors(settings.workers)
                contacts = contact_search.search_contacts(run.folder, opened, texel_map, executor, threads, watch)
                texel_map, facets, touched = contact_map.cut_at_contacts(texel_map, facets, contacts, watch)
                is_cut = True
            if not is_cut:
                run.warn([("", _NO_CONTACTS)])
    shared_arrays.save_struct(place, texel_map)
    if lit:
        texel_map = traced_scene.open_tracing(str(run.folder)).texels
    return Receivers(facets, texel_map, touched)
