"""Which cells can be reached at all, which takes a fraction of finding out at what cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.planning.cost_field import Floor
from protocol.kernels import kernel


def reachable(floor: Floor, x: int, y: int) -> NDArray[np.bool_]:
    """Which cells can be reached from cell (x, y).

    A diagonal step needs both cells beside it free, so this is the 4-connected part of the floor.

    Returns
    -------
    bool array, shape (h, w)
        True where `agent.planning.cost_field.costs` are finite; so in cell (x, y) itself.
    """
    reached = np.zeros(len(floor.free), np.bool_)
    _flood(floor.free, floor.stride, floor.at(x, y), reached)
    return reached.reshape(-1, floor.stride)[1:-1, 1:-1]


@kernel("void(boolean[::1], int64, int64, boolean[::1])")
def _flood(free: NDArray[np.bool_], stride: int, start: int, reached: NDArray[np.bool_]) -> None:
    """Fill the 4-connected part of the floor around a cell, run after run of its rows."""
    waiting = np.empty(2 * len(free), np.int32)
    waiting[0], count = start, 1
    while count:
        count -= 1
        first = last = waiting[count]
        if reached[first]:
            continue
        while free[first - 1]:
            first -= 1
        while free[last + 1]:
            last += 1
        reached[first : last + 1] = True
        for side in (-stride, stride):
            within = False
            for cell in range(first + side, last + side + 1):
                if not within and free[cell] and not reached[cell]:
                    waiting[count] = cell
                    count += 1
                within = free[cell]
