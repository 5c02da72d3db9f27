"""The probability model of the arithmetic coder: contexts and their counts.

The state of a cell that a beam enters, free or wall, is coded in a context of its eight neighbors: 3^8 contexts with
two counts each. The other parts of an update (poses, dependencies, corrections) have further contexts. The counts of
every log begin with a table that was trained on generated maps (`deploy.study.starting_table`).
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from agent.predictive.coder import NUMBER, Counts
from protocol.grid import UNKNOWN, Grid
from protocol.kernels import kernel

CELLS_MOST = 256
"""Sum at which the counts of a cell context are halved."""

REST_MOST = 1024
"""Sum at which the counts of any other context are halved."""

CELLS = 0
"""Free or wall: by the states of the eight neighbors, as a number in base 3."""

OBSERVED = 3**8
"""Whether the robot has observed the unknown cell that a beam enters: by whether the last coded beam ended at an
unobserved cell, and whether an earlier cell of this beam was coded."""

MORE_SCANS = OBSERVED + 4
"""Whether another scan follows: by the number of scans so far, at most 3."""

FIRST_POSE = MORE_SCANS + 4
"""11 bits each of the column and the row of the first pose."""

SAME_MOTION = FIRST_POSE + 22
"""Whether the robot repeats its last motion: by the kind of this motion (none, straight, oblique or diagonal)."""

ALONG = SAME_MOTION + 4
"""Difference along the direction of the last motion: by the kind of this motion."""

ACROSS = ALONG + 4 * NUMBER
"""Difference across it: by the kind of the last motion, and by the difference along it, clipped to -3 to 3."""

BASES = ACROSS + 4 * 7 * NUMBER
"""Number of further updates of another map on which the update depends: by whether there were any last time."""

CORRECTIONS = BASES + 2 * NUMBER
"""Number of corrections."""

FIRST_X = CORRECTIONS + NUMBER
"""Column of the first correction relative to the robot; `FIRST_Y`: its row."""

FIRST_Y = FIRST_X + NUMBER
NEXT_ROW = FIRST_Y + NUMBER
"""Rows to the next correction; `SAME_ROW` and `OTHER_ROW`: columns to it, in the same or another row."""

SAME_ROW = NEXT_ROW + NUMBER
OTHER_ROW = SAME_ROW + NUMBER
CHANGED = OTHER_ROW + NUMBER
"""Which of the two other states a corrected cell has: by its predicted state."""

HAS_TILES = CHANGED + 3
"""Whether an update of tiles has any."""

MORE_SCANS_NARROW = HAS_TILES + 1
"""`MORE_SCANS` on narrow media."""

CONTEXTS = MORE_SCANS_NARROW + 4

TABLE = Path(__file__).with_name("start.npz")
"""The shipped table: counts trained on generated maps."""

NARROW_TABLE = Path(__file__).with_name("narrow_start.npz")
"""The shipped table for narrow media, trained on generated maps (`deploy.study.narrow_table`): other `counts` of some
`contexts`, and the `factors` of `agent.predictive.pose_model`."""


@cache
def _counts_of(*tables: Path) -> Counts:
    """Return the counts of shipped tables; those of later ones replace those of earlier ones."""
    counts: Counts = np.zeros((CONTEXTS, 2), np.uint16)
    for table in tables:
        with np.load(table) as file:
            counts[file["contexts"]] = file["counts"]
    return counts


def start(*, narrow: bool = False) -> Counts:
    """Return a copy of the initial counts of every log, of a narrow medium or not: uint16, shape (CONTEXTS, 2)."""
    return _counts_of(*((TABLE, NARROW_TABLE) if narrow else (TABLE,))).copy()


@kernel
def cell_state(grid: Grid, x: int, y: int) -> int:
    """Return the state of a cell, unknown outside the grid; the flags of the cell are left out."""
    if 0 <= y < grid.shape[0] and 0 <= x < grid.shape[1]:
        return int(np.int64(grid[y, x]) & 3)
    return UNKNOWN


@kernel
def neighbors(grid: Grid, x: int, y: int) -> int:
    """Return the context of cell (x, y): the states of its eight neighbors, row by row, as a number in base 3.

    The state is in the low two bits of a cell; cells outside the grid are unknown.
    """
    height, width = grid.shape
    context = 0
    if 0 < x < width - 1 and 0 < y < height - 1:
        for row in range(y - 1, y + 2):
            for column in range(x - 1, x + 2):
                if row != y or column != x:
                    context = 3 * context + (grid[row, column] & 3)
        return context
    for row in range(y - 1, y + 2):
        for column in range(x - 1, x + 2):
            if row != y or column != x:
                inside = 0 <= row < height and 0 <= column < width
                context = 3 * context + (grid[row, column] & 3 if inside else UNKNOWN)
    return context
