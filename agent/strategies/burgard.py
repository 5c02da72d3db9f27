"""Coordinated exploration (Burgard, Moors, Stachniss, Schneider 2005), and the uncoordinated baseline.

nearest           each robot drives to its nearest frontier cell; maps are shared, targets are not
burgard           Algorithm 1: repeatedly the best pair of robot and frontier cell, with lowered utilities
burgard-optimal   Algorithm 2: randomized search of the assignment with the largest sum of U - beta V^2

The paper replans when a robot reaches its target, or after a distance or a time since the last assignment:
``replan = "at-goal"``, `after_meters`, `after_steps`. With ``costs = "weighted"`` the cost of a way is its length times
the occupancy of a smoothed map (section II-A). This takes several times as long as the length, the default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.planning.assignment import Assignment, Costs, best_of_all, in_turn
from agent.planning.measured_distances import MeasuredDistances
from agent.planning.path_planner import PathPlanner
from agent.planning.utility import proximity, utilities
from agent.settings import Settings
from agent.strategies.base import Decision, Situation, cell_at
from agent.strategies.options import option
from agent.strategies.targets import BarringParts, TargetStrategy
from agent.strategies.team import Table, TeamStrategy
from protocol.arrays import Cells, Floats
from protocol.grid import Cell

SUB_TEAMS = ("in-range", "connected")
"""The robots that decide together. ``in-range``: robots in range of each other. ``connected``, as in the paper: also
robots connected through others, which forward their states; each hop delays a state by a step."""


VISIBILITIES = ("linear", "learned")
"""P(d), the probability that a robot at its target covers a cell at distance d. ``linear``: 1 - d / range (Eq. 2).
``learned``: from the distances that the team has measured so far (`agent.planning.measured_distances`)."""


@dataclass(frozen=True)
class CoordinatedOptions(BarringParts):
    """Options of the coordinated strategies."""

    beta: float = option(1.0, "weight of cost against utility", least=0)
    every: int = option(0, "replan in every step that is a multiple of this; 0: never", least=0)
    after_steps: int = option(0, "replan this many steps after the last assignment; 0: never", least=0)
    after_meters: float = option(
        0.0, "replan when a member has driven this far since the last assignment; 0: never", least=0
    )
    sub_team: str = option("in-range", "the robots that decide together", SUB_TEAMS)


@dataclass(frozen=True)
class BurgardOptions(CoordinatedOptions):
    """Options of `burgard`."""

    visibility: str = option(
        "linear", "P(d), how likely a robot at its target covers a cell at distance d", VISIBILITIES
    )


class Nearest(TargetStrategy):
    """Uncoordinated (Yamauchi 1998)."""

    name = "nearest"
    summary = "each robot drives to its nearest frontier cell, without coordination"
    source = "Burgard et al. 2005, section IV-C: uncoordinated, after Yamauchi 1998"
    publishes_target = False

    def choose(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Cell | None:
        """Return the goal of least cost; of equal goals the first, row by row."""
        return cell_at(goals, np.argmin(planner.costs(*situation.here)[goals[:, 1], goals[:, 0]]))


class CoordinatedStrategy(TeamStrategy):
    """The common part of both algorithms: when to replan, and which targets are taken."""

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self.forwards_state = self.options.sub_team == "connected"
        self._assigned = 0
        self._traveled: dict[int, float] = {}
        """`_assigned`, `_traveled`: the step of the last assignment, and the cells that each robot had driven then."""

    def is_due(self, situation: Situation) -> bool:
        """Return whether to replan: as `TeamStrategy`, and after a time or a distance."""
        every, after = self.options.every, self.options.after_steps
        return (
            super().is_due(situation)
            or bool(every and situation.step % every == 0)
            or bool(after and situation.step - self._assigned >= after)
            or self._has_driven(situation)
        )

    def select(self, situation: Situation, planner: PathPlanner) -> tuple[Cell | None, bool]:
        """Choose a target; save the step and the distances that the members have driven."""
        self._assigned, self._traveled = situation.step, dict(situation.traveled)
        return super().select(situation, planner)

    def _has_driven(self, situation: Situation) -> bool:
        """Whether a member has driven `after_meters` since the last assignment."""
        most = self.options.after_meters / self.settings.resolution
        return bool(most) and any(
            situation.traveled.get(robot, 0.0) - self._traveled.get(robot, 0.0) >= most
            for robot in self.team(situation)
        )

    def weighted(self, costs: Costs) -> Costs:
        """Return costs times beta; infinite ones remain so, also without a weight."""
        weighted: Costs = np.full_like(costs, np.inf)
        np.multiply(self.options.beta, costs, out=weighted, where=np.isfinite(costs))
        return weighted

    def utility(self, table: Table, situation: Situation) -> Floats:
        """Return the utility of each goal, lowered by the last targets of teammates out of range, shape (n,)."""
        remembered = self.remembered(situation)
        ranges = self.settings.ranges_of(remembered)
        return utilities(situation.grid, table.goals, list(remembered.values()), ranges)


class Burgard(CoordinatedStrategy):
    """Algorithm 1: repeated choice of the best pair."""

    name = "burgard"
    summary = "sub-teams assign frontier cells one by one, the best pair of robot and cell first"
    source = "Burgard et al. 2005, Algorithm 1 (section II-C), sub-teams (II-D)"
    options_type = BurgardOptions

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self._measured: MeasuredDistances | None = None
        if self.options.visibility == "learned":
            self._measured = MeasuredDistances(settings.scale_cells, settings.beams)

    def decide(self, situation: Situation) -> Decision:
        """Decide as all strategies with targets; first update what the sub-team's lasers have measured."""
        if self._measured is not None:
            for robot, cell in self.team(situation).items():
                self._measured.add(situation.grid, cell, self.settings.bodies[robot].range_cells)
        return super().decide(situation)

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Assign goals."""
        costs = self.weighted(table.costs) / self.settings.scale_cells
        ranges = self.settings.ranges_of(table.robots)
        visibility = proximity if self._measured is None else self._measured.proximity
        return in_turn(situation.grid, table.goals, self.utility(table, situation), costs, ranges, visibility)

    def utility(self, table: Table, situation: Situation) -> Floats:
        """Return the utility of each goal, by the learned P(d) if that is chosen."""
        if self._measured is None:
            return super().utility(table, situation)
        worth = np.ones(len(table.goals))
        for robot, target in self.remembered(situation).items():
            range_cells = self.settings.bodies[robot].range_cells
            worth -= self._measured.proximity(
                situation.grid, table.goals, np.array(target, np.int32), range_cells
            )
        return worth


class BurgardOptimal(CoordinatedStrategy):
    """Algorithm 2: randomized search of the best assignment."""

    name = "burgard-optimal"
    summary = "sub-teams search the assignment with the largest sum of utility minus squared cost"
    source = "Burgard et al. 2005, Algorithm 2 (section IV-C)"
    options_type = CoordinatedOptions

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Assign goals; all members search from the same random starts."""
        costs = self.weighted((table.costs / self.settings.scale_cells) ** 2)
        return best_of_all(
            situation.grid, table.goals, self.utility(table, situation), costs,
            self.settings.ranges_of(table.robots), self.draw("assignment", situation),
        )  # fmt: skip
