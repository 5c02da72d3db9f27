"""Tours for the whole team that reach much soon and leave nothing for late: our own strategy, of no paper.

Every free edge is a goal, however small. What it promises is predicted from the unknown area in predictive of it; a
crumb promises next to nothing, but it must be fetched some time, and what is left behind is a long way back. So
robots plan as k travelling repairmen (`agent.planning.team_tours`): together they order all goals into tours, in
which a goal costs by what it promises and by when it is reached, a crumb the more the later, and how far all drive
and when the last robot is done count on top. A goal is seen from some way off: each is a neighbourhood. Each robot
drives to the first goal of its own tour and plans anew in every step.

A crumb is not driven up to. The robot looks at it from a cell that is on its tour's way, or nearly, and from which
what is unknown there is in predictive (`agent.planning.viewpoint`).

A robot that has no teammates in the scenario comes back itself for all that it leaves: it drives the shortest
tour through all goals (`agent.planning.single_robot_tour`), whatever they promise. One that is only out of range of its
teammates does not: they pass where it does not, and it plans as a team of one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.planning.assignment import Assignment
from agent.planning.candidates import components, count_representatives, thin_out
from agent.planning.clusters import medoids
from agent.planning.frontier import is_frontier
from agent.planning.gain import expected_gain
from agent.planning.path_planner import PathPlanner
from agent.planning.single_robot_tour import single_robot_tour
from agent.planning.team_tours import Task, team_tours
from agent.planning.viewpoint import best_vantage, vantage_cells
from agent.planning.yielding import MEMORY
from agent.settings import Settings
from agent.strategies.base import Cell, Situation
from agent.strategies.options import option
from agent.strategies.targets import Parts
from agent.strategies.team import PATIENCE, Table, TeamStrategy
from protocol.grid import ray_table

PLENTY = 1 / 8
"""An edge that promises this share of the sensor's disc, or more, has the weight 1."""

WORTHWHILE = 1 / 2
"""A robot without a tour goes where others explore an edge of this weight or more."""

SAME = 1 / 4
"""An edge within this many sensor ranges of a robot's last target may be what is left of it."""


GAP = 1 / 10
"""Goals nearer to each other than this many sensor ranges, in predictive of each other, are one, or those farther
apart where there are more than `MOST`."""

NEAR = 3 / 10
"""A robot has seen what there is to see at a goal when it is so many sensor ranges away."""

REMAINS = 1 / 20
"""Of ways within that distance this much counts: of two goals in one neighbourhood the nearer comes first."""

LONE_LOYALTY = 1 / 4
"""How loyal to its last target a robot without teammates is, of what a team's is."""

MOST = 96
"""Goals of a plan, more or less: ways between all pairs of them are searched in every step."""

CRUMB_CELLS = 2
"""An edge of so many cells is looked at from afar: of longer ones there is more to see from near."""

AHEAD = 5
"""Goals that come after the next one and have a say in where to look at it from."""

STILL = 3
"""Steps on end in one place after which a teammate sees nothing to do, or cannot go where there is."""

RECALL = 200
"""Steps for which a teammate out of range is believed to be at the last target that it told of."""

EACH_STEP = "each-step"


@dataclass(frozen=True)
class Options(Parts):
    """Options of the strategy."""

    candidates: str = option("edges", "which cells are worth going to", ("edges",))
    replan: str = option(EACH_STEP, "when a new target is chosen", (EACH_STEP, "at-once", "at-goal"))
    small_frontier: float = option(
        0.02, "weight of an edge that promises nothing; one that promises much has 1", least=0
    )
    latency_weight: float = option(
        0.2, "by how much an edge's weight grows with each sensor range of way until it is reached", least=0
    )
    last: float = option(6.0, "weight of the longest tour", least=0)
    total: float = option(6.0, "weight of the lengths of all tours", least=0)
    look: float = option(
        0.9, "from how many sensor ranges off a crumb is looked at; 0: from where it is", least=0
    )
    work: float = option(
        1.5,
        "sensor ranges of way expected behind an edge that promises much: who has these gets less else",
        least=0,
    )
    target_hysteresis: float = option(
        0.2, "by how many sensor ranges a robot's last target seems nearer", least=0
    )


