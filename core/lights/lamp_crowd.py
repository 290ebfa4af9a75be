"""Direct light from many lamps: the few that matter to a texel are sampled one by one, the others by a stratified choice."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..scene.shadow_rays import ShadowRays
from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int64, IntArray
from ..util.brightness import weigh_channels
from ..util.geometry import dot_rows, take_rows
from .direct_lights import AreaSource, PointSource, Source, join_sources
from .direct_points import MIDDLE, Receivers, TexelChunk, light_points, random_shift, row_pieces
from .lights import spread_attenuation
from .stratified_choice import (
    BLOCK_TEXELS,
    Clusters,
    Demand,
    Span,
    choose,
    choose_by_importance,
    cumulate,
    cut_evenly,
    draw_strata,
    find_reach,
    in_order,
    sample_adaptively,
    sort_by_place,
    sum_regions,
)

_MAX_CLUSTERS = 4096  # 32 KB each of a chunk of 2^14 texels
_MATTERS = 1 / 16  # a lamp of at least this share of a texel's total importance is sampled by itself
_TOGETHER = 4  # neighbouring texels within a chart that share a pdf
# Conditions for evaluating the importances once for the four: least length of the mean of their normals, and greatest distance from their
# mean position, in half diagonals of a texel. That is 1 in a square of four, and 5 where three of four texels need no more rays.
_ALIKE, _BESIDE = 0.98, 6.0
_REGION_BLOCKS = 16  # blocks of texels whose pooled visibility of the lamps is a prior
_AROUND_RAYS = 4  # weight of that prior, in rays
_LEAST_LIT = 0.1
_GRAZING, _BEHIND = np.float32(0.1), np.float32(0.01)  # least cosine of an importance, and the factor of a lamp that shines elsewhere
_CONE_SLACK_RAD = 0.1
_ANYWHERE = -2.0  # below any cosine


@dataclass(frozen=True)
class LampCrowd:
    """Lamps sorted by place; clusters are single lamps unless there are more than _MAX_CLUSTERS.

    kind, number   (n,) int64                    the lamp is row `number` of kinds[kind]
    clusters       of the lamps; the normal is the direction in which a spot or area light shines, 0 for a light in all directions
    low_cosine     (n_cluster,) float32          of the cone outside of which a lamp is dark
    flat           (n_cluster,) bool             the intensity goes as the cosine, as for an area light
    """

    kinds: tuple[Source, ...]
    kind: Int64
    number: Int64
    clusters: Clusters
    low_cosine: Float32
    flat: BoolArray

    @classmethod
    def of(cls, lamps: Sequence[Source]) -> LampCrowd:
        """From sources of one lamp each, which have a position: no suns."""
        joined = join_sources(lamps)
        kind = np.concatenate([np.full(len(of), k) for k, (_, of) in enumerate(joined)])
        number = np.concatenate([np.arange(len(of)) for _, of in joined])
        outlines = [_outline(source) for source, _ in joined]
        centre, axis, weight, square, low, flat = (np.concatenate(parts) for parts in zip(*outlines, strict=True))
        order = sort_by_place(centre, axis)
        centre, axis, weight, square, low, flat = (values[order] for values in (centre, axis, weight, square, low, flat))
        clusters = Clusters.of(weight, centre, axis, square, cut_evenly(weight, _MAX_CLUSTERS))
        alone = np.diff(clusters.start) == 1
        first = clusters.start[:-1]
        clusters.normal[~alone] = 0  # lamps that shine elsewhere may be among them
        low_cosine = np.where(alone, low[first], _ANYWHERE).astype(np.float32)
        return cls(tuple(source for source, _ in joined), kind[order], number[order], clusters, low_cosine, flat[first] & alone)

    def separate(self, chunk: TexelChunk, starts: Receivers) -> tuple[list[tuple[Source, Int64, Int64]], RestOfCrowd]:
        """Sources with the pairs (texel, row of the source) to sample one by one, and the rest of the lamps.

        starts   origins of rays from the chunk's texels, equally many of each
        """
        count, n_cluster = len(chunk), len(self.clusters)
        end = np.empty((-(-count // _TOGETHER), n_cluster))
        alone = np.diff(self.clusters.start) == 1
        groups, chosen = [], []
        for probes in _find_probes(chunk, find_reach(starts.position, count)):
            for piece in row_pieces(np.arange(len(probes.group)), n_cluster * probes.each):
                rows = (piece[:, None] * probes.each + np.arange(probes.each)).ravel()
                share = self.estimate(probes.receivers.rows(rows), probes.reach[rows])
                share /= share.sum(axis=1, keepdims=True)
                share = share.reshape(len(piece), probes.each, n_cluster)
                row, cluster = np.nonzero((share.max(axis=1) > np.float32(_MATTERS)) & alone)
                together = share.sum(axis=1)
                together[row, cluster] = 0
                _cumulate_rows(together, probes.group[piece], end)
                groups.append(probes.group[piece[row]])
                chosen.append(cluster)
        lamp = np.repeat(self.clusters.start[np.concatenate(chosen)], _TOGETHER)
        texel = (np.concatenate(groups)[:, None] * _TOGETHER + np.arange(_TOGETHER)).ravel()
        order = np.argsort(lamp, kind="stable")
        order = order[texel[order] < count]
        texel, lamp = texel[order], lamp[order]
        pairs = []
        for k, source in enumerate(self.kinds):
            own = np.flatnonzero(self.kind[lamp] == k)
            if len(own):
                pairs.append((source, texel[own], self.number[lamp[own]]))
        return pairs, RestOfCrowd(self, end, count * len(self.kind) - len(texel))

    def choose(self, receivers: Receivers, rng: np.random.Generator) -> tuple[Int64, Float64]:
        """A lamp for each of n receivers, by importance, and its probability; (n,) each."""
        lamp, chance = np.empty(len(receivers.position), np.int64), np.empty(len(receivers.position))
        u = rng.random(len(lamp))
        for rows, cluster, of_cluster, rest in choose_by_importance(receivers, len(self.clusters), self.estimate, u):
            lamp[rows], within = self.clusters.choose(cluster, rest)
            chance[rows] = of_cluster * within
        return lamp, chance

    def split(self, lamp: Int64) -> Iterator[tuple[Source, Int64]]:
        """The lamps (n,) by kind: a source with a row for each of some of them, and which these are (k,)."""
        kind = self.kind[lamp]
        for k, source in enumerate(self.kinds):
            own = np.flatnonzero(kind == k)
            if len(own):
                yield source.rows(self.number[lamp[own]]), own

    def estimate(self, receivers: Receivers, reach: Float32) -> Float32:
        """(n, n_cluster): importance > 0 of the clusters, about their unoccluded irradiance; reach (n,), unit box: receiver radius."""
        centre, normal, axis = self.clusters.centre, receivers.normal, self.clusters.normal
        square = dot_rows(receivers.position, receivers.position)[:, None] + dot_rows(centre, centre) - 2 * receivers.position @ centre.T
        np.maximum(square, np.float32(1e-9), out=square)
        distance = np.sqrt(square)
        out: Float32 = normal @ centre.T - dot_rows(normal, receivers.position)[:, None]
        extent = np.sqrt(self.clusters.square)
        least = np.where(out > -(extent + reach[:, None]), _GRAZING, _BEHIND)
        least *= distance
        np.maximum(out, least, out=out)
        square += self.clusters.square
        square += (reach * reach)[:, None]
        square *= distance
        out /= square
        out *= self.clusters.weight.astype(np.float32)
        aimed = np.flatnonzero(axis.any(axis=1))
        if len(aimed):
            # The greatest cosine to the axis within reach.
            cosine = receivers.position @ axis[aimed].T - dot_rows(centre, axis)[aimed] + reach[:, None]
            cosine /= distance[:, aimed]
            shine = np.where(self.flat[aimed], np.maximum(cosine, _GRAZING), np.float32(1))
            out[:, aimed] *= np.where(cosine >= self.low_cosine[aimed], shine, _BEHIND)
        return out


class RestOfCrowd:
    """The lamps of low importance at each texel, sampled at random.

    end      (n_group, n_cluster) float64   from stratified_choice.cumulate, a row for _TOGETHER texels; all the row's number if empty
    n_pair   number of pairs (texel, lamp)
    """

    def __init__(self, crowd: LampCrowd, end: Float64, n_pair: int) -> None:
        self._crowd, self._end, self.n_pair = crowd, end, n_pair

    def irradiance(
        self, rays: ShadowRays, chunk: TexelChunk, demand: Demand, base_rgb: Float64, rng: np.random.Generator
    ) -> tuple[Float64, Float64, int]:
        """As EmitterPool.irradiance."""
        count = len(chunk)
        shift, turn = random_shift(rng, count), random_shift(rng, count)[:, 0]

        n_cluster = self._end.shape[1]
        shot, lit = np.zeros((2, -(-count // BLOCK_TEXELS) * n_cluster))

        def gather(rows: IntArray, span: Span) -> tuple[Float64, int]:
            first, last = span
            receivers = chunk.receivers(rows, first, last)
            step, pick = draw_strata(turn[rows], last - first, rng)
            cluster, chance, rest = choose(self._end, np.broadcast_to(rows // _TOGETHER, pick.shape), pick)
            lamp, lamp_chance = self._crowd.clusters.choose(cluster, rest)
            value, traced = self._trace(rays, receivers, lamp, light_points(take_rows(shift, rows), first, last))
            if first == 0:
                place = np.tile(rows // BLOCK_TEXELS * n_cluster, last) + cluster
                np.add(shot, np.bincount(place, minlength=len(shot)), out=shot)
                np.add(lit, np.bincount(place, value.any(axis=1), len(lit)), out=lit)
            value /= (chance * lamp_chance)[:, None]
            return in_order(step, value), traced

        def learn(rows: IntArray) -> None:
            self._weigh(np.unique(rows // _TOGETHER), _lit_share(shot.reshape(-1, n_cluster), lit.reshape(-1, n_cluster)))

        somebody = self._end[:, -1] > np.arange(len(self._end))
        rows = np.flatnonzero(np.repeat(somebody, _TOGETHER)[:count])
        return sample_adaptively(gather, rows, demand, base_rgb, learn=learn)

    def _weigh(self, groups: Int64, share: Float32) -> None:
        """Multiplies the groups' probabilities by the measured visibility, share (n_block, n_cluster)."""
        for piece in row_pieces(groups, self._end.shape[1]):
            chances = np.diff(self._end[piece], axis=1, prepend=piece[:, None].astype(float))
            np.maximum(chances, 0, out=chances)
            chances *= share[piece * _TOGETHER // BLOCK_TEXELS]
            _cumulate_rows(chances, piece, self._end)

    def _trace(self, rays: ShadowRays, receivers: Receivers, lamp: Int64, u: Float32) -> tuple[Float64, int]:
        """(n, 3) float64: irradiance by one ray from each receiver to its lamp; and rays traced."""
        value, traced = np.zeros((len(lamp), 3)), 0
        for lamps, own in self._crowd.split(lamp):
            asking = receivers.rows(own)
            aim = lamps.aim(asking.position, asking.normal, u[own])
            given = aim.weight[:, None] * lamps.rgb
            if lamps.casts_shadow:
                seen = asking.see(rays, aim)
                given, traced = seen.times(given), traced + seen.rays
            value[own] = given
        return value, traced


@dataclass(frozen=True)
class _Probes:
    """Places at which importances are evaluated.

    group   (n_group,) int64                          groups of texels
    each    number of places of each group, consecutive
    reach   (n_group * each,) float32, unit box       half the diagonal of the texels that each place represents
    """

    group: Int64
    each: int
    receivers: Receivers
    reach: Float32


def _find_probes(chunk: TexelChunk, reach: Float32) -> tuple[_Probes, _Probes]:
    """One place for each flat group, and one per texel for the others.

    reach   (n,) float32, unit box: half a texel's diagonal
    """
    count = len(chunk)
    n_group = -(-count // _TOGETHER)
    texel = np.minimum(np.arange(n_group * _TOGETHER), count - 1)
    every = chunk.receivers_at(texel, MIDDLE)
    place, normal = (values.reshape(n_group, _TOGETHER, 3) for values in (every.position, every.normal))
    middle, facing = place.mean(axis=1), normal.mean(axis=1)
    length = np.sqrt(dot_rows(facing, facing))
    away = np.sqrt(((place - middle[:, None]) ** 2).sum(axis=2).max(axis=1))
    widest = reach[texel].reshape(n_group, _TOGETHER).max(axis=1)
    is_flat = (length > _ALIKE) & (away < _BESIDE * widest)
    flat, uneven = np.flatnonzero(is_flat), np.flatnonzero(~is_flat)
    facing = (facing[flat] / length[flat, None]).astype(np.float32)
    alike = _Probes(flat, 1, Receivers(middle[flat].astype(np.float32), facing, facing), (away + widest)[flat])
    rows = (uneven[:, None] * _TOGETHER + np.arange(_TOGETHER)).ravel()
    return alike, _Probes(uneven, _TOGETHER, every.rows(rows), reach[texel[rows]])


def _cumulate_rows(chances: FloatArray, rows: Int64, end: Float64) -> None:
    """As stratified_choice.cumulate, into any `rows` of `end`."""
    own = np.empty(chances.shape)
    cumulate(chances, 0, own)
    own += (rows - np.arange(len(rows)))[:, None]
    end[rows] = own


def _lit_share(shot: Float64, lit: Float64) -> Float32:
    """(n_block, n_cluster): visibility of a cluster from a block, shrunk towards that of the region, at least _LEAST_LIT."""
    around = (sum_regions(lit, _REGION_BLOCKS) + 1) / (sum_regions(shot, _REGION_BLOCKS) + 1)
    share = (lit + _AROUND_RAYS * around) / (shot + _AROUND_RAYS)
    return np.maximum(share, _LEAST_LIT).astype(np.float32)


def _outline(source: Source) -> tuple[Float32, Float32, Float64, Float32, Float32, BoolArray]:
    """Centre (n, 3), axis (n, 3), intensity (n,), squared size (n,), cosine of the cone (n,), and flat (n,), see LampCrowd."""
    weight = weigh_channels(source.rgb)
    anywhere, no = np.full(len(weight), _ANYWHERE, np.float32), np.zeros(len(weight), bool)
    if isinstance(source, PointSource):
        if not source.is_spot:
            return source.centre, np.zeros_like(source.centre), weight, source.radius**2, anywhere, no
        return source.centre, source.axis, weight, source.radius**2, _widen(np.arccos(1 - source.drop)), no
    if isinstance(source, AreaSource):
        square = dot_rows(source.x_axis, source.x_axis) + dot_rows(source.y_axis, source.y_axis)
        boost = spread_attenuation(np.ones(len(weight)), source.spread_rad)
        low = np.full_like(anywhere, -_GRAZING) if source.is_lambertian else _widen(source.spread_rad / 2)
        return source.centre, -source.z_axis, weight * source.area * boost, square, low, ~no
    raise TypeError(f"{type(source).__name__} has no place")


def _widen(half_angle_rad: Float32) -> Float32:
    """Cosines of the cones, widened by _CONE_SLACK_RAD to be conservative for all of a texel."""
    return np.cos(np.minimum(half_angle_rad + _CONE_SLACK_RAD, np.float32(math.pi)))
