"""Voronoi diagrams of grid maps, and their size in pixels compared with contours (thesis, sections 3.3 and 3.5).

The Voronoi diagram is the ridge of the distance map: free cells that are farther from all obstacles than both neighbors
in their row or column. A contour pixel is a cell that is not free and has a free 4-neighbor (section 4.1).

Jagged walls cause many ridges, so the thesis first smooths a map three times by a Gaussian and a threshold. It chose
both for the smallest ratio but does not name them. The values below are chosen likewise, on seven of its ten maps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from protocol.grid import FREE, Grid, Mask
from worldsim.regions import largest_part

SIGMA = 1.5
"""Standard deviation of the Gaussian in cells."""

THRESHOLD = 0.3
"""Gray value from which a cell counts as occupied; 0 is free."""

SMOOTHINGS = 3

ISLAND_M2 = 0.1
"""Area in square meters below which an object within the free space is removed from a map before it is measured."""


class Pixels(NamedTuple):
    """Number of cells of a map's Voronoi diagram, and of its contours."""

    voronoi: int
    contour: int

    @property
    def ratio(self) -> float:
        """Voronoi pixels per contour pixel (Table 3.1); infinite without contours."""
        return self.voronoi / self.contour if self.contour else float("inf")


def pixels(free: Mask) -> Pixels:
    """Count the pixels of both representations of a free space."""
    return Pixels(int(ridge(free).sum()), int(contour(free).sum()))


def free_space(grid: Grid) -> Mask:
    """The largest 4-connected area of free cells, shape (h, w)."""
    return largest_part(grid == FREE)


def cleaned(free: Mask, resolution: float) -> Mask:
    """The free space without objects that are smaller than `ISLAND_M2`; a cell is `resolution` meters wide.

    The thesis cleaned its maps by hand: "very small objects like chair or table legs were removed" (section 3.5.1).
    """
    labels, objects = ndimage.label(np.pad(~free, 1, constant_values=True), np.ones((3, 3)))
    sizes = np.bincount(labels.ravel(), minlength=objects + 1)
    small = sizes * resolution**2 < ISLAND_M2
    small[[0, labels[0, 0]]] = False
    found: Mask = free | small[labels][1:-1, 1:-1]
    return found


def distances(free: Mask) -> NDArray[np.float64]:
    """Distance of each free cell to the nearest cell that is not free, in cells; the border counts as occupied."""
    found: NDArray[np.float64] = ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    return found


def ridge(free: Mask) -> Mask:
    """The Voronoi diagram of the free space, shape (h, w).

    If a ridge is two cells wide, as in a corridor of an even number of cells, only the first cell counts.
    """
    away = distances(free)
    return (_row_maxima(away) | _row_maxima(away.T).T) & free


def _row_maxima(away: NDArray[np.float64]) -> Mask:
    """Local maxima in each row: no neighbor is larger, and one is smaller; of two equal cells the first."""
    padded = np.pad(away, ((0, 0), (1, 1)))
    before, after = padded[:, :-2], padded[:, 2:]
    first = (away > before) & (away >= after)
    second = np.pad(first, ((0, 0), (1, 0)))[:, :-1]
    found: Mask = first | ((away >= before) & (away > after) & ~second)
    return found


def contour(free: Mask) -> Mask:
    """Cells that are not free and have a free 4-neighbor, shape (h + 2, w + 2): they may lie beyond the border."""
    padded = np.pad(free, 1)
    found: Mask = ndimage.binary_dilation(padded) & ~padded
    return found


def smoothed(free: Mask) -> Mask:
    """The largest area of the smoothed free space (section 3.5.1)."""
    solid = (~free).astype(np.float64)
    for _ in range(SMOOTHINGS):
        solid = (ndimage.gaussian_filter(solid, SIGMA, mode="nearest") >= THRESHOLD).astype(np.float64)
    return largest_part(solid == 0)
