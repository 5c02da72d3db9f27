"""The planning grid of a noisy laser, without details that mislead strategies.

Between beams and beside walls, noise leaves gaps of unknown cells. They are no frontiers: a robot has nothing to enter
there. So an unknown cell counts only if it lies in a square of unknown cells as wide as the narrowest opening. Every
other one counts as a wall if a wall touches it, else as free. Likewise, noise opens walls: a free cell beside unknown
ones counts as a wall if it does not lie in a square of as many cells without walls. The unknown cells beside a frontier
of a single cell count as walls, too, and those beside one that a few beams of a coarse laser can make.

False walls can enclose a robot, which would then report that it has nothing left to explore. So the cells that it has
driven over count as free, unless it bumped into something there later. Poses have errors, so walls of teammates' maps
may lie where the robot stands. If it reaches no frontier, cells around it that its own scans show as free count as
free. Targets that a robot could not reach are drawn last (`agent.planning.avoided`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from agent.planning.avoided import AvoidedTargets
from agent.planning.frontier import frontier_cells
from agent.planning.path_planner import PathPlanner
from agent.planning.small_frontiers import close_beside
from protocol.arrays import NO_CELLS, Cells
from protocol.body import Body
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Mask
from protocol.kernels import kernel

LEAST_CELLS = 2
"""Cells of the shortest frontier that is worth exploring, at least."""

_UNKNOWN_SQUARE, _OPEN_SQUARE = 1, 2
"""Marks of cells in squares of unknown cells, and of cells without walls."""

_NO_STATE = 255
"""Differs from all states of cells."""

FEW_BEAMS = 3
"""Neighboring beams that may end behind a wall by errors; at the end of the range, they are some cells apart."""

LONGEST_SPECK = 5
"""Most cells of the shortest frontier that is worth exploring, whatever the laser."""


class NoisyGrid:
    """The planning grid of one robot as its strategy sees it; all grids are uint8 arrays of shape (h, w).

    `narrow` is the width of the narrowest opening (`protocol.body.narrowest_opening`), `shortest` the number of cells
    of the shortest frontier (`shortest_frontier`), `radius_cells` the radius of the robot.
    """

    def __init__(
        self, height: int, width: int, narrow: int, shortest: int = 1, radius_cells: float = 0.0
    ) -> None:
        self.avoided = AvoidedTargets(2 * narrow, narrow / 2)
        """Targets that the robot could not reach."""
        self._narrow, self._shortest, self._radius = narrow, shortest, radius_cells
        self._trail = np.zeros((height, width), np.bool_)
        """The cells that the robot has driven over."""
        self._marks: Grid = np.zeros((height, width), np.uint8)
        self._planning: Grid = np.full((height, width), _NO_STATE, np.uint8)
        """The planning grid of the last call of `clean`."""
        self._wide: Grid = np.empty((height, width), np.uint8)
        """The same without narrow gaps and openings."""
        self._here: Cell | None = None

    def drive(self, x: int, y: int) -> None:
        """Note that the robot has driven straight to cell (x, y)."""
        column, row = self._here or (x, y)
        self._trail[row, column] = True
        while (column, row) != (x, y):
            if abs(x - column) >= abs(y - row):
                column += 1 if x > column else -1
            else:
                row += 1 if y > row else -1
            self._trail[row, column] = True
        self._here = x, y

    def bump(self, x: int, y: int) -> None:
        """Note that the robot has bumped into something in cell (x, y)."""
        if (x, y) != self._here and 0 <= y < len(self._trail) and 0 <= x < self._trail.shape[1]:
            self._trail[y, x] = False

    def explorable(self, planning: Grid, own: Grid) -> Grid:
        """Return the grid on which the strategy decides in this step; `own` is the self-explored grid.

        It is the cleaned planning grid. Walls of teammates' maps around the robot are free in it if `own` has these
        cells as free, the robot reaches no frontier otherwise, and it reaches one then.
        """
        found = self.clean(planning)
        doubtful = self._doubtful_walls(planning, own)
        if doubtful.any() and not self._reaches_frontier(found):
            opened = self._without_avoided(self.clean_optimistic(planning, doubtful))
            found = opened if self._reaches_frontier(opened) else found
        self.avoided.pass_step()
        return found

    def clean(self, planning: Grid) -> Grid:
        """Return a copy of a planning grid without misleading details."""
        self._update(planning)
        return self._without_avoided(self._without_specks(self._wide.copy()))

    def clean_optimistic(self, planning: Grid, doubtful: Mask) -> Grid:
        """Return the same as if all doubtful walls, shape (h, w), were free; no target is avoided."""
        optimistic, found = np.where(doubtful, np.uint8(FREE), planning), np.empty_like(planning)
        _without_gaps(optimistic, self._narrow, self._marks, found)
        return self._without_specks(found)

    def _update(self, planning: Grid) -> None:
        """Bring `_wide` up to date, in the rows that have changed and those near by."""
        rows = np.flatnonzero((planning != self._planning).any(axis=1))
        if not len(rows):
            return
        height, near = len(planning), self._narrow
        first, end = max(0, int(rows[0]) - near), min(height, int(rows[-1]) + 1 + near)
        top, bottom = max(0, first - near), min(height, end + near)
        found = np.empty_like(planning[top:bottom])
        _without_gaps(planning[top:bottom], near, self._marks[top:bottom], found)
        self._wide[first:end] = found[first - top : end - top]
        self._planning[first:end] = planning[first:end]

    def _without_specks(self, grid: Grid) -> Grid:
        """Open the robot's trail, and close frontiers that are too short; return the grid itself."""
        np.copyto(grid, np.uint8(FREE), where=self._trail)
        if self._shortest > 1:
            _close_specks(grid, frontier_cells(grid, grid == FREE), self._shortest, self._marks)
        return grid

    def _without_avoided(self, grid: Grid) -> Grid:
        """Draw the avoided targets; return the grid itself."""
        if self._here is not None:
            self.avoided.draw(grid, self._here)
        return grid

    def _doubtful_walls(self, planning: Grid, own: Grid) -> Mask:
        """Return the walls of teammates' maps near the robot that its own map has as free, shape (h, w)."""
        doubtful = np.zeros(planning.shape, np.bool_)
        if self._here is not None:
            rows, columns = (
                slice(max(0, at - self._narrow), at + self._narrow + 1) for at in self._here[::-1]
            )
            near, seen = planning[rows, columns], own[rows, columns]
            doubtful[rows, columns] = (near == OCCUPIED) & (seen == FREE)
        return doubtful

    def _reaches_frontier(self, grid: Grid) -> bool:
        """Return whether the robot reaches a frontier cell on a cleaned grid."""
        planner = PathPlanner(grid, radius_cells=self._radius)
        return self._here is not None and planner.first_frontier(*self._here, NO_CELLS, 0.0) is not None


