"""Errors of a robot's map: its differences from the true map, cell by cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, Mask

IRRELEVANT, RIGHT, WALL, FALSE_WALL, UNSEEN, WRONG_FREE = range(6)
"""Unknown and unreachable; correctly free; correctly not free; and the three errors."""

ERRORS = {FALSE_WALL: "false wall", UNSEEN: "unknown", WRONG_FREE: "false floor"}
"""Text of the errors."""

DIFFERENCES = {FALSE_WALL: "wall, free for the team", UNSEEN: "unknown", WRONG_FREE: "free, not for the team"}
"""Text of the same differences if the true map is unknown, and the team's map replaces it."""

SCAN_DIFFERENCES = {
    FALSE_WALL: "wall, free by all scans",
    UNSEEN: "unknown",
    WRONG_FREE: "free, not by all scans",
}
"""Texts of these differences for recorded runs, which are compared with the map of all scans."""


def compare(grid: Grid, truth: Grid, reachable: Mask) -> NDArray[np.uint8]:
    """Classify each cell of a robot's map, from `IRRELEVANT` to `WRONG_FREE`; all arrays have shape (h, w).

    `grid` and `truth` have unknown, free and occupied cells. `reachable` are the free cells that can be explored;
    unknown cells are errors only there.
    """
    floor = truth == FREE
    found = np.full(grid.shape, IRRELEVANT, np.uint8)
    found[grid == FREE] = WRONG_FREE
    found[(grid == FREE) & floor] = RIGHT
    found[grid == OCCUPIED] = WALL
    found[(grid == OCCUPIED) & floor] = FALSE_WALL
    found[(grid == UNKNOWN) & reachable] = UNSEEN
    return found


def share_correct(errors: NDArray[np.uint8], reachable: Mask) -> float:
    """The share of the reachable cells that are correct on a map."""
    return float((errors[reachable] == RIGHT).mean())
