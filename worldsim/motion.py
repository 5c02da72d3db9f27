"""Motion of robots, never into a wall, one robot per cell.

`drive` moves along free cells, 8-connected, without cutting corners. `glide` moves along waypoints at any position.
Positions are integers, thousandths of a cell, so that a motion has the same result on every machine. A cell extends
half a cell from its center to every side.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FINE, FREE, HEADINGS, Cell, Grid, Mask, Point, cell_of

Taken = NDArray[np.uint8] | Mask
"""Cells that a center may not enter: bits that say why, or a mask of cells near robots."""

_STRIDE = 100
"""`glide` checks at least every tenth of a cell, and every tenth of its distance if that is less than a cell."""

DIAGONAL = math.sqrt(2.0)

ROUNDING = 1e-9
"""Tolerance for rounding errors, in cells: 0.3 m per step must be 3 cells of 0.1 m."""

WALL, ROBOT, PERSON, INTERFERENCE, NOT_BLOCKED = "wall", "robot", "person", "interference", ""
"""Why a robot stopped early."""

TAKEN_BY_ROBOT, TAKEN_BY_PERSON = 1, 2
"""Bits of a cell that a robot's center may not enter because it is close to another robot or to a person."""


@dataclass(frozen=True)
class Motion:
    """The result of one robot's move."""

    point: Point
    """Final position."""
    direction: tuple[int, int]
    """Direction (dx, dy) in which the robot heads in the end; (0, 0) if it did not move."""
    cells: list[Cell]
    """Cells (x, y) entered, in order."""
    length: float
    """Distance driven, in cells."""
    blocked: str
    """Why the robot stopped before the end of its path; empty if the distance was used up."""
    carry: float = 0.0
    """Unused distance, too short for the next cell; the next step adds it to its own."""
    bump: tuple[int, int] = (0, 0)
    """Direction (dx, dy) of the wall that stopped the robot; (0, 0) if none did."""


def drive(
    truth: Grid, taken: Taken, start: Cell, path: list[Cell], way: float, diagonal: float = DIAGONAL
) -> Motion:
    """Move one robot from cell `start` along `path` for at most `way` cells.

    `truth` (uint8) and `taken` have shape (h, w). A cell of the path that is no neighbor of the previous one ends it
    like a wall. Steps to 4-neighbors have length 1, others `diagonal`.
    """
    (x, y), direction, bump = start, (0, 0), (0, 0)
    cells: list[Cell] = []
    length = used = carry = 0.0
    blocked = NOT_BLOCKED
    for there in path:
        dx, dy = there[0] - x, there[1] - y
        if max(abs(dx), abs(dy)) != 1 or not _is_passable(truth, (x, y), there):
            blocked, bump = WALL, (dx, dy)
            break
        if taken[there[1], there[0]]:
            blocked = _taker(taken[there[1], there[0]])
            break
        cost = diagonal if dx and dy else 1.0
        if used + cost > way + ROUNDING:
            carry = max(0.0, way - used)
            break
        used += cost
        length += DIAGONAL if dx and dy else 1.0
        (x, y), direction = there, (dx, dy)
        cells.append(there)
    return Motion((x * FINE, y * FINE), direction, cells, length, blocked, carry, bump)


def glide(truth: Grid, taken: Taken, start: Point, points: list[Point], way: float) -> Motion:
    """Move one robot along straight lines between waypoints, for at most `way` cells.

    `truth` (uint8) and `taken` have shape (h, w). `start` and the waypoints are in thousandths of a cell. The robot
    stops at the last checked position within `way`.
    """
    at, length, blocked = start, 0.0, NOT_BLOCKED
    bump = 0, 0
    cells: list[Cell] = []
    for ahead in _positions(start, points, min(_STRIDE, max(1, int(way * _STRIDE)))):
        step = math.hypot(ahead[0] - at[0], ahead[1] - at[1]) / FINE
        if length + step > way:
            break
        here, there = cell_of(at), cell_of(ahead)
        if here != there:
            if not _is_passable(truth, here, there):
                blocked, bump = WALL, (ahead[0] - at[0], ahead[1] - at[1])
                break
            if taken[there[1], there[0]]:
                blocked = _taker(taken[there[1], there[0]])
                break
            cells.append(there)
        at, length = ahead, length + step
    return Motion(at, (at[0] - start[0], at[1] - start[1]), cells, length, blocked, bump=bump)


def _positions(start: Point, points: list[Point], stride: int) -> Iterator[Point]:
    """Yield positions at most `stride` apart on the straight lines from `start` through `points`."""
    for point in points:
        dx, dy = point[0] - start[0], point[1] - start[1]
        pieces = max(1, -(-max(abs(dx), abs(dy)) // stride))
        for piece in range(1, pieces + 1):
            yield start[0] + dx * piece // pieces, start[1] + dy * piece // pieces
        start = point


def _is_passable(truth: Grid, here: Cell, there: Cell) -> bool:
    """Return whether a robot can leave its cell for a neighbor; past a corner only if all cells there are free."""
    (x, y), (next_x, next_y) = here, there
    if not (0 <= next_x < truth.shape[1] and 0 <= next_y < truth.shape[0]):
        return False
    return bool(truth[next_y, next_x] == truth[y, next_x] == truth[next_y, x] == FREE)


def _taker(bits: int) -> str:
    """Return what blocks a robot before a cell with these bits."""
    return PERSON if bits & TAKEN_BY_PERSON else ROBOT


def swept(start: Cell, cells: list[Cell]) -> list[Cell]:
    """Return all cells that a motion proves free: the entered cells, and both cells beside each diagonal step."""
    result: list[Cell] = []
    x, y = start
    for next_x, next_y in cells:
        if next_x != x and next_y != y:
            result += [(next_x, y), (x, next_y)]
        result.append((next_x, next_y))
        x, y = next_x, next_y
    return result


def heading_of(dx: int, dy: int) -> int:
    """Return the heading of a step to a neighbor, in eighths of a turn from +x toward +y."""
    return round(math.atan2(dy, dx) / (math.pi / 4)) % HEADINGS


@lru_cache(maxsize=64)
def too_near(reach: float) -> Mask:
    """Cells less than `reach` cells, or one cell, from the middle one, as a square mask."""
    side = np.arange(-int(reach), int(reach) + 1)
    return side[:, None] ** 2 + side[None, :] ** 2 < max(reach, 1.0) ** 2


def mark_near(taken: NDArray[np.uint8], cell: Cell, reach: float, bit: int) -> NDArray[np.uint8]:
    """Set a bit of the cells less than `reach` cells from `cell`; return the changed part of `taken`, a view."""
    near = too_near(reach)
    x, y = cell
    side = len(near) // 2
    cut_x, cut_y = max(0, side - x), max(0, side - y)
    here = taken[max(0, y - side) : y + side + 1, max(0, x - side) : x + side + 1]
    here |= near[cut_y : cut_y + here.shape[0], cut_x : cut_x + here.shape[1]] * np.uint8(bit)
    return here


def clear(marked: Iterable[NDArray[np.uint8]]) -> None:
    """Remove the marks from parts of a grid."""
    for part in marked:
        part[:] = 0
