"""The bounded error of a copy: change as few cells of it as the tolerance allows.

The *copy* is the grid that receivers hold of the robot's own grid. A cell is *settled* if the robot is certain of its
state: its log odds have at least a given absolute value. Distances are Chebyshev distances in cells. After an update

1. every settled wall has a wall of the copy within the tolerance,
2. every wall of the copy on a cell that is settled as free has a wall of the own grid within the tolerance,
3. every settled free cell is free in the copy, or a wall of the copy lies within the tolerance,
4. every known wall is known in the copy. So is every free cell beside a wall, and every cell whose surroundings are
   mostly free, unless a wall of the copy lies within the tolerance,
5. no cell of the copy is free beside an unknown one if the robot has found a wall within the tolerance, settled or not,
   except where the robot has seen the cell free.

The last two conditions save teammates useless ways: the fourth completes areas that the robot has seen once from afar,
the fifth closes gaps that scans of other robots have left in walls. Single beams into unknown areas are not sent.

For copies at half resolution (`agent.mapping.block_bound`), conditions 4 and 5 are weaker: a wall need not be known if
a wall of the copy lies directly before or behind it, and a free cell is exempt if the robot has seen a cell of its
block free.

With tolerance 0, every known cell of the own grid is equal in the copy, settled or not.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agent.mapping.blocks import BLOCK, is_covered
from agent.mapping.estimator import Int8Grid
from protocol.arrays import Int64s
from protocol.boxes import Box
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

TILE = 8
"""Side of a tile in cells."""

MOSTLY = 6
"""Free cells, of a cell and its eight neighbors, from which it counts as free although it is not settled."""

_REMOVE, _WALLS, _FREE, _FILL, _CLOSE = range(5)
"""Phases, in this order: remove walls that the robot has not found (2), add walls (1), add free cells (3), also those
that have lost their wall, fill incomplete (4) and changed tiles, close gaps (5). A removed wall is never the only copy
of a settled wall, because it has no wall of the robot's own grid within the tolerance."""


TileMask = NDArray[np.bool_]
"""A flag for each tile of a grid, shape (tile rows, tile columns)."""


