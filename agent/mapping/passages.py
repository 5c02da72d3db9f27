"""Whether a copy of a map closes a passage: thicker walls must not make rooms unreachable.

A passage is open where a square of free cells fits, as wide as the narrowest opening that robots explore. Around a
tile, all open cells that are connected in the robot's own grid must be connected in the copy, too.
"""

from __future__ import annotations

import numpy as np

from protocol.arrays import Int64s
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel

MARGIN = 8
"""Cells around a tile that are searched for a way."""

LONGEST_NICHE = 8
"""Cells of the longest open area that may vanish in the copy; longer ones are passages."""


@kernel
def _copied_state(own: Grid, target: Grid, x: int, y: int) -> int:
    """Return the state of a cell of the copy, the own state where receivers know none."""
    state = int(target[y, x] & 3)
    return int(own[y, x]) if state == UNKNOWN else state


@kernel
def _label(is_free: Grid, opening: int, labels: Grid) -> int:
    """Number the connected areas of squares of free cells, from 1; return the number of areas.

    Both grids have the shape of the window. At most 250 areas get a number of their own.
    """
    height, width = is_free.shape
    labels[:] = 0
    for y in range(height - opening + 1):
        for x in range(width - opening + 1):
            if is_free[y : y + opening, x : x + opening].all():
                labels[y : y + opening, x : x + opening] = 255
    stack = np.empty((height * width, 2), np.int64)
    count = 0
    for first_y in range(height):
        for first_x in range(width):
            if labels[first_y, first_x] != 255:
                continue
            count = min(count + 1, 250)
            labels[first_y, first_x] = count
            stack[0] = first_x, first_y
            size = 1
            while size:
                size -= 1
                x, y = stack[size, 0], stack[size, 1]
                for column, row in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
                    if 0 <= column < width and 0 <= row < height and labels[row, column] == 255:
                        labels[row, column] = count
                        stack[size] = column, row
                        size += 1
    return count


@kernel
def _thickens(own: Grid, target: Grid, box: Int64s) -> bool:
    """Whether the copy has a wall in the box where the robot's own grid is free."""
    for y in range(box[1], box[3]):
        for x in range(box[0], box[2]):
            if target[y, x] & 3 == OCCUPIED and own[y, x] == FREE:
                return True
    return False


@kernel
def closes_passage(own: Grid, target: Grid, box: Int64s, opening: int) -> bool:
    """Return whether the copy closes a passage in or around a box.

    `own` and `target`, shape (h, w), are the robot's own grid, and the copy, with receivers' states in the low two
    bits. `box` has the first column and row of a tile, and those behind the last ones. `opening` is the width of the
    narrowest passage in cells.
    """
    if not _thickens(own, target, box):
        return False
    left, top = max(0, box[0] - MARGIN), max(0, box[1] - MARGIN)
    right, bottom = min(own.shape[1], box[2] + MARGIN), min(own.shape[0], box[3] + MARGIN)
    before = np.zeros((bottom - top, right - left), np.uint8)
    after = np.zeros_like(before)
    for y in range(top, bottom):
        for x in range(left, right):
            before[y - top, x - left] = own[y, x] == FREE
            after[y - top, x - left] = _copied_state(own, target, x, y) == FREE
    own_areas, areas = np.empty_like(before), np.empty_like(before)
    number = _label(before, opening, own_areas)
    _label(after, opening, areas)
    found = np.zeros(number + 1, np.int64)
    extent = np.zeros((number + 1, 4), np.int64)
    extent[:, :2] = bottom + right
    for y in range(bottom - top):
        for x in range(right - left):
            area, copied = own_areas[y, x], areas[y, x]
            if not area:
                continue
            extent[area, 0], extent[area, 1] = min(extent[area, 0], x), min(extent[area, 1], y)
            extent[area, 2], extent[area, 3] = max(extent[area, 2], x), max(extent[area, 3], y)
            if copied and found[area] and found[area] != copied:
                return True
            if copied:
                found[area] = copied
    for area in range(1, number + 1):
        length = max(extent[area, 2] - extent[area, 0], extent[area, 3] - extent[area, 1]) + 1
        if not found[area] and length > LONGEST_NICHE:
            return True
    return False
