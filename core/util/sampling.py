"""Random streams, low-discrepancy points, warps from the unit square, and the alias table.

A warp takes u (n, 2) float, uniform in [0, 1), and keeps its dtype; points (n, k) are views of (k, n) rows.
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from .arrays import Float32, FloatArray, IntArray
from .coverage import expand_ranges
from .geometry import gather, select, stack_columns


def shard_rng(seed: int, round_index: int, shard: int) -> np.random.Generator:
    """The random stream of one shard, independent of all others: the three numbers are hashed, not added.

    Source: numpy's SeedSequence (O'Neill 2015, "Developing a seed_seq alternative"); SFC64 is numpy's fastest generator.
    """
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence((seed, round_index, shard))))


# For each dimension after the first, which is van der Corput's: degree and coefficients of the primitive polynomial, and first direction
# numbers. Source: Joe & Kuo 2008, "Constructing Sobol sequences with better two-dimensional projections".
_SOBOL = ((1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)))
_SOBOL_BITS = 17  # log2 of the points; further ones repeat them with another shift
_NET_PARTS = 16  # parts that are scrambled one after the other, which bounds temporary memory
_SCRAMBLES = (0x9E3779B9, 0x85EBCA6B, 0xC2B2AE35, 0x27D4EB2F)  # one per dimension


def low_discrepancy_points(shift: NDArray[np.uint32], start: IntArray, count: IntArray) -> Float32:
    """Points start ... start + count - 1 of k low-discrepancy sequences; over random shifts, each point is uniform.

    A lattice is as uniform, but its noise shows as stripes where it aligns with the texels as seen from a lamp. The noise of a scrambled
    net is spread over more frequencies.

    shift          (k, 4) uint32, uniform: digital shift of each sequence
    start, count   (k,) int
    out            (sum of count, 4) float32 in [0, 1), a view of rows, ordered by sequence
    Source: Sobol' 1967; Owen 1995, "Randomly permuted (t,m,s)-nets and (t,s)-sequences".
    """
    # The sequence of each run of points with one shift, and which of its runs that is.
    of, turn = expand_ranges(start >> _SOBOL_BITS, (start + count - 1 >> _SOBOL_BITS) + 1)
    first = np.maximum(start[of], turn << _SOBOL_BITS)
    length = np.minimum((start + count)[of], turn + 1 << _SOBOL_BITS) - first
    moved = shift[of]
    for run in np.flatnonzero(turn):
        moved[run] = np.random.SeedSequence((*shift[of[run]].tolist(), int(turn[run]))).generate_state(4)
    place = np.arange(length.sum()) + np.repeat(first - (turn << _SOBOL_BITS) - (np.cumsum(length) - length), length)
    bits = gather(_scrambled_net(), place)
    bits ^= np.repeat(moved.T, length, axis=1)
    return to_unit_interval(bits).T


def grouped_points(count: IntArray, group: IntArray, rng: np.random.Generator) -> Float32:
    """Points of the unit square; each is uniform, and those of a group are stratified.

    count   (g,) int, number of points in each group, at most 2^17
    group   (n,) int, group of each point: count[0] times 0, and so on
    out     (2, n) float32 in [0, 1), ordered by group
    Source: as for low_discrepancy_points; each group has a digital shift of its own.
    """
    start = np.cumsum(count) - count
    bits = gather(_scrambled_net()[:2], np.arange(len(group)) - gather(start, group))
    bits ^= gather(rng.integers(0, 2**32, (2, len(count)), np.uint32), group)
    return to_unit_interval(bits)


def to_unit_interval(bits: NDArray[np.uint32]) -> Float32:
    """Numbers in [0, 1) from their first 24 binary digits; `bits` is overwritten."""
    bits >>= np.uint32(8)
    out = bits.view(np.int32).astype(np.float32)  # the same numbers below 2^31, converted faster
    out *= np.float32(2.0**-24)
    return out


def load_ahead() -> None:
    """Build the tables of points before their first use, where they would delay a small bake."""
    _scrambled_net()


@functools.cache
def _scrambled_net() -> NDArray[np.uint32]:
    """(4, 2^_SOBOL_BITS) uint32: the first points of Sobol's sequence, with nested scrambling of each dimension."""
    net = np.zeros((4, 1 << _SOBOL_BITS), np.uint32)
    columns = [[1 << (31 - bit) for bit in range(_SOBOL_BITS)], *(_direction_numbers(*polynomial) for polynomial in _SOBOL)]
    for row, numbers, seed in zip(net, columns, _SCRAMBLES, strict=True):
        for bit, number in enumerate(_reverse_bits(np.array(numbers, np.uint32))):
            np.bitwise_xor(row[: 1 << bit], number, out=row[1 << bit : 2 << bit])
        for part in np.split(row, _NET_PARTS):
            part[:] = _reverse_bits(_hash_carrying_up(part, seed))
    net.flags.writeable = False
    return net


