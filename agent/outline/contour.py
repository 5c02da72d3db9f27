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

from agent.outline.polygons import LEFT, RIGHT, SIDE_X, SIDE_Y, Polygons
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel


def contours(grid: Grid, robot: tuple[int, int]) -> Polygons:
    """Extract the contours of the free space around the robot.

    Parameters
    ----------
    grid : uint8 array of shape (height, width)
        What the robot knows: unknown, free and occupied cells.
    robot : (int, int)
        The cell (x, y) that the robot stands in; it must be free.

    Returns
    -------
    Polygons
        All contour points. Objects stand in the order in which a raster scan first meets the left or right
        side of one of their cells, and begin there. So the inside object is the first.

    Raises
    ------
    ValueError
        The robot does not stand in a free cell of the grid.

    Notes
    -----
    Nothing is kept from one step to the next: a map of 290 x 291 cells with 9000 contour points is traced
    anew in 0.1 ms.
    """
    height, width = grid.shape
    x, y = robot
    if not (0 <= x < width and 0 <= y < height) or grid[y, x] != FREE:
        raise ValueError(f"robot at ({x}, {y}): it must stand in a free cell of the {width} x {height} grid")
    if not grid.flags.writeable:
        grid = grid.copy()
    point_x, point_y, side, occupied, start = _trace(grid, x, y, _workspace((height + 2) * (width + 2)))
    inside = np.zeros(len(start) - 1, np.bool_)
    inside[0] = True
    return Polygons((height, width), point_x, point_y, side, occupied, start, inside)


@lru_cache(maxsize=1)
def _workspace(cells: int) -> NDArray[np.int32]:
    """Memory in which all traces of grids of one size note where they have been; each leaves it all 0."""
    return np.zeros(cells, np.int32)


@kernel("int64(int64[::1], int64)")
def _root(root: NDArray[np.int64], k: int) -> int:
    """Find the representative of `k`, shortening the way for the next time."""
    while root[k] != k:
        root[k] = root[root[k]]
        k = root[k]
    return k


@kernel("Tuple((uint8[::1], int32[::1], int64))(uint8[:,::1])")
def _lay_out(grid: Grid) -> tuple[NDArray[np.uint8], NDArray[np.int32], int]:
    """Put a rim of unknown cells around a grid.

    Returns its cells row by row, the places i where just one of the cells i and i + 1 is free, and how many
    contour points there are, those of other free areas included.
    """
    height, width = grid.shape
    row = width + 2
    cells = np.empty((height + 2) * row, np.uint8)
    cells[:row] = UNKNOWN
    cells[-row:] = UNKNOWN
    across = np.empty(height, np.int64)
    ends = 0
    points = 0
    for y in range(height):
        out = cells[(y + 1) * row : (y + 2) * row]
        above = cells[y * row : (y + 1) * row]
        out[0] = out[-1] = UNKNOWN
        source = grid[y]
        for x in range(width):
            out[x + 1] = source[x]
        beside, over = 0, 0
        for x in range(row - 1):
            beside += (out[x] == FREE) != (out[x + 1] == FREE)
        for x in range(row):
            over += (out[x] == FREE) != (above[x] == FREE)
        across[y] = beside
        ends += beside
        points += over
    last = cells[height * row : (height + 1) * row]
    for x in range(row):
        points += last[x] == FREE
    run_ends = np.empty(ends, np.int32)
    count = 0
    for y in range(height):
        at = (y + 1) * row
        wanted = count + across[y]
        while count < wanted:
            if (cells[at] == FREE) != (cells[at + 1] == FREE):
                run_ends[count] = at
                count += 1
            at += 1
    return cells, run_ends, ends + points


@kernel(
    "Tuple((int16[::1], int16[::1], uint8[::1], uint8[::1], int32[::1]))(uint8[:,::1], int64, int64, int32[::1])"
)
def _trace(
    grid: Grid, robot_x: int, robot_y: int, contour_at: NDArray[np.int32]
) -> tuple[NDArray[np.int16], NDArray[np.int16], NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int32]]:
    """Trace all contours, keep those of the robot's free area.

    `contour_at` has, between cells i and i + 1 of the grid with its rim, the number of the contour, from 1; it
    is 0 before and after.
    """
    row = grid.shape[1] + 2
    robot = (robot_y + 1) * row + robot_x + 1
    cells, run_ends, points = _lay_out(grid)
    offset = np.array([row, 1, -row, -1], np.int64)
    point_x = np.empty(points, np.int16)
    point_y = np.empty(points, np.int16)
    side = np.empty(points, np.uint8)
    occupied = np.empty(points, np.uint8)
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
        y = at // row - 1
        x = at - (y + 1) * row - 1
        while True:
            if s == RIGHT:
                if contour_at[at]:
                    break
                contour_at[at] = count
            elif s == LEFT:
                if contour_at[at - 1]:
                    break
                contour_at[at - 1] = count
            point_x[traced] = x
            point_y[traced] = y
            side[traced] = s
            occupied[traced] = cells[at] == OCCUPIED
            traced += 1
            left = (s + 1) & 3
            ahead = at + offset[left]
            diagonal = ahead + offset[s]
            if cells[diagonal] != FREE:
                at = diagonal
                x += SIDE_X[left] + SIDE_X[s]
                y += SIDE_Y[left] + SIDE_Y[s]
                s = (s + 3) & 3
            elif cells[ahead] != FREE:
                at = ahead
                x += SIDE_X[left]
                y += SIDE_Y[left]
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
        if _root(root, k) != here:
            continue
        first, length = start[k], start[k + 1] - start[k]
        if write < first:
            for i in range(length):
                point_x[write + i] = point_x[first + i]
                point_y[write + i] = point_y[first + i]
                side[write + i] = side[first + i]
                occupied[write + i] = occupied[first + i]
        start[kept] = write
        kept += 1
        write += length
    start[kept] = write
    return point_x[:write], point_y[:write], side[:write], occupied[:write], start[: kept + 1]
