"""The way that a robot is on: followed cell by cell, led around a teammate that stands on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.planning.ways import Ways
from protocol.chance import chance
from protocol.grid import FREE, Grid

_NOWHERE = np.empty((0, 2), np.int32)


class Route:
    """Cells still to be driven."""

    def __init__(self) -> None:
        self.cells: NDArray[np.int32] = _NOWHERE

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
        """Lead around the cell in front, which a teammate holds.

        Where no other way leads to `end`, or it is much longer, lead to a random cell at most `reach`
        cells away instead; `key` (seed, robot, step) decides which.
        """
        if not len(self.cells):
            return
        around = ways.without(int(self.cells[0][0]), int(self.cells[0][1]))
        field = around.costs(*start)
        if field[end[1], end[0]] < len(self.cells) + reach:
            self.lead(around, start, end)
            return
        ys, xs = np.nonzero(field <= reach)
        pick = int(chance(key[0], "step aside", *key[1:]).integers(len(xs)))
        self.lead(around, start, (int(xs[pick]), int(ys[pick])))
