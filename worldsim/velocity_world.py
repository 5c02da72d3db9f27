"""A world by time: robots drive at velocities, with poses at any position and heading, as real ones do.

`worldsim.world` moves robots along planned cells, step by step. Here, a robot obeys a velocity until it gets another
one. It stops before walls, other robots, and people. Poses are in meters and radians, counterclockwise, in the frame
of the map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Uint16s
from protocol.grid import FINE, FREE, HEADINGS, Cell, Grid, Mask, Point, cell_of, enlarge, ray_table
from protocol.keyed_random import keyed_random
from protocol.map_frame import MapFrame
from protocol.range_scans import UNIT
from protocol.scans import draw
from protocol.transforms import Pose
from worldsim.laser import cast
from worldsim.motion import NOT_BLOCKED, TAKEN_BY_ROBOT, clear, glide, mark_near
from worldsim.people import People, PeopleSettings, RobotDisc
from worldsim.range_laser import NO_DISCS, RangeLaser
from worldsim.world import WorldSettings, reachable_by_team


class Velocity(NamedTuple):
    """A velocity: meters per second ahead, and radians per second counterclockwise."""

    ahead: float
    turn: float


STOP = Velocity(0.0, 0.0)


class VelocityWorld:
    """All robots and people on the true map, uint8 of shape (h, w), whose cells are solid if they are not free.

    `frame` tells where the map lies. `settings` gives bodies, start cells, seed, sensors, which it must have, and
    people, whose speed is in cells per second. `headings` are those of the robots at the start, in radians, and a step
    lasts `step_s` seconds. `sees_robots`: whether lasers measure the distance to other robots; if not, beams that
    meet one have no measurement.
    """

    def __init__(
        self,
        truth: Grid,
        frame: MapFrame,
        settings: WorldSettings,
        headings: Sequence[float],
        step_s: float,
        *,
        sees_robots: bool = False,
    ) -> None:
        assert settings.sensors is not None
        self.frame = frame
        self.step = 0
        self.seen = np.zeros_like(truth)
        """Grid of all cells seen by the team's lasers."""
        self.floors = [enlarge(truth, body.radius_cells) for body in settings.bodies]
        """For each robot: the grid of cells that its center may enter."""
        self.reachable = reachable_by_team(truth, settings)
        """The free cells that the team can see, shape (h, w)."""
        self._truth, self._settings, self._step_s = truth, settings, step_s
        self._sees_robots = sees_robots
        self._points: list[Point] = [(x * FINE, y * FINE) for x, y in settings.starts]
        self._yaws = list(headings)
        self._taken = np.zeros(truth.shape, np.uint8)
        sensors = settings.sensors
        cell = sensors.resolution
        self._lasers = [RangeLaser(each.laser, each.beams, cell) for each in sensors.robots]
        self._ray_tables = [
            ray_table(min(each.beams.reach_mm / 1000 / cell, max(truth.shape) * 2)) for each in sensors.robots
        ]
        self._people = None
        if (people := settings.people) is not None:
            per_step = PeopleSettings(people.number, people.speed * step_s, people.radius_cells)
            self._people = People(truth, self.reachable, self._robot_discs(), per_step, settings.seed)

    @property
    def coverage(self) -> float:
        """Share of the reachable cells that the team's lasers have seen."""
        return float(np.mean(self.seen[self.reachable] == FREE))

    def pose(self, robot: int) -> Pose:
        """Return the true pose of a robot."""
        x, y = self._points[robot]
        return Pose(*self.frame.position(x / FINE + 0.5, y / FINE + 0.5), self._yaws[robot])

    def cell(self, robot: int) -> Cell:
        """Return the cell (x, y) of a robot's center."""
        return cell_of(self._points[robot])

    def advance(self, velocities: Sequence[Velocity]) -> list[str]:
        """Move all robots in ascending order, and people, for a step; return what blocked each robot, or nothing."""
        self.step += 1
        blocked = [self._drive(robot, velocity) for robot, velocity in enumerate(velocities)]
        if self._people is not None:
            self._people.advance(self.step, self._robot_discs())
        return blocked

    def scan(self, robot: int, laser: Pose) -> Uint16s:
        """Measure in this step with the robot's laser, at pose `laser` on the robot.

        Ranges are in the form of `protocol.range_scans`, beams clockwise.
        """
        pose = self.pose(robot).then(laser)
        place = self.frame.place(pose)
        heading = self.frame.heading(pose)
        random = keyed_random(self._settings.seed, "laser", robot, self.step)
        position = place[0] / UNIT, place[1] / UNIT
        discs = NO_DISCS if self._people is None else self._people.discs
        others = self._others(robot)
        if self._sees_robots:
            discs = np.concatenate([discs, self._discs(others)])
        marked = [] if self._sees_robots else [self._mark(other, 0.0) for other in others]
        ranges = self._lasers[robot].ranges(
            self._truth, self._taken.view(np.bool_), position, heading, random, discs
        )
        clear(marked)
        self._see(robot)
        return ranges

    def near_others(self, robot: int, within_m: float) -> Mask:
        """Return the cells that a robot's center cannot enter because of robots within `within_m`, shape (h, w)."""
        near = np.zeros(self._truth.shape, np.uint8)
        here, own = self.pose(robot), self._settings.bodies[robot].radius_cells
        for other in self._others(robot):
            if math.dist(here[:2], self.pose(other)[:2]) <= within_m:
                reach = own + self._settings.bodies[other].radius_cells
                mark_near(near, self.cell(other), reach, TAKEN_BY_ROBOT)
        if self._people is not None:
            self._people.mark(near, own)
        return near.astype(np.bool_)

    def _drive(self, robot: int, velocity: Velocity) -> str:
        """Turn a robot, and drive along the middle of its turn; return what blocked it."""
        turn = velocity.turn * self._step_s
        direction = self._yaws[robot] + turn / 2
        self._yaws[robot] = math.remainder(self._yaws[robot] + turn, math.tau)
        way = velocity.ahead * self._step_s / self.frame.resolution
        x, y = start = self._points[robot]
        end = x + round(FINE * way * math.cos(direction)), y - round(FINE * way * math.sin(direction))
        if end == start:
            return NOT_BLOCKED
        own = self._settings.bodies[robot].radius_cells
        marked = [self._mark(other, own) for other in self._others(robot)]
        if self._people is not None:
            marked += self._people.mark(self._taken, own)
        motion = glide(self.floors[robot], self._taken, start, [end], abs(way) + 1)
        clear(marked)
        self._points[robot] = motion.point
        return motion.blocked

    def _others(self, robot: int) -> list[int]:
        return [other for other in range(len(self._points)) if other != robot]

    def _mark(self, other: int, radius_cells: float) -> NDArray[np.uint8]:
        """Mark the cells nearer to a robot than its radius and `radius_cells`; return the changed part."""
        reach = self._settings.bodies[other].radius_cells + radius_cells
        return mark_near(self._taken, self.cell(other), reach, TAKEN_BY_ROBOT)

    def _discs(self, robots: list[int]) -> NDArray[np.float64]:
        """Return robots in the form of `worldsim.people.People.discs`, shape (n, 3)."""
        rows = [
            (self._points[robot][0] / FINE + 0.5, self._points[robot][1] / FINE + 0.5,
             self._settings.bodies[robot].radius_cells)
            for robot in robots
        ]  # fmt: skip
        return np.array(rows).reshape(-1, 3)

    def _robot_discs(self) -> list[RobotDisc]:
        return [(self.cell(robot), body.radius_cells) for robot, body in enumerate(self._settings.bodies)]

    def _see(self, robot: int) -> None:
        """Count the cells that a robot sees from its cell."""
        table, (x, y) = self._ray_tables[robot], self.cell(robot)
        heading = round(-self._yaws[robot] / math.tau * HEADINGS) % HEADINGS
        no_robot = np.zeros(self._truth.shape, np.bool_)
        view = self._settings.bodies[robot].field_of_view
        draw(self.seen, table, x, y, cast(self._truth, no_robot, table, x, y, heading, view))
