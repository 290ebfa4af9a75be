"""From a traced scene to light on texels: rounds of photons, refinement, and the rule that stops them.

A photon's way: lights.emit -> photons.trace_shard -> texels.entry_of -> tally.deposit -> refine.mark -> quadtree.split.
With workers and bake the only module that sees both the tracing and the statistics.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..filter import estimate
from ..filter.reading import Reading
from ..filter.squares import Squares
from ..integrate.direct_field import DirectField
from ..integrate.direct_shards import NOTHING_AHEAD, ShotAhead
from ..integrate.gather import KnownLight
from ..integrate.gathered import GatheredField
from ..integrate.light_field import LightField
from ..integrate.next_rays import Look, Stop, Tell, choose_texels, have_look
from ..integrate.other_light import OtherLight
from ..integrate.texel_light import find_known
from ..parallel.executors import spread
from ..radiosity import basis, quadtree, refine, tally
from ..radiosity.cell_tally import CellTally
from ..radiosity.few_photons import CELL_BITS, FewPhotons
from ..radiosity.splitting import SplitGuide, Splitting, weigh_deposits
from ..radiosity.tally import Tally
from ..scene.space_cells import code_cells
from ..texels.judged import Judged, Parts
from ..transport import rounds, traced_scene
from ..transport.birth_guide import BirthGuide
from ..transport.ledger import Ledger
from ..util.ablation import uses
from ..util.messages import Status
from ..util.settings import Settings
from .deadline import Deadline
from .first_photons import FirstPhotons
from .gather_plan import GatherPlan
from .photon_rounds import PhotonRounds, save_view
from .photon_shards import PhotonShard
from .stop_rules import StopRules

# Of nodes below what rises from a surface, from the first round on: a default bake may have no more than two, too few to come so far.
_RISING_SIDE = 8  # texels
_LEAST_PHOTONS = 1 << 15  # of a round that a time limit cuts short: of fewer, looking at them takes all of the time
TRACING = Status("photons", "Tracing photons")


@dataclass
class Solver:
    """A bake in progress: a stable solution exists after every round."""

    folder: Path  # of traced_scene.open_tracing
    settings: Settings
    executor: Executor
    direct: DirectField
    forced_texels: NDArray[np.bool_]
    started: float = field(default_factory=time.monotonic)
    watch: Callable[[LightField], None] = lambda light: None  # sees the light after every round but the last
    photons_before: int = 0  # of an earlier bake, which this goes on with
    first: FirstPhotons = field(default_factory=FirstPhotons)
    rising_texels: NDArray[np.bool_] | None = None  # (n,) of ContactMap; None for none
    limit: Deadline | None = None  # of the time limit of a whole bake; None: it counts from now

    def __post_init__(self) -> None:
        self.tracing = traced_scene.open_tracing(str(self.folder))
        self.deadline = self.limit or Deadline(self.settings.time_limit)
        texels, settings = self.tracing.texels, self.settings
        self.degree = basis.DEGREES[settings.basis]
        self.tree = quadtree.plant_trees(texels, self.degree, settings.min_level, settings.finest_texels, not settings.hierarchical)
        if settings.hierarchical:
            self._grow_previews()
            if self.rising_texels is not None and uses("rising_nodes"):
                self.tree = quadtree.grow_to(self.tree, texels, max(_RISING_SIDE, settings.finest_texels), self.rising_texels)
        components = 1 if settings.direct == "rays" and not self.tracing.scene.has_caustics else tally.COMPONENTS
        self.tally = Tally.empty(len(self.tree), self.degree, components)
        self.squares = Squares.of(texels, self.forced_texels)
        self.square_tally = Tally.empty(len(self.squares.entry), 0, components)
        self.guide = SplitGuide.empty(len(self.tracing.snapshot.objects) + len(self.tree))
        self.births = BirthGuide.of(self.tracing.scene.emitter_share)
        self.reading: Reading | None = None  # of the last round, as are the next two
        self.parts: tuple[Parts, NDArray[np.float64]] | None = None  # that were judged, and Parts.weigh of them
        self.splitting: Splitting | None = None
        self._mean_direct: tuple[tuple[Reading, int], NDArray[np.float64]] | None = None  # of _find_mean_direct, for whom it was
        self._few: tuple[Reading, FewPhotons] | None = None  # of _find_few, for whom it was
        self.gathered: GatheredField | None = None
        self.gather_plan = GatherPlan.of(texels)
        self.judged = Judged.of(settings.error_of, texels, self.tracing.snapshot.tri_object)
        self.cell_tally = CellTally.empty(len(self.tracing.cells))
        self.ledger, self.rounds, self.round = Ledger(), PhotonRounds(self.executor), 0
        self.rule = refine.Rule(settings.oracle, settings.threshold, settings.stability, settings.preview_depth)

    def _grow_previews(self) -> None:
        depth, finest = self.settings.preview_depth, self.settings.finest_texels
        self.tree = quadtree.grow_previews(self.tree, self.tracing.texels, depth, finest)

    def begin(self) -> None:
        """Traces and reads the first round, before there is direct light by rays."""
        self._trace_round(None)
        self.reading = self._read_tallies()

    def shoot_direct(self, tell: Tell, should_stop: Stop, ahead: ShotAhead = NOTHING_AHEAD) -> bool:
        """Shadow rays from all texels of a bake that has begun, as sure as they must be beside its light; see DirectField.shoot."""
        every, other = range(len(self.tracing.texels)), self._other_light(self.reading or self._read_tallies())
        settings = self.deadline.ease(self.settings)
        is_done = self.direct.shoot(self.folder, settings, self.executor, every, tell, should_stop, other, ahead)
        self.started = time.monotonic()  # a time limit, and what is foretold of the time left, are of what comes now
        return is_done

    def run(self, tell: Tell, should_stop: Stop) -> LightField:
        """Rounds until one of the stop rules holds; `tell` hears of each."""
        stated: estimate.StatedError | None = None
        traced = self.ledger.photons > 0  # begun, or a bake that goes on: its last round has not been refined yet
        reading = self.reading
        rules = StopRules(self.settings, should_stop, self.started, self.deadline)
        since, before = time.monotonic(), self.ledger.photons
        while True:
            if not traced:
                self._trace_round(stated)
                self.deadline.note_round(self.ledger.photons - before, time.monotonic() - since)
            looked = time.monotonic()
            if reading is None or not traced:
                reading = self.reading = self._read_tallies()
            traced = False
            if self.round == 1 and not rules.find_reason(math.nan, self.ledger.photons) and self._refine(reading):
                # What it would say of its error takes time, and ends no bake: of detail that trees as planted do not show it says nothing.
                light, stated = self._make_light(reading), None
                tell(rules.measure_progress(light, self.photons_before))
                self.watch(light)
                since, before = time.monotonic(), self.ledger.photons
                continue
            light, stated = self._light(reading)
            self.deadline.note_light(time.monotonic() - looked)
            while (look := self._choose_look(reading, stated)) and not rules.break_off():
                have_look(look, tell, rules.break_off, TRACING)
                light, stated = self._light(reading)
            stopped_by = rules.find_reason(light.error, light.photons) or self._find_haste()
            error = light.error if stopped_by in ("", "error") else stated.relative  # not chosen by its error, then
            light = replace(light, error=error, stopped_by=stopped_by)
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

    def _choose_look(self, reading: Reading, stated: estimate.StatedError) -> Look | None:
        """What sends more rays from texels, if one more helps more than a photon's."""
        settings, ledger = self.settings, self.ledger
        if settings.direct != "rays" or (self.gathered and stated.chosen <= settings.error):
            return None
        if self.gathered is None and self.gather_plan.pays(settings, stated, ledger, self.round, lambda: self._guide_photons()[1]):
            return partial(self._gather, reading, stated.relative, np.arange(len(self.tracing.texels)))
        chosen = choose_texels(settings.error, stated, ledger.rays, self.direct, self.gathered)
        if chosen is None:
            return None
        rays, worst, repeats = chosen
        if rays is self.gathered:
            if ledger.gathered >= self.gather_plan.budget_rays:
                return self._stop_gathering
            return partial(self._gather, reading, stated.relative, worst, repeats=repeats)
        return partial(self._shoot_again, reading, worst, repeats)

    def _other_light(self, reading: Reading) -> OtherLight | None:
        """What is shown with direct light, as far as photons tell; None where direct light is shown by itself too."""
        if "direct" in self.settings.passes or not uses("reference_level"):
            return None
        return OtherLight.of_leaves(self.tree, reading.solution, reading.leaves)

    def _stop_gathering(self, tell: Tell, should_stop: Stop) -> None:
        """Go back to the light of the leaves, for photons reduce the error sooner."""
        self.gathered = None

    def _shoot_again(self, reading: Reading, texels: NDArray[np.int64], repeats: int, tell: Tell, should_stop: Stop) -> None:
        other = self._other_light(reading)
        for _ in range(repeats):
            if not self.direct.shoot(self.folder, self.settings, self.executor, texels, tell, should_stop, other):
                return

    def _gather(self, reading: Reading, error: float, texels: NDArray[np.int64], tell: Tell, should_stop: Stop, repeats: int = 1) -> None:
        into = self.gathered = self.gathered or GatheredField.none(len(self.tracing.texels), error)
        light, doubt = find_known(replace(self._make_light(reading), few=self._find_few(reading)), self.tracing.texels)
        known = KnownLight(light, self.direct.irradiance, doubt, *self.cell_tally.irradiance(self.tracing.cells))
        before = into.counters.get("rays", 0)
        for _ in range(repeats):
            if not into.gather(self.folder, self.settings, self.executor, texels, known, tell, should_stop):
                break
        self.ledger.gathered += into.counters.get("rays", 0) - before
        if not into.passes.all():  # stopped before all texels had a first estimate, beside which that of leaves would stand out
            self.gathered = None

    def _read_tallies(self) -> Reading:
        squares = self.squares.light(self.square_tally)
        shrink = self.settings.hierarchical and uses("coefficient_shrinkage")
        return Reading.of(self.tree, self.tally, self.rule, self.judged, shrink, squares)

    def _trace_round(self, stated: estimate.StatedError | None) -> None:
        if self.gathered:
            self.gather_plan.give_up(self.settings.error, self.ledger.told)
        self.gathered, (splitting, weight) = None, self._guide_photons()
        view, self.splitting = self._save_view(self.round, splitting), splitting
        settings, parted, born, (photons, left) = self.settings, [], [], self._next_photons(stated, weight)
        ahead, guided = rounds.count_ahead(self.round, settings.direct == "rays"), splitting is not None
        shares = rounds.share_photons(photons, ahead)
        shards = PhotonShard.of_round(self.folder, settings, self.round, shares, view, self.degree, weight, guided)
        shards = [self.first.take(shard) for shard in shards]
        for shard, result in self.rounds.trace(shards, rounds.count_late(len(shards), left)):
            self.tally.add(shard.shard % 2, result.tally, shard.photons * shard.weight)
            self.square_tally.add(shard.shard % 2, result.squares, shard.photons * shard.weight)
            self.ledger.add(shard.photons, shard.weight, result.audit, result.counters)
            self.cell_tally.add(shard.shard % 2, result.elsewhere, shard.photons * shard.weight)
            if self.round and shard.shard % 2 and self.deadline.is_over():  # both halves have as many
                self.rounds.drop()
                break
            if shard.round == self.round:  # late ones were sent otherwise, and what they would guide is planned already
                parted += [result.splitting] if result.splitting else []
                born += [result.births] if result.births else []
        self.guide.add_round(parted)
        self.births.add_round(born)
        self.round += 1

    def _save_view(self, number: int, splitting: Splitting | None) -> str:
        place = self.folder / f"view_{self.settings.direct}_{number}"  # of a bake by rays that stopped at once photons alone may follow
        return save_view(place, self.tree, len(self.tracing.texels), self.squares.entry, splitting)

    def send_again(self, late: list[PhotonShard], splitting: Splitting | None) -> None:
        """Shards of the last round that were under way when the bake stopped, if it may have so many photons and another round."""
        self.splitting = splitting
        if late and self.settings.max_photons - self.ledger.photons - sum(shard.photons for shard in late) > 1:
            view = self._save_view(late[0].round, splitting)
            self.rounds.send([replace(shard, tracing=str(self.folder), view=view) for shard in late])

    def _guide_photons(self) -> tuple[Splitting | None, float]:
        """Where photons of the next round are born and part, and how much one of them tells; nothing where no round was read."""
        if self.reading is None or not self.settings.guided:
            return None, 1.0
        tree, flux = self.tree, self.reading.solution.flux
        light = flux / np.maximum(tree.area[: flux.shape[1]], np.finfo(float).tiny)
        light += self._find_mean_direct(self.reading)
        snapshot, texels = self.tracing.snapshot, self.tracing.texels
        self.guide.grow(len(snapshot.objects) + len(tree))
        factor, weight = self.guide.plan(tree, snapshot.tri_object[texels.texel_tri[tree.start[tree.levels[0]]]])
        worth = weigh_deposits(tree, self.reading.leaves, light, self.ledger.deposits, self.parts)
        return Splitting(factor, worth, self.births.plan()), weight

    def _find_mean_direct(self, reading: Reading) -> NDArray[np.float64]:
        """(3, n_node) float64, W/m^2: direct light by rays on the nodes of a reading; asked for twice a round, and found once."""
        asked = reading, self.direct.turns
        if self._mean_direct is None or self._mean_direct[0] != asked:
            self._mean_direct = asked, quadtree.mean_in_nodes(reading.tree, self.direct.irradiance)
        return self._mean_direct[1]

    def _refine(self, reading: Reading) -> bool:
        """Splits what the oracle marks; whether there is more of the tree now."""
        if not self.settings.hierarchical:
            return False
        before = len(self.tree)
        forced = quadtree.any_in_nodes(self.tree, self.forced_texels) & (self.tree.side > self.settings.finest_texels)
        forced &= uses("contact_nodes")
        background = self._find_mean_direct(reading)
        while True:  # a split node's children may have previews of their own that tell enough already
            marked = refine.mark(self.tree, reading.totals, reading.solution, reading.comparison, self.rule, forced, background)
            if not len(marked):
                break
            self.tree = quadtree.split(self.tree, marked)
        self._grow_previews()
        self.tally.grow(len(self.tree))
        return len(self.tree) > before

    def glance(self) -> LightField:
        """The light after one round, for the eye: nothing is known of its error."""
        self._trace_round(None)
        return self._make_light(self._read_tallies())

    def _light(self, reading: Reading) -> tuple[LightField, estimate.StatedError]:
        """The light as it stands."""
        texels = self.tracing.texels
        limited = self.deadline.limit_spread(partial(spread, self.executor), self.deadline.is_over)
        shown = texels, self.settings.denoise, limited
        direct, gathered = self.direct.show(*shown), self.gathered.show_gathered(*shown) if self.gathered else None
        photon_w, few = self.ledger.photon_w(), self._find_few(reading)
        stated = estimate.state_error(reading, direct, texels, self.settings.denoise, gathered, self.judged, photon_w, few)
        self.parts = stated.parts, stated.parts.weigh(stated.of_parts, self.settings.error)
        return self._make_light(reading, stated), stated

    def _find_few(self, reading: Reading) -> FewPhotons | None:
        """Leaves that few photons fell on, found once; None where photons bring light straight from lamps.

        That has edges, on whose two sides it is as bright as it is.
        """
        if self.settings.direct != "rays" or not uses("spatial_shrinkage"):
            return None
        if self._few is None or self._few[0] is not reading:
            nodes = reading.tree, reading.solution, reading.leaves, reading.totals.received
            tri = self.tracing.texels.texel_tri[reading.tree.start[reading.leaves]]
            cell = code_cells(self.tracing.snapshot, tri, CELL_BITS)
            self._few = reading, FewPhotons.of(*nodes, reading.correction, cell)
        return self._few[1]

    def _make_light(self, reading: Reading, stated: estimate.StatedError | None = None) -> LightField:
        return LightField(
            tree=self.tree,
            solution=reading.solution,
            leaves=reading.leaves,
            received=reading.totals.received,
            correction=stated.correction if stated else np.ones(3),
            direct=self.direct,
            error=stated.chosen if stated else math.nan,
            photons=self.ledger.photons,
            rounds=self.round,
            stopped_by="",
            ledger=self.ledger,
            squares=reading.squares,
            gathered=self.gathered,
            neighbours=stated.neighbours if stated else None,
            few=self._find_few(reading) if stated else None,
        )

    def _next_photons(self, stated: estimate.StatedError | None, weight: float) -> tuple[int, int]:
        """Photons of the next round, and how many the bake may have after it, 0 where it is likely to need none."""
        errors = (math.nan, 0.0) if stated is None else (stated.chosen, math.hypot(stated.direct, stated.gathered))
        settings, most, late = self.settings, self.settings.max_photons, self.rounds.count_late()
        so_far, told = self.ledger.photons + late[0], self.ledger.told + late[1]
        degree = self.degree if settings.hierarchical else None
        photons, is_last = rounds.next_photons(so_far, told, weight, most, len(self.tree), settings.error, *errors, degree)
        photons = max(self.deadline.cap_photons(photons), min(photons, _LEAST_PHOTONS))
        return photons, 0 if is_last else most - so_far - photons
