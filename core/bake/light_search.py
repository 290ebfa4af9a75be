"""The stages that find the light: preview, direct light, photons."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from ..integrate.direct_field import DirectField
from ..integrate.direct_shards import NOTHING_AHEAD, ShotAhead, cut_into_shards
from ..integrate.light_field import LightField
from ..parallel.executors import ShardExecutor
from ..scene.materials import SurfaceMaterials
from ..util.arrays import IntArray
from ..util.messages import Message, Status
from ..util.settings import Settings
from . import checkpoint, preview, solve
from .direct_only import settle_direct
from .first_photons import FirstPhotons
from .lost_light import state_lost
from .receiving_texels import Receivers
from .run import Run
from .work_plan import WorkPlan

PREVIEW_FOLDER = "preview"
_GLANCING = Status("preview", "First light")
_NO_ERROR = 1e-4  # the least that Settings allow: no bake by photons comes to it
_COARSE = "the time limit ended before shadow rays were sent from all texels; the lightmap is coarse, raise Time Limit (--time-limit)"


@dataclass
class LightSearch:
    """Inputs of the stages.

    first        photons that are traced ahead
    surfaces     materials for the preview
    tri_object   (n_tri,) int: the object of each triangle
    """

    run: Run
    settings: Settings
    needs: WorkPlan
    receivers: Receivers
    executor: ShardExecutor
    first: FirstPhotons
    surfaces: SurfaceMaterials
    tri_object: IntArray

    def find(self) -> tuple[LightField, solve.Solver | None]:
        """The light, and the solver with the state to keep; None if there is none.

        Raises ValueError with a sentence if an earlier bake cannot be continued.
        """
        run, settings, texels = self.run, self.settings, self.receivers.texels
        kept = checkpoint.load_checkpoint(Path(run.job.resume), run.folder, settings) if run.job.resume else None
        direct = kept.direct if kept else DirectField.none(len(texels))
        live, tell = self._show_first_light(direct, is_first=not kept)
        solver, is_shot = None, True
        if self.needs.direct and not kept:
            solver, is_shot = self._shoot_direct(direct, tell)
        if not is_shot:  # stopped before all texels have direct light: photons estimate all light coarsely in the time left
            self.settings = settings = replace(settings, direct="photons", error=_NO_ERROR)
            solver, direct, self.first = None, DirectField.none(len(texels)), FirstPhotons()
        if self.needs.photons or not is_shot:
            with run.stage(solve.TRACING):
                solver = solver or self._open_solver(direct)
                if kept:
                    kept.give_to(solver)
                if live:
                    solver.watch = live.show
                light = solver.run(run.tell, run.should_stop)
        else:
            deadline = run.deadline
            light = settle_direct(run.folder, texels, self.tri_object, settings, self.executor, direct, run.tell, run.should_stop, deadline)
        light, lost = state_lost(light, settings)
        run.warn(lost)
        if not is_shot:  # the variance of photons does not include the bias of coarse leaves
            light = replace(light, error=math.nan, object_error={})
            run.warn([("", _COARSE)] if light.stopped_by == "time_limit" else [])
        return light, solver if is_shot else None

    def _show_first_light(self, direct: DirectField, is_first: bool) -> tuple[preview.PreviewPages | None, Callable[[Message], None]]:
        """Preview pages, None without a viewport, and the listener for progress of direct light.

        is_first   whether there is no light of an earlier bake to show
        """
        run, texels = self.run, self.receivers.texels
        if not (run.job.preview and self.needs.direct):
            return None, run.tell
        with run.stage(_GLANCING):
            live = preview.PreviewPages(run.folder / PREVIEW_FOLDER, texels, self.surfaces, self.settings, run.tell)
            if not is_first:
                return live, run.tell
            return live, live.join(preview.find_first_light(run.folder, self.settings, texels), direct)

    def _shoot_direct(self, direct: DirectField, tell: Callable[[Message], None]) -> tuple[solve.Solver | None, bool]:
        """Send shadow rays from all texels, to a tolerance relative to the total light, which a first round of photons estimates. Returns
        the solver of that round, None without photons, and whether all rays were sent.
        """
        run, settings, texels = self.run, self.settings, self.receivers.texels
        solver, ahead, by_rays = None, NOTHING_AHEAD, settings.direct == "rays"
        if self.needs.photons and by_rays:
            if not run.deadline.limit_s:  # waiting for rays that were sent ahead ignores the time limit
                ahead = ShotAhead.send(run.folder, settings, self.executor, len(texels))
            with run.stage(solve.TRACING):
                solver = self._open_solver(direct)
                solver.begin()
        is_shot, foreseen = True, run.deadline.foresee(len(cut_into_shards(len(texels))) - 1)

        def should_stop() -> bool:
            return run.should_stop() or foreseen()

        with run.stage(DirectField.said):
            if solver:
                is_shot = solver.shoot_direct(tell, should_stop, ahead)
            elif by_rays:
                eased = run.deadline.ease(settings)
                is_shot = direct.shoot(run.folder, eased, self.executor, range(len(texels)), tell, should_stop)
            if solver and is_shot:  # the filter runs on idle processes meanwhile
                limited = run.deadline.limit_spread(self.executor.spread, run.deadline.is_over)
                direct.begin_show(texels, settings.denoise, limited)
        return solver, is_shot

    def _open_solver(self, direct: DirectField) -> solve.Solver:
        found = self.receivers
        return solve.Solver(
            self.run.folder,
            self.settings,
            self.executor,
            direct,
            found.touched,
            first=self.first,
            limit=self.run.deadline,
        )
