"""Texel maps and photons on simple charts, for tests of the quadtree and what is built on it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from leaflight.core.radiosity import basis, quadtree, tally
from leaflight.core.radiosity.quadtree import TreeView
from leaflight.core.texels.texels import TexelMap, build_texel_map
from leaflight.core.util.progress import Watch, unwatched
from scenes import Mesh, make_scene, quad_mesh

SIDE = 64  # texels, of the squares that `throw` lights


def make_map(uv: Any, chart: Any = None, position: Any = None, size: int = 8, degree: int = 4, watch: Watch = unwatched) -> TexelMap:
    """Texels of triangles `uv` (n, 3, 2); they lie in the plane z = 0 at their UV unless `position` (n, 3, 3) says otherwise."""
    uv = np.asarray(uv, float)
    n = len(uv)
    chart = np.zeros(n, np.int32) if chart is None else np.asarray(chart, np.int32)
    position = np.concatenate([uv, np.zeros((n, 3, 1))], axis=2) if position is None else np.asarray(position, float)
    snapshot = make_scene([Mesh("Plane", position.reshape(-1, 3), np.arange(3 * n).reshape(n, 3).tolist())])
    n_chart = int(chart.max(initial=-1)) + 1
    atlas: Any = SimpleNamespace(page_size=size, page_count=1, tri_chart=chart, tri_uv=uv, chart_page=np.zeros(n_chart, np.int32))
    return build_texel_map(snapshot, atlas, degree, watch=watch)


def make_square_map(side, degree, width=1.0):
    """Texel map of a square metre seen by a chart of `side` texels; `width` below 1 covers that share of it in x."""
    scene = make_scene([quad_mesh("Square", width)])
    atlas = SimpleNamespace(
        page_size=side,
        page_count=1,
        tri_chart=np.zeros(2, np.int32),
        tri_uv=scene.tri_position[..., :2] * side,
        chart_page=np.zeros(1, np.int32),
        chart_object=np.zeros(1, np.int32),
        object_page=np.zeros(1, np.int32),
        warnings=(),
    )
    return build_texel_map(scene, atlas, 2 * degree)


class SquareBake:
    """Photons with a given density on the square of make_square_map, without any tracing."""

    def __init__(self, side=64, degree=1, width=1.0, level=0, preview_depth=2, flat=False):
        self.texels, self.degree, self.side = make_square_map(side, degree, width), degree, side
        self.n_texel = len(self.texels.texel_code)
        self.preview_depth = preview_depth
        self.tree = quadtree.plant_trees(self.texels, degree, level, 1, flat)
        if not flat:
            self.grow()
        self.tally = tally.Tally.empty(len(self.tree), degree)

    def grow(self):
        self.tree = quadtree.grow_previews(self.tree, self.texels, self.preview_depth, 1)

    def throw(self, s, t, half=0, emitted=None, flux=None, is_first=True):
        """Deposit photons at s, t in [0, 1) of the square; straight from a light if `is_first`."""
        self.tally.grow(len(self.tree))
        view = TreeView.of_tree(self.tree, self.n_texel)
        x, y = s * self.side, t * self.side
        node, *local = view.locate(self.texels.entry_of(np.zeros(len(x), int), x, y), x, y)
        power = np.ones((3, len(x))) if flux is None else flux
        sums = tally.deposit(node, *local, power, np.full(len(x), is_first), len(self.tree), self.degree)
        self.tally.add(half, sums, len(x) if emitted is None else emitted)

    def totals(self):
        return tally.accumulate(self.tree, self.tally)

    def solution(self):
        return tally.solve_tallies(self.tree, self.totals())

    def values(self, nodes, s, t):
        """Irradiance of the first channel at s, t, on the node of `nodes` that holds each."""
        owner = quadtree.node_of_texel(self.tree, nodes, self.n_texel)
        node = owner[self.texels.entry_of(np.zeros(len(s), int), s * self.side, t * self.side)]
        half = self.tree.side[node] / 2
        local = [(v * self.side - self.tree.origin[node, axis]) / half - 1 for axis, v in enumerate((s, t))]
        monomials = np.array(basis.monomials(*local, self.degree))
        return (self.solution().coefficient.sum(0)[0][:, node] * monomials).sum(0)


def even(rng, n):
    """Where photons of even light fall: (2, n), as samplers of `throw` do."""
    return rng.random((2, n))


def hill(rng, n):
    """Density (1 + sin(2 pi s) sin(2 pi t) * 0.8): drawn by rejection."""
    s, t, u = rng.random((3, 4 * n))
    kept = np.flatnonzero(u * 1.8 < hill_truth(s, t))[:n]
    return s[kept], t[kept]


def glow(rng, n):
    """As a small lamp does half a metre above a corner: glow_truth, drawn by rejection."""
    s, t, u = rng.random((3, 12 * n))
    kept = np.flatnonzero(u < glow_truth(s, t))[:n]
    return s[kept], t[kept]


def even_truth(s, t):
    return np.ones_like(s)


def hill_truth(s, t):
    return 1 + 0.8 * np.sin(2 * np.pi * s) * np.sin(2 * np.pi * t)


def glow_truth(s, t):
    """The fourth power of the cosine."""
    return 1 / (1 + 4 * (s * s + t * t)) ** 2


def throw(sampler, photons, seed, **options):
    """A bake of a watt over a square metre, in two halves."""
    bake = SquareBake(side=SIDE, **options)
    rng = np.random.default_rng(seed)
    for half in (0, 1):
        s, t = sampler(rng, photons // 2)
        bake.throw(s, t, half, emitted=photons // 2)
    return bake


def current(bake):
    return np.flatnonzero(bake.tree.current)
