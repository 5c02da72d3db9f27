"""Boxes of cells, which bound where a grid has changed, so that only these cells are processed again.

A box is (x0, y0, x1, y1): the cells of columns x0 to x1 - 1 and rows y0 to y1 - 1. Several boxes are the rows of an
int32 array. They may overlap, cover more cells than have changed, and extend beyond the grid.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Int32s
from protocol.grid import Mask
from protocol.kernels import kernel

Box = tuple[int, int, int, int]
"""(x0, y0, x1, y1); empty if x0 >= x1 or y0 >= y1."""

Boxes = Annotated[NDArray[np.int32], "int32[:,::1]"]
"""Several boxes, shape (n, 4)."""

MAX_BOXES = 16
"""The most boxes that `union` returns; it joins boxes to stay below."""

_EXTRA_CELLS = 64
"""Two boxes are joined if their common box covers at most so many cells more than both."""

NO_BOX: Box = (1 << 30, 1 << 30, 0, 0)
"""An empty box, which `bounding_box` ignores."""

NO_BOXES: Boxes = np.empty((0, 4), np.int32)


def whole_grid(shape: tuple[int, int]) -> Boxes:
    """Return one box that covers a grid of `shape`, (height, width)."""
    return np.array([(0, 0, shape[1], shape[0])], np.int32)


def union(first: Boxes, second: Boxes) -> Boxes:
    """Return at most `MAX_BOXES` boxes that cover all cells of both arguments."""
    if not len(first) or not len(second):
        return first if len(first) else second
    return _union(first, second)


def bounding_box(boxes: Iterable[Sequence[int]]) -> Box:
    """Return the smallest box that contains all `boxes`; `NO_BOX` if there are none."""
    x0, y0, x1, y1 = zip(NO_BOX, *boxes, strict=True)
    return min(x0), min(y0), max(x1), max(y1)


def box_of(cells: Mask) -> Box:
    """Return the smallest box that contains all true cells of an array of shape (h, w); `NO_BOX` if there are none."""
    rows, columns = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    if not len(rows):
        return NO_BOX
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


@kernel
def clip(box: Int32s, margin: int, shape: tuple[int, int], out: Int32s) -> None:
    """Write to `out` the part of a box, enlarged by `margin` cells on each side, that lies on the grid."""
    out[0], out[1] = max(box[0] - margin, 0), max(box[1] - margin, 0)
    out[2], out[3] = max(min(box[2] + margin, shape[1]), out[0]), max(min(box[3] + margin, shape[0]), out[1])


@kernel
def add_box(boxes: Boxes, count: int, x0: int, y0: int, x1: int, y1: int) -> int:
    """Add a box behind the first `count` of `boxes`, shape (`MAX_BOXES`, 4), or enlarge one; return the new count."""
    fewest, best = np.int64(1) << 60, -1
    for at in range(count):
        b0, b1, b2, b3 = boxes[at, 0], boxes[at, 1], boxes[at, 2], boxes[at, 3]
        joined = (max(b2, x1) - min(b0, x0)) * (max(b3, y1) - min(b1, y0))
        extra = joined - (b2 - b0) * (b3 - b1) - (x1 - x0) * (y1 - y0)
        if extra < fewest:
            fewest, best = extra, at
    if best >= 0 and (fewest <= _EXTRA_CELLS or count == MAX_BOXES):
        b = boxes[best]
        b[0], b[1], b[2], b[3] = min(b[0], x0), min(b[1], y0), max(b[2], x1), max(b[3], y1)
        return count
    boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = x0, y0, x1, y1
    return count + 1


@kernel
def _union(first: Boxes, second: Boxes) -> Boxes:
    boxes = np.empty((MAX_BOXES, 4), np.int32)
    count = 0
    for some in (first, second):
        for at in range(len(some)):
            count = add_box(boxes, count, some[at, 0], some[at, 1], some[at, 2], some[at, 3])
    return boxes[:count].copy()
