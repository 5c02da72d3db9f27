"""All simulated robots, step by step. The caller passes the time in: equal inputs at equal times have equal results."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
from msgspec.structs import replace as changed

from deploy.scenario.bodies import laser_of
from deploy.scenario.plan import Plan
from deploy.serve.giving_way import Others, Way
from deploy.serve.navigator import Navigator
from deploy.serve.robot import SimulatedRobot
from protocol.nanoseconds import SECOND
from protocol.range_scans import MAX_REACH_M
from protocol.transforms import Pose
from worldsim.localization import Localization
from worldsim.sensors import RobotSensors, SensorSettings
from worldsim.velocity_world import VelocityWorld

LATEST = 10
"""Steps by which the simulation may be late; it skips the time beyond them."""
AVOID_M = 3.0
"""Distance up to which robots plan around each other."""
MARGIN_CELLS = 1.0
"""Distance that a robot which gives way keeps in addition to both radii."""
LASER_AHEAD_M = 0.1
"""How far the laser is ahead of the robot's center, at most half its radius."""


class Swarm:
    """The robots of a plan; they begin at `start_ns`, nanoseconds of the caller's clock.

    `rate` is the number of steps per second; `sees_robots` says whether lasers measure the distance to other robots.
    """

    def __init__(self, plan: Plan, start_ns: int, *, rate: float = 10.0, sees_robots: bool = False) -> None:
        scenario, world_map = plan.scenario, plan.map
        self.step_ns = round(SECOND / rate)
        self._start_ns, self._skipped_ns = start_ns, 0
        frame = world_map.frame
        sensors = tuple(_sensors(plan, robot) for robot in range(scenario.robots))
        headings = [robot % 4 * math.pi / 2 for robot in range(scenario.robots)]
        step_s = self.step_ns / SECOND
        self._radii = [body.radius_cells for body in plan.world.bodies]
        self.world = VelocityWorld(
            world_map.cells,
            frame,
            replace(plan.world, sensors=SensorSettings(sensors, world_map.resolution)),
            headings,
            step_s,
            sees_robots=sees_robots,
        )
        self.robots: list[SimulatedRobot] = []
        for number, own in enumerate(sensors):
            start, hardware = self.world.pose(number), scenario.body_of(number)
            navigator = Navigator(self.world.floors[number], frame, hardware.speed, step_s)
            localization = Localization(start, own.pose, frame.resolution, scenario.seed, number)
            mount = Pose(min(LASER_AHEAD_M, hardware.radius / 2), 0.0, 0.0)
            self.robots.append(
                SimulatedRobot(start, frame, own.beams, mount, navigator, localization, hardware.speed)
            )
        self._look()

    @property
    def time_ns(self) -> int:
        """Time since the start, in simulated nanoseconds: that of the last step."""
        return self.world.step * self.step_ns

    @property
    def now_ns(self) -> int:
        """Time of the last step by the caller's clock."""
        return self._start_ns + self._skipped_ns + self.time_ns

    @property
    def next_ns(self) -> int:
        """Time of the next step by the caller's clock."""
        return self.now_ns + self.step_ns

    def advance(self, now_ns: int) -> int:
        """Simulate all steps that are due; return how many."""
        late = (now_ns - self.now_ns) // self.step_ns - LATEST
        if late > 0:
            self._skipped_ns += late * self.step_ns
        steps = 0
        while self.next_ns <= now_ns:
            self._step()
            steps += 1
        return steps

    def _step(self) -> None:
        velocities = [
            robot.decide(self.next_ns, self._others(number)) for number, robot in enumerate(self.robots)
        ]
        blocked = self.world.advance(velocities)
        for number, robot in enumerate(self.robots):
            robot.moved(self.world.pose(number), blocked[number], self.time_ns / SECOND)
        self._look()

    def _others(self, number: int) -> Others:
        return Others(partial(self.world.near_others, number, AVOID_M), partial(self._ways, number))

    def _ways(self, number: int, everyone: bool) -> list[Way]:
        """Return the ways of other robots that drive to a goal: of those with lower numbers, or of `everyone`."""
        return [
            Way(
                np.concatenate([np.array([self.world.cell(other)], np.int32), robot.navigator.path]),
                self._radii[number] + self._radii[other] + MARGIN_CELLS,
            )
            for other, robot in enumerate(self.robots)
            if robot.is_driving and (other < number or (everyone and other != number))
        ]

    def _look(self) -> None:
        for number, robot in enumerate(self.robots):
            robot.look(self.world.scan(number, robot.laser_pose))


def _sensors(plan: Plan, robot: int) -> RobotSensors:
    """Return the sensors of a robot; its laser has its largest range."""
    hardware = plan.scenario.body_of(robot)
    reach_m = min(hardware.laser.max_range_m or hardware.sensor_range, MAX_REACH_M)
    beams = changed(laser_of(hardware, plan.scenario.beams), reach_mm=round(1000 * reach_m))
    return RobotSensors(hardware.laser, hardware.pose, beams)
