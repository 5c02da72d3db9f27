"""The way that a robot is on: followed cell by cell, led around teammates that stand on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.planning.ways import Ways
from protocol.chance import chance
from protocol.grid import FREE, Grid
from protocol.kernels import kernel

_FINE = 1000
"""Way points count in thousandths of a cell."""

_NOWHERE = np.empty((0, 2), np.int32)

MEMORY = 20
"""Steps for which a robot keeps away from a cell that it could not enter for a teammate."""


class Route:
    """Cells still to be driven, and those that teammates lately held."""

    def __init__(self) -> None:
        self.cells: NDArray[np.int32] = _NOWHERE
        self._held: dict[tuple[int, int], int] = {}

    def lead(self, ways: Ways, start: tuple[int, int], end: tuple[int, int]) -> bool:
        """Take a best way from `start` to `end`; whether there is one. Without one, the way is empty."""
        found = ways.way(start, end)
        self.cells = _NOWHERE if found is None else found
        return found is not None

    def clear(self) -> None:
        """Stay."""
        self.cells = _NOWHERE

    def drive_to(self, x: int, y: int) -> None:
        """The robot is at (x, y) now: drop the cells up to there."""
        at = np.flatnonzero((self.cells == (x, y)).all(axis=1))
        if len(at):
            self.cells = self.cells[at[-1] + 1 :]

    def is_open(self, floor: Grid) -> bool:
        """Whether all cells still to be driven are free on `floor`."""
        return bool((floor[self.cells[:, 1], self.cells[:, 0]] == FREE).all())

    def next_cells(self, count: int) -> NDArray[np.int32]:
        """The next cells to enter, shape (at most `count`, 2)."""
        return self.cells[:count]

    def detour(
        self,
        ways: Ways,
        start: tuple[int, int],
        end: tuple[int, int],
        reach: float,
        key: tuple[int, int, int],
    ) -> None:
        """Lead around the cell in front, which a teammate holds, and around those lately found held.

        Without the memory a robot between two teammates would turn from one to the other for good. Where no
        other way leads to `end`, or it is much longer, lead to a random cell at most `reach` cells away
        instead; `key` (seed, robot, step) decides which.
        """
        if not len(self.cells):
            return
        step = key[2]
        self._held = {cell: since for cell, since in self._held.items() if step - since < MEMORY}
        self._held[int(self.cells[0][0]), int(self.cells[0][1])] = step
        around = ways
        for x, y in self._held:
            if (x, y) != start:
                around = around.without(x, y)
        field = around.costs(*start)
        if field[end[1], end[0]] < len(self.cells) + reach:
            self.lead(around, start, end)
            return
        ys, xs = np.nonzero(field <= reach)
        pick = int(chance(key[0], "step aside", *key[1:]).integers(len(xs)))
        self.lead(around, start, (int(xs[pick]), int(ys[pick])))


def straighten(floor: Grid, start: tuple[int, int], cells: NDArray[np.int32]) -> NDArray[np.int32]:
    """Simplify a way by ray shooting: from each corner straight to the farthest cell that is seen.

    What is seen is what a straight line of cells leads to, 8-connected and over free cells, with those beside
    its diagonal steps free as well; so the new way is no longer than the old one.

    Parameters
    ----------
    floor : uint8 array, shape (h, w)
        Where the robot may drive.
    start : (x, y)
        Where the way begins.
    cells : int32 array, shape (n, 2)
        The cells of the way behind its start.
    """
    if not len(cells):
        return cells
    points = np.concatenate([np.array([start], np.int32), cells])
    out = np.empty((3 * len(points), 2), np.int32)
    return out[: _shoot(floor, points, out)].copy()


@kernel("boolean(uint8[:,::1], int64, int64, int64, int64)")
def _is_clear(floor: Grid, x: int, y: int, to_x: int, to_y: int) -> bool:
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


def corners(floor: Grid, start: tuple[int, int], cells: NDArray[np.int32]) -> NDArray[np.int32]:
    """Way points for a way that need not keep to cells' centres: where it bends, and its end.

    Parameters
    ----------
    floor : uint8 array, shape (h, w)
        Where the robot may be.
    start : (x, y)
        Where it is, in thousandths of a cell.
    cells : int32 array, shape (n, 2)
        The cells of the way, a neighbour of the robot's cell first.

    Returns
    -------
    int32 array, shape (m, 2)
        In thousandths of a cell. Where the first cell cannot be reached on a straight line, the centre of the
        robot's own comes first.
    """
    points = cells * _FINE
    found: list[NDArray[np.int32]] = []
    at = np.array(start, np.int32)
    if len(points) and not _is_line_clear(floor, *map(int, at), *map(int, points[0])):
        at = (at + _FINE // 2) // _FINE * _FINE
        found.append(at)
    next_one = 0
    while next_one < len(points):
        while next_one + 1 < len(points) and _is_line_clear(
            floor, *map(int, at), *map(int, points[next_one + 1])
        ):
            next_one += 1
        at = points[next_one]
        found.append(at)
        next_one += 1
    return np.array(found, np.int32).reshape(-1, 2)


@kernel("boolean(uint8[:,::1], int64, int64, int64, int64)")
def _is_line_clear(floor: Grid, x: int, y: int, to_x: int, to_y: int) -> bool:
    """Whether all cells that a line touches are free, looked at every tenth of a cell; in thousandths."""
    half = _FINE // 2
    pieces = max(1, max(abs(to_x - x), abs(to_y - y)) // (_FINE // 10))
    cell_x, cell_y = (x + half) // _FINE, (y + half) // _FINE
    for piece in range(1, pieces + 1):
        next_x = (x + (to_x - x) * piece // pieces + half) // _FINE
        next_y = (y + (to_y - y) * piece // pieces + half) // _FINE
        if next_x != cell_x or next_y != cell_y:
            if (
                floor[next_y, next_x] != FREE
                or floor[cell_y, next_x] != FREE
                or floor[next_y, cell_x] != FREE
            ):
                return False
            cell_x, cell_y = next_x, next_y
    return True


@kernel("int64(uint8[:,::1], int32[:,::1], int32[:,::1])")
def _shoot(floor: Grid, points: NDArray[np.int32], out: NDArray[np.int32]) -> int:
    length = 0
    corner = 0
    while corner < len(points) - 1:
        seen = corner + 1
        while seen + 1 < len(points) and _is_clear(
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
            out[length, 0] = x
            out[length, 1] = y
            length += 1
        corner = seen
    return length
