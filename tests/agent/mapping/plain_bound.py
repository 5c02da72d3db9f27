"""A plain second implementation of the bound: which cells of a copy violate it, cell by cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.mapping.estimator import SETTLED
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid


def violations(
    own: Grid, log_odds: NDArray[np.int8], held: Grid, tolerance: int
) -> list[tuple[str, int, int]]:
    """Return the cells (x, y) of a robot's own grid that a copy violates, with the condition."""

    def count(grid: list[list[int]], state: int, x: int, y: int, reach: int) -> int:
        rows = grid[max(0, y - reach) : y + reach + 1]
        return sum(row[max(0, x - reach) : x + reach + 1].count(state) for row in rows)

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
        ):
            found.append(("incomplete", x, y))
        cross = [(y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)]
        beside = [cell for cell in cross if 0 <= cell[0] < own.shape[0] and 0 <= cell[1] < own.shape[1]]
        borders_unknown = any(held[cell] == UNKNOWN == own[cell] for cell in beside)
        if copy == FREE != state and near_own and borders_unknown:
            found.append(("open gap", x, y))
    return found