def _direction_numbers(degree: int, coefficients: int, first: tuple[int, ...]) -> list[int]:
    m = list(first)
    for k in range(degree, _SOBOL_BITS):
        following = m[k - degree] ^ m[k - degree] << degree
        for i in range(1, degree):
            if coefficients >> (degree - 1 - i) & 1:
                following ^= m[k - i] << i
        m.append(following)
    return [number << (31 - k) for k, number in enumerate(m)]


def _hash_carrying_up(bits: NDArray[np.uint32], seed: int) -> NDArray[np.uint32]:
    """Flip each binary digit by a hash of the lower digits, since multiplication by even numbers carries only to higher digits. On reversed
    digits this is a nested scrambling.

    Source: Owen 1995; Laine & Karras 2011, "Stratified sampling for stochastic transparency"; constants of Burley 2020, "Practical
    hash-based Owen scrambling".
    """
    out = bits + np.uint32(seed)
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        out ^= out * np.uint32(factor)
    return out


def _reverse_bits(bits: NDArray[np.uint32]) -> NDArray[np.uint32]:
    out = bits.byteswap()
    for step, mask in ((4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        out = (out >> np.uint32(step) & np.uint32(mask)) | (out & np.uint32(mask)) << np.uint32(step)
    return out


def square_to_uniform_disk(u: FloatArray) -> FloatArray:
    """Points of the unit disk with density 1/pi per area, by a continuous map.

    u     (n, 2) float, uniform in [0, 1)
    out   (n, 2) float
    Source: Shirley & Chiu 1997, concentric map, in Cline's form.
    """
    a, b = 2 * u[:, 0] - 1, 2 * u[:, 1] - 1
    wide = (np.abs(a) > np.abs(b)).astype(a.dtype)
    swap = wide * (a - b)
    radius, other = b + swap, a - swap
    phi = math.pi / 4 * other / (radius + (radius == 0))  # from the nearer axis
    along, across = radius * np.cos(phi), radius * np.sin(phi)
    swap = wide * (along - across)
    return stack_columns(across + swap, along - swap)


def square_to_cosine_hemisphere(u: FloatArray) -> FloatArray:
    """Unit directions around +Z with density cos(theta)/pi per steradian.

    u     (n, 2) float, uniform in [0, 1)
    out   (n, 3) float, unit
    Source: Malley's method; Shirley & Chiu 1997 for the disk.
    """
    x, y = square_to_uniform_disk(u).T
    return stack_columns(x, y, np.sqrt(np.maximum(0, 1 - (x * x + y * y))))


def square_to_uniform_cone(u: FloatArray, half_angle_rad: float) -> FloatArray:
    """Unit directions within an angle of +Z, pi for all, uniform per steradian; precise in float32 for angles as small as the sun's.

    u     (n, 2) float, uniform in [0, 1)
    out   (n, 3) float, unit
    """
    return directions_from_height(u[:, 0] * (2 * math.sin(half_angle_rad / 2) ** 2), u[:, 1])


def directions_from_height(drop: FloatArray, turn: FloatArray) -> FloatArray:
    """(n, 3): unit directions with z = 1 - drop (n,), `turn` (n,) of the way around +Z; uniform per steradian if both are uniform."""
    radius = np.sqrt(np.maximum(drop * (2 - drop), 0))
    phi = 2 * math.pi * turn
    return stack_columns(radius * np.cos(phi), radius * np.sin(phi), 1 - drop)


def square_to_uniform_triangle(u: FloatArray) -> FloatArray:
    """Barycentric coordinates (weights of corners 1 and 2), density 2 in the unit triangle, 1/area on a triangle.

    u     (n, 2) float, uniform in [0, 1)
    out   (n, 2) float
    Source: Heitz 2019, "A Low-Distortion Map Between Triangle and Square".
    """
    a, b = u[:, 0], u[:, 1]
    overlap = np.minimum(a, b) / 2
    return stack_columns(a - overlap, b - overlap)


class AliasTable:
    """Chooses indices in proportion to weights, in constant time per choice.

    weights       (n,) float, finite, >= 0, at least one > 0
    probability   (n,) float64, of each index
    Raises ValueError for invalid weights.
    Source: Walker 1974, Vose 1991; built without a loop by the sweep of Hübschle-Schneider & Sanders 2019, section 4.
    """

    def __init__(self, weights: FloatArray) -> None:
        weight = np.asarray(weights, np.float64)
        if weight.ndim != 1 or not np.isfinite(weight).all() or (weight < 0).any() or not weight.any():
            raise ValueError(f"weights: expected finite numbers >= 0 with one above 0, got shape {weight.shape}: {weight[:8]}")
        share = weight / weight.max()  # the sum of huge weights would overflow
        self.probability = share / share.sum()
        filled = self.probability * len(weight)
        light, heavy = np.flatnonzero(filled < 1), np.flatnonzero(filled >= 1)
        if not len(heavy):  # all equal, rounded just below 1
            light, heavy = light[:-1], light[-1:]
        need = np.cumsum(1 - filled[light])  # cumulative mass that light buckets take from heavy ones
        spare = np.cumsum(filled[heavy] - 1)  # cumulative mass that heavy buckets can give
        self._keep, self._alias = np.ones(len(weight)), np.arange(len(weight))
        self._keep[light] = filled[light]
        giver = np.searchsorted(spare, np.concatenate([[0.0], need[:-1]])[: len(light)], side="right")
        self._alias[light] = heavy[np.minimum(giver, len(heavy) - 1)]
        # A heavy bucket ends with the first light one that overdraws it; the next heavy bucket fills its own lack.
        if len(light):
            last = np.minimum(np.searchsorted(need, spare[:-1]), len(light) - 1)
            self._keep[heavy[:-1]] = np.clip(1 + spare[:-1] - need[last], 0, 1)
            self._alias[heavy[:-1]] = heavy[1:]

    def sample(self, u: FloatArray) -> tuple[IntArray, FloatArray]:
        """Indices, and the numbers rescaled to be uniform in [0, 1) again, with log2(n) fewer bits.

        u       (m,) float, uniform in [0, 1)
        index   (m,) int64
        rest    (m,) float, dtype of u
        """
        place = np.asarray(u, np.float64) * len(self._keep)
        bucket = np.minimum(place.astype(np.int64), len(self._keep) - 1)
        rest, keep = place - bucket, self._keep.take(bucket)
        kept = rest < keep
        low, width = ~kept * keep, select(kept, keep, 1 - keep)
        below_one = np.nextafter(u.dtype.type(1), u.dtype.type(0))
        rest = np.minimum((rest - low) / width, below_one).astype(u.dtype)
        return kept * bucket + ~kept * self._alias.take(bucket), rest
