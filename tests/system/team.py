"""Robots and the radio between them in one thread, so that a test can inspect each robot at every step.

`Team` does the work of the processes and the bus. The test chooses the robots' positions: they explore a `World`, or
stand in given cells.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.encodings.base import NO_SENDER
from agent.encodings.catalog import make_encoding
from agent.radio_events import respond
from agent.robot import Robot
from agent.settings import Settings
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from netshaper.ledger import ROW
from protocol.grid import FREE, OCCUPIED, Grid, ray_table
from protocol.messages import MediumEvent, Move, RobotFrames, Sense
from tests.agent.outline.edit_scripts import canonical
from tests.netshaper.network import Network
from worldsim import generators
from worldsim.laser import cast
from worldsim.maps import Map

Cell = tuple[int, int]


def small_plan(name: str = "office", side_m: float = 12.0, map_seed: int = 0, **settings: Any) -> Plan:
    """A plan on a small generated map, in memory."""
    world_map = generators.make(name, seed=map_seed, width_m=side_m, height_m=side_m)
    return plan_on(world_map, **settings)


def plan_on(world_map: Map, **settings: Any) -> Plan:
    """A plan in memory with the thesis's map encoding (polygons) and strategy (Meier) unless set otherwise."""
    thesis = {"map_encoding": "polygons", "strategy": "meier"}
    return plans.make(parse({"bus": "memory", "sensor_range": 3.0} | thesis | settings), world_map)


def corridor(length: int, height: int = 5) -> Map:
    """A corridor of `length` by `height` cells, with niches in its walls so that its map is not trivial."""
    cells = np.full((height + 4, length + 2), OCCUPIED, np.uint8)
    cells[2:-2, 1:-1] = FREE
    cells[1, 3:-1:4] = FREE
    cells[-2, 5:-1:6] = FREE
    return Map("corridor", cells, 0.1)


def decoded(robot: Robot, step: int) -> tuple[Grid, Grid]:
    """Decode all logs that a robot holds, its own included, as a robot does that joins the team now.

    Return that robot's planning grid, and its shared map if it has the same own grid.
    """
    listener = make_encoding(replace(robot.settings, incarnations=2, incarnation=1))
    for map_id, log in enumerate(robot.replication.replica.logs):
        if len(log):
            listener.apply(map_id, log.read(0), step=step, sender=NO_SENDER)
    planning = listener.merge(np.zeros_like(robot.own))
    return planning, listener.shared_map(robot.own, planning)


class Member:
    """A robot without its process."""

    def __init__(self, settings: Settings) -> None:
        self.robot = Robot(settings)

    def perceive(self, sense: Sense) -> None:
        self.robot.perceive(sense)

    def take(self, event: MediumEvent) -> RobotFrames | None:
        """Handle an event of the relay; return the frames that the robot sends in response."""
        return respond(self.robot, event, pytest.fail)

    def __call__(self, event: MediumEvent) -> list[RobotFrames]:
        frames = self.take(event)
        return [] if frames is None else [frames]

    def decide(self) -> Move:
        return self.robot.decide()


class Team:
    """All robots of a plan; the argument `members` replaces some of them."""

    def __init__(self, plan: Plan, members: Mapping[int, Member] | None = None) -> None:
        self.plan = plan
        self.truth: Grid = plan.map.cells
        self.world = plan.make_world()
        self.members = {number: Member(settings) for number, settings in plan.robot_settings.items()} | dict(
            members or {}
        )
        self.step = 0
        self.sent_bytes: dict[int, int] = {}
        """Bytes that robots submitted to the relay, by step."""
        self.moves: dict[int, Move] = {}
        self._network = Network(plan.radio, self.members)
        self._rows: list[bytes] = []
        self._laser = ray_table(plan.world.bodies[0].range_cells, plan.world.beams)

    @property
    def robots(self) -> list[Robot]:
        return [member.robot for _, member in sorted(self.members.items())]

    def held(self, robot: int, map_id: int) -> object:
        """A robot's copy of a map in a comparable form; None if it has none."""
        polygons = self.members[robot].robot.polygons.get(map_id)
        return None if polygons is None else canonical(polygons)

    def ledger(self) -> NDArray[np.void]:
        return np.frombuffer(b"".join(self._rows), ROW)

    def explore(self, steps: int) -> None:
        """Explore until the first robot is done, for at most `steps` steps."""
        while self.step < steps and not any(move.explored for move in self.moves.values()):
            senses = self.world.advance(self.moves)
            self.play(senses, self.world.cells)

    def stand(self, cells: Mapping[int, Cell]) -> None:
        """Play one step with the robots in these cells."""
        no_robots = np.zeros(self.truth.shape, np.bool_)
        senses = {
            robot: Sense(
                self.step + 1,
                x,
                y,
                0,
                b"",
                cast(self.truth, no_robots, self._laser, x, y).tobytes(),
                "",
                0,
                0,
            )
            for robot, (x, y) in cells.items()
        }
        self.play(senses, cells)

    def kill(self, robot: int) -> None:
        """Let a robot's process end."""
        self.world.remove(robot)
        self._network.radio.lost(robot)

    def play(self, senses: Mapping[int, Sense], cells: Mapping[int, Cell]) -> None:
        """Play one step with these readings of the robots, which stand in these cells."""
        self.step += 1
        for robot, sense in senses.items():
            self.members[robot].perceive(sense)
        step = self._network.step(self.step, cells)
        self.sent_bytes[self.step] = sum(len(payload) for _, payload in step.submitted)
        self._rows.append(step.report.rows)
        self.moves = {robot: self.members[robot].decide() for robot in sorted(senses)}
