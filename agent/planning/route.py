"""The way that a robot is on: planned on costs, followed cell by cell, mended when it is blocked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.planning.cost import Field, costs, way
from protocol.chance import chance
from protocol.grid import FREE, OCCUPIED, Grid

_NOWHERE = np.empty((0, 2), np.int32)


class Route:
    """Cells still to be driven, and the costs on which they were planned."""

    def __init__(self) -> None:
        self._cells: NDArray[np.int32] = _NOWHERE
        self._grid: Grid | None = None
        self._field: Field | None = None

    def plan(self, grid: Grid, x: int, y: int) -> Field:
        """Compute the costs of all cells from (x, y); `lead_to` follows them."""
        self._grid = grid
        self._field = costs(grid, x, y)
        return self._field

    def lead_to(self, x: int, y: int) -> bool:
        """Take the shortest way to (x, y); whether there is one. Without one, the way is empty."""
        if self._grid is None or self._field is None or not np.isfinite(self._field[y, x]):
            self.clear()
            return False
        self._cells = way(self._grid, self._field, x, y)
        return True

    def clear(self) -> None:
        """Stay."""
        self._cells = _NOWHERE

    def drive_to(self, x: int, y: int) -> None:
        """The robot is at (x, y) now: drop the cells up to there."""
        at = np.flatnonzero((self._cells == (x, y)).all(axis=1))
        if len(at):
            self._cells = self._cells[at[-1] + 1 :]

    def is_open(self, grid: Grid) -> bool:
        """Whether all cells still to be driven are free on `grid`."""
        return bool((grid[self._cells[:, 1], self._cells[:, 0]] == FREE).all())

    def next_cells(self, count: int) -> NDArray[np.int32]:
        """The next cells to enter, shape (at most `count`, 2)."""
        return self._cells[:count]

    def detour(
        self,
        grid: Grid,
        start: tuple[int, int],
        target: tuple[int, int],
        reach: float,
        key: tuple[int, int, int],
    ) -> None:
        """Lead around the cell in front, which a teammate holds.

        Where no other way leads to the target, or it is much longer, lead to a random cell at most `reach`
        cells away instead; `key` (seed, robot, step) decides which.
        """
        if not len(self._cells):
            return
        around = grid.copy()
        around[self._cells[0][1], self._cells[0][0]] = OCCUPIED
        field = self.plan(around, *start)
        if field[target[1], target[0]] < len(self._cells) + reach:
            self.lead_to(*target)
            return
        ys, xs = np.nonzero(field <= reach)
        pick = int(chance(key[0], "step aside", *key[1:]).integers(len(xs)))
        self.lead_to(int(xs[pick]), int(ys[pick]))
