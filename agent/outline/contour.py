"""Exact contours of a grid: the line where free space ends (thesis, section 4.1, Algorithms 1 to 3).

A contour pixel is a non-free cell with a free 4-neighbor; each such pair of cells gives one contour point. From a point
the contour continues with the object on its left: to the diagonal cell if that is not free (a turn to the right), else
to the cell straight ahead if that is not free, else to the next side of the same cell (a turn to the left). So non-free
cells are 8-connected, free cells 4-connected, and no two contours touch.

Free cells that are not 4-connected to the robot count as unknown, so that exactly one object is inside. They are found
without flood fill. Both ends of a horizontal run of free cells lie on contours of the same free component. Conversely,
the runs of a component link all its contours. Proof: otherwise a run of one class of contours would overlap a run of
another class in the next row. Followed to the left along the contours between them, both runs end at one contour.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from agent.outline.polygons import LEFT, RIGHT, SIDE_X, SIDE_Y, Polygons, Symbols
from protocol.arrays import Int16Rows, Int32s, Int64s, Uint8s
from protocol.boxes import Boxes, clip, whole_grid
from protocol.grid import FREE, OCCUPIED, Cell, Grid
from protocol.kernels import kernel


def contours(grid: Grid, robot: Cell) -> Polygons:
    """Extract the contours of the free space around the robot, as `Tracer.contours` of a single grid."""
    return Tracer(grid.shape).contours(grid, robot)


class Tracer:
    """Extracts the contours of a grid that changes step by step.

    The runs of free cells are kept and updated where the grid changes. The contours themselves are traced anew each
    time: 9000 contour points take 0.03 ms.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        height, width = shape
        self._shape = height, width
        self._cells = np.zeros((height + 2) * (width + 2), np.uint8)
        self._ends = np.empty((height, width + 1), np.int16)
        self._counts = np.zeros(height, np.int64)

    def contours(self, grid: Grid, robot: Cell, changed: Boxes | None = None) -> Polygons:
        """Extract the contours of the free space around the robot.

        `grid` is the self-explored grid, shape (height, width), `robot` the robot's cell (x, y). Outside of the boxes
        `changed`, the grid equals that of the last call; None: it may differ anywhere.

        Returns all contour points. Objects are in the order in which a raster scan first meets the left or right side
        of one of their cells, and start there. So the inside object is the first. ValueError: the robot's cell is not a
        free cell of the grid.
        """
        height, width = self._shape
        x, y = robot
        if not (0 <= x < width and 0 <= y < height) or grid[y, x] != FREE:
            raise ValueError(f"robot at ({x}, {y}): it must be in a free cell of the {width} x {height} grid")
        if not grid.flags.writeable:
            grid = grid.copy()
        boxes = whole_grid(self._shape) if changed is None else changed
        _update_runs(grid, boxes, self._cells, self._ends, self._counts)
        robot_at = (y + 1) * (width + 2) + x + 1
        runs = self._ends, self._counts
        points, start = _trace(self._cells, width + 2, runs, robot_at, *_workspace(len(self._cells)))
        inside = np.zeros(len(start) - 1, np.bool_)
        inside[0] = True
        return Polygons(self._shape, points, start, inside)


@lru_cache(maxsize=1)
def _workspace(cells: int) -> tuple[NDArray[np.int32], Symbols]:
    """Return the memory that all traces of grids of one size share: contour numbers, all 0 between traces, and points.

    There is at most one contour point between two neighbors.
    """
    return np.zeros(cells, np.int32), np.empty(2 * cells, np.int32)


