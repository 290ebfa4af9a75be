"""Nodes of random charts: their bases are orthonormal on the part that the chart covers, and their areas sum to the mesh's.

The inner products are integrated anew, over the polygon cut to each node's square, by Gauss's rule on triangles.
"""

import numpy as np
import pytest
from leaflight.core.atlas import charts
from leaflight.core.radiosity import basis, quadtree
from leaflight.core.texels.texels import build_texel_map
from leaflight.core.util.geometry import triangle_normals_areas
from leaflight.core.util.settings import BASES, Settings
from scenes import Mesh, grid_mesh, make_scene, moved, sphere_mesh

SIZE_TEXELS, LEVELS = 64, 4
LEAST_SHARE = 0.05  # of a node's square: on slivers the rounding of their moments is all there is


def random_polygon(rng):
    """(n, 2) corners of a convex polygon in the unit square, counterclockwise."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 12)))
    turn = rng.uniform(0, np.pi)
    ellipse = np.stack([0.49 * np.cos(angle), rng.uniform(0.05, 0.49) * np.sin(angle)], axis=1)
    return 0.5 + ellipse @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])


def cut(corner, axis, bound, keep_below):
    """The part of a convex polygon (m, 2) on one side of a line. Source: Sutherland & Hodgman 1974."""
    side = (bound - corner[:, axis]) * (1 if keep_below else -1)
    out = []
    for k, following in enumerate(np.roll(np.arange(len(corner)), -1)):
        if side[k] >= 0:
            out.append(corner[k])
        if (side[k] >= 0) != (side[following] >= 0):
            out.append(corner[k] + (corner[following] - corner[k]) * side[k] / (side[k] - side[following]))
    return np.array(out).reshape(-1, 2)


def quadrature(corner):
    """Points (n, 2) and weights (n,) exact for polynomials of degree 4 on a convex polygon. Source: Duffy 1982."""
    place, weight = np.polynomial.legendre.leggauss(4)
    u, v = (grid.ravel() for grid in np.meshgrid((place + 1) / 2, (place + 1) / 2))
    share = np.multiply.outer(weight, weight).ravel() / 4 * u
    points, weights = [np.zeros((0, 2))], [np.zeros(0)]
    for k in range(1, len(corner) - 1):
        first, second = corner[k] - corner[0], corner[k + 1] - corner[k]
        points.append(corner[0] + u[:, None] * first + (u * v)[:, None] * second)
        weights.append(share * abs(first[0] * second[1] - first[1] * second[0]))
    return np.concatenate(points), np.concatenate(weights)


def polygon_tree(corner, degree):
    """The nodes of a polygon that is its own layout: a unit square of SIZE_TEXELS texels."""
    scene = make_scene([Mesh("Polygon", np.pad(corner, ((0, 0), (0, 1))), [list(range(len(corner)))], [corner])])
    settings = Settings(size=SIZE_TEXELS)
    texels = build_texel_map(scene, charts.make_charts(scene, settings), 2 * degree)
    tree = quadtree.plant_trees(texels, degree, 0, 1, False)
    return quadtree.grow_previews(tree, texels, LEVELS, 1)


@pytest.mark.parametrize("degree", [1, 2], ids=BASES[1:])
def test_bases_of_nodes_are_orthonormal_on_the_chart(degree, hold):
    rng, worst, judged = np.random.default_rng(12), 0.0, 0
    for _ in range(4):
        corner = random_polygon(rng)
        tree = polygon_tree(corner, degree)
        functions = basis.orthonormal_functions(basis.gram_matrix(tree.moment, degree))
        for node in range(len(tree)):
            domain, half = corner, tree.side[node] / SIZE_TEXELS / 2
            for axis in (0, 1):
                low = tree.origin[node, axis] / SIZE_TEXELS
                domain = cut(cut(domain, axis, low, False), axis, low + 2 * half, True)
            point, weight = quadrature(domain)
            if weight.sum() < LEAST_SHARE * 4 * half**2:
                continue
            local = (point - tree.origin[node] / SIZE_TEXELS) / half - 1
            values = functions[node] @ np.array(basis.monomials(*local.T, degree))
            worst = max(worst, np.abs((values * weight) @ values.T - np.eye(len(values))).max())
            judged += 1
    assert judged > 200
    hold("basis: inner products on nodes that random charts cover by a twentieth and more off the identity", worst, high=1e-10)


@pytest.mark.parametrize("mesh", [sphere_mesh(), moved(grid_mesh("Bent", noise=0.4), scale=0.01)], ids=["sphere", "bent"])
def test_areas_of_nodes_sum_to_the_mesh(mesh, hold):
    scene = make_scene([mesh])
    texels = build_texel_map(scene, charts.make_charts(scene, Settings(size=128)), 2)
    total = triangle_normals_areas(scene.tri_position)[1].sum()
    for level in range(LEVELS):
        tree = quadtree.plant_trees(texels, 1, level, 1, False)
        hold("areas: sum over nodes off the mesh", abs(tree.area.sum() / total - 1), high=1e-9, case=f"{mesh.name}, level {level}")
