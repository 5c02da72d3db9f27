"""What is wrong on a robot's map: its difference to the true one, cell by cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

IRRELEVANT, RIGHT, WALL, FALSE_WALL, UNSEEN, WRONG_FREE = range(6)
"""Unknown where nobody can go; free as in truth; no floor, as in truth; and the three errors."""

ERRORS = {
    FALSE_WALL: "wall where there is none",
    UNSEEN: "not known",
    WRONG_FREE: "floor where there is none",
}
"""The errors in words."""


def compare(grid: Grid, truth: Grid, reachable: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Say of each cell of a map what it is.

    Parameters
    ----------
    grid, truth : uint8 arrays, shape (h, w)
        A robot's map, and the true one, of unknown, free and occupied cells.
    reachable : bool array, shape (h, w)
        Free cells that can be explored: only there does a robot miss anything that it does not know.

    Returns
    -------
    uint8 array, shape (h, w)
        `IRRELEVANT`, `RIGHT`, `WALL`, `FALSE_WALL`, `UNSEEN` or `WRONG_FREE`.
    """
    floor = truth == FREE
    found = np.full(grid.shape, IRRELEVANT, np.uint8)
    found[grid == FREE] = WRONG_FREE
    found[(grid == FREE) & floor] = RIGHT
    found[grid == OCCUPIED] = WALL
    found[(grid == OCCUPIED) & floor] = FALSE_WALL
    found[(grid == UNKNOWN) & reachable] = UNSEEN
    return found


def share_right(errors: NDArray[np.uint8], reachable: NDArray[np.bool_]) -> float:
    """The part of the reachable cells that a map has right."""
    return float((errors[reachable] == RIGHT).mean())
