"""Artificial potential field: forces on a robot, and its motion under them (leader paper, section III-B).

Units are meters, seconds and newtons; the robot has unit mass. Euler's method with a fixed step of 0.05 s integrates
the motion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from protocol.arrays import Cells, FloatRows, Floats
from protocol.grid import FREE, OCCUPIED, Grid
from protocol.kernels import kernel

TIME_STEP = 0.05
"""Seconds of one Euler step."""

SUBSTEPS = 20
"""Euler steps per world step of one second."""

_TOUCH = 0.01
"""Least distance in meters that counts, so that forces stay finite."""


class FieldParameters(NamedTuple):
    """Gains and ranges of the potential field."""

    rho_robots: float
    rho_obstacles: float
    """`rho_robots`, `rho_obstacles`: ranges of the repulsion by robots, and by obstacles, in meters; the first is at
    least as large (Eq. 4)."""
    gain_robots: float
    gain_obstacles: float
    """`gain_robots`, `gain_obstacles`: k of Eq. (2) for each of them."""
    gain_frontier: float
    """k_att of Eq. (6)."""
    damping: float
    """Newtons for each meter per second."""


@kernel
def repulsion(distance: float, rho: float, gain: float) -> float:
    """Eq. (2): k (1 / d - 1 / rho) / d^2 within rho, away from the source; 0 beyond."""
    if distance > rho:
        return 0.0
    near = max(distance, _TOUCH)
    return gain * (1.0 / near - 1.0 / rho) / (near * near)


def glide(
    floor: Grid,
    resolution: float,
    at: tuple[float, float],
    velocity: Floats,
    frontier: Cells,
    robots: FloatRows,
    field: FieldParameters,
    top_speed: float,
    drifts: FloatRows | None = None,
) -> tuple[FloatRows, Floats]:
    """Integrate a robot's motion over one step of the world.

    A robot that would leave the free cells of its map slides along their border. The closest of the `frontier` cells
    attracts it (Eq. 6); the `robots`, positions of shape (m, 2), within range repel it (Eq. 3). During the step they
    move by `drifts`, shape (m, 2); by default, they stay. Positions and drifts are in cells, `resolution` is in meters
    per cell, velocities are in meters per second.

    Returns the position after each Euler step, shape (SUBSTEPS, 2), and the velocity at the end, shape (2,).
    """
    moving = velocity.copy()
    others = np.hstack([robots, np.zeros_like(robots) if drifts is None else drifts])
    numbers = np.array([*field, top_speed, resolution])
    path: FloatRows = _integrate(floor, frontier, others, np.array(at, np.float64), moving, numbers)
    return path, moving


@kernel
def closest_obstacle(floor: Grid, x: float, y: float, reach: float, out: Floats) -> None:
    """Write to `out` the closest point of an occupied cell within `reach` cells of (x, y); NaN if there is none."""
    height, width = floor.shape
    out[:] = np.nan
    best = reach * reach
    for cy in range(max(0, int(y - reach)), min(height, int(y + reach) + 2)):
        for cx in range(max(0, int(x - reach)), min(width, int(x + reach) + 2)):
            if floor[cy, cx] == OCCUPIED:
                px = min(max(x, cx - 0.5), cx + 0.5)
                py = min(max(y, cy - 0.5), cy + 0.5)
                distance = (px - x) ** 2 + (py - y) ** 2
                if distance < best:
                    best = distance
                    out[0] = px
                    out[1] = py


@kernel
def _integrate(
    floor: Grid, frontier: Cells, robots: FloatRows, at: Floats, velocity: Floats, numbers: Floats
) -> FloatRows:
    # Rows of `robots` have a position (x, y) and the way that the robot drives during the step.
    path = np.empty((SUBSTEPS, 2))
    rho_robots, rho_obstacles, gain_robots, gain_obstacles, gain_frontier, damping, top, size = numbers
    obstacle = np.empty(2)
    other = np.empty(2)
    force = np.empty(2)
    for step in range(len(path)):
        force[:] = -damping * velocity
        best = np.inf
        goal = -1
        for point in range(len(frontier)):
            distance = (frontier[point, 0] - at[0]) ** 2 + (frontier[point, 1] - at[1]) ** 2
            if distance < best:
                best = distance
                goal = point
        if goal >= 0 and best > 0.0:
            distance = np.sqrt(best)
            pull = gain_frontier * (distance * size)
            for axis in range(2):
                force[axis] += pull * (frontier[goal, axis] - at[axis]) / distance
        for robot in range(len(robots)):
            for axis in range(2):
                other[axis] = robots[robot, axis] + robots[robot, 2 + axis] * step / len(path)
            distance = np.hypot(at[0] - other[0], at[1] - other[1])
            push = repulsion(distance * size, rho_robots, gain_robots)
            if distance > 0.0:
                for axis in range(2):
                    force[axis] += push * (at[axis] - other[axis]) / distance
        closest_obstacle(floor, at[0], at[1], rho_obstacles / size, obstacle)
        distance = np.hypot(at[0] - obstacle[0], at[1] - obstacle[1])
        if distance > 0.0:
            push = repulsion(distance * size, rho_obstacles, gain_obstacles)
            for axis in range(2):
                force[axis] += push * (at[axis] - obstacle[axis]) / distance
        velocity += force * TIME_STEP
        speed = np.hypot(velocity[0], velocity[1])
        if speed > top:
            velocity *= top / speed
        for axis in range(2):
            before = at[axis]
            at[axis] += velocity[axis] * TIME_STEP / size
            x, y = int(np.floor(at[0] + 0.5)), int(np.floor(at[1] + 0.5))
            if not (0 <= x < floor.shape[1] and 0 <= y < floor.shape[0]) or floor[y, x] != FREE:
                at[axis] = before
                velocity[axis] = 0.0
        path[step] = at
    return path
