"""A run whose caller chooses the goals of some robots: the common core of both environments.

It is a run in memory, advanced by its caller. Robots under control wait at the end of each step, after they have merged
their maps. If one of them needs a goal, the caller chooses; else they drive on to their targets.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property

import msgspec
import numpy as np

from agent.strategies.base import Situation
from deploy.run.in_memory import MemoryRun
from deploy.run.launch import Outcome
from deploy.run.result import Result, conclude
from deploy.scenario.plan import Plan
from murmur.gym.chosen_goals import Candidates, ChosenGoals
from protocol.grid import Cell, Grid
from worldsim.ending import OUT_OF_STEPS

STRATEGY = f"{ChosenGoals.__module__}:{ChosenGoals.__qualname__}"
"""The name of the strategy of robots under control."""


@dataclasses.dataclass(frozen=True)
class Progress:
    """What has happened since the last choice of goals; the argument of reward functions."""

    steps: int
    """Steps of the run, each of one second."""
    new_cells: int
    """Reachable cells that the team has seen for the first time."""
    seen_cells: int
    """Reachable cells that the team has seen so far."""
    reachable_cells: int
    """Cells that the team can see in total."""
    sent_bytes: int
    """Bytes that the whole team has sent."""
    is_over: bool
    """Whether the run has ended, or all robots under control are lost."""


class Episode:
    """One run, in which the caller chooses the goals of `robots`, each among its `most` nearest candidates.

    With `every`, the caller chooses after that many steps at the latest; with 0, only if a robot needs a goal.
    """

    def __init__(self, plan: Plan, robots: Sequence[int], most: int, every: int = 0) -> None:
        self.plan = with_control(plan, robots)
        self.situations: dict[int, Situation] = {}
        """What each robot under control knows, by its number; of a lost robot, what it knew last."""
        self._waiting: tuple[int, ...] = ()
        """Robots under control that wait for the caller, ascending; empty once the run is over."""
        self._most = most
        self._every = every
        self._strategies: dict[int, ChosenGoals] = {}
        """The strategy of each robot under control, by its number; of a lost robot, its last one."""
        self._candidates: dict[int, Candidates] = {}
        self.step = 0
        """The last step in which a robot under control took part."""
        self._seen = self._sent = 0
        """Cells seen, and bytes sent, up to this step."""
        self._began = time.perf_counter()
        self._run = MemoryRun(self.plan, held=robots)
        self._moments = self._run.steps()
        self._run_to_choice()

    def advance(self, goals: Mapping[int, Cell]) -> Progress:
        """Let robots drive to new goals, and return when one needs the next goal, or the run is over.

        `goals` has a candidate for each robot that gets a new goal. Robots without one keep their targets; those that
        have none stay for a step.
        """
        for robot, goal in goals.items():
            self._strategies[robot].goal = goal
        step, seen, sent = self.step, self._seen, self._sent
        while self._waiting:
            for robot in self._waiting:
                self._run.agents[robot].decide()
            if self._run_to_choice() or self.step - step == self._every:
                break
        return self._progress(step, seen, sent)

    @property
    def active(self) -> tuple[int, ...]:
        """Robots under control that take part in the run, or will again, ascending; empty once the run is over."""
        return tuple(
            robot
            for robot in self.situations
            if self._waiting and (robot in self._waiting or self._returns(robot))
        )

    @property
    def begun(self) -> Progress:
        """What has happened from the start of the run to this step."""
        return self._progress(0, 0, 0)

    @property
    def is_truncated(self) -> bool:
        """Whether the run has ended because it has no steps left, and not without the robots under control."""
        end = self._run.records.end
        return end is not None and end.reason == OUT_OF_STEPS and end.step == self.step

    @cached_property
    def result(self) -> Result:
        """The result of the run, as `murmur.explore` returns it; RuntimeError before its end."""
        if self._run.records.end is None:
            raise RuntimeError("the episode has not ended: call step until it is terminated or truncated")
        seconds = time.perf_counter() - self._began
        return conclude(self.plan, Outcome(self._run.records, {}), None, seconds)

    def candidates(self, robot: int) -> Candidates:
        """Return the goals that a robot can choose from; none if it takes no part now."""
        if robot not in self._candidates:
            most = 0 if self._is_away(robot) else self._most
            self._candidates[robot] = self._strategies[robot].candidates(self.situations[robot], most)
        return self._candidates[robot]

    def needs_goal(self, robot: int) -> bool:
        """Return whether there are goals, and a robot has no target or is done with it."""
        needs = self._strategies[robot].needs_goal(self.situations[robot])
        return needs and len(self.candidates(robot).cells) > 0

    def target(self, robot: int) -> Cell | None:
        """Return the cell to which a robot drives."""
        return self._strategies[robot].target

    def team_map(self) -> Grid:
        """Return the cells that the team has seen, uint8 of shape (h, w)."""
        robots = (agent.robot for agent in self._run.agents)
        seen: Grid = np.maximum.reduce([robot.own for robot in robots if robot is not None])
        return seen

    def places(self) -> dict[int, tuple[float, float]]:
        """Return the true position (x, y) of each robot in the world, in cells."""
        poses = self._run.records.world[-1].pose_rows
        cell_mm = 1000 * self.plan.map.resolution
        return {robot: (x / cell_mm, y / cell_mm) for robot, x, y, _ in poses.tolist()}

    def _run_to_choice(self) -> bool:
        """Run until robots under control wait at the end of a step; return whether one of them needs a goal."""
        self._candidates.clear()
        self._waiting = ()
        for _ in self._moments:
            agents = enumerate(self._run.agents)
            waiting = {
                robot: agent.situation for robot, agent in agents if agent.situation and not agent.done
            }
            if waiting:
                self.situations |= waiting
                self._strategies |= {robot: self._strategy(robot) for robot in waiting}
                self._waiting = tuple(waiting)
                self.step = self._run.records.step
                self._seen = self._run.records.world[-1].seen
                self._sent += self._run.records.carried
                break
        return any(self.needs_goal(robot) for robot in self._waiting)

    def _progress(self, step: int, seen: int, sent: int) -> Progress:
        """Return what has happened since a step, up to which the team had seen and sent so much."""
        reachable = self._run.records.world[-1].reachable
        done, new_cells, sent_bytes = self.step - step, self._seen - seen, self._sent - sent
        return Progress(done, new_cells, self._seen, reachable, sent_bytes, is_over=not self._waiting)

    def _is_away(self, robot: int) -> bool:
        """Return whether a robot takes no part in a run that is not over."""
        return bool(self._waiting) and robot not in self._waiting

    def _returns(self, robot: int) -> bool:
        """Return whether a robot that takes no part now will again: it is stopped for some steps, or restarts later."""
        return any(
            self.step <= fault.step
            if fault.kind == "restart"
            else fault.kind == "stop" and fault.step <= self.step < fault.step + fault.steps
            for fault in self.plan.scenario.faults
            if fault.robot == robot
        )

    def _strategy(self, robot: int) -> ChosenGoals:
        """Return the strategy of a robot under control."""
        controlled = self._run.agents[robot].robot
        assert controlled is not None
        assert isinstance(controlled.strategy, ChosenGoals)
        return controlled.strategy


def with_control(plan: Plan, robots: Collection[int]) -> Plan:
    """Return a plan in which the caller chooses the goals of these robots."""
    settings = {
        number: msgspec.structs.replace(settings, strategy=STRATEGY, options={})
        if number in robots
        else settings
        for number, settings in plan.robot_settings.items()
    }
    return dataclasses.replace(plan, robot_settings=settings)
