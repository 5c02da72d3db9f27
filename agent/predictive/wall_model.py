"""Predict whether a cell that a beam enters is free or a wall, from several contexts at once, for narrow media.

The plain code of scans has one context for this, the eight neighbors (`agent.predictive.contexts`). Buildings have
long straight walls, so walls in the same row or column help, too. The predictions are mixed (`agent.predictive.mixer`).
Every log begins with the same trained model.

A cell of the grid is a byte: its state in the low two bits, and flags of the caller, which the code does not read.
"""

from __future__ import annotations

from pathlib import Path

from agent.predictive.contexts import cell_state
from agent.predictive.mixer import MixingCoder, Model, code_mixed, new_model
from agent.predictive.model_table import shipped_model
from protocol.grid import FREE, OCCUPIED, Grid
from protocol.kernels import kernel

CONTEXTS = 1 << 14
"""Contexts of each input."""

FAR = 24
"""Cells up to which walls in the same row and column count."""

NEAR = 3
"""Cells up to which free cells and walls around a cell count, in rows and columns."""

_HASH = 40503
"""Odd multiplier that spreads the twelve cells around a cell over `CONTEXTS` contexts."""

TABLE = Path(__file__).with_name("wall_start.npz")
"""The shipped table: the initial model of every log, trained on generated maps (`deploy.study.wall_table`)."""


def no_model() -> Model:
    """Return an empty model, of streams that do not mix predictions."""
    return new_model(0, 0)


def start_model() -> Model:
    """Return a copy of the initial model of every log."""
    return shipped_model(TABLE, CONTEXTS, 1)


@kernel
def _nearest_wall(grid: Grid, x: int, y: int, dx: int, dy: int) -> tuple[int, int]:
    """Return the distance of the nearest wall in a direction, 0 if none is within `FAR`, and the walls within it."""
    nearest = walls = 0
    for distance in range(1, FAR + 1):
        if cell_state(grid, x + dx * distance, y + dy * distance) == OCCUPIED:
            walls += 1
            if nearest == 0:
                nearest = distance
    return nearest, walls


@kernel
def _magnitude(number: int) -> int:
    """Return the number of bits of a number, at most 4: 0, 1, 2 to 3, 4 to 7, 8 and above."""
    magnitude = 0
    for limit in (0, 1, 3, 7):
        magnitude += number > limit
    return magnitude


@kernel
def _rank(number: int) -> int:
    """Return a number of walls on a scale from 0 to 6, which is finer at its beginning."""
    rank = 0
    for limit in (0, 1, 2, 4, 8, 13):
        rank += number > limit
    return rank


@kernel
def code_wall(coder: MixingCoder, grid: Grid, x: int, y: int, wall: int) -> int:
    """Encode or decode whether cell (x, y) is a wall; return it."""
    west, north = cell_state(grid, x - 1, y), cell_state(grid, x, y - 1)
    east, south = cell_state(grid, x + 1, y), cell_state(grid, x, y + 1)
    north_west, north_east = cell_state(grid, x - 1, y - 1), cell_state(grid, x + 1, y - 1)
    south_west, south_east = cell_state(grid, x - 1, y + 1), cell_state(grid, x + 1, y + 1)
    behind = (
        (cell_state(grid, x + 2, y) * 3 + cell_state(grid, x, y + 2)) * 3 + cell_state(grid, x, y - 2)
    ) * 3
    behind += cell_state(grid, x - 2, y)
    around = (((north_west * 3 + north) * 3 + north_east) * 3 + west) * 3 + east
    around = ((around * 3 + south_west) * 3 + south) * 3 + south_east
    cross = ((south * 3 + north) * 3 + east) * 3 + west
    to_east, in_east = _nearest_wall(grid, x, y, 1, 0)
    to_west, in_west = _nearest_wall(grid, x, y, -1, 0)
    to_south, in_south = _nearest_wall(grid, x, y, 0, 1)
    to_north, in_north = _nearest_wall(grid, x, y, 0, -1)
    distances = (_magnitude(to_east) * 5 + _magnitude(to_west)) * 5 + _magnitude(to_south)
    free = walls = 0
    for row in range(y - NEAR, y + NEAR + 1):
        for column in range(x - NEAR, x + NEAR + 1):
            state = cell_state(grid, column, row)
            free += state == FREE
            walls += state == OCCUPIED
    contexts = coder[5]
    contexts[0, 0] = around
    contexts[0, 1] = (_rank(in_east + in_west) * 7 + _rank(in_south + in_north)) * 81 + cross
    contexts[0, 2] = (distances * 5 + _magnitude(to_north)) * 9 + east * 3 + west
    contexts[0, 3] = free // 3 * 18 + min(walls, 17)
    contexts[0, 4] = (around * 81 + behind) * _HASH >> 3 & CONTEXTS - 1
    contexts[0, 5] = behind * 81 + cross
    return int(code_mixed(coder, 0, wall))
