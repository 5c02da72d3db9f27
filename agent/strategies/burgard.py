"""Coordinated exploration (Burgard, Moors, Stachniss, Schneider 2005), and what it is compared with.

nearest           each robot drives to its nearest frontier cell; maps are shared, targets are not
burgard           Algorithm 1: the best pair of robot and frontier cell, utilities lowered, the next
burgard-optimal   Algorithm 2: the assignment with the largest sum of U - beta V^2, searched at random

The paper assigns anew when a robot reaches its target, or when a distance or a time since the last assignment
has passed: ``replan = "at-goal"``, `after_metres`, `after_steps`. With ``costs = "weighted"`` ways are counted as
in section II-A, by length times occupancy on a smoothed map; that takes several times as long as counting their
length, which is the default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.planning.assignment import Assignment, best_of_all, in_turn
from agent.planning.path_planner import PathPlanner
from agent.planning.utility import utilities
from agent.settings import Settings
from agent.strategies.base import Cell, Situation
from agent.strategies.options import option
from agent.strategies.targets import Parts, TargetStrategy
from agent.strategies.team import Table, TeamStrategy

SUB_TEAMS = ("in-range", "connected")
"""Who decides together. ``in-range``: those who hear each other. ``connected``: also those between whom others pass
on what they have heard, which is the paper's; every link of a chain costs a step."""


@dataclass(frozen=True)
class Coordinated(Parts):
    """Options of the coordinated ones."""

    beta: float = option(1.0, "weight of cost against utility", least=0)
    every: int = option(
        0, "targets are assigned anew after so many steps at the latest; 0: never for time alone", least=0
    )
    after_steps: int = option(0, "and so many steps after they were last assigned; 0: never", least=0)
    after_metres: float = option(
        0.0, "and when a member has driven so far since they were last assigned; 0: never", least=0
    )
    sub_team: str = option("in-range", "who decides together", SUB_TEAMS)
    occ_max: float = option(
        1.0, "cells of more occupancy on the smoothed map are barred; from 0.9 on none are", least=0
    )


class Nearest(TargetStrategy):
    """Uncoordinated (Yamauchi 1998)."""

    name = "nearest"
    summary = "each robot drives to its nearest frontier cell, whatever the others do"
    source = "Burgard et al. 2005, section IV-C: uncoordinated, after Yamauchi 1998"
    publishes_target = False

    def choose(self, situation: Situation, goals: NDArray[np.int32], planner: PathPlanner) -> Cell | None:
        """Take the goal of least cost; of equals the first cell, row by row."""
        best = goals[np.argmin(planner.costs(*situation.here)[goals[:, 1], goals[:, 0]])]
        return int(best[0]), int(best[1])


class Burgard(TeamStrategy):
    """Algorithm 1."""

    name = "burgard"
    summary = "sub-teams give out frontier cells in turn, the best pair of robot and cell first"
    source = "Burgard et al. 2005, Algorithm 1 (section II-C), sub-teams (II-D)"
    options_type = Coordinated

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self.forwards_state = self.options.sub_team == "connected"
        self._assigned = 0
        self._traveled: dict[int, float] = {}

    def is_due(self, situation: Situation) -> bool:
        """As a team's, and after a time or a distance."""
        every, after = self.options.every, self.options.after_steps
        return (
            super().is_due(situation)
            or bool(every and situation.step % every == 0)
            or bool(after and situation.step - self._assigned >= after)
            or self._has_driven(situation)
        )

    def planner(self, situation: Situation) -> PathPlanner:
        """As all, without cells that are too likely to be occupied."""
        return PathPlanner(
            situation.grid,
            self.options.costs,
            self.settings.radius_cells,
            occ_max=self.options.occ_max,
            cache=self._cache,
        )

    def select(self, situation: Situation, planner: PathPlanner) -> tuple[Cell | None, bool]:
        """As all, noting when, and how far all had come by then."""
        self._assigned, self._traveled = situation.step, dict(situation.traveled)
        return super().select(situation, planner)

    def _has_driven(self, situation: Situation) -> bool:
        """Whether a member has driven so far that targets are assigned anew."""
        most = self.options.after_metres / self.settings.resolution
        return bool(most) and any(
            situation.traveled.get(robot, 0.0) - self._traveled.get(robot, 0.0) >= most
            for robot in self.team(situation)
        )

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Utilities begin at 1, lowered by the targets remembered of those out of range."""
        del planner
        costs = self.options.beta * table.costs / self.settings.scale_cells
        utility = self._utility(table, situation)
        ranges = self.settings.ranges_of(table.robots)
        return in_turn(situation.grid, table.goals, utility, costs, ranges)

    def _utility(self, table: Table, situation: Situation) -> NDArray[np.float64]:
        remembered = self.remembered(situation)
        ranges = self.settings.ranges_of(remembered)
        return utilities(situation.grid, table.goals, list(remembered.values()), ranges)


class BurgardOptimal(Burgard):
    """Algorithm 2."""

    name = "burgard-optimal"
    summary = "sub-teams search the assignment with the largest sum of utilities minus squared costs"
    source = "Burgard et al. 2005, Algorithm 2 (section IV-C)"

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Search from the same random starts in all members."""
        del planner
        costs = self.options.beta * (table.costs / self.settings.scale_cells) ** 2
        return best_of_all(
            situation.grid, table.goals, self._utility(table, situation), costs,
            self.settings.ranges_of(table.robots), self.draw("assignment", situation),
        )  # fmt: skip
