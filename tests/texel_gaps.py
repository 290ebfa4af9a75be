"""Whether charts on a page keep clear of each other, texel by texel."""

import numpy as np


def covered_texels(uv: np.ndarray, chart: np.ndarray, size: int) -> np.ndarray:
    """(size, size) int: chart + 1 of the texels that charts reach into by more than rounding; -1 where several do."""
    page = np.zeros((size, size), int)
    edges = np.arange(size + 1.0)
    for triangle, owner in zip(uv, chart, strict=True):
        x0, y0 = np.maximum(np.floor(triangle.min(axis=0) + 1e-4).astype(int), 0)
        x1, y1 = np.ceil(triangle.max(axis=0) - 1e-4).astype(int)
        low_x, low_y = np.meshgrid(edges[x0:x1], edges[y0:y1])
        cut = np.zeros(low_x.shape, bool)
        for k in range(3):
            a, b, c = triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]
            normal = np.array([a[1] - b[1], b[0] - a[0]])
            normal = normal * np.sign(normal @ (c - a))
            best = low_x * normal[0] + low_y * normal[1] + np.maximum(normal, 0).sum() - normal @ a
            cut |= best < 1e-4 * np.abs(normal).sum()
        part = page[y0:y1, x0:x1]
        part[~cut & (part != 0) & (part != owner + 1)] = -1
        part[~cut & (part == 0)] = owner + 1
    return page


def check_gaps(uv: np.ndarray, chart: np.ndarray, size: int, padding: int) -> None:
    """No texel has two charts, none is nearer to another than the padding, nor nearer to the border."""
    assert uv.min() >= padding - 1e-5
    assert uv.max() <= size - padding + 1e-5
    owner = covered_texels(uv, chart, size)
    assert (owner >= 0).all(), "charts overlap"
    for y in range(padding + 1):
        for x in range(-padding, padding + 1):
            here = owner[: size - y, max(0, -x) : size - max(0, x)]
            there = owner[y:, max(0, x) : size - max(0, -x)]
            assert not ((here > 0) & (there > 0) & (here != there)).any(), f"charts {x}, {y} texels apart"
