"""Direct light at single points, where gather rays meet surfaces without a lightmap, or with a coarse one: one shadow ray to a light of
each kind.

Of the lights that texels sample one by one, one is chosen with a probability proportional to its unoccluded irradiance times the share of
earlier rays that found it visible. Lamps of a crowd and emitting triangles of a pool are chosen by their importance; directions of an
environment have a cosine distribution.

Source: Shirley, Wang and Zimmerman 1996, "Monte Carlo techniques for direct lighting calculations", 3.2 (one ray for all lights).
"""

from __future__ import annotations

import math

import numpy as np

from ..lights.direct_lights import INFINITE, Aim, Source
from ..lights.direct_points import Receivers
from ..scene.shadow_rays import ShadowRays, Sight
from ..util.arrays import Float32, Float64, IntArray
from ..util.brightness import weigh_channels
from ..util.geometry import rotate_to
from ..util.sampling import square_to_cosine_hemisphere
from .direct import DirectScene

# The visibility of a light counts as at least this: it bounds the weight of rays to a light that hardly any ray has found.
_LEAST_SEEN = 0.1


class HitLight:
    """Direct light at the hits of one chunk's gather rays. Each ray to a light updates the light's visibility for later rays."""

    def __init__(self, scene: DirectScene, rng: np.random.Generator) -> None:
        self._scene, self._rng = scene, rng
        # Number of rays to each source, and the sum of their visibilities. Both begin with 1: all sources count as visible at first.
        self._sent, self._seen = np.ones((2, len(scene.sources)))

    def find_light(self, receivers: Receivers, tri: IntArray) -> tuple[Float64, int]:
        """Irradiance (n, 3) float64, W/m^2, at points of triangles (n,), and the number of rays traced.

        The closed form of a light is multiplied by the visibility of one point of it, chosen uniformly by area or solid angle (as in
        visibility_estimator.Tally). That is biased in penumbrae, but bounds the light of a lamp that nearly touches the surface.
        """
        light, traced = self._sample_sources(receivers, tri)
        scene, rng = self._scene, self._rng
        if scene.crowd is not None:
            lamp, chance = scene.crowd.choose(receivers, rng)
            for lamps, own in scene.crowd.split(lamp):
                asking = receivers.rows(own)
                unoccluded = lamps.irradiance(asking.position, asking.normal) / chance[own]
                found = self._trace(lamps, scene.rays, asking)
                light[own] += found.times(unoccluded[:, None] * lamps.rgb)
                traced += found.rays
        for pool in scene.pools:
            unlit = scene.find_unlit(pool, tri)
            own = np.arange(len(tri)) if unlit is None else np.flatnonzero(~unlit)
            asking = receivers.rows(own)
            radiance, aim = pool.choose(asking, rng)
            seen = asking.see(scene.rays_to(pool), aim)
            light[own] += seen.times(radiance * aim.weight[:, None])
            traced += seen.rays
        if scene.environment is not None:
            places = square_to_cosine_hemisphere(rng.random((len(tri), 2), np.float32))
            direction = rotate_to(places, receivers.normal).astype(np.float32)
            one = np.ones(len(tri), np.float32)
            seen = receivers.see(scene.rays, Aim(direction, INFINITE * one, one, one, by_chance=True))
            light += seen.times(math.pi * scene.environment.environment.look_up(direction).astype(np.float64))
            traced += seen.rays
        return light, traced

    def _sample_sources(self, receivers: Receivers, tri: IntArray) -> tuple[Float64, int]:
        scene, light, traced = self._scene, np.zeros((len(tri), 3)), 0
        if not scene.sources:
            return light, traced
        unoccluded = np.empty((len(scene.sources), len(tri)))
        for row, source in zip(unoccluded, scene.sources, strict=True):
            row[:] = source.irradiance(receivers.position, receivers.normal)
            unlit = scene.find_unlit(source, tri)
            if unlit is not None:
                row[unlit] = 0.0
        power = np.array([float(weigh_channels(source.rgb)[0]) for source in scene.sources])
        worth = unoccluded * (power * np.maximum(self._seen / self._sent, _LEAST_SEEN))[:, None]
        end = np.cumsum(worth, axis=0)
        chosen = (self._rng.random(len(tri)) * end[-1] >= end).sum(axis=0)
        for number, source in enumerate(scene.sources):
            own = np.flatnonzero(chosen == number)  # where no light shines, `chosen` is the number of sources, and none is found
            if len(own):
                given = unoccluded[number, own] * (end[-1, own] / worth[number, own])
                found = self._trace(source, scene.rays_to(source), receivers.rows(own))
                light[own] = found.times(given[:, None] * source.rgb)
                self._sent[number] += len(own)
                self._seen[number] += found.share.sum()
                traced += found.rays
        return light, traced

    def _trace(self, lights: Source, rays: ShadowRays, receivers: Receivers) -> Sight:
        """What each of n points sees of its light: visibility of one point of it, times what the closed form leaves out, see Aim."""
        u: Float32 = self._rng.random((len(receivers.position), 2), np.float32)
        aim = lights.aim(receivers.position, receivers.normal, u)
        share = np.divide(aim.weight, aim.share, out=np.zeros_like(aim.weight), where=aim.share > 0)
        seen = receivers.see(rays, aim) if lights.casts_shadow else Sight(aim.weight > 0, None, 0)
        return seen.dim(share)
