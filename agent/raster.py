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

from agent.polygons import SIDE_X, SIDE_Y
from protocol.kernels import kernel


@kernel(
    "void(uint8[:,::1], int16[::1], int16[::1], uint8[::1], int64, int64, uint8[:,::1], int64, int64)"
)
def fill(
    layer: NDArray[np.uint8],
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    side: NDArray[np.uint8],
    first: int,
    end: int,
    scratch: NDArray[np.uint8],
    set_bits: int,
    clear_bits: int,
) -> None:
    """Set and clear bits of the cells that the polygon of the vertices ``first:end`` encloses.

    `scratch` has the shape of `layer`, and is zero before and after.
    """
    height, width = layer.shape
    top, bottom, left, right = height, -1, width, -1
    a_x = 4 * x[end - 1] + SIDE_X[side[end - 1]]
    a_y = 4 * y[end - 1] + SIDE_Y[side[end - 1]]
    for i in range(first, end):
        b_x, b_y = 4 * x[i] + SIDE_X[side[i]], 4 * y[i] + SIDE_Y[side[i]]
        # Rows whose middle lies in [low, high) are crossed; to the right of the crossing all cells toggle.
        low_x, low_y, high_x, high_y = (a_x, a_y, b_x, b_y) if a_y <= b_y else (b_x, b_y, a_x, a_y)
        row, last = max((low_y + 3) // 4, 0), min((high_y + 3) // 4, height) - 1
        if row <= last:
            top, bottom = min(top, row), max(bottom, last)
            run, rise = high_x - low_x, high_y - low_y
            denominator = 4 * rise
            # The first column whose middle is not left of the crossing: the crossing, rounded up.
            numerator = low_x * rise + run * (4 * row - low_y) + denominator - 1
            for at in range(row, last + 1):
                column = max(numerator // denominator, 0)
                if column < width:
                    scratch[at, column] ^= 1
                    left, right = min(left, column), max(right, column)
                else:
                    right = width
                numerator += 4 * run
        a_x, a_y = b_x, b_y
    right = min(right, width - 1)
    for at in range(top, bottom + 1):
        within = np.uint8(0)
        for column in range(left, right + 1):
            within ^= scratch[at, column]
            scratch[at, column] = 0
            if within:
                layer[at, column] = layer[at, column] & ~clear_bits | set_bits
