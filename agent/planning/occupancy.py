"""Costs by occupancy: ways that keep away from walls (Burgard et al., section II-A)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from protocol.grid import FREE, OCCUPIED, Grid

P_FREE, P_UNKNOWN, P_OCCUPIED = 0.1, 0.5, 0.9
"""Occupancy probability that a cell of each state stands for."""

SMOOTHING = 1.0
"""Standard deviation of the Gaussian that maps are smoothed by, in cells."""


def occupancy_weights(floor: Grid, grid: Grid) -> NDArray[np.float64]:
    """What a cell's width costs on a map smoothed by a Gaussian (Burgard et al., section II-A).

    The paper's cost is distance times occupancy; here it is scaled so that a cell far from all obstacles
    costs its length. Only cells that are free on `floor` can be entered at all: that is the paper's occ_max,
    put where no doorway closes.

    Returns
    -------
    float64 array, shape (h, w)
        At least 1; P_OCCUPIED / P_FREE at most.
    """
    table = np.zeros(256)
    table[[0, FREE, OCCUPIED]] = P_UNKNOWN, P_FREE, P_OCCUPIED
    smoothed = ndimage.gaussian_filter(table[grid], SMOOTHING, mode="constant", cval=P_UNKNOWN, truncate=3.0)
    weights = np.maximum(smoothed / P_FREE, 1.0)
    weights[floor != FREE] = P_OCCUPIED / P_FREE
    return np.ascontiguousarray(weights)
