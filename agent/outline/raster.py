"""Drawing polygons into a grid: the cells that they enclose, and the cells of their edges.

Both go by the same integer coordinates, in quarters of a cell, so that they fit: of two 4-neighbours of
which a polygon encloses just one, at least one lies on its boundary. Free space cannot leak out.

- A cell is enclosed if its centre is, by the even-odd rule.
- An edge is drawn in one cell a column (steep ones: a row): where it passes the middle of the column, in
  the nearest cell; in the first column, in the cell of its vertex. The last vertex is left to the edge that
  begins there: an edge speaks of the contour points before it. An exact edge, which is straight or
  diagonal, is drawn in just the cells of its contour points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.outline.polygons import SIDE_X, SIDE_Y
from protocol.kernels import kernel


@kernel(
    "void(uint8[:,::1], int16[::1], int16[::1], uint8[::1], int64, int64, int32[::1], uint8[:,::1], uint8, uint8,"
    " int32[::1])"
)
def fill(
    layer: NDArray[np.uint8],
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    side: NDArray[np.uint8],
    first: int,
    end: int,
    edges: NDArray[np.int32],
    scratch: NDArray[np.uint8],
    set_bits: int,
    clear_bits: int,
    box: NDArray[np.int32],
) -> None:
    """Set and clear bits of the cells in a box that the polygon of the vertices ``first:end`` encloses.

    `edges` has the vertices with which the edges begin that cross a column of the box, in it or above it, at least.
    `scratch` has the shape of `layer`, and is zero before and after. The box, (x0, y0, x1, y1), is on the grid.
    """
    x0, y0, x1, y1 = np.int64(box[0]), np.int64(box[1]), np.int64(box[2]), np.int64(box[3])
    for i in edges:
        j = i + 1 if i + 1 < end else first
        a_x, a_y = 4 * x[i] + SIDE_X[side[i]], 4 * y[i] + SIDE_Y[side[i]]
        b_x, b_y = 4 * x[j] + SIDE_X[side[j]], 4 * y[j] + SIDE_Y[side[j]]
        # The edge crosses the columns whose middle lies in [low, high); all cells below it there toggle.
        low_x, low_y, high_x, high_y = (a_x, a_y, b_x, b_y) if a_x <= b_x else (b_x, b_y, a_x, a_y)
        column, last = max((low_x + 3) >> 2, x0), min((high_x + 3) >> 2, x1) - 1
        if column > last or min(low_y, high_y) > 4 * y1:
            continue
        if max(low_y, high_y) <= 4 * y0:
            for at in range(column, last + 1):
                scratch[y0, at] ^= 255
        else:
            run, rise = high_x - low_x, high_y - low_y
            denominator = 4 * run
            numerator = low_y * run + rise * (4 * column - low_x) + denominator - 1  # rounds up
            for at in range(column, last + 1):
                row = max(numerator // denominator, y0)
                if row < y1:
                    scratch[row, at] ^= 255
                numerator += 4 * rise
    for row in range(y0, y1):
        within = scratch[row, x0:x1]
        bits = layer[row, x0:x1]
        if row > y0:
            above = scratch[row - 1, x0:x1]
            for at in range(len(within)):
                within[at] ^= above[at]
        for at in range(len(bits)):
            bits[at] = bits[at] & ~(clear_bits & within[at]) | set_bits & within[at]
    for row in range(y0, y1):
        scratch[row, x0:x1] = 0


@kernel(
    "void(uint8[:,::1], int16[::1], int16[::1], uint8[::1], uint8[::1], int64, int64, int32[::1], uint8, uint8, uint8,"
    " int32[::1])"
)
def draw(
    layer: NDArray[np.uint8],
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    side: NDArray[np.uint8],
    occupied: NDArray[np.uint8],
    first: int,
    end: int,
    edges: NDArray[np.int32],
    occupied_bits: int,
    other_bits: int,
    clear_bits: int,
    box: NDArray[np.int32],
) -> None:
    """Draw the edges of the polygon of the vertices ``first:end``, as far as they lie in a box on the grid.

    Clears `clear_bits` in all their cells; sets `occupied_bits` on occupied edges, `other_bits` on others. `edges`
    has the vertices with which the edges begin that pass through the box, at least.
    """
    x0, y0, x1, y1 = np.int64(box[0]), np.int64(box[1]), np.int64(box[2]), np.int64(box[3])
    for i in edges:
        j = i + 1 if i + 1 < end else first
        if (x[i] > x1 and x[j] > x1) or (x[i] < x0 - 1 and x[j] < x0 - 1):
            continue
        if (y[i] > y1 and y[j] > y1) or (y[i] < y0 - 1 and y[j] < y0 - 1):
            continue
        bits = occupied_bits if occupied[i] else other_bits
        a_x, a_y = 4 * x[i] + SIDE_X[side[i]], 4 * y[i] + SIDE_Y[side[i]]
        run, rise = 4 * x[j] + SIDE_X[side[j]] - a_x, 4 * y[j] + SIDE_Y[side[j]] - a_y
        # Along the axis of the longer extent, `at` counts columns (or rows) from the first vertex' own.
        flat = abs(run) >= abs(rise)
        at, last = (x[i], x[j]) if flat else (y[i], y[j])
        step = 1 if last > at else -1
        if flat:
            numerator, denominator, slope = a_y * run + rise * (4 * at - a_x), 4 * run, 4 * rise * step
        else:
            numerator, denominator, slope = a_x * rise + run * (4 * at - a_y), 4 * rise, 4 * run * step
        if denominator == 0:  # both vertices are the same, which only a hostile stream says
            numerator, denominator = a_y, 4
        elif denominator < 0:
            numerator, denominator, slope = -numerator, -denominator, -slope
        numerator += denominator // 2
        while True:
            across = numerator // denominator
            column, row = (at, across) if flat else (across, at)
            if x0 <= column < x1 and y0 <= row < y1:
                layer[row, column] = layer[row, column] & ~clear_bits | bits
            at += step
            numerator += slope
            if (last - at) * step <= 0:
                break
