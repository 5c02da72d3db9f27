"""Exact contours of a grid: the line where free space ends (thesis, section 4.1, Algorithms 1 to 3).

A contour pixel is a non-free cell with a free 4-neighbour; each such pair of cells gives one contour point.
From a point one moves on with the object on the left: to the diagonal cell if that is non-free (a turn to
the right), else to the next cell straight ahead if that is, else to the next side of the same cell (a turn
to the left). So non-free space hangs together by corners, free space does not, and no two contours touch.

Free cells that are not 4-connected to the robot count as unknown: then exactly one object is inside. To
find them no cell is flooded. The two ends of a horizontal run of free cells lie on contours of one and the
same free area; and all contours of an area are linked by its runs: if they fell into two classes, some
run of the one would overlap a run of the other in the next row, and walking to the left from one to the
next along the contours below and above them must end where both rest on the same contour.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from agent.outline.objects import Symbols, unpack
from agent.outline.polygons import LEFT, RIGHT, SIDE_X, SIDE_Y, Polygons
from protocol.boxes import Boxes, clip, whole_grid
from protocol.grid import FREE, OCCUPIED, Grid
from protocol.kernels import kernel


def contours(grid: Grid, robot: tuple[int, int]) -> Polygons:
    """Extract the contours of the free space around the robot: `Tracer.contours`, of a grid seen once."""
    return Tracer(grid.shape).contours(grid, robot)


class Tracer:
    """Extracts the contours of a grid that changes little by little.

    Where the runs of free cells begin and end is kept from one time to the next. The contours themselves are
    traced anew: 9000 contour points take 0.03 ms.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the grid.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        height, width = shape
        self._shape = height, width
        self._cells = np.zeros((height + 2) * (width + 2), np.uint8)
        self._ends = np.empty((height, width + 1), np.int16)
        self._counts = np.zeros(height, np.int64)

    def contours(self, grid: Grid, robot: tuple[int, int], changed: Boxes | None = None) -> Polygons:
        """Extract the contours of the free space around the robot.

        Parameters
        ----------
        grid : uint8 array of shape (height, width)
            What the robot knows: unknown, free and occupied cells.
        robot : (int, int)
            The cell (x, y) that the robot stands in; it must be free.
        changed : int32 array of shape (n, 4), optional
            Boxes in which the grid may differ from the one before; None: anywhere.

        Returns
        -------
        Polygons
            All contour points. Objects stand in the order in which a raster scan first meets the left or right
            side of one of their cells, and begin there. So the inside object is the first.

        Raises
        ------
        ValueError
            The robot does not stand in a free cell of the grid.
        """
        height, width = self._shape
        x, y = robot
        if not (0 <= x < width and 0 <= y < height) or grid[y, x] != FREE:
            raise ValueError(
                f"robot at ({x}, {y}): it must stand in a free cell of the {width} x {height} grid"
            )
        if not grid.flags.writeable:
            grid = grid.copy()
        boxes = whole_grid(self._shape) if changed is None else changed
        _lay_out(grid, boxes, self._cells, self._ends, self._counts)
        point_x, point_y, side, occupied, start = _trace(
            self._cells, width + 2, self._ends, self._counts, x, y, *_workspace(len(self._cells))
        )
        inside = np.zeros(len(start) - 1, np.bool_)
        inside[0] = True
        return Polygons(self._shape, point_x, point_y, side, occupied, start, inside)


@lru_cache(maxsize=1)
def _workspace(cells: int) -> tuple[NDArray[np.int32], Symbols]:
    """Memory in which all traces of grids of one size note where they have been, each leaves it all 0; and points.

    There is no more than one contour point between two neighbours.
    """
    return np.zeros(cells, np.int32), np.empty(2 * cells, np.int32)


@kernel("void(uint8[:,::1], int32[:,::1], uint8[::1], int16[:,::1], int64[::1])")
def _lay_out(
    grid: Grid, boxes: Boxes, cells: NDArray[np.uint8], ends: NDArray[np.int16], counts: NDArray[np.int64]
) -> None:
    """Bring up to date the cells with an unknown rim, and for each row where runs of free cells begin and end.

    ``ends[y]`` has `counts[y]` columns x, from -1, where just one of the cells x and x + 1 is free.
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
"""What a step to the cell on each side adds to a symbol."""


@kernel("int64(int64[::1], int64)")
def _root(root: NDArray[np.int64], k: int) -> int:
    """Find the representative of `k`, shortening the way for the next time."""
    while root[k] != k:
        root[k] = root[root[k]]
        k = root[k]
    return k


@kernel(
    "Tuple((int16[::1], int16[::1], uint8[::1], uint8[::1], int32[::1]))"
    "(uint8[::1], int64, int16[:,::1], int64[::1], int64, int64, int32[::1], int32[::1])"
)
def _trace(
    cells: NDArray[np.uint8],
    row: int,
    ends: NDArray[np.int16],
    counts: NDArray[np.int64],
    robot_x: int,
    robot_y: int,
    contour_at: NDArray[np.int32],
    points: Symbols,
) -> tuple[NDArray[np.int16], NDArray[np.int16], NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int32]]:
    """Trace all contours, keep those of the robot's free area.

    `cells` has the grid with its rim, `row` cells a row; `ends` and `counts` are as `_lay_out` leaves them.
    `contour_at` has, between cells i and i + 1, the number of the contour, from 1; it is 0 before and after. `points`
    has room for all contour points.
    """
    robot = (robot_y + 1) * row + robot_x + 1
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

    # Contours of one free area get one root, the smallest of their numbers.
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
    return *unpack(points[:write]), start[: kept + 1]
