"""The route of a robot: followed cell by cell, straightened, or converted to waypoints."""

from __future__ import annotations

from itertools import zip_longest

import numpy as np

from agent.planning.path_planner import PathPlanner
from protocol.arrays import NO_CELLS, Cells
from protocol.grid import FINE, FREE, Cell, Grid, Point, cell_of
from protocol.kernels import kernel


class Route:
    """The remaining way of a robot."""

    def __init__(self) -> None:
        self.cells: Cells = NO_CELLS
        """The cells of the way, without the robot's own cell: int32 array, shape (n, 2)."""

    def plan(self, planner: PathPlanner, start: Cell, end: Cell) -> bool:
        """Plan a best way from `start` to `end`; return whether there is one. Without one, the route is empty."""
        found = planner.path(start, end)
        self.cells = NO_CELLS if found is None else found
        return found is not None

    def clear(self) -> None:
        """Make the route empty."""
        self.cells = NO_CELLS

    def advance_to(self, x: int, y: int) -> None:
        """Drop the cells up to (x, y), the robot's cell."""
        done = _cells_up_to(self.cells, x, y)
        if done:
            self.cells = self.cells[done:]

    def is_open(self, floor: Grid, start: Cell) -> bool:
        """Return whether the remaining cells from `start` on are free on `floor`, and both beside each diagonal."""
        return bool(_is_open(floor, *start, self.cells))


@kernel
def _cells_up_to(cells: Cells, x: int, y: int) -> int:
    """Return the number of cells up to and including (x, y); 0 if the cell is not on the way."""
    for at in range(len(cells) - 1, -1, -1):
        if cells[at, 0] == x and cells[at, 1] == y:
            return at + 1
    return 0


@kernel
def _is_open(floor: Grid, x: int, y: int, cells: Cells) -> bool:
    for at in range(len(cells)):
        next_x, next_y = cells[at, 0], cells[at, 1]
        if floor[next_y, next_x] != FREE:
            return False
        if next_x != x and next_y != y and (floor[y, next_x] != FREE or floor[next_y, x] != FREE):
            return False
        x, y = next_x, next_y
    return True


def straighten(floor: Grid, start: Cell, cells: Cells) -> Cells:
    """Straighten a way by ray shooting: from each corner straight to the farthest visible cell of the way.

    A cell is visible if a straight, 8-connected line of free cells leads to it, and the cells beside its diagonal steps
    are free. So the new way is no longer than the old one. Both lack the start.
    """
    if not len(cells):
        return cells
    points = np.concatenate([np.array([start], np.int32), cells])
    out = np.empty((3 * len(points), 2), np.int32)
    return out[: _shoot(floor, points, out)].copy()


@kernel
def is_line_free(floor: Grid, x: int, y: int, to_x: int, to_y: int) -> bool:
    """Return whether a straight, 8-connected line of free cells joins two cells, as in `straighten`."""
    dx, dy = abs(to_x - x), abs(to_y - y)
    step_x = 1 if to_x > x else -1
    step_y = 1 if to_y > y else -1
    error = dx - dy
    while x != to_x or y != to_y:
        double = 2 * error
        next_x, next_y = x, y
        if double > -dy:
            error -= dy
            next_x += step_x
        if double < dx:
            error += dx
            next_y += step_y
        if floor[next_y, next_x] != FREE or floor[y, next_x] != FREE or floor[next_y, x] != FREE:
            return False
        x, y = next_x, next_y
    return True


def corners(floor: Grid, start: Point, cells: Cells) -> Cells:
    """Return the waypoints of a way that may leave the centers of cells: its bends and its end.

    `start` and the result, shape (m, 2), are in thousandths of a cell. The first of `cells` is a neighbor of the
    robot's cell. If no straight line leads to it, the center of the robot's own cell comes first.
    """
    points = [(x * FINE, y * FINE) for x, y in cells.tolist()]
    found: list[Point] = []
    at = start
    if points and not _is_line_clear(floor, *at, *points[0]):
        x, y = cell_of(at)
        at = x * FINE, y * FINE
        found.append(at)
    for point, ahead in zip_longest(points, points[1:]):
        if ahead is None or not _is_line_clear(floor, *at, *ahead):
            at = point
            found.append(at)
    return np.array(found, np.int32).reshape(-1, 2)


def crossed(start: Point, points: Cells, most: float) -> Cells:
    """Return the cells that the lines from point to point cross, in order: int32 array, shape (m, 2).

    Lines that begin after more than `most` cells are left out. `start` and `points`, shape (n, 2), are in thousandths
    of a cell.
    """
    found: list[Cell] = []
    at, last = start, cell_of(start)
    for x, y in points.tolist():
        pieces = max(1, max(abs(x - at[0]), abs(y - at[1])) // (FINE // 10))
        for piece in range(1, pieces + 1):
            cell = cell_of((at[0] + (x - at[0]) * piece // pieces, at[1] + (y - at[1]) * piece // pieces))
            if cell != last:
                found.append(cell)
                last = cell
        at = x, y
        if len(found) > most:
            break
    return np.array(found, np.int32).reshape(-1, 2)


@kernel
def _is_line_clear(floor: Grid, x: int, y: int, to_x: int, to_y: int) -> bool:
    """Return whether a line, in thousandths of a cell, touches free cells alone; checked every tenth of a cell."""
    half = FINE // 2
    pieces = max(1, max(abs(to_x - x), abs(to_y - y)) // (FINE // 10))
    cell_x, cell_y = (x + half) // FINE, (y + half) // FINE
    for piece in range(1, pieces + 1):
        next_x = (x + (to_x - x) * piece // pieces + half) // FINE
        next_y = (y + (to_y - y) * piece // pieces + half) // FINE
        if next_x != cell_x or next_y != cell_y:
            is_free = floor[next_y, next_x] == floor[cell_y, next_x] == floor[next_y, cell_x] == FREE
            if not is_free:
                return False
            cell_x, cell_y = next_x, next_y
    return True


@kernel
def _shoot(floor: Grid, points: Cells, out: Cells) -> int:
    length = 0
    corner = 0
    while corner < len(points) - 1:
        seen = corner + 1
        while seen + 1 < len(points) and is_line_free(
            floor, points[corner, 0], points[corner, 1], points[seen + 1, 0], points[seen + 1, 1]
        ):
            seen += 1
        x, y = points[corner]
        to_x, to_y = points[seen]
        dx, dy = abs(to_x - x), abs(to_y - y)
        step_x = 1 if to_x > x else -1
        step_y = 1 if to_y > y else -1
        error = dx - dy
        while x != to_x or y != to_y:
            double = 2 * error
            if double > -dy:
                error -= dy
                x += step_x
            if double < dx:
                error += dx
                y += step_y
            out[length, 0], out[length, 1] = x, y
            length += 1
        corner = seen
    return length
