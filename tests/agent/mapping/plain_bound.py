"""A plain second implementation of the bound: which cells of a copy violate it, cell by cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.mapping.estimator import SETTLED
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid


def violations(
    own: Grid, log_odds: NDArray[np.int8], held: Grid, tolerance: int, *, blocks: bool = False
) -> list[tuple[str, int, int]]:
    """Return the cells (x, y) of a robot's own grid that a copy violates, with the condition.

    With `blocks`, the copy has half resolution.
    """

    def count(grid: list[list[int]], state: int, x: int, y: int, reach: int) -> int:
        rows = grid[max(0, y - reach) : y + reach + 1]
        return sum(row[max(0, x - reach) : x + reach + 1].count(state) for row in rows)

    def is_covered(x: int, y: int) -> bool:
        """Whether a wall of the copy lies before or behind a cell, not beside it along the wall."""

        def opens(row: int, column: int, dx: int, dy: int) -> bool:
            if not (0 <= row < own.shape[0] and 0 <= column < own.shape[1]):
                return False
            beside, behind = (row, column), (row + dy, column + dx)
            is_open = own[beside] == FREE and held[beside] != OCCUPIED
            return bool(is_open and own[behind] != OCCUPIED and held[behind] != OCCUPIED)

        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            row, column = y + dy, x + dx
            inside = 0 <= row < own.shape[0] and 0 <= column < own.shape[1]
            if inside and held[row, column] == OCCUPIED:
                sides = [(y + side * dx, x + side * dy) for side in (-1, 1)]
                if not any(opens(*side, dx, dy) for side in sides):
                    return True
        return False

    found = []
    own_rows, held_rows = own.tolist(), held.tolist()
    for y, x in np.ndindex(own.shape):
        state, copy = own_rows[y][x], held_rows[y][x]
        near_copy, near_own = (count(rows, OCCUPIED, x, y, tolerance) for rows in (held_rows, own_rows))
        if tolerance == 0:
            if state not in (UNKNOWN, copy):
                found.append(("not exact", x, y))
            continue
        if abs(log_odds[y, x]) >= SETTLED:
            if state == OCCUPIED and not near_copy:
                found.append(("missing wall", x, y))
            if state == FREE and copy == OCCUPIED and not near_own:
                found.append(("invented wall", x, y))
            if state == FREE and copy != FREE and not near_copy:
                found.append(("missing free cell", x, y))
        beside_wall = state == FREE and count(own_rows, OCCUPIED, x, y, 1)
        surrounded = (
            state != OCCUPIED
            and not count(own_rows, OCCUPIED, x, y, 1)
            and count(own_rows, FREE, x, y, 1) >= 6
        )
        settled = state == UNKNOWN and abs(log_odds[y, x]) >= SETTLED
        if (
            copy == UNKNOWN
            and (state == OCCUPIED or ((beside_wall or surrounded) and not near_copy))
            and not settled
            and not (blocks and state == OCCUPIED and is_covered(x, y))
        ):
            found.append(("incomplete", x, y))
        cross = [(y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)]
        beside = [cell for cell in cross if 0 <= cell[0] < own.shape[0] and 0 <= cell[1] < own.shape[1]]
        borders_unknown = any(held[cell] == UNKNOWN == own[cell] for cell in beside)
        block = own[y // 2 * 2 : y // 2 * 2 + 2, x // 2 * 2 : x // 2 * 2 + 2]
        is_exempt = blocks and (block == FREE).any()
        if copy == FREE != state and near_own and borders_unknown and not is_exempt:
            found.append(("open gap", x, y))
    return found
