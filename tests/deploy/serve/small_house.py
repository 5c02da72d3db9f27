"""A house of two rooms with a door, as a plan of simulated robots; a third room has no door."""

from __future__ import annotations

from typing import Any

import numpy as np

from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from deploy.serve.robot import SimulatedRobot
from deploy.serve.swarm import Swarm
from protocol.grid import FREE, OCCUPIED, Grid
from protocol.transforms import Pose
from worldsim.maps import Map

CELL = 0.1
STEP_NS = 100_000_000
FIRST_ROOM, SECOND_ROOM, CLOSED_ROOM = (1.5, 2.0), (4.5, 1.0), (4.5, 3.5)


def house() -> Grid:
    truth = np.full((42, 62), OCCUPIED, np.uint8)
    truth[1:-1, 1:-1] = FREE
    truth[:, 30] = OCCUPIED
    truth[25:33, 30] = FREE  # the door, from 0.9 to 1.7 m above the lower border
    truth[14, 31:] = OCCUPIED
    return truth


def house_plan(*starts: tuple[float, float], **settings: Any) -> Plan:
    given = {"robots": len(starts), "starts": starts, "radius": 0.2, "sensor_range": 8.0} | settings
    return plans.make(parse(given), Map("house", house(), CELL))


def swarm(*starts: tuple[float, float], **settings: Any) -> Swarm:
    """Robots that start at time 0."""
    return Swarm(house_plan(*starts, **settings), 0)


def goal_at(robot: SimulatedRobot, place: tuple[float, float], yaw: float = 0.0) -> Pose:
    """A pose of the common frame in the map frame of a robot."""
    return robot.start.inverse().then(Pose(*place, yaw))


def run(robots: Swarm, seconds: float) -> None:
    until = robots.now_ns + round(seconds * 10**9)
    while robots.next_ns <= until:
        robots.advance(robots.next_ns)


def corridor(length: int, room: int) -> Grid:
    """A room of 2 m, and a corridor of `length` cells in which robots cannot pass each other.

    At its other end is a room of `room` cells; without any, a dead end.
    """
    truth = np.full((24, 22 + length + room), OCCUPIED, np.uint8)
    truth[2:-2, 2:20] = FREE
    truth[9:15, 20 : 20 + length] = FREE
    truth[2:-2, 20 + length : 20 + length + room] = FREE
    return truth


def corridor_plan(length: int, room: int, *starts: tuple[float, float]) -> Plan:
    given = {"robots": len(starts), "starts": starts, "radius": 0.2, "sensor_range": 8.0}
    return plans.make(parse(given), Map("corridor", corridor(length, room), CELL))
