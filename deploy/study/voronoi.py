"""Voronoi diagrams of grid maps, and how many pixels they take beside contours (thesis, sections 3.3 and 3.5).

The Voronoi diagram is the ridge of the distance map: the cells of the free space that are farther from all that is
not free than the cells on both sides of them, in their row or in their column. What it takes to tell is compared with
contours by counting pixels; a contour pixel is a non-free cell with a free 4-neighbour (section 4.1).

Jagged walls give many ridges. So the thesis smooths maps first: three times, a Gaussian and a threshold. It chose
both for the smallest ratio and does not name them; those here are chosen likewise, on seven of its ten maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from protocol.grid import FREE, OCCUPIED, Grid

SIGMA = 1.5
"""Standard deviation of the Gaussian in cells."""

THRESHOLD = 0.3
"""Grey value from which on a cell counts as occupied, 0 is free and 1 is not."""

TIMES = 3
"""How often the map is smoothed."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Pixels:
    """What a map takes, in pixels.

    Attributes
    ----------
    voronoi : int
        Cells of the Voronoi diagram.
    contour : int
        Contour pixels.
    """

    voronoi: int
    contour: int

    @property
    def ratio(self) -> float:
        """Voronoi pixels for each contour pixel (Table 3.1); infinite without contours."""
        return self.voronoi / self.contour if self.contour else float("inf")


def pixels(free: Mask) -> Pixels:
    """Count what the free space of a map takes in both forms."""
    return Pixels(int(ridge(free).sum()), int(contour(free).sum()))


def free_space(grid: Grid) -> Mask:
    """The largest 4-connected area of free cells; shape (h, w)."""
    labels, parts = ndimage.label(grid == FREE)
    if not parts:
        return np.zeros(grid.shape, np.bool_)
    largest = 1 + int(np.argmax(np.bincount(labels.ravel(), minlength=parts + 1)[1:]))
    found: Mask = labels == largest
    return found


def distances(free: Mask) -> NDArray[np.float64]:
    """Distance of each free cell to the nearest cell that is not free, in cells; beyond the rim nothing is."""
    padded = np.pad(free, 1)
    found: NDArray[np.float64] = ndimage.distance_transform_edt(padded)[1:-1, 1:-1]
    return found


def ridge(free: Mask) -> Mask:
    """The Voronoi diagram of the free space; shape (h, w).

    Where a ridge is two cells wide, as in a corridor of an even number of cells, the first one counts.
    """
    away = distances(free)
    return (_tops(away) | _tops(away.T).T) & free


def _tops(away: NDArray[np.float64]) -> Mask:
    """Cells that no neighbour in their row exceeds, and one falls short of; of two alike side by side the first."""
    padded = np.pad(away, ((0, 0), (1, 1)))
    behind, ahead = padded[:, :-2], padded[:, 2:]
    first = (away > behind) & (away >= ahead)
    second = np.pad(first, ((0, 0), (1, 0)))[:, :-1]
    found: Mask = first | ((away >= behind) & (away > ahead) & ~second)
    return found


def contour(free: Mask) -> Mask:
    """Cells that are not free and have a free 4-neighbour; shape (h + 2, w + 2), for they may lie beyond the rim."""
    padded = np.pad(free, 1)
    found: Mask = ndimage.binary_dilation(padded) & ~padded
    return found


def smoothed(free: Mask, sigma: float = SIGMA, times: int = TIMES) -> Mask:
    """The free space with jags, indentations and salients smoothed away (section 3.5.1); its largest area."""
    solid = (~free).astype(np.float64)
    for _ in range(times):
        solid = (ndimage.gaussian_filter(solid, sigma, mode="nearest") >= THRESHOLD).astype(np.float64)
    return free_space(np.where(solid > 0, OCCUPIED, FREE).astype(np.uint8))
