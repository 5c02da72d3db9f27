"""Boxes of cells: where something has changed, so that what follows from it is done there and nowhere else.

A box is (x0, y0, x1, y1): columns x0 to x1 - 1 and rows y0 to y1 - 1. A few boxes, which may overlap, cover all
that has changed; they may cover more, and reach beyond the grid.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.kernels import kernel
from protocol.scans import Change

Boxes = NDArray[np.int32]
"""Shape (n, 4)."""

MOST = 16
"""So many boxes at most; beyond that, boxes are joined."""

_SLACK = 64
"""Boxes are joined where that covers no more than so many cells more."""

NO_BOXES: Boxes = np.empty((0, 4), np.int32)


def whole(shape: tuple[int, int]) -> Boxes:
    """One box that covers a grid of so many rows and columns."""
    return np.array([(0, 0, shape[1], shape[0])], np.int32)


def box_of(change: Change) -> Boxes:
    """The box of what a drawing has changed."""
    if not change.cells:
        return NO_BOXES
    return np.array([(change.x0, change.y0, change.x1, change.y1)], np.int32)


def united(one: Boxes, other: Boxes) -> Boxes:
    """Boxes that cover what both cover."""
    if not len(one) or not len(other):
        return one if len(one) else other
    covered: Boxes = _united(one, other)
    return covered


def around(boxes: Boxes) -> tuple[int, int, int, int]:
    """The box (x0, y0, x1, y1) around one or more."""
    x0, y0, x1, y1 = zip(*boxes.tolist(), strict=True)
    return min(x0), min(y0), max(x1), max(y1)


@kernel("void(int32[::1], int64, UniTuple(int64, 2), int32[::1])")
def clip(box: NDArray[np.int32], spread: int, shape: tuple[int, int], out: NDArray[np.int32]) -> None:
    """Write what of a box, made larger by `spread` cells on all sides, lies on the grid. For other kernels."""
    out[0], out[1] = max(box[0] - spread, 0), max(box[1] - spread, 0)
    out[2], out[3] = max(min(box[2] + spread, shape[1]), out[0]), max(min(box[3] + spread, shape[0]), out[1])


@kernel("int64(int32[:,::1], int64, int64, int64, int64, int64)")
def add_box(boxes: Boxes, count: int, x0: int, y0: int, x1: int, y1: int) -> int:
    """Add a box to the first `count` of `MOST`, or join it with one; how many there are then. For other kernels."""
    least, best = np.int64(1) << 60, -1
    for at in range(count):
        b0, b1, b2, b3 = boxes[at, 0], boxes[at, 1], boxes[at, 2], boxes[at, 3]
        joined = (max(b2, x1) - min(b0, x0)) * (max(b3, y1) - min(b1, y0))
        more = joined - (b2 - b0) * (b3 - b1) - (x1 - x0) * (y1 - y0)
        if more < least:
            least, best = more, at
    if best >= 0 and (least <= _SLACK or count == MOST):
        b = boxes[best]
        b[0], b[1], b[2], b[3] = min(b[0], x0), min(b[1], y0), max(b[2], x1), max(b[3], y1)
        return count
    boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = x0, y0, x1, y1
    return count + 1


@kernel("int32[:,::1](int32[:,::1], int32[:,::1])")
def _united(one: Boxes, other: Boxes) -> Boxes:
    boxes = np.empty((MOST, 4), np.int32)
    count = 0
    for some in (one, other):
        for at in range(len(some)):
            count = add_box(boxes, count, some[at, 0], some[at, 1], some[at, 2], some[at, 3])
    return boxes[:count].copy()