def tiles_of(height: int, width: int) -> tuple[int, int]:
    """Return the numbers of tile rows and columns that cover a grid."""
    return -(-height // TILE), -(-width // TILE)


@dataclass(frozen=True)
class Bound:
    """The error that a copy of this robot's grid may have."""

    tolerance: int
    """Cells between a wall and its copy at most."""
    settled: int
    """Absolute log odds from which a cell is settled."""
    closes_gaps: bool = True
    """Whether the fifth condition counts; it serves robots that plan with the maps of others."""
    blocks: bool = field(default=False, init=False)
    """Whether copies have half resolution (`agent.mapping.block_bound`)."""

    def tiles_near(self, box: Box) -> tuple[slice, slice]:
        """Return the rows and columns of tiles in which changes of the cells in a box may violate the bound.

        A change may remove a wall on which a cell relied, and a wall within the tolerance of that cell.
        """
        x0, y0, x1, y1 = box
        reach = 2 * self.tolerance
        rows = slice(max(0, y0 - reach) // TILE, (y1 + reach - 1) // TILE + 1)
        return rows, slice(max(0, x0 - reach) // TILE, (x1 + reach - 1) // TILE + 1)

    def apply(
        self, own: Grid, log_odds: Int8Grid, held: Grid, tiles: Grid, target: Grid, changed: Grid
    ) -> int:
        """Compute the states that receivers shall hold, in the marked tiles; return the number of tiles that change.

        `own` and `log_odds`, shape (h, w), are states and log odds of the robot's estimator. `held` is the grid that
        receivers hold, with states in the low two bits. `tiles`, uint8 of shape (tile rows, tile columns), are marks of
        the tiles that may change, and whose cells then fulfill the bound. Results are `target`, shape (h, w), the
        states of all cells in and around the marked tiles, and `changed`, 1 for tiles in which they differ from the
        held ones.
        """
        estimate = own, log_odds, self.settled if self.tolerance else 0
        last = _CLOSE if self.closes_gaps else _FILL
        return int(_apply(estimate, held, tiles, (self.tolerance, self.blocks), last, target, changed))


Estimate = tuple[Grid, Int8Grid, int]
"""States and log odds of the robot's estimator, and the absolute log odds from which a cell is settled."""

_Rules = tuple[int, bool]
"""`Bound.tolerance` and `Bound.blocks`."""


@kernel
def has_wall(grid: Grid, x: int, y: int, tolerance: int) -> bool:
    """Whether there is a wall within the tolerance of a cell."""
    for row in range(max(0, y - tolerance), min(grid.shape[0], y + tolerance + 1)):
        for column in range(max(0, x - tolerance), min(grid.shape[1], x + tolerance + 1)):
            if grid[row, column] & 3 == OCCUPIED:
                return True
    return False


@kernel
def tile_box(box: Int64s, grid: Grid, tile_x: int, tile_y: int) -> None:
    """Write the first column and row of a tile, and those behind the last ones."""
    box[0], box[1] = tile_x * TILE, tile_y * TILE
    box[2], box[3] = min(box[0] + TILE, grid.shape[1]), min(box[1] + TILE, grid.shape[0])


@kernel
def shared_state(estimate: Estimate, x: int, y: int) -> int:
    """Return the state that receivers shall hold of a cell that they do not know.

    A cell that is neither settled nor beside a wall is free if most cells around it are free, else unknown.
    """
    own, log_odds, settled = estimate
    state = int(own[y, x])
    if state == OCCUPIED or abs(np.int64(log_odds[y, x])) >= settled:
        return state
    free = 0
    for row in range(max(0, y - 1), min(own.shape[0], y + 2)):
        for column in range(max(0, x - 1), min(own.shape[1], x + 2)):
            if own[row, column] == OCCUPIED:
                return state
            free += own[row, column] == FREE
    return FREE if free >= MOSTLY else UNKNOWN


@kernel
def _is_complete(estimate: Estimate, held: Grid, box: Int64s, rules: _Rules) -> bool:
    """Whether receivers hold all cells of a tile that they shall know, or a wall beside them."""
    tolerance, blocks = rules
    for y in range(box[1], box[3]):
        for x in range(box[0], box[2]):
            if held[y, x] == UNKNOWN:
                state = shared_state(estimate, x, y)
                if blocks and state == OCCUPIED and is_covered(estimate[0], held, x, y):
                    continue
                if state == OCCUPIED or (state == FREE and not has_wall(held, x, y, tolerance)):
                    return False
    return True


@kernel
def _must_change(phase: int, own: Grid, held: Grid, x: int, y: int, tolerance: int) -> bool:
    """Whether a cell whose own state is known, and differs from the held one, must take the own state in a phase."""
    state = own[y, x]
    if phase == _REMOVE:
        return bool(state == FREE and held[y, x] == OCCUPIED and not has_wall(own, x, y, tolerance))
    if phase == _WALLS:
        return bool(state == OCCUPIED and not has_wall(held, x, y, tolerance))
    return bool(state == FREE and held[y, x] == UNKNOWN and not has_wall(held, x, y, tolerance))


@kernel
def borders_unknown(own: Grid, held: Grid, x: int, y: int) -> bool:
    """Whether neither receivers nor the robot know a 4-neighbor of a cell."""
    height, width = own.shape
    for row, column in ((y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)):
        if 0 <= row < height and 0 <= column < width and held[row, column] == UNKNOWN == own[row, column]:
            return True
    return False


@kernel
def _knows_free(own: Grid, x: int, y: int) -> bool:
    """Whether the robot has seen a cell of the same block free."""
    top, left = y - y % BLOCK, x - x % BLOCK
    return bool((own[top : top + BLOCK, left : left + BLOCK] == FREE).any())


@kernel
def _close_frontier(own: Grid, target: Grid, box: Int64s, rules: _Rules) -> bool:
    """Turn the cells of a tile that violate the fifth condition into walls; return whether there are any."""
    tolerance, blocks = rules
    closed = False
    for y in range(box[1], box[3]):
        for x in range(box[0], box[2]):
            is_open = target[y, x] == FREE != own[y, x] and has_wall(own, x, y, tolerance)
            if is_open and blocks and _knows_free(own, x, y):
                continue
            if is_open and borders_unknown(own, target, x, y):
                target[y, x] = OCCUPIED
                closed = True
    return closed


@kernel
def _change_tile(
    phase: int, estimate: Estimate, target: Grid, box: Int64s, rules: _Rules, was_changed: bool
) -> bool:
    """Change the cells of a tile in a phase; return whether any has changed, now or before."""
    own, log_odds, settled = estimate
    if phase == _FILL:
        if not was_changed and _is_complete(estimate, target, box, rules):
            return False
        for y in range(box[1], box[3]):
            for x in range(box[0], box[2]):
                if target[y, x] == UNKNOWN:
                    target[y, x] = shared_state(estimate, x, y)
        return True
    if phase == _CLOSE:
        return _close_frontier(own, target, box, rules) or was_changed
    changed = was_changed
    for y in range(box[1], box[3]):
        for x in range(box[0], box[2]):
            if own[y, x] == UNKNOWN or own[y, x] == target[y, x]:
                continue
            if abs(np.int64(log_odds[y, x])) >= settled and _must_change(phase, own, target, x, y, rules[0]):
                target[y, x] = own[y, x]
                changed = True
    return changed


@kernel
def _apply(
    estimate: Estimate, held: Grid, tiles: Grid, rules: _Rules, last: int, target: Grid, changed: Grid
) -> int:
    height, width = held.shape
    tolerance = rules[0]
    changed[:] = 0
    top, left, bottom, right = tiles.shape[0], tiles.shape[1], -1, -1
    for tile_y in range(tiles.shape[0]):
        for tile_x in range(tiles.shape[1]):
            if tiles[tile_y, tile_x]:
                top, left = min(top, tile_y), min(left, tile_x)
                bottom, right = max(bottom, tile_y), max(right, tile_x)
    for y in range(max(0, top * TILE - tolerance), min(height, (bottom + 1) * TILE + tolerance)):
        for x in range(max(0, left * TILE - tolerance), min(width, (right + 1) * TILE + tolerance)):
            target[y, x] = held[y, x] & 3
    count = 0
    box = np.empty(4, np.int64)
    for phase in range(last + 1):
        for tile_y in range(top, bottom + 1):
            for tile_x in range(left, right + 1):
                if not tiles[tile_y, tile_x]:
                    continue
                tile_box(box, held, tile_x, tile_y)
                before = changed[tile_y, tile_x] > 0
                after = _change_tile(phase, estimate, target, box, rules, before)
                changed[tile_y, tile_x] = after
                count += after and not before
    return count
