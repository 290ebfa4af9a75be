"""Filter the noise of light at texels by non-local means (nonlocal_means).

Only texels of one piece of a chart are compared, and only where leaves are smaller than the window: noise is correlated within a leaf.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, starmap
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..texels.texel_map import FOOTPRINT_SIDE, TexelMap
from ..texels.tiling import Strips
from .nonlocal_means import HALO, RADIUS, smooth_alike

# Greatest side, texels, of leaves whose noise is filtered. Measured on the samples: with 4 the error is 0 to 4 % larger, with 8 up to 1 %
# at 256^2 and 1.5 % at 1024^2; with 32 it would be 1 to 2 % smaller there, and the filter takes longer.
SMALL_LEAF = 16
_DARKEST = 1e-30  # W/m^2

_Image = NDArray[np.float32]
# Calls the function with each tuple of arguments, wherever it runs, and returns the results in order.
Spread: TypeAlias = Callable[[Callable[..., Any], Iterable[tuple[Any, ...]]], Iterable[Any]]


@dataclass(frozen=True)
class Smoothed:
    """Filtered light.

    entry       (m,) int32
    light       (k, m, 3) float32, W/m^2
    variance    (m, 3) float32, (W/m^2)^2: residual variance if the errors of texels are independent
    own_share   (m,) float32: weight of each texel in its own filtered value
    """

    entry: NDArray[np.int32]
    light: NDArray[np.float32]
    variance: NDArray[np.float32]
    own_share: NDArray[np.float32]


@dataclass(frozen=True)
class Smoothing:
    """A filter in progress.

    asked   for each result its entries
    found   the results, in the same order
    """

    asked: list[NDArray[np.int32]]
    found: Iterable[tuple[_Image, _Image, _Image]]

    def finish(self) -> Smoothed:
        """Wait for the results and collect them; may be called once."""
        found = list(self.found)  # fewer than requested if time is up; the other texels stay unfiltered
        parts = [(entry, *values) for entry, values in zip(self.asked, found, strict=False)]
        entry, smoothed, left, own_share = (np.concatenate(of, axis=-1 if of[0].ndim == 1 else -2) for of in zip(*parts, strict=True))
        return Smoothed(entry, smoothed, left, own_share)


def denoise(
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    grainy: NDArray[np.bool_],
    texels: TexelMap,
    spread: Spread = starmap,
    with_variance: bool = False,
) -> Smoothed:
    """Filter the light; arguments are as for begin_denoising."""
    return begin_denoising(light, variance, grainy, texels, spread, with_variance).finish()


def begin_denoising(
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    grainy: NDArray[np.bool_],
    texels: TexelMap,
    spread: Spread,
    with_variance: bool,
) -> Smoothing:
    """Start filtering all texels near grainy ones; the arrays must not change until the filter has finished.

    light           (k, n, 3) float32: parts of the light at the texel entries; similarity is measured on their sum
    variance        (n, 3) float32: variance of the sum
    grainy          (n,) bool: texels whose noise is independent of their neighbours'
    with_variance   whether the residual variance is computed; else it is 0
    """
    # The scale keeps squares of tiny and huge light finite.
    brightness, noise = sum(float(part.mean(dtype=np.float64)) for part in light), float(np.sqrt(variance.mean(dtype=np.float64)))
    scale = np.float32(1 / max(brightness, noise, _DARKEST))
    nothing = np.zeros((len(light), 0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    asked = [np.zeros(0, np.int32)]
    # Texels that hold light of both sides of a wall are compared with their like alone; else they would spread it.
    chart_piece, mixes = 2 * texels.chart_piece, texels.borders.see_beyond(np.arange(len(texels)), FOOTPRINT_SIDE)

    def ask() -> Iterator[tuple[Any, ...]]:
        entries = np.flatnonzero(grainy)
        page = texels.page_of(entries)
        for number, entry_at in enumerate(texels.entry_at if len(entries) else ()):
            some = entries[page == number]
            strips = Strips.of(some, texels.texel_xy[some], entry_at, RADIUS, HALO)
            for some in strips.groups():
                entry, wanted = strips.stack(some)
                asked.append(entry[HALO:-HALO, HALO:-HALO][wanted])
                group = chart_piece.take(texels.texel_chart.take(entry, mode="wrap")) + mixes.take(entry, mode="wrap")
                chart = np.where(entry >= 0, group, -1)
                yield light.take(entry, axis=1, mode="wrap"), variance.take(entry, axis=0, mode="wrap"), chart, wanted, scale, with_variance

    return Smoothing(asked, chain([nothing], spread(_smooth_strips, ask())))


def _smooth_strips(
    light: _Image, variance: _Image, chart: NDArray[np.int32], wanted: NDArray[np.bool_], scale: np.float32, with_variance: bool
) -> tuple[_Image, _Image, _Image]:
    """Filtered light (k, m, 3), its variance (m, 3), 0 unless `with_variance`, and own shares (m,) of the texels `wanted`.

    light (k, h, w, 3), variance (h, w, 3); chart (h, w), -1 outside of charts; wanted without the halo
    """
    planes = np.ascontiguousarray(light.transpose(0, 3, 1, 2)) * scale
    noise = np.where(chart >= 0, np.ascontiguousarray(variance.transpose(2, 0, 1)) * scale * scale, 0)
    mean, left, own_share = smooth_alike(planes, noise, chart, with_variance)
    smoothed = (mean[..., wanted] / scale).transpose(0, 2, 1)
    kept = left[:, wanted].T / scale**2 if with_variance else np.zeros(smoothed.shape[1:], np.float32)
    return np.ascontiguousarray(smoothed), np.ascontiguousarray(kept), own_share[wanted]
