"""Photons and gather rays that go straight on through transparent surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lights.light_links import LightLinks
from ..scene.materials import SurfaceMaterials
from ..scene.scene import DIFFUSE, GLOSSY, RAY_KINDS, SHADOW, TRANSMISSION
from ..scene.shadow_rays import leave_through
from ..util.arrays import BoolArray, Float32, IntArray
from ..util.geometry import gather, locate_hits
from .emission import Photons

_TINY = np.finfo(np.float32).tiny
_Rows = Float32


@dataclass(frozen=True)
class Passing:
    """Surfaces that photons may pass straight through.

    tri_passes   (2, n_tri) bool     whether light between surfaces passes, for any kind of ray, and whether light from a lamp does
    tri_frame    (3, 3, n_tri) float32, of triangle_frames, unit box
    tri_normal   (3, n_tri) float32, unit
    """

    surfaces: SurfaceMaterials
    tri_passes: BoolArray
    tri_frame: _Rows
    tri_normal: _Rows

    @classmethod
    def of(cls, surfaces: SurfaceMaterials, tri_frame: _Rows, tri_normal: _Rows, links: LightLinks) -> Passing | None:
        """None if no surface lets light pass and all surfaces block all lamps."""
        of_kind = [surfaces.find_passing(kind)[0] for kind in RAY_KINDS]
        passes = np.stack([np.logical_or.reduce(of_kind[:SHADOW]), of_kind[SHADOW]])
        return cls(surfaces, passes, tri_frame, tri_normal) if passes.any() or not links.blocks.all() else None

    def follow(self, direction: _Rows, share: _Rows, tri: IntArray, u: _Rows, v: _Rows, kind: IntArray) -> tuple[IntArray, _Rows, _Rows]:
        """Gather rays that go on through triangles (n,): their rows (k,), new origins (3, k), and throughputs (3, k).

        direction   (3, n) float32, unit
        share       (3, n) float32: throughput before
        kind        (n,) int: DIFFUSE, GLOSSY or TRANSMISSION
        """
        place = gather(self.tri_passes[0], tri).nonzero()[0]
        tri, u, v = gather(tri, place), gather(u, place), gather(v, place)
        toward = -gather(direction, place)
        passing = self.surfaces.passing_at(tri, u, v, DIFFUSE, toward).T
        if self.surfaces.by_kind:
            kind = gather(kind, place)
            for other in (GLOSSY, TRANSMISSION):
                own = (kind == other).nonzero()[0]
                at_own = gather(tri, own), gather(u, own), gather(v, own)
                passing[:, own] = self.surfaces.passing_at(*at_own, other, gather(toward, own)).T
        through = gather(share, place) * passing
        on = through.any(axis=0).nonzero()[0]
        tri, u, v, place = gather(tri, on), gather(u, on), gather(v, on), gather(place, on)
        at = locate_hits(self.tri_frame, tri, u, v)
        return place, leave_through(at, gather(direction, place), gather(self.tri_normal, tri)), gather(through, on)

    def leave(self, tri: IntArray, u: _Rows, v: _Rows, direction: _Rows) -> _Rows:
        """(3, n): share of a lamp's light, in directions (3, n), that refraction may carry: not what shadow rays bring through a surface
        that does not let other rays pass straight on.
        """
        shadow, other = (1 - self.surfaces.passing_at(tri, u, v, kind, direction).T for kind in (SHADOW, TRANSMISSION))
        return np.minimum(shadow / np.maximum(other, _TINY), 1)

    def go_on(
        self,
        photons: Photons,
        hit: IntArray,
        tri: IntArray,
        u: _Rows,
        v: _Rows,
        distance: _Rows,
        is_first: bool,
        is_open: BoolArray | None,
        rng: np.random.Generator,
    ) -> Photons | None:
        """Photons that pass, by Russian roulette; None if none does.

        The same photon may also be reflected: passing and reflection have roulettes of their own, so both are unbiased. The probability
        keeps the greatest channel of the flux, as for reflection.

        hit        (m,) int: rows of the photons that have met a triangle
        tri, u, v  (m,): their hits
        distance   (n,) float32: to the hit, of all photons
        is_first   the photons come straight from their lamp
        is_open    (m,) bool: from LightLinks, the lamp's light ignores the surface; None for none
        """
        of_lamp = np.full(len(tri), is_first)
        if photons.sky is not None:
            of_lamp &= ~gather(photons.sky, hit)
        passes = np.where(of_lamp, gather(self.tri_passes[1], tri), gather(self.tri_passes[0], tri))
        if is_open is not None:
            passes = passes | is_open
        place = passes.nonzero()[0]
        if photons.stops is not None:
            place = place[~gather(photons.stops, gather(hit, place))]
        if not len(place):
            return None
        tri, u, v, row, of_lamp = (gather(values, place) for values in (tri, u, v, hit, of_lamp))
        flux = gather(photons.flux, row)  # without soft falloff, which is applied anew at the next surface
        share = self._share_at(tri, u, v, of_lamp, gather(photons.direction, row))
        if is_open is not None:
            share = np.where(gather(is_open, place), np.float32(1), share)
        seen = None
        if self.surfaces.by_kind:
            seen = share if photons.seen is None else share * gather(photons.seen, row)
            share = seen.max(axis=0, keepdims=True)
            seen = seen / np.maximum(share, _TINY)
        through = flux * share[0]
        chance = through.max(axis=0) / np.maximum(flux.max(axis=0), _TINY)
        on = (chance > rng.random(len(chance), dtype=np.float32)).nonzero()[0]
        if not len(on):
            return None
        tri, u, v, row = gather(tri, on), gather(u, on), gather(v, on), gather(row, on)
        flux = gather(through, on) / gather(chance, on)
        direction = gather(photons.direction, row)
        origin = leave_through(locate_hits(self.tri_frame, tri, u, v), direction, gather(self.tri_normal, tri))
        soft = stops = sky = None
        if photons.soft is not None:
            soft = gather(photons.soft, row)
            soft[2] += gather(distance, row)
        if photons.stops is not None:
            stops = gather(photons.stops, row)
        if photons.sky is not None:
            sky = gather(photons.sky, row)
        mirrored = None if photons.mirrored is None else gather(photons.mirrored, row)
        link = None if photons.link is None else gather(photons.link, row)
        seen = None if seen is None else gather(seen, on)
        return Photons(origin, direction, flux, soft, np.add.reduce(flux, 1, np.float64), stops, sky, mirrored, link, seen)

    def _share_at(self, tri: IntArray, u: _Rows, v: _Rows, of_lamp: BoolArray, direction: _Rows) -> _Rows:
        """(k, 3, n): transmittance for light straight from lamps where of_lamp (n,), elsewhere for other light, in directions (3, n); for k
        kinds of rays, one where all are alike.
        """
        if not self.surfaces.by_kind and (not self.surfaces.has_two_passings or of_lamp.all()):
            return self.surfaces.passing_at(tri, u, v, SHADOW, direction).T[None]
        out = np.empty((3 if self.surfaces.by_kind else 1, 3, len(tri)), np.float32)
        from_lamp, other = of_lamp.nonzero()[0], (~of_lamp).nonzero()[0]
        of_these = gather(tri, from_lamp), gather(u, from_lamp), gather(v, from_lamp)
        out[..., from_lamp] = self.surfaces.passing_at(*of_these, SHADOW, gather(direction, from_lamp)).T
        of_others, direction = (gather(tri, other), gather(u, other), gather(v, other)), gather(direction, other)
        for kind, own in enumerate(out):
            own[:, other] = self.surfaces.passing_at(*of_others, kind, direction).T
        return out
