"""What is expected of a decision: contexts and their counts.

Whether the cell that a beam enters is free or a wall depends on what is known of its eight neighbours by then: 3^8
contexts with two counts each. The rest of a unit (poses, what it is built on, exceptions) has contexts of its own
behind these. Every maker's stream begins with the counts of a table that was learnt on generated maps.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from agent.predictive.coder import NUMBER, Counts
from protocol.grid import UNKNOWN, Grid
from protocol.kernels import kernel

CELLS_MOST = 256
"""Counts of a cell's contexts are halved at this sum; those of all else at `REST_MOST`."""

REST_MOST = 1024

CELLS = 0
"""Free or wall: the state of the eight neighbours, in base 3."""

SEEN = 3**8
"""Whether the cell that a beam enters is told of at all: by whether the last beam ended unseen, and whether this
is the first cell asked for along this one."""

MORE = SEEN + 4
"""Whether another look follows: by how many there have been, 3 at most."""

PLACED = MORE + 4
"""11 bits of the first pose's column, and of its row."""

SAME = PLACED + 22
"""Whether the robot went on as it did before: by its last way, none, straight, askew or diagonal."""

ALONG = SAME + 4
"""How much farther along its last way it came: a number a kind of last way."""

ACROSS = ALONG + 4 * NUMBER
"""And across: by how much farther, from -3 to 3, as well."""

BUILT_ON = ACROSS + 4 * 7 * NUMBER
"""How many more units of another map it is built on: by whether there were any the last time."""

EXCEPTIONS = BUILT_ON + 2 * NUMBER
"""How many exceptions there are."""

FIRST_X = EXCEPTIONS + NUMBER
"""The first exception's column, from the robot's, and its row."""

FIRST_Y = FIRST_X + NUMBER
NEXT_ROW = FIRST_Y + NUMBER
"""Rows to the next exception, and columns, in its own row or another."""

SAME_ROW = NEXT_ROW + NUMBER
OTHER_ROW = SAME_ROW + NUMBER
CHANGED = OTHER_ROW + NUMBER
"""Which of the two other states a cell has: by the one that was expected."""

CONTEXTS = CHANGED + 3

TABLE = Path(__file__).with_name("start.npz")
"""Counts learnt on generated maps."""


@cache
def _table() -> Counts:
    with np.load(TABLE) as file:
        counts: Counts = np.zeros((CONTEXTS, 2), np.uint16)
        counts[file["contexts"]] = file["counts"]
    counts.flags.writeable = False
    return counts


def start() -> Counts:
    """Return the counts with which every maker's stream begins: uint16 of shape (CONTEXTS, 2)."""
    return _table().copy()


@kernel("int64(uint8[:,::1], int64, int64)")
def neighbors(grid: Grid, x: int, y: int) -> int:
    """Return the context of cell (x, y): the state of its eight neighbours, row by row, in base 3.

    The low two bits of a grid's byte are the state; what lies beyond the rim is unknown.
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
