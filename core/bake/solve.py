"""From a traced scene to light on texels: rounds of photons, rays that gather their light, and the rule that stops them.

A photon's way: lights.emit -> photons.trace_shard -> texels.entry_of -> tally.deposit -> refine.mark -> quadtree.split.
Two rounds of photons are traced, then every texel gathers their light; if the photons' share of the error is too great, more are traced,
and texels gather again. With direct = "photons" leaves are the light, as in [Tobler97], and rounds go on until their error is small.
With workers and bake the only module that sees both the tracing and the statistics.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..filter import error_estimate
from ..filter.denoise import Spread
from ..integrate import texel_shards
from ..integrate.adaptive_sampling import SamplingStep, Stop, Tell, choose_texels, run_step
from ..integrate.bright_places import find_bright
from ..integrate.direct_field import DirectField
from ..integrate.direct_shards import NOTHING_AHEAD, ShotAhead
from ..integrate.gather import KnownLight, give_signs
from ..integrate.gathered import GatheredField
from ..integrate.light_field import LightField
from ..integrate.texel_light import find_known
from ..lights.stratified_choice import sort_by_place
from ..parallel.executors import ShardExecutor
from ..radiosity import basis, quadtree, refine, tally
from ..radiosity.cell_tally import CellTally
from ..radiosity.radiosity_solution import RadiositySolution
from ..radiosity.scarce_charts import ChartOrder
from ..radiosity.tally import Tally
from ..texels.error_metric import ErrorMetric
from ..transport import rounds, traced_scene
from ..transport.energy_audit import Ledger
from ..util.ablation import uses
from ..util.messages import Status
from ..util.settings import Settings
from .deadline import Deadline
from .first_photons import FirstPhotons
from .photon_rounds import PhotonRounds, save_view
from .photon_shards import PhotonShard
from .stop_rules import StopRules

_LEAST_PHOTONS = 1 << 15  # Least photons of a round that a time limit cuts short: for fewer, estimating the light takes all of the time.
PHOTONS_SHARE = 0.5  # share of the requested error that photons may leave in gathered light, and in caustics; the rest is for rays
TRACING = Status("photons", "Tracing photons")


@dataclass
class Solver:
    """A bake in progress: a stable solution exists after every round."""

    folder: Path  # of traced_scene.open_tracing
    settings: Settings
    executor: ShardExecutor
    direct: DirectField
    forced_texels: NDArray[np.bool_]
    started: float = field(default_factory=time.monotonic)
    watch: Callable[[LightField], None] = lambda light: None  # called with the light after every round but the last
    photons_before: int = 0  # photons of an earlier bake that this one continues
    first: FirstPhotons = field(default_factory=FirstPhotons)
    limit: Deadline | None = None  # of the time limit of a whole bake; None: it counts from now

    def __post_init__(self) -> None:
        self.tracing = traced_scene.open_tracing(str(self.folder))
        self.deadline = self.limit or Deadline(self.settings.time_limit)
        texels, settings = self.tracing.texels, self.settings
        self.degree = basis.DEGREES[settings.basis]
        self.tree = quadtree.plant_trees(texels, self.degree, settings.min_level, settings.finest_texels, not settings.hierarchical)
        if settings.hierarchical:
            self._grow_previews()
        components = 1 if settings.direct == "rays" and not self.tracing.scene.has_caustics else tally.COMPONENTS
        self.tally = Tally.empty(len(self.tree), self.degree, components)
        self.reading: RadiositySolution | None = None  # after the last round
        self._mean_direct: tuple[tuple[RadiositySolution, int], NDArray[np.float64]] | None = (
            None  # result of _find_mean_direct and its key
        )
        self.gathered: GatheredField | None = None
        self._gathered_of = 0  # photons whose light was gathered
        self.metric = ErrorMetric.of(settings.error_of, texels, self.tracing.snapshot.tri_object)
        self.cell_tally = CellTally.empty(len(self.tracing.cells))
        self.ledger, self.rounds, self.round = Ledger(), PhotonRounds(self.executor), 0
        self.rule = refine.Rule(settings.oracle, settings.threshold, settings.stability, settings.preview_depth)

    def _grow_previews(self) -> None:
        depth, finest = self.settings.preview_depth, self.settings.finest_texels
        self.tree = quadtree.grow_previews(self.tree, self.tracing.texels, depth, finest)

    def begin(self) -> None:
        """Trace and read the first round, before there is direct light by rays."""
        self._trace_round(None)
        self.reading = self._read_tallies()

    def shoot_direct(self, tell: Tell, should_stop: Stop, ahead: ShotAhead = NOTHING_AHEAD) -> bool:
        """Shoot shadow rays from all texels after `begin`; see DirectField.shoot."""
        every = range(len(self.tracing.texels))
        settings = self.deadline.ease(self.settings)
        is_done = self.direct.shoot(self.folder, settings, self.executor, every, tell, should_stop, ahead)
        self.started = time.monotonic()  # the time limit and the estimate of the time left count from here
        return is_done

    def run(self, tell: Tell, should_stop: Stop) -> LightField:
        """Trace rounds until a stop rule holds; `tell` receives the progress after each."""
        stated: error_estimate.StatedError | None = None
        traced = self.ledger.photons > 0  # begun, or continued: the last round has not been refined yet
        reading = self.reading
        rules = StopRules(self.settings, should_stop, self.started, self.deadline)
        since, before = time.monotonic(), self.ledger.photons
        while True:
            if not traced:
                self._trace_round(stated)
                self.deadline.note_round(self.ledger.photons - before, time.monotonic() - since)
            began = time.monotonic()
            if reading is None or not traced:
                reading = self.reading = self._read_tallies()
            traced = False
            if self.round == 1 and not rules.find_reason(math.nan, self.ledger.photons) and self._refine(reading):
                # Estimating the error takes time and cannot end the bake here: the first trees do not resolve the detail it should measure.
                light, stated = self._make_light(reading), None
                tell(rules.measure_progress(light, self.photons_before))
                self.watch(light)
                since, before = time.monotonic(), self.ledger.photons
                continue
            light, stated = self._light(reading)
            self.deadline.note_light(time.monotonic() - began)
            while (step := self._choose_step(reading, stated)) and not rules.break_off():
                run_step(step, tell, rules.break_off, TRACING)
                light, stated = self._light(reading)
            stopped_by = rules.find_reason(light.error, light.photons) or self._find_haste()
            light = replace(light, stopped_by=stopped_by)
            tell(rules.measure_progress(light, self.photons_before))
            if light.stopped_by:
                self.rounds.drop()
                return replace(light, object_error=stated.of_objects())
            since, before = time.monotonic(), self.ledger.photons
            self.watch(light)
            self._refine(reading)

    def _find_haste(self) -> str:
        """ "time_limit" where not even a small round can be traced in the time left, else ""."""
        return "" if self.deadline.cap_photons(_LEAST_PHOTONS) == _LEAST_PHOTONS else "time_limit"

    def _choose_step(self, reading: RadiositySolution, stated: error_estimate.StatedError) -> SamplingStep | None:
        """The step that sends more rays from texels, if it reduces the error by more than further photons do."""
        settings, ledger = self.settings, self.ledger
        if settings.direct != "rays":
            return None
        needs_photons = self._foresee_photons(stated) > PHOTONS_SHARE * settings.error and not self._is_last
        if self._gathered_of < ledger.photons:
            every = np.arange(len(self.tracing.texels))
            return None if needs_photons and self.gathered else partial(self._gather, reading, every)
        if stated.relative <= settings.error or needs_photons or stated.photons > max(settings.error, stated.gathered):
            return None  # what was gathered is gathered anew after more photons
        chosen = choose_texels(settings.error, stated, ledger.rays, self.direct, self.gathered)
        if chosen is None:
            return None
        rays, worst, repeats = chosen
        if rays is self.gathered:
            return partial(self._gather, reading, worst, repeats=repeats)
        return partial(self._shoot_again, worst, repeats)

    def _foresee_photons(self, stated: error_estimate.StatedError) -> float:
        """Relative error that the photons so far will leave in gathered light, by what fewer have left, or leave in caustics."""
        carried2 = max(stated.photons**2 - stated.caustics**2, 0.0) * self._gathered_of / max(self.ledger.photons, 1)
        return max(math.sqrt(carried2), stated.caustics)

    @property
    def _is_last(self) -> bool:
        """Whether no more photons may be traced."""
        return self.settings.max_photons - self.ledger.photons < 2

    def _shoot_again(self, texels: NDArray[np.int64], repeats: int, tell: Tell, should_stop: Stop) -> None:
        for _ in range(repeats):
            if not self.direct.shoot(self.folder, self.settings, self.executor, texels, tell, should_stop):
                return

    def _gather(self, reading: RadiositySolution, texels: NDArray[np.int64], tell: Tell, should_stop: Stop, repeats: int = 1) -> None:
        """Gather light at texels; if photons were traced since the last time, anew."""
        known = self._find_known(reading)
        is_new = self.gathered is None or self._gathered_of < self.ledger.photons
        into = GatheredField.none(len(self.tracing.texels)) if is_new or self.gathered is None else self.gathered
        before = into.counters.get("rays", 0)
        into.gather(self.folder, self.settings, self.executor, texels, known, tell, should_stop, repeats)
        self.ledger.gathered += into.counters.get("rays", 0) - before
        if into.passes.all():  # else it was stopped before every texel had an estimate, and the earlier one stays
            self.gathered, self._gathered_of = into, self.ledger.photons

    def _find_known(self, reading: RadiositySolution) -> KnownLight:
        """The light that gather rays meet."""
        light, doubt, leaf = find_known(self._make_light(reading), self.tracing.texels)
        on_cells, cell_doubt = self.cell_tally.irradiance(self.tracing.cells)
        bright = find_bright(texel_shards.open_surfaces(str(self.folder)), light, on_cells.sum(axis=0))
        direct = np.ascontiguousarray(self.direct.irradiance.T)
        return KnownLight(light, direct, give_signs(doubt, leaf), on_cells, give_signs(cell_doubt), bright)

    def _read_tallies(self) -> RadiositySolution:
        shrink = self.settings.hierarchical and uses("coefficient_shrinkage")
        shares = self.settings.direct == "rays" and uses("scarce_charts")
        return RadiositySolution.of(self.tree, self.tally, self.rule, shrink, self._chart_order if shares else None)

    @cached_property
    def _chart_order(self) -> ChartOrder:
        """The charts by object, by the axis that they face, and by place along a Morton curve."""
        texels, receiving = self.tracing.texels, texel_shards.open_surfaces(str(self.folder)).receiving
        tri = texels.texel_tri[np.minimum(texels.chart_start[:-1], len(texels) - 1)]
        third = np.full(len(tri), 1 / 3, np.float32)
        rank = np.argsort(sort_by_place(receiving.place(tri, third, third), receiving.normal[tri]))
        return ChartOrder(rank, self.tracing.snapshot.tri_object[tri].astype(np.int64))

    def _trace_round(self, stated: error_estimate.StatedError | None) -> None:
        view = self._save_view(self.round)
        settings, (photons, left) = self.settings, self._next_photons(stated)
        shares = rounds.share_photons(photons, rounds.count_ahead(self.round, settings.direct == "rays"))
        shards = PhotonShard.of_round(self.folder, settings, self.round, shares, view, self.degree)
        shards = [self.first.take(shard) for shard in shards]
        for shard, result in self.rounds.trace(shards, rounds.count_late(len(shards), left)):
            self.tally.add(shard.shard % 2, result.tally, shard.photons)
            self.ledger.add(shard.photons, result.audit, result.counters)
            self.cell_tally.add(shard.shard % 2, result.elsewhere, shard.photons)
            if self.round and shard.shard % 2 and self.deadline.is_over():  # after a pair of shards both halves have equally many photons
                self.rounds.drop()
                break
        self.round += 1

    def _save_view(self, number: int) -> str:
        place = self.folder / f"view_{self.settings.direct}_{number}"  # a bake by photons alone may follow one by rays that stopped at once
        return save_view(place, self.tree, len(self.tracing.texels))

    def send_again(self, late: list[PhotonShard]) -> None:
        """Resend shards of the last round that were under way when the bake stopped, if its limit allows them and another round."""
        if late and self.settings.max_photons - self.ledger.photons - sum(shard.photons for shard in late) > 1:
            view = self._save_view(late[0].round)
            self.rounds.send([replace(shard, tracing=str(self.folder), view=view) for shard in late])

    def _find_mean_direct(self, reading: RadiositySolution) -> NDArray[np.float64]:
        """(3, n_node) float64, W/m^2: direct light by rays on the nodes of a reading; cached, for a round needs it twice."""
        asked = reading, self.direct.turns
        if self._mean_direct is None or self._mean_direct[0] != asked:
            self._mean_direct = asked, quadtree.mean_in_nodes(reading.tree, self.direct.irradiance)
        return self._mean_direct[1]

    def _refine(self, reading: RadiositySolution) -> bool:
        """Split the nodes that the oracle marks; returns whether the tree has grown."""
        if not self.settings.hierarchical:
            return False
        before = len(self.tree)
        forced = quadtree.any_in_nodes(self.tree, self.forced_texels) & (self.tree.side > self.settings.finest_texels)
        forced &= uses("contact_nodes")
        background = self._find_mean_direct(reading)
        while True:  # a split node's children may have previews with enough photons already
            marked = refine.mark(self.tree, reading.totals, reading.solution, reading.comparison, self.rule, forced, background)
            if not len(marked):
                break
            self.tree = quadtree.split(self.tree, marked)
        self._grow_previews()
        self.tally.grow(len(self.tree))
        return len(self.tree) > before

    def glance(self) -> LightField:
        """The light after one round, for a preview without an error estimate."""
        self._trace_round(None)
        return self._make_light(self._read_tallies())

    def _light(self, reading: RadiositySolution) -> tuple[LightField, error_estimate.StatedError]:
        """The light after the last round with its stated error."""
        texels = self.tracing.texels
        limited = self.deadline.limit_spread(self.executor.spread, self.deadline.is_over)
        direct = self.direct.show(texels, self.settings.denoise, limited)
        stated = error_estimate.state_error(self.metric, direct, self._show_photons(reading, limited))
        return self._make_light(reading, stated), stated

    def _show_photons(self, reading: RadiositySolution, limited: Spread) -> error_estimate.PhotonLight:
        """Gathered light and what photons brought by mirrors and glass, or the light of leaves."""
        texels, tree = self.tracing.texels, reading.tree
        gathered = self.gathered.show_photons(texels, self.settings.denoise, limited) if self.gathered else None
        share = reading.direct_share if gathered else np.ones_like(reading.mean)
        if gathered and not share.any():
            return gathered
        leaf = quadtree.node_of_texel(tree, reading.leaves, len(texels))
        mean, error2 = share * reading.mean, share * reading.error2
        total = float((mean[reading.leaves] * (tree.end - tree.start)[reading.leaves, None]).sum())
        by_leaves = error_estimate.PhotonLight(lambda entry: mean[leaf[entry]], total, lambda entry: error2[leaf[entry]])
        return gathered.beside(by_leaves) if gathered else by_leaves

    def _make_light(self, reading: RadiositySolution, stated: error_estimate.StatedError | None = None) -> LightField:
        return LightField(
            tree=self.tree,
            solution=reading.solution,
            leaves=reading.leaves,
            received=reading.totals.received,
            direct=self.direct,
            error=stated.relative if stated else math.nan,
            photons=self.ledger.photons,
            rounds=self.round,
            stopped_by="",
            ledger=self.ledger,
            gathered=self.gathered,
        )

    def _next_photons(self, stated: error_estimate.StatedError | None) -> tuple[int, int]:
        """Photons of the next round, and how many the bake may trace after it: 0 where it probably needs none."""
        errors = (math.nan, 0.0) if stated is None else (stated.relative, math.hypot(stated.direct, stated.gathered))
        if stated and self.gathered:
            rays = math.sqrt(1.0 - PHOTONS_SHARE**2) * self.settings.error
            errors = math.hypot(self._foresee_photons(stated), rays), rays
        settings, most, late = self.settings, self.settings.max_photons, self.rounds.count_late()
        so_far = self.ledger.photons + late
        degree = self.degree if settings.hierarchical and settings.direct == "photons" else None  # gather rays average over many leaves
        photons, is_last = rounds.next_photons(so_far, most, len(self.tree), settings.error, *errors, degree)
        photons = max(self.deadline.cap_photons(photons), min(photons, _LEAST_PHOTONS))
        return photons, 0 if is_last else most - so_far - photons