@kernel
def _update_runs(grid: Grid, boxes: Boxes, cells: Uint8s, ends: Int16Rows, counts: Int64s) -> None:
    """Update, within boxes, the cells with their unknown border, and for each row the ends of its runs of free cells.

    ``ends[y]`` has ``counts[y]`` columns x, from -1, for which exactly one of the cells x and x + 1 is free.
    """
    width = grid.shape[1]
    box = np.empty(4, np.int32)
    row_ends = np.empty(width + 1, np.int16)
    for number in range(len(boxes)):
        clip(boxes[number], 0, grid.shape, box)
        x0, x1 = np.int64(box[0]), np.int64(box[2])
        if x0 >= x1:
            continue
        for y in range(box[1], box[3]):
            out = cells[(y + 1) * (width + 2) : (y + 2) * (width + 2)]
            for x in range(x0, x1):
                out[x + 1] = grid[y, x]
            count = 0
            at = 0
            while at < counts[y] and ends[y, at] < x0 - 1:
                at += 1
            kept = at
            while at < counts[y] and ends[y, at] < x1:
                at += 1
            is_free = out[x0] == FREE
            for x in range(x0, x1 + 1):
                next_is_free = out[x + 1] == FREE
                if next_is_free != is_free:
                    row_ends[count] = x - 1
                    count += 1
                is_free = next_is_free
            moved = kept + count - at
            if moved > 0:
                for i in range(counts[y] - 1, at - 1, -1):
                    ends[y, i + moved] = ends[y, i]
            elif moved < 0:
                for i in range(at, counts[y]):
                    ends[y, i + moved] = ends[y, i]
            counts[y] += moved
            for i in range(count):
                ends[y, kept + i] = row_ends[i]


_STEP = (SIDE_Y << 15) + (SIDE_X << 3)
"""For each side, the difference between the symbol of a vertex and that of the cell on that side."""


@kernel
def _root(root: Int64s, k: int) -> int:
    """Find the representative of `k` (union-find), and shorten the path to it."""
    while root[k] != k:
        root[k] = root[root[k]]
        k = root[k]
    return k


@kernel
def _trace(
    cells: Uint8s, row: int, runs: tuple[Int16Rows, Int64s], robot: int, contour_at: Int32s, points: Symbols
) -> tuple[Symbols, Int32s]:
    """Trace all contours, and keep those of the robot's free component; return their points, and their starts.

    `cells` is the grid with its border, `row` cells per row, and the robot in cell `robot`; `runs` are `ends` and
    `counts` as `_update_runs` leaves them. ``contour_at[i]`` is the number, from 1, of the contour between the cells i
    and i + 1; it is all 0 before and after. `points` is scratch memory for all contour points.
    """
    ends, counts = runs
    run_ends = np.empty(counts.sum(), np.int32)
    gathered = 0
    for y in range(len(counts)):
        for i in range(counts[y]):
            run_ends[gathered] = (y + 1) * row + 1 + ends[y, i]
            gathered += 1
    offset = np.array([row, 1, -row, -1], np.int64)
    start = np.empty(len(run_ends) // 2 + 1, np.int32)

    traced = 0
    count = 0
    for end in run_ends:
        if contour_at[end]:
            continue
        start[count] = traced
        count += 1
        s = LEFT if cells[end] == FREE else RIGHT
        at = end + 1 if s == LEFT else end
        cell = at // row << 15 | at % row << 3
        while True:
            if s == RIGHT:
                if contour_at[at]:
                    break
                contour_at[at] = count
            elif s == LEFT:
                if contour_at[at - 1]:
                    break
                contour_at[at - 1] = count
            points[traced] = cell | s << 1 | (cells[at] == OCCUPIED)
            traced += 1
            left = (s + 1) & 3
            ahead = at + offset[left]
            diagonal = ahead + offset[s]
            if cells[diagonal] != FREE:
                at = diagonal
                cell += _STEP[left] + _STEP[s]
                s = (s + 3) & 3
            elif cells[ahead] != FREE:
                at = ahead
                cell += _STEP[left]
            else:
                s = left
    start[count] = traced

    # Contours of one free component get one root, the smallest of their numbers.
    root = np.arange(count)
    here = -1
    for k in range(0, len(run_ends), 2):
        one = _root(root, contour_at[run_ends[k]] - 1)
        other = _root(root, contour_at[run_ends[k + 1]] - 1)
        root[max(one, other)] = min(one, other)
        if run_ends[k] < robot <= run_ends[k + 1]:
            here = contour_at[run_ends[k]] - 1
    here = _root(root, here)
    for end in run_ends:
        contour_at[end] = 0

    kept = 0
    write = 0
    for k in range(count):
        if _root(root, k) == here:
            first, length = start[k], start[k + 1] - start[k]
            points[write : write + length] = points[first : first + length]
            start[kept] = write
            kept += 1
            write += length
    start[kept] = write
    return points[:write].copy(), start[: kept + 1]
