"""Maps on which searches are planned: peaked, with several modes, ring-shaped, rough."""

import numpy as np
from scipy import ndimage


def gaussian(x, y, sx, sy=None, cells=120):
    """A peak at x, y (cells) of a map."""
    row, column = np.mgrid[0:cells, 0:cells] + 0.5
    return np.exp(-0.5 * (((column - x) / sx) ** 2 + ((row - y) / (sy or sx)) ** 2))


def ring(radius, width, cells=120):
    """A ring about the middle of a map."""
    row, column = np.mgrid[0:cells, 0:cells] + 0.5
    distance = np.hypot(row - cells / 2, column - cells / 2)
    return np.exp(-0.5 * ((distance - radius) / width) ** 2)


def rough(seed, cells=120):
    """Log-normal noise of about 4 cells' size."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(cells, cells)), 4.0)
    return np.exp(1.5 * noise / noise.std())


def mixture(seed, cells=120):
    """Two to five peaks of any place, size and weight."""
    rng = np.random.default_rng(seed)
    peaks = [
        rng.uniform(0.3, 1.0) * gaussian(*rng.uniform(15, 105, 2), *rng.uniform(5, 20, 2), cells=cells)
        for _ in range(rng.integers(2, 6))
    ]
    return np.sum(peaks, axis=0)


MAPS = {
    "peak": gaussian(60, 60, 12),
    "wide": gaussian(60, 60, 25),
    "long": gaussian(60, 60, 30, 8),
    "three": gaussian(25, 30, 7) + 0.8 * gaussian(90, 35, 8) + 0.6 * gaussian(60, 95, 9),
    "ring": ring(35, 5),
    "rough": rough(1),
}
