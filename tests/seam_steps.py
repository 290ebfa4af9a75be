"""Steps of light across seams, as a viewer sees them: both sides of a seam's points read from the pages by bilinear filtering."""

import numpy as np
from leaflight.core.texels.seam_points import SeamPoints


def read_page(pages: np.ndarray, page: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(m, 3) float64: pages (count, size, size, 3) at places (m, 2) in texels, with the page's edge going on."""
    last = pages.shape[1] - 1
    corner = place - 0.5
    low = np.floor(corner).astype(int)
    part = corner - low
    out = np.zeros((len(place), 3))
    for dx in (0, 1):
        for dy in (0, 1):
            weight = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
            x, y = np.clip(low + np.array([dx, dy]), 0, last).T
            out += weight[:, None] * pages[page, y, x, :3]
    return out


def measure_step(pages: np.ndarray, points: SeamPoints) -> float:
    """Root mean square of the difference over the points, relative to the light there plus a tenth of its mean."""
    one, other = (read_page(pages, points.page[side], points.place[side]).mean(axis=1) for side in (0, 1))
    local = (one + other) / 2
    return float(np.sqrt((((one - other) / (local + 0.1 * local.mean())) ** 2).mean()))