class Repairmen(TeamStrategy):
    """Weighted arrivals over tours of the whole team."""

    name = "repairmen"
    summary = "the team plans tours through all free edges that reach much soon and leave nothing for late"
    source = "Murmur, after the k-travelling repairmen problem (minimum latency)"
    options_type = Options
    observes_from_distance = True

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self._past = 0
        self._known = 0
        self._lengths = np.empty(0, np.int64)
        self._between = np.empty((0, 0))
        self._tour: list[int] = []
        self._next = np.empty((0, 2), np.int32), np.empty(0, np.bool_)
        self._seen_in_vain: set[Cell] = set()
        self._given_up: dict[int, int] = {}
        """When each teammate had been heard when the robot ceased to rely on it."""

    def is_due(self, situation: Situation) -> bool:
        """In each step that brings news of the map: a robot that hears nothing new does not turn to and fro.

        As a team's where that is wanted, and while it gets past a teammate.
        """
        known = int(np.count_nonzero(situation.grid))
        news, self._known = known != self._known, known
        each_step = self.options.replan == EACH_STEP and situation.step >= self._past
        return (each_step and news) or super().is_due(situation)

    def is_spent(self, situation: Situation, target: Cell, at: Cell) -> bool:
        """As the parts say; with plans in each step as with `at-once`."""
        if self.options.replan == EACH_STEP:
            return not is_frontier(situation.grid, *target)
        return super().is_spent(situation, target, at)

    def _pass_by(self, situation: Situation, planner: PathPlanner) -> bool:
        self._past = situation.step + MEMORY
        return super()._pass_by(situation, planner)

    def team(self, situation: Situation) -> dict[int, Cell]:
        """The sub-team, and who left it not long ago: they are taken to be where they were headed.

        A robot that waits for what others are to do does not rely on those that stand still, and once it has waited
        in vain for long on nobody, until they tell of a new target.
        """
        members = super().team(situation)
        for peer, target in situation.targets.items():
            if situation.step - situation.target_steps.get(peer, 0) <= RECALL:
                members.setdefault(peer, target)
        for peer in members:
            stands = situation.step - situation.last_moved.get(peer, situation.step) >= STILL
            if self._waited >= PATIENCE or (self._waited and stands and peer in situation.peers):
                self._given_up[peer] = situation.target_steps.get(peer, 0)
        return {
            peer: members[peer]
            for peer in sorted(members)
            if peer == self.settings.robot
            or situation.target_steps.get(peer, 0) > self._given_up.get(peer, -1)
        }

    def goals(self, situation: Situation, planner: PathPlanner) -> NDArray[np.int32]:
        """Representatives of all free edges that can be reached, however small; of those in a place one."""
        frontier = self.frontier(situation, planner)
        if not len(frontier):
            return frontier
        range_cells = self.settings.scale_cells
        edges, sizes = components(frontier)
        counts = np.minimum(sizes, count_representatives(sizes, range_cells))
        cells, edge = medoids(edges, sizes, counts)
        lengths = sizes[edge]
        gap = GAP * range_cells
        stays = thin_out(situation.grid, cells, lengths, gap)
        while len(stays) > MOST and gap < range_cells:
            gap *= 1.5
            stays = thin_out(situation.grid, cells, lengths, gap)
        self._lengths = lengths[stays]
        return cells[stays]

    def table(self, situation: Situation, goals: NDArray[np.int32], planner: PathPlanner) -> Table:
        """As a team's; ways between goals are searched for at once with those of the robots."""
        team = self.team(situation)
        radii = {self.settings.radius_of(robot) for robot in team}
        if len(radii) > 1:
            _, self._between = planner.of_radius(min(radii)).costs_among(goals[:0], goals)
            return super().table(situation, goals, planner)
        cells = np.array(list(team.values()), np.int32)
        ways, self._between = planner.costs_among(cells, goals)
        return Table(tuple(team), cells, goals, ways)

    def choose(self, situation: Situation, goals: NDArray[np.int32], planner: PathPlanner) -> Cell | None:
        """Take the first goal of one's own tour; keep those that come first, and how long their edges are."""
        self._tour = []
        chosen = super().choose(situation, goals, planner)
        numbers = self._tour[: 1 + AHEAD]
        self._next = goals[numbers], self._lengths[numbers] <= CRUMB_CELLS
        return chosen

    def stand(self, situation: Situation, planner: PathPlanner) -> Cell | None:
        """Look at a crumb from afar: from where the way there and through the tour's next goals is short.

        Not if it has been looked at in vain: a teammate may have stood before it, or the map be drawn of outlines.
        """
        goals, are_crumbs = self._next
        target = self.target
        if target is None or not len(goals) or not are_crumbs[0] or not self._looks_afar():
            return target
        if target in self._seen_in_vain:
            return target
        reach = min(self.options.look, 1.0) * self.settings.range_cells
        around = ray_table(self.settings.range_cells, self.settings.beams)
        views = (
            vantage_cells(situation.grid, (x, y), around, reach) if is_crumb else None
            for (x, y), is_crumb in zip(goals.tolist(), are_crumbs, strict=True)
        )
        found = best_vantage(planner, situation.here, views, goals, self.settings.speed_cells)
        if found is None:
            self._seen_in_vain.add(target)
        return found or target

    def _looks_afar(self) -> bool:
        """Whether one look from anywhere settles what is there."""
        settings = self.settings
        full_turn = settings.field_of_view >= 360.0 and settings.turn_steps == 1
        return full_turn and self.options.replan != "at-goal" and self.options.look > 0

    def _is_stranded(self, here: Cell) -> bool:
        """Also where it has looked at a crumb without news of the map: it drives there."""
        stranded = super()._is_stranded(here)
        if stranded and self.target is not None:
            self._seen_in_vain.add(self.target)
        return stranded

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """With which goal the tour of each robot begins; of a robot without teammates the shortest tour."""
        del planner
        range_cells = self.settings.scale_cells
        loyal = self._loyal(table, situation)
        if self.settings.robots == 1:
            self._tour = single_robot_tour(loyal[0], self._between)
            return np.array((self._tour or [-1])[:1])
        near = NEAR * range_cells
        ways, between = (np.maximum(costs - near, REMAINS * costs) for costs in (loyal, self._between))
        promised = expected_gain(situation.grid, table.goals, self._lengths, range_cells)
        worth = np.minimum(promised / PLENTY, 1.0)
        task = Task(
            starts=ways,
            between=between,
            weights=worth + self.options.small_frontier,
            latency_weight=np.full(len(table.goals), self.options.latency_weight / (2 * range_cells)),
            last=self.options.last,
            way=self.options.total,
            loads=self.options.work * range_cells * worth,
        )
        tours = team_tours(task)
        self._tour = tours[table.robots.index(self.settings.robot)]
        return _follow(np.array([tour[0] if tour else -1 for tour in tours]), table.costs, worth)

    def _loyal(self, table: Table, situation: Situation) -> NDArray[np.float64]:
        """The ways to all goals, a little shorter to what is left of each robot's last target."""
        range_cells = self.settings.scale_cells
        target_hysteresis = self.options.target_hysteresis * (
            LONE_LOYALTY if self.settings.robots == 1 else 1.0
        )
        ways = table.costs.copy()
        for way, robot in zip(ways, table.robots, strict=True):
            target = self.target if robot == self.settings.robot else situation.targets.get(robot)
            if target is not None:
                gap = np.abs(table.goals - target).max(axis=1)
                nearest = int(np.argmin(gap))
                if gap[nearest] <= SAME * range_cells:
                    way[nearest] = max(0.0, way[nearest] - target_hysteresis * range_cells)
        return ways


def _follow(firsts: Assignment, ways: NDArray[np.float64], worth: NDArray[np.float64]) -> Assignment:
    """Send robots without a tour after the others, to where much more is to be found than is known.

    Each goes to the nearest of the goals of some worth to which the fewest are headed.
    """
    headed = np.bincount(firsts[firsts >= 0], minlength=len(worth)).astype(np.float64)
    headed[worth < WORTHWHILE] = np.inf
    for robot in np.flatnonzero(firsts < 0):
        near = np.where(headed == headed.min(), ways[robot], np.inf)
        goal = int(np.argmin(near))
        if np.isfinite(headed[goal]) and np.isfinite(near[goal]):
            firsts[robot] = goal
            headed[goal] += 1
    return firsts
