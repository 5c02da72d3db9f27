"""The laser scanner: exact ray casting on the true grid."""

from __future__ import annotations

import numpy as np

from protocol.arrays import Int32Rows, Int32s
from protocol.grid import FREE, HEADINGS, Grid, Mask, RayTable
from protocol.kernels import kernel
from protocol.scans import HIT, NONE, Readings

FULL_TURN = 360.0


def cast(
    truth: Grid,
    teammates: Mask,
    ray_table: RayTable,
    x: int,
    y: int,
    heading: int = 0,
    field_of_view: float = FULL_TURN,
) -> Readings:
    """Cast one scan from the center of cell (x, y); return uint16 readings of shape (beams,) (`protocol.scans`).

    `truth` (uint8) and `teammates` (bool) have shape (h, w). Cells that are not free are solid, and so is everything
    beyond the border; cells of other robots end a beam but do not count as walls. `heading`, in eighths of a turn, is
    the middle of the field of view, in degrees; beams outside it read `NONE`.
    """
    readings = np.empty(ray_table.beams, np.uint16)
    flat = ray_table.flat(truth.shape[1])
    shared, others = ray_table.shared, teammates.view(np.uint8)
    _cast(truth, others, ray_table.cells, flat, ray_table.start, shared, x, y, readings)
    if field_of_view < FULL_TURN:
        angles = np.arange(ray_table.beams) * (FULL_TURN / ray_table.beams)
        off = np.abs((angles - heading * FULL_TURN / HEADINGS + FULL_TURN / 2) % FULL_TURN - FULL_TURN / 2)
        readings[off > field_of_view / 2] = NONE
    return readings


@kernel
def _cast(
    truth: Grid,
    teammates: Grid,
    cells: Int32Rows,
    flat: Int32s,
    start: Int32s,
    shared: Int32s,
    x: int,
    y: int,
    readings: Readings,
) -> None:
    # Unsigned, a cell beyond the left or upper border is a very large number (as in `protocol.scans.draw`).
    height, width = np.uint64(truth.shape[0]), np.uint64(truth.shape[1])
    lying, others = truth.reshape(truth.size), teammates.reshape(truth.size)
    here = y * truth.shape[1] + x
    clear = np.uint64(0)
    for beam in range(len(start) - 1):
        first, end = np.uint64(start[beam]), np.uint64(start[beam + 1])
        # A beam that ends on the grid never leaves it. Beyond the border, everything counts as wall.
        on_grid = end
        while on_grid > first:
            last = on_grid - np.uint64(1)
            if np.uint64(x + cells[last, 0]) < width and np.uint64(y + cells[last, 1]) < height:
                break
            on_grid = last
        reading = end - first if on_grid == end else on_grid - first | np.uint64(HIT)
        # Cells shared with the previous beam are clear up to the place where that beam ended.
        known = min(np.uint64(shared[beam]), clear, on_grid - first)
        clear = on_grid - first
        for at in range(first + known, on_grid):
            cell = np.uint64(here + flat[at])
            if lying[cell] != FREE:
                clear = at - first
                reading = clear | np.uint64(HIT)
                break
            if others[cell]:
                clear = at - first
                reading = clear + np.uint64(1)
                break
        readings[beam] = reading
