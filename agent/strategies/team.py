"""Strategies whose robots assign targets together: each robot computes the central assignment itself.

Each robot broadcasts its pose. The sub-team of a robot consists of itself and the robots in range. With relayed states
(`agent.team_state`) it has all connected robots. If all members receive each other, they have the same
table of robots and goals, so they compute the same assignment at the same time. Each takes its own goal and broadcasts
it. In a chain A - B - C, and with late messages, tables may differ. Then a received target takes precedence over the
computed one, and if two robots drive to one cell, the higher-numbered one chooses again.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.planning.assignment import Assignment, Costs
from agent.planning.path_planner import PathPlanner
from agent.planning.utility import covers
from agent.settings import Settings
from agent.strategies.base import Situation, array_of, cell_at
from agent.strategies.targets import Clash, TargetStrategy, is_searched
from protocol.arrays import Cells
from protocol.grid import Cell
from protocol.keyed_random import keyed_random

PLAN_ALONE_AFTER = 20
"""Steps after which a robot without a goal plans alone, as its teammates seem not to visit all goals."""


@dataclass(frozen=True)
class Table:
    """Input of an assignment."""

    robots: tuple[int, ...]
    """The members of the sub-team, ascending."""
    cells: Cells
    """The cell of each member."""
    goals: Cells
    """The goals."""
    costs: Costs
    """Cost of each member's way to each goal, in cells, shape (m, n); infinite without a way."""


class TeamStrategy(TargetStrategy):
    """A strategy of sub-teams; a subclass assigns goals to robots in `assign`."""

    publishes_pose = True
    clashes = (
        *TargetStrategy.clashes,
        Clash(("candidates",), is_searched, "breadth-first search finds one robot's goal, not a team's"),
        Clash(
            ("replan",),
            lambda parts: parts.replan == "after-turn",
            "a team that assigns targets together would wait for its slowest scanner",
        ),
    )

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self._spent: set[tuple[int, Cell]] = set()
        """Members that are done with their targets, with these targets, as of the last call of `is_due`."""
        self._waited = 0
        """Steps without a target since the last one, as far as `is_due` was called."""
        self._alike = len({body.radius_cells for body in settings.bodies}) == 1
        """Whether all robots have the same radius."""

    @abstractmethod
    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Return for each row of the table the index of its goal, -1 for none: int64 array, shape (m,)."""

    def team(self, situation: Situation) -> dict[int, Cell]:
        """Return the sub-team, robots in range or connected with a known pose, as robot to cell."""
        there = (*situation.peers, *situation.connected)
        members = {peer: situation.poses[peer][:2] for peer in there if peer in situation.poses}
        if self._waited >= PLAN_ALONE_AFTER:
            members = {}
        members[self.settings.robot] = situation.here
        return dict(sorted(members.items()))

    def team_size(self, situation: Situation) -> int:
        """Return the number of members of the sub-team."""
        return len(self.team(situation))

    def remembered(self, situation: Situation) -> dict[int, Cell]:
        """Return the last targets of robots outside the sub-team, by robot."""
        team = self.team(situation)
        return {peer: target for peer, target in situation.targets.items() if peer not in team}

    def is_due(self, situation: Situation) -> bool:
        """Return whether to replan: this robot or, for the first time, a member is done with its target.

        Also if a lower-numbered teammate has just sent the same target as this robot's. A robot without a goal waits
        for such an event, unless it is alone.
        """
        spent = self._spent_teammates(situation)
        newly_spent, self._spent = spent - self._spent, spent
        if self.target is None:
            self._waited += 1
            return bool(newly_spent) or self._waited == 1 or len(self.team(situation)) == 1
        is_done = bool(newly_spent) or self.is_spent(situation, self.target, situation.here)
        return is_done or any(
            peer < self.settings.robot and target == self.target
            for peer, target in situation.new_targets.items()
        )

    def choose(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Cell | None:
        """Return this robot's goal in the assignment."""
        table = self.table(situation, goals, planner)
        own = table.robots.index(self.settings.robot)
        goal = int(self.assign(table, situation, planner)[own])
        if goal < 0:
            return None
        self._waited = 0
        chosen = cell_at(goals, goal)
        planner.note_cost(situation.here, chosen, table.costs.item(own, goal))
        return chosen

    def table(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Table:
        """Return the table of members, goals and costs."""
        team = self.team(situation)
        cells = array_of(team.values())
        return Table(tuple(team), cells, goals, self.costs_of(team, goals, planner))

    def costs_of(self, team: Mapping[int, Cell], goals: Cells, planner: PathPlanner) -> Costs:
        """Return the cost of each member's way to each goal, shape (m, n), with obstacles enlarged by its radius."""
        costs = np.empty((len(team), len(goals)))
        radii = np.array([self.settings.bodies[robot].radius_cells for robot in team])
        cells = array_of(team.values())
        for radius in np.unique(radii):
            alike = radii == radius
            costs[alike] = planner.of_radius(float(radius)).costs_between(cells[alike], goals)
        return costs

    def frontier(self, situation: Situation, planner: PathPlanner) -> Cells:
        """Return the frontier cells that this robot, or with mixed radii any member, can reach."""
        team = {} if self._alike else self.team(situation)
        radii = [self.settings.bodies[robot].radius_cells for robot in team]
        if len(set(radii)) <= 1:
            return super().frontier(situation, planner)
        planners = map(planner.of_radius, radii)
        reached = np.concatenate(
            [each.frontier(*cell) for each, cell in zip(planners, team.values(), strict=True)]
        )
        width = planner.grid.shape[1]
        rows, columns = np.divmod(np.unique(reached[:, 1] * width + reached[:, 0]), width)
        return np.column_stack((columns, rows)).astype(np.int32)

    def draw(self, purpose: str, situation: Situation) -> np.random.Generator:
        """Return a random generator that is the same for all members."""
        return keyed_random(self.settings.seed, purpose, situation.step)

    def _spent_teammates(self, situation: Situation) -> set[tuple[int, Cell]]:
        """Return the members that are done with their last sent targets, with these targets."""
        return {
            (peer, situation.targets[peer])
            for peer, cell in self.team(situation).items()
            if peer in situation.targets and self.is_spent(situation, situation.targets[peer], cell)
        }


def unclaimed(situation: Situation, goals: Cells, targets: Mapping[int, Cell], settings: Settings) -> Cells:
    """Return the goals not within sensor range and in sight of a robot's target; all goals if none would be left."""
    taken = [(target, settings.bodies[robot].range_cells) for robot, target in targets.items()]
    keep = [
        not any(covers(situation.grid, target, (x, y), range_cells) for target, range_cells in taken)
        for x, y in goals.tolist()
    ]
    return goals[keep] if any(keep) else goals