def shortest_frontier(bodies: Iterable[Body]) -> int:
    """Return the number of cells of the shortest frontier worth exploring: one that `FEW_BEAMS` beams do not make.

    Planning grids contain the scans of the whole team, so the coarsest laser of all robots counts.
    """
    longest = max(FEW_BEAMS * (body.laser.spacing_rad * body.range_cells) for body in bodies if body.laser)
    return max(LEAST_CELLS, min(math.ceil(longest), LONGEST_SPECK))


@kernel
def _mark_squares(grid: Grid, narrow: int, walls: bool, marks: Grid, mark: int) -> None:
    """Mark the cells of all squares of `narrow` by `narrow` cells without walls, or of unknown cells only."""
    height, width = grid.shape
    above = np.zeros(width, np.int32)  # cells of each column, up to this row, that fit into a square
    for y in range(height):  # marks the lowest row of each square
        run = 0
        for x in range(width):
            fits = grid[y, x] != OCCUPIED if walls else grid[y, x] == UNKNOWN
            above[x] = above[x] + 1 if fits else 0
            run = run + 1 if above[x] >= narrow else 0
            if run == narrow:
                for left in range(x - narrow + 1, x + 1):
                    marks[y, left] |= mark
            elif run > narrow:
                marks[y, x] |= mark
    left_to_mark = np.zeros(width, np.int32)
    for y in range(height - 1, -1, -1):
        for x in range(width):
            if marks[y, x] & mark:
                left_to_mark[x] = narrow
            if left_to_mark[x]:
                left_to_mark[x] -= 1
                marks[y, x] |= mark


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
def _close_specks(grid: Grid, frontier: Cells, shortest: int, marks: Grid) -> None:
    """Turn unknown cells beside frontier cells into walls unless there are `shortest` such cells near by.

    Near by are cells with a distance below `shortest`, the frontier cell itself included. `frontier`: all frontier
    cells of the grid. `marks` is a buffer.
    """
    height, width = grid.shape
    marks[:] = 0
    for x, y in frontier:
        marks[y, x] = 1
    for x, y in frontier:
        count = 0
        for row in range(max(0, y - shortest + 1), min(height, y + shortest)):
            for column in range(max(0, x - shortest + 1), min(width, x + shortest)):
                count += marks[row, column]
        if count < shortest:
            close_beside(grid, x, y)
