"""A strategy whose goals come from outside: a policy chooses among the frontier segments that the robot knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from agent.planning.gain import information_gain
from agent.planning.path_planner import PathPlanner
from agent.settings import Settings
from agent.strategies.base import Situation
from agent.strategies.options import with_defaults
from agent.strategies.targets import SINGLE_CANDIDATE, Parts, TargetStrategy
from protocol.arrays import Cells, Floats, Int64s
from protocol.grid import Cell


@dataclass(frozen=True, eq=False)
class Candidates:
    """The goals that a robot can choose from, the nearest first."""

    cells: Cells
    """Their cells (x, y), int32 of shape (n, 2)."""
    ways: Floats
    """The length of the way to each, in cells, shape (n,)."""
    gains: Int64s
    """The number of unknown cells within sensor range of each, shape (n,)."""


class ChosenGoals(TargetStrategy):
    """A robot drives to the goal that is chosen for it, until that goal is no frontier any more."""

    name = "chosen-goals"
    summary = "drives to goals that a policy chooses (murmur.gym)"
    source = "Murmur, environments"
    options_type: ClassVar[type] = with_defaults(Parts, candidates="rfe")
    clashes = (*TargetStrategy.clashes, SINGLE_CANDIDATE)
    publishes_pose = True

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self.goal: Cell | None = None
        """The goal that the next decision takes; None: the robot keeps its target."""

    def needs_goal(self, situation: Situation) -> bool:
        """Return whether the robot has no target, or is done with it."""
        return super().is_due(situation)

    def is_due(self, situation: Situation) -> bool:
        """Return whether to take the chosen goal, or to give up a target that the robot is done with."""
        return self.goal is not None or self.needs_goal(situation)

    def candidates(self, situation: Situation, most: int) -> Candidates:
        """Return the nearest goals, at most `most`; of equally near goals, the first one row by row comes first."""
        planner = self.planner(situation)
        goals = self.goals(situation, planner)
        ways = planner.costs(*situation.here)[goals[:, 1], goals[:, 0]]
        nearest = np.argsort(ways, kind="stable")[:most]
        cells = goals[nearest]
        gains = information_gain(situation.grid, cells, self.settings.body.range_cells, ())
        return Candidates(cells, ways[nearest], gains)

    def choose(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Cell | None:
        """Return the chosen goal; without one, the robot stays where it is."""
        goal, self.goal = self.goal, None
        return goal
