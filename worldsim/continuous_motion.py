"""Continuous motion: robots move along waypoints at any position, never into a wall, one robot per cell.

Positions are integers, thousandths of a cell, so that a drive has the same result on every machine. A cell
extends half a cell from its center to every side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, Grid
from worldsim.cell_motion import NOT_BLOCKED, ROBOT, WALL

FINE = 1000
"""Resolution of positions: steps per cell."""

_STRIDE = 100
"""A drive is checked at least every tenth of a cell, and every tenth of its distance if that is less than a cell."""

Point = tuple[int, int]


@dataclass(frozen=True)
class Glide:
    """The result of one robot's continuous move."""

    point: Point
    """Final position (x, y), in thousandths of a cell."""
    cells: list[tuple[int, int]]
    """Cells (x, y) entered, in order."""
    length: float
    """Distance driven, in cells."""
    blocked: str
    """Why the robot stopped before its last waypoint; empty if the distance was used up."""


def cell_of(point: Point) -> tuple[int, int]:
    """Return the cell of a point; a border belongs to the cell on its right, or below."""
    return (point[0] + FINE // 2) // FINE, (point[1] + FINE // 2) // FINE


def glide(truth: Grid, taken: NDArray[np.bool_], start: Point, points: list[Point], way: float) -> Glide:
    """Move one robot along straight lines between waypoints, for at most `way` cells.

    `truth` (uint8) and `taken` (bool, cells of other robots) have shape (h, w). `start` and the waypoints are in
    thousandths of a cell. The robot stops at the last checked position within `way`.
    """
    stride = min(_STRIDE, max(1, int(way * _STRIDE)))
    at, length = start, 0.0
    cells: list[tuple[int, int]] = []
    for point in points:
        dx, dy = point[0] - at[0], point[1] - at[1]
        pieces = max(1, -(-max(abs(dx), abs(dy)) // stride))
        origin = at
        for piece in range(1, pieces + 1):
            ahead = origin[0] + dx * piece // pieces, origin[1] + dy * piece // pieces
            step = math.hypot(ahead[0] - at[0], ahead[1] - at[1]) / FINE
            if length + step > way:
                return Glide(at, cells, length, NOT_BLOCKED)
            here, there = cell_of(at), cell_of(ahead)
            if here != there:
                if not _is_passable(truth, here, there):
                    return Glide(at, cells, length, WALL)
                if taken[there[1], there[0]]:
                    return Glide(at, cells, length, ROBOT)
                cells.append(there)
            at, length = ahead, length + step
    return Glide(at, cells, length, NOT_BLOCKED)


def _is_passable(truth: Grid, here: tuple[int, int], there: tuple[int, int]) -> bool:
    """Return whether a robot can enter a neighboring cell; past a corner only if all four cells there are free."""
    height, width = truth.shape
    around = [(x, y) for x in (here[0], there[0]) for y in (here[1], there[1])]
    return all(0 <= x < width and 0 <= y < height and truth[y, x] == FREE for x, y in around)
