"""Cell motion: robots move along free cells, 8-connected, without cutting corners, one robot per cell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, Grid

DIAGONAL = math.sqrt(2.0)

ROUNDING = 1e-9
"""Tolerance for rounding errors, in cells: 0.3 m per step must be 3 cells of 0.1 m."""

WALL, ROBOT, INTERFERENCE, NOT_BLOCKED = "wall", "robot", "interference", ""
"""Why a robot stopped early."""


@dataclass(frozen=True)
class Drive:
    """The result of one robot's move."""

    cells: list[tuple[int, int]]
    """Cells (x, y) entered, in order."""
    length: float
    """Distance driven, in cells."""
    carry: float
    """Unused distance, too short for the next cell; the next step adds it to its own."""
    blocked: str
    """Why the robot stopped before the end of its path; empty if the distance was used up."""


def drive(
    truth: Grid,
    taken: NDArray[np.bool_],
    start: tuple[int, int],
    path: list[tuple[int, int]],
    way: float,
    diagonal: float = DIAGONAL,
) -> Drive:
    """Move one robot from cell `start` along `path` for at most `way` cells.

    `truth` (uint8) and `taken` (bool, cells of other robots) have shape (h, w). A cell of the path that is no neighbor
    of the previous one ends it like a wall. Steps to 4-neighbors have length 1, others `diagonal`.
    """
    height, width = truth.shape
    x, y = start
    cells: list[tuple[int, int]] = []
    length = used = 0.0
    for next_x, next_y in path:
        dx, dy = next_x - x, next_y - y
        inside = 0 <= next_x < width and 0 <= next_y < height
        if not inside or max(abs(dx), abs(dy)) != 1 or truth[next_y, next_x] != FREE:
            return Drive(cells, length, 0.0, WALL)
        if dx and dy and (truth[y, next_x] != FREE or truth[next_y, x] != FREE):
            return Drive(cells, length, 0.0, WALL)
        if taken[next_y, next_x]:
            return Drive(cells, length, 0.0, ROBOT)
        cost = diagonal if dx and dy else 1.0
        if used + cost > way + ROUNDING:
            return Drive(cells, length, max(0.0, way - used), NOT_BLOCKED)
        used += cost
        length += DIAGONAL if dx and dy else 1.0
        x, y = next_x, next_y
        cells.append((x, y))
    return Drive(cells, length, 0.0, NOT_BLOCKED)


def swept(start: tuple[int, int], cells: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return all cells that a drive proves free: the entered cells, and both cells beside each diagonal step."""
    result: list[tuple[int, int]] = []
    x, y = start
    for next_x, next_y in cells:
        if next_x != x and next_y != y:
            result += [(next_x, y), (x, next_y)]
        result.append((next_x, next_y))
        x, y = next_x, next_y
    return result


def heading_of(dx: int, dy: int) -> int:
    """Return the heading of a step to a neighbor, in eighths of a turn from +x toward +y."""
    return round(math.atan2(dy, dx) / (math.pi / 4)) % 8
