"""The planning grid of a noisy laser, without details that mislead strategies.

Between beams and beside walls, noise leaves gaps of unknown cells. They are no frontiers: a robot has nothing to enter
there. So an unknown cell counts only if it lies in a square of unknown cells as wide as the narrowest opening. Every
other one counts as a wall if a wall touches it, else as free. Likewise, noise opens walls: a free cell beside unknown
ones counts as a wall if it does not lie in a square of as many cells without walls. The unknown cells beside a frontier
of a single cell count as walls, too, and those beside one that a few beams of a coarse laser can make.

False walls can enclose a robot, which would then report that it has nothing left to explore. So the cells that it has
driven over count as free, unless it bumped into something there later. Targets that a robot could not reach are drawn
last (`agent.planning.avoided`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agent.planning.avoided import AvoidedTargets
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel
from protocol.range_scans import TURN, Laser

LEAST_CELLS = 2
"""Cells of the shortest frontier that is worth exploring, at least."""

_UNKNOWN_SQUARE, _OPEN_SQUARE = 1, 2
"""Marks of cells in squares of unknown cells, and of cells without walls."""

FEW_BEAMS = 3
"""Neighboring beams that may end behind a wall by errors; at the end of the range, they are some cells apart."""

LONGEST_SPECK = 5
"""Most cells of the shortest frontier that is worth exploring, whatever the laser."""


class NoisyGrid:
    """The planning grid of one robot as its strategy sees it; all grids are uint8 arrays of shape (h, w).

    `narrow` is the width of the narrowest opening (`protocol.body.narrowest_opening`), `shortest` the number of cells
    of the shortest frontier (`shortest_frontier`).
    """

    def __init__(self, height: int, width: int, narrow: int, shortest: int = 1) -> None:
        self.avoided = AvoidedTargets(2 * narrow, narrow / 2)
        """Targets that the robot could not reach."""
        self._narrow, self._shortest = narrow, shortest
        self._trail: Grid = np.zeros((height, width), np.uint8)
        self._marks: Grid = np.zeros((height, width), np.uint8)
        self._here: tuple[int, int] | None = None

    def drive(self, x: int, y: int) -> None:
        """Note that the robot has driven straight to cell (x, y)."""
        column, row = self._here or (x, y)
        self._trail[row, column] = 1
        while (column, row) != (x, y):
            if abs(x - column) >= abs(y - row):
                column += 1 if x > column else -1
            else:
                row += 1 if y > row else -1
            self._trail[row, column] = 1
        self._here = x, y

    def bump(self, x: int, y: int) -> None:
        """Note that the robot has bumped into something in cell (x, y)."""
        if (x, y) != self._here and 0 <= y < len(self._trail) and 0 <= x < self._trail.shape[1]:
            self._trail[y, x] = 0

    def clean(self, planning: Grid) -> Grid:
        """Return a copy of a planning grid without misleading details."""
        found = self._clean(planning)
        if self._here is not None:
            self.avoided.draw(found, self._here)
        return found

    def clean_optimistic(self, planning: Grid, doubtful: NDArray[np.bool_]) -> Grid:
        """Return the same as if all doubtful walls, shape (h, w), were free; no target is avoided."""
        return self._clean(np.where(doubtful, np.uint8(FREE), planning))

    def _clean(self, planning: Grid) -> Grid:
        found = np.empty_like(planning)
        _without_gaps(planning, self._narrow, self._marks, found)
        found[self._trail != 0] = FREE
        if self._shortest > 1:
            _close_specks(found, self._shortest, self._marks)
        return found


def shortest_frontier(laser: Laser, range_cells: float) -> int:
    """Return the number of cells of the shortest frontier worth exploring: one that `FEW_BEAMS` beams do not make."""
    apart = 2 * math.pi * laser.span / TURN / max(laser.beams - 1, 1)
    return max(LEAST_CELLS, min(math.ceil(FEW_BEAMS * apart * range_cells), LONGEST_SPECK))


@kernel
def _mark_squares(grid: Grid, narrow: int, walls: bool, marks: Grid, mark: int) -> None:
    """Mark the cells of all squares of `narrow` by `narrow` cells without walls, or of unknown cells only."""
    height, width = grid.shape
    for y in range(height - narrow + 1):
        run = 0
        for x in range(width):
            column = 0
            while column < narrow and (
                grid[y + column, x] != OCCUPIED if walls else grid[y + column, x] == UNKNOWN
            ):
                column += 1
            run = run + 1 if column == narrow else 0
            if run >= narrow:
                for row in range(y, y + narrow):
                    for left in range(x - narrow + 1, x + 1):
                        marks[row, left] |= mark


@kernel
def _touches(grid: Grid, state: int, x: int, y: int) -> bool:
    """Whether a cell or one of its eight neighbors has a state."""
    for row in range(max(0, y - 1), min(grid.shape[0], y + 2)):
        for column in range(max(0, x - 1), min(grid.shape[1], x + 2)):
            if grid[row, column] == state:
                return True
    return False


@kernel
def _without_gaps(grid: Grid, narrow: int, marks: Grid, out: Grid) -> None:
    """Write a planning grid without narrow gaps and openings to `out`; `marks` is a buffer of the same shape."""
    marks[:] = 0
    _mark_squares(grid, narrow, False, marks, _UNKNOWN_SQUARE)
    _mark_squares(grid, narrow, True, marks, _OPEN_SQUARE)
    for y in range(grid.shape[0]):
        for x in range(grid.shape[1]):
            state, mark = grid[y, x], marks[y, x]
            out[y, x] = state
            if state == UNKNOWN and not mark & _UNKNOWN_SQUARE:
                out[y, x] = OCCUPIED if _touches(grid, OCCUPIED, x, y) else FREE
            elif state == FREE and not mark & _OPEN_SQUARE and _touches(grid, UNKNOWN, x, y):
                out[y, x] = OCCUPIED


@kernel
def _is_frontier(grid: Grid, x: int, y: int) -> bool:
    """Whether a cell is free and has an unknown 4-neighbor."""
    height, width = grid.shape
    return bool(grid[y, x] == FREE) and bool(
        (x > 0 and grid[y, x - 1] == UNKNOWN)
        or (x + 1 < width and grid[y, x + 1] == UNKNOWN)
        or (y > 0 and grid[y - 1, x] == UNKNOWN)
        or (y + 1 < height and grid[y + 1, x] == UNKNOWN)
    )


@kernel
def _close_specks(grid: Grid, shortest: int, marks: Grid) -> None:
    """Turn unknown cells beside frontier cells into walls unless there are `shortest` such cells near by.

    Near by are cells with a distance below `shortest`, the frontier cell itself included. `marks` is a buffer.
    """
    height, width = grid.shape
    for y in range(height):
        for x in range(width):
            marks[y, x] = _is_frontier(grid, x, y)
    for y in range(height):
        for x in range(width):
            if not marks[y, x]:
                continue
            count = 0
            for row in range(max(0, y - shortest + 1), min(height, y + shortest)):
                for column in range(max(0, x - shortest + 1), min(width, x + shortest)):
                    count += marks[row, column]
            if count < shortest:
                _close_beside(grid, x, y)


@kernel
def _close_beside(grid: Grid, x: int, y: int) -> None:
    """Turn the unknown 4-neighbors of a cell into walls."""
    for row, column in ((y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)):
        if 0 <= row < grid.shape[0] and 0 <= column < grid.shape[1] and grid[row, column] == UNKNOWN:
            grid[row, column] = OCCUPIED
