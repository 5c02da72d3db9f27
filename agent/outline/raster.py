"""Rasterization of polygons: the cells that they enclose, and the cells of their edges.

Both use the same integer coordinates, in quarters of a cell, so they are consistent: of two 4-neighbors of which a
polygon encloses exactly one, at least one lies on its boundary. So free space cannot leak out.

- A cell is enclosed if its center is, by the even-odd rule.
- An edge is drawn in one cell per column (steep edges: per row): the cell nearest to its point in the middle of the
  column, and in the first column the cell of its first vertex. The cell of its last vertex belongs to the next edge,
  because an edge represents the contour points before that vertex. An exact edge, which is straight or diagonal, is
  drawn in exactly the cells of its contour points.
"""

from __future__ import annotations

import numpy as np

from protocol.arrays import Int32Rows, Int32s, Uint8
from protocol.grid import Grid
from protocol.kernels import kernel

Edges = Int32Rows
"""Shape (n, 5): x and y of the first and of the last vertex, in quarters of a cell; 1 if the edge is occupied."""


@kernel
def _four(numbers: Int32s) -> tuple[int, int, int, int]:
    """Return the first four numbers as int64, so that products do not overflow."""
    return numbers[0], numbers[1], numbers[2], numbers[3]


@kernel
def fill(layer: Grid, edges: Edges, set_bits: Uint8, clear_bits: Uint8, box: Int32s) -> None:
    """Set and clear bits of all cells in a box that a polygon encloses.

    `edges` must contain all edges that cross a column of the box, within it or above it. The box must be on the grid.
    """
    x0, y0, x1, y1 = _four(box)
    toggles = np.zeros((y1 - y0, x1 - x0), np.uint8)
    if not toggles.size:
        return
    for e in range(len(edges)):
        low_x, low_y, high_x, high_y = _four(edges[e])
        if low_x > high_x:
            low_x, low_y, high_x, high_y = high_x, high_y, low_x, low_y
        # The edge crosses the columns whose middle is in [low, high): there it toggles all cells below it.
        column, last = max((low_x + 3) >> 2, x0), min((high_x + 3) >> 2, x1) - 1
        if column > last or min(low_y, high_y) > 4 * y1:
            continue
        if max(low_y, high_y) <= 4 * y0:
            for at in range(column, last + 1):
                toggles[0, at - x0] ^= 255
        else:
            run, rise = high_x - low_x, high_y - low_y
            denominator = 4 * run
            numerator = low_y * run + rise * (4 * column - low_x) + denominator - 1  # rounds up
            for at in range(column, last + 1):
                row = max(numerator // denominator, y0)
                if row < y1:
                    toggles[row - y0, at - x0] ^= 255
                numerator += 4 * rise
    within = np.zeros(x1 - x0, np.uint8)
    for row in range(y0, y1):
        toggled, bits = toggles[row - y0], layer[row, x0:x1]
        for at in range(len(within)):
            within[at] ^= toggled[at]
            bits[at] = bits[at] & ~(clear_bits & within[at]) | set_bits & within[at]


@kernel
def draw(
    layer: Grid, edges: Edges, occupied_bits: Uint8, other_bits: Uint8, clear_bits: Uint8, box: Int32s
) -> None:
    """Draw the edges of a polygon within a box on the grid.

    Clears `clear_bits` in all their cells; sets `occupied_bits` on occupied edges, `other_bits` on others.
    """
    x0, y0, x1, y1 = _four(box)
    for e in range(len(edges)):
        a_x, a_y, b_x, b_y = _four(edges[e])
        x, y, end_x, end_y = a_x + 1 >> 2, a_y + 1 >> 2, b_x + 1 >> 2, b_y + 1 >> 2
        if min(x, end_x) > x1 or max(x, end_x) < x0 - 1 or min(y, end_y) > y1 or max(y, end_y) < y0 - 1:
            continue
        bits = occupied_bits if edges[e, 4] else other_bits
        run, rise = b_x - a_x, b_y - a_y
        # `at` runs along the axis of the longer extent, from the column (or row) of the first vertex; the box contains
        # its steps from `skipped` to `cells` - 1.
        flat = abs(run) >= abs(rise)
        at, last, low, high = (x, end_x, x0, x1) if flat else (y, end_y, y0, y1)
        step = 1 if last > at else -1
        before, within = (low - at, high - at) if step > 0 else (at - high + 1, at - low + 1)
        skipped, cells = max(before, 0), min(max(abs(last - at), 1), within)
        at += skipped * step
        if flat:
            numerator, denominator, slope = a_y * run + rise * (4 * at - a_x), 4 * run, 4 * rise * step
        else:
            numerator, denominator, slope = a_x * rise + run * (4 * at - a_y), 4 * rise, 4 * run * step
        if denominator == 0:  # both vertices are equal, which only a malicious stream contains
            numerator, denominator = a_y, 4
        elif denominator < 0:
            numerator, denominator, slope = -numerator, -denominator, -slope
        numerator += denominator // 2
        across = numerator // denominator
        rest = numerator - across * denominator
        for _ in range(skipped, cells):
            column, row = (at, across) if flat else (across, at)
            if x0 <= column < x1 and y0 <= row < y1:
                layer[row, column] = layer[row, column] & ~clear_bits | bits
            at += step
            rest += slope  # the slope is at most one cell per cell
            if rest >= denominator:
                rest -= denominator
                across += 1
            elif rest < 0:
                rest += denominator
                across -= 1
