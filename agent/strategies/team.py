"""Strategies whose robots assign targets together: a planner at the centre, without the centre.

Each robot broadcasts its pose. A robot's sub-team is itself and those whose radio reaches it; where poses and targets
are passed on (`agent.strategies.relayed_state`), all that are connected. Where all members hear each other they have the
same table of robots and goals and compute the same assignment at the same time; each takes its own share and says so.
In a chain A - B - C, and where maps or words are late, they may differ: what a teammate says of its target counts, and
of two that are headed for one cell the higher-numbered robot chooses again.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.planning.assignment import Assignment
from agent.planning.candidates import SEARCHED
from agent.planning.path_planner import PathPlanner
from agent.planning.utility import in_predictive
from agent.settings import Settings
from agent.strategies.base import Cell, Situation
from agent.strategies.targets import TargetStrategy
from protocol.keyed_random import keyed_random

PATIENCE = 20
"""Steps after which a robot without a goal no longer trusts that its teammates see to all of them."""


@dataclass(frozen=True)
class Table:
    """What a sub-team decides on.

    Attributes
    ----------
    robots : tuple of int
        The members, ascending.
    cells : int32 array, shape (m, 2)
        Where they are.
    goals : int32 array, shape (n, 2)
        Cells (x, y).
    costs : float64 array, shape (m, n)
        Cost of each member's way to each goal, in cells; infinite where none leads.
    """

    robots: tuple[int, ...]
    cells: NDArray[np.int32]
    goals: NDArray[np.int32]
    costs: NDArray[np.float64]


class TeamStrategy(TargetStrategy):
    """A strategy of sub-teams; a subclass says in `assign` who gets which goal."""

    publishes_pose = True

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self._settled: set[tuple[int, Cell]] = set()
        self._waited = 0

    @classmethod
    def clashes(cls, parts: Any) -> list[tuple[tuple[str, ...], str]]:
        """All that clash, and parts that speak of one robot."""
        found = super().clashes(parts)
        if parts.candidates in SEARCHED:
            found.append((("candidates",), "breadth-first search finds one robot's goal, not a team's"))
        if parts.replan == "after-turn":
            found.append((("replan",), "a team that assigns together would wait for its last scanner"))
        return found

    @abstractmethod
    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Give goals to robots: for each row of the table the number of its goal, -1 for none."""

    def team(self, situation: Situation) -> dict[int, Cell]:
        """The sub-team: the robot and all whose pose it has heard, or had passed on, with their cells."""
        there = (*situation.peers, *situation.connected)
        members = {peer: situation.poses[peer][:2] for peer in there if peer in situation.poses}
        if self._waited >= PATIENCE:
            members = {}
        members[self.settings.robot] = situation.here
        return dict(sorted(members.items()))

    def team_size(self, situation: Situation) -> int:
        """Members of the sub-team."""
        return len(self.team(situation))

    def remembered(self, situation: Situation) -> dict[int, Cell]:
        """The last targets of those who are out of range, by their numbers."""
        team = self.team(situation)
        return {peer: target for peer, target in situation.targets.items() if peer not in team}

    def is_due(self, situation: Situation) -> bool:
        """When the robot is done with its target, or a member newly is; and once for a target in conflict.

        A robot without a goal waits for such a moment as well, unless it is alone.
        """
        spent = self._spent_teammates(situation)
        news, self._settled = spent - self._settled, spent
        if self.target is None:
            self._waited += 1
            return bool(news) or self._waited == 1 or len(self.team(situation)) == 1
        return (
            bool(news) or self.is_spent(situation, self.target, situation.here) or self._collides(situation)
        )

    def choose(self, situation: Situation, goals: NDArray[np.int32], planner: PathPlanner) -> Cell | None:
        """Take one's own share of the assignment."""
        table = self.table(situation, goals, planner)
        goal = int(self.assign(table, situation, planner)[table.robots.index(self.settings.robot)])
        if goal < 0:
            return None
        self._waited = 0
        return int(goals[goal, 0]), int(goals[goal, 1])

    def table(self, situation: Situation, goals: NDArray[np.int32], planner: PathPlanner) -> Table:
        """Lay out who could go where at what cost."""
        team = self.team(situation)
        cells = np.array(list(team.values()), np.int32)
        return Table(tuple(team), cells, goals, self.costs_of(team, goals, planner))

    def costs_of(
        self, team: Mapping[int, Cell], goals: NDArray[np.int32], planner: PathPlanner
    ) -> NDArray[np.float64]:
        """Cost of each member's way to each goal, shape (m, n): where its own disc may drive."""
        costs = np.empty((len(team), len(goals)))
        radii = np.array([self.settings.radius_of(robot) for robot in team])
        cells = np.array(list(team.values()), np.int32)
        for radius in np.unique(radii):
            alike = radii == radius
            costs[alike] = planner.of_radius(float(radius)).costs_between(cells[alike], goals)
        return costs

    def frontier(self, situation: Situation, planner: PathPlanner) -> NDArray[np.int32]:
        """The frontier cells that can be reached: by any of the team, if its robots are not of one size."""
        team = self.team(situation)
        radii = {robot: self.settings.radius_of(robot) for robot in team}
        if len(set(radii.values())) == 1:
            return super().frontier(situation, planner)
        found = {
            (y, x)
            for robot, cell in team.items()
            for x, y in planner.of_radius(radii[robot]).frontier(*cell).tolist()
        }
        return np.array([(x, y) for y, x in sorted(found)], np.int32).reshape(-1, 2)

    def draw(self, purpose: str, situation: Situation) -> np.random.Generator:
        """Random numbers that are the same for all members."""
        return keyed_random(self.settings.seed, purpose, situation.step)

    def _spent_teammates(self, situation: Situation) -> set[tuple[int, Cell]]:
        """Members that are done with the targets that they told of."""
        return {
            (peer, situation.targets[peer])
            for peer, cell in self.team(situation).items()
            if peer in situation.targets and self.is_spent(situation, situation.targets[peer], cell)
        }

    def _collides(self, situation: Situation) -> bool:
        """Whether a lower-numbered teammate has just said that it is headed for the same cell."""
        return any(
            peer < self.settings.robot and target == self.target
            for peer, target in situation.new_targets.items()
        )


def unclaimed(
    situation: Situation, goals: NDArray[np.int32], targets: Mapping[int, Cell], settings: Settings
) -> NDArray[np.int32]:
    """Leave out goals within sensor range and in predictive of robots' targets; all stay if none would be left."""
    keep = [
        all(
            (x - tx) ** 2 + (y - ty) ** 2 >= settings.ranges_cells[robot] ** 2
            or not in_predictive(situation.grid, x, y, tx, ty)
            for robot, (tx, ty) in targets.items()
        )
        for x, y in goals.tolist()
    ]
    return goals[keep] if any(keep) else goals
