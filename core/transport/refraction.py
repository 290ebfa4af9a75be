"""Reflection and refraction of photons and gather rays by glass.

Photons follow the adjoint of Cycles' rays: Cycles leaves the radiance of a refracted ray unscaled, so a photon's flux is multiplied by
(n / n')^2 (Veach 1997, 5.2). On the way into a closed solid and out of it the factors cancel; behind a single face they do not.
"""

import numpy as np

from ..scene.glass import Bent, Glass
from ..scene.scene import GLOSSY, TRANSMISSION
from ..util.arrays import BoolArray, Float32, Float64, IntArray
from ..util.geometry import gather, locate_hits, offset_origin
from .emission import Arrivals, Photons
from .mirrors import GlossyScene, send_on, shade

_Rows = Float32


def bend_photons(
    scene: GlossyScene,
    arrived: Arrivals,
    tri: IntArray,
    cosine: _Rows,
    is_first: bool,
    from_lamp: BoolArray | None,
    seen: _Rows | None,
    copies: int,
    rng: np.random.Generator,
) -> tuple[Photons | None, Float64]:
    """Photons that glass reflects or refracts, None if there are none; and the power, (3,) W, of the refracted ones.

    Diffuse reflection has a roulette of its own. Further arguments are as for mirrors.reflect_photons.

    from_lamp   (n,) bool: photons straight from a lamp; the share that passes as shadow rays do is not refracted too. None for none
    seen        (3, 3, n) float32: of Photons; None if all rays see all
    """
    nothing = np.zeros(3)
    glass = scene.glass
    if glass is None:
        return None, nothing
    place = gather(glass.tri_glass, tri).nonzero()[0]
    if not len(place):
        return None, nothing
    count = np.where(gather(glass.tri_rough, gather(tri, place)), copies, 1)  # smooth glass would send all copies the same way
    flux = gather(arrived.flux, place) / count.astype(np.float32)
    if copies > 1:
        place, flux = np.repeat(place, count), np.repeat(flux, count, axis=1)
    tri, u, v = gather(tri, place), gather(arrived.u, place), gather(arrived.v, place)
    if from_lamp is not None and scene.passing is not None:
        flux = flux * np.where(gather(from_lamp, place), scene.passing.leave(tri, u, v, gather(arrived.direction, place)), np.float32(1))
    direction = gather(arrived.direction, place)
    bent, side = _bend(scene, glass, tri, u, v, direction, gather(cosine, place), rng, of_light=True)
    scale = np.where(bent.crossed, bent.eta**-2, 1).astype(np.float32)
    if seen is not None:
        _, reflected, refracted = gather(seen, place)
        flux = flux * np.where(bent.crossed, refracted, reflected)
    flux = flux * bent.weight * scale
    kept = flux.any(axis=0).nonzero()[0]
    if not len(kept):
        return None, nothing
    flux, tri, u, v, side, crossed = (gather(values, kept) for values in (flux, tri, u, v, side, bent.crossed))
    origin = offset_origin(locate_hits(scene.tri_frame, tri, u, v), side)
    photons = send_on(scene, arrived, is_first, gather(place, kept), origin, gather(bent.direction, kept), flux)
    return photons, np.add.reduce(flux[:, crossed], 1, np.float64)


def follow_glass(
    scene: GlossyScene, direction: _Rows, share: _Rows, tri: IntArray, u: _Rows, v: _Rows, rng: np.random.Generator
) -> tuple[IntArray, _Rows, _Rows, _Rows, IntArray]:
    """Gather rays that glass reflects or refracts, as of mirrors.follow_mirrors; and of which kind (k,) they are then."""
    glass = scene.glass
    place = np.zeros(0, np.intp) if glass is None else gather(glass.tri_glass, tri).nonzero()[0]
    nothing = np.zeros((3, 0), np.float32)
    if glass is None or not len(place):
        return place, nothing, nothing, nothing, place
    tri, u, v = gather(tri, place).astype(np.intp), gather(u, place), gather(v, place)
    direction, share = gather(direction, place), gather(share, place)
    cosine = np.einsum("kn,kn->n", direction, gather(scene.tri_normal, tri))
    bent, side = _bend(scene, glass, tri, u, v, direction, cosine, rng)
    on = bent.weight.any(axis=0).nonzero()[0]
    tri, u, v, side = (gather(values, on) for values in (tri, u, v, side))
    origin = offset_origin(locate_hits(scene.tri_frame, tri, u, v), side)
    kind = np.where(gather(bent.crossed, on), TRANSMISSION, GLOSSY)
    return gather(place, on), origin, gather(bent.direction, on), gather(share * bent.weight, on), kind


def _bend(
    scene: GlossyScene,
    glass: Glass,
    tri: IntArray,
    u: _Rows,
    v: _Rows,
    direction: _Rows,
    cosine: _Rows,
    rng: np.random.Generator,
    of_light: bool = False,
) -> tuple[Bent, _Rows]:
    """Directions after reflection or refraction, and the geometric normals (3, n) on the side that the rays leave to.

    cosine     (n,) float32: of the directions (3, n) with the geometric normal
    of_light   as for Gloss.reflect: a coat's share depends on the direction towards the viewer
    """
    numbers = rng.random((3, len(tri)), dtype=np.float32)
    side = -np.copysign(np.float32(1), cosine)
    face = gather(scene.tri_normal, tri) * side
    normal, is_front = shade(scene, tri, u, v, side, face, direction), cosine < 0
    bent = glass.bend(tri, u, v, direction, normal, is_front, numbers)
    if normal is not face:
        # Shading normals may send rays to the wrong side of the face; geometric ones do not.
        wrong = ((np.einsum("kn,kn->n", bent.direction, face) > 0) == bent.crossed).nonzero()[0]
        if len(wrong):
            own = (gather(values, wrong) for values in (tri, u, v, direction, face, is_front, numbers))
            bent.put(wrong, glass.bend(*own))
    bent.weight[:, (np.einsum("kn,kn->n", bent.direction, face) > 0) == bent.crossed] = 0
    seen = bent.direction if of_light else direction
    cosine_seen = np.zeros(0, np.float32) if scene.gloss is None else np.abs(np.einsum("kn,kn->n", seen, normal))
    below = None if scene.gloss is None else scene.gloss.below_coat(tri, u, v, cosine_seen)
    if below is not None and scene.gloss is not None:
        # By roulette: the coat reflects photons of its own, so with weights instead their number would grow within the glass.
        bent.weight[:, below <= rng.random(len(below), dtype=np.float32)] = 0
        tint = scene.gloss.tint_below_coat(tri, u, v, cosine_seen)
        if tint is not None:
            np.multiply(bent.weight, tint, out=bent.weight)
    return bent, face * np.where(bent.crossed, np.float32(-1), np.float32(1))
