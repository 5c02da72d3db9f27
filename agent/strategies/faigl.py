"""Task allocation (Faigl and Vanek 2014, section 3): robots are assigned to representatives of frontier segments.

    greedy           GA: one robot after the other, in random order, takes the nearest goal left
    iterative        IA: the nearest pair of robot and goal first
    hungarian        HA: the assignment of least total distance
    mtsp             MA: goals clustered around the robots, each drives to the first goal of its cluster's shortest tour
    hungarian-depot  HAd: distance, distance from the goal to the depot, and distance traveled so far (Eq. 2)
    mtsp-depot       MAd: the tour ends at the depot

Goals (rfe or anr), replanning (at-goal is the paper's GR, at-once its IR) and mission (open is OP, return RD)
are options. So is the treatment of frontier segments of at most two cells (n_f = 2): the paper does not consider them,
so an exploration ends when no others are left; by default, robots visit them last.

Three more deviations from the paper have options, too (`GOALS`, `TOURS`, `EMPTY_CLUSTERS`): a goal is a cell of the
frontier, not the mean of a cluster; a tour leads through the nearest goals of a cluster; a robot whose cluster is empty
takes a goal of another robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from agent.planning.assignment import Assignment, Costs, greedy, hungarian, iterative
from agent.planning.candidates import large_segments, mean_goals, segment_clusters
from agent.planning.clusters import k_means
from agent.planning.lin_kernighan import chained_tour
from agent.planning.path_planner import PathPlanner
from agent.planning.route import straighten
from agent.planning.tour import LONGEST, open_tour
from agent.strategies.base import Situation
from agent.strategies.options import option, with_defaults
from agent.strategies.targets import Clash, Parts
from agent.strategies.team import Table, TeamStrategy, unclaimed
from protocol.arrays import Bools, Cells, Floats, Int64s
from protocol.grid import Cell

SMALL_SEGMENTS = ("last", "dropped")
"""When to visit frontier segments of at most two cells: after all others, or never."""

GOALS = ("cell", "mean")
"""The goal of a cluster of frontier cells. ``cell``: the cell nearest to the mean. ``mean``: the mean, as in the paper.
The paper does not say what the goal is if the mean is not free; here it is the cell then, and where a mean serves no
purpose (`agent.planning.candidates.mean_goals`). With immediate replanning, a robot whose goal is no frontier cell
replans at each step."""


@dataclass(frozen=True)
class AllocatingOptions(Parts):
    """Options of the allocating strategies."""

    small_segments: str = option(
        "last", "when to visit frontier segments of at most two cells", SMALL_SEGMENTS
    )
    goals: str = option("cell", "the goal of a cluster of frontier cells", GOALS)


TOURS = ("nearest-12", "whole")
"""Goals of a tour. ``nearest-12``: the 12 goals of the cluster nearest to the robot; the tour is the shortest.
``whole``: all goals of the cluster; the tour is that of the Chained Lin-Kernighan heuristic, as in the paper."""

EMPTY_CLUSTERS = ("filled", "idle")
"""What a robot with an empty cluster does. ``filled``: it takes the nearest goal of a robot that has several; with
fewer goals than robots, goals are assigned as in IA. ``idle``: it has no goal, as in the paper."""


@dataclass(frozen=True)
class TouringOptions(AllocatingOptions):
    """Options of the strategies with tours."""

    tours: str = option("nearest-12", "which goals of its cluster a robot's tour leads through", TOURS)
    empty_clusters: str = option("filled", "what a robot with an empty cluster does", EMPTY_CLUSTERS)


_OPTIONS = with_defaults(AllocatingOptions, candidates="anr")
_DEPOT_OPTIONS = with_defaults(AllocatingOptions, candidates="anr", mission="return")
_TOURING_OPTIONS = with_defaults(TouringOptions, candidates="anr")
_TOURING_DEPOT_OPTIONS = with_defaults(TouringOptions, candidates="anr", mission="return")

_OPEN = Clash(
    ("mission",),
    lambda parts: parts.mission == "open",
    "its costs include the way to the depot, which no robot of an open mission drives",
)


class _Allocating(TeamStrategy):
    """Common part of the six: goals of teammates out of range are left to them, and routes are straightened."""

    options_type: ClassVar[type] = _OPTIONS
    clashes = (
        *TeamStrategy.clashes,
        Clash(
            ("goals", "candidates"),
            lambda parts: parts.goals == "mean" and parts.candidates == "cells",
            "each frontier cell is a goal, so there are no clusters",
        ),
    )

    def frontier(self, situation: Situation, planner: PathPlanner) -> Cells:
        """Return the reachable frontier cells, row by row; without small segments if these are dropped."""
        cells = super().frontier(situation, planner)
        return large_segments(cells) if self.options.small_segments == "dropped" else cells

    def goals(self, situation: Situation, planner: PathPlanner) -> Cells:
        """Return the candidates that are not near the last target of a teammate out of range."""
        means = self.options.goals == "mean"
        found = self._means(situation, planner) if means else super().goals(situation, planner)
        return unclaimed(situation, found, self.remembered(situation), self.settings)

    def _means(self, situation: Situation, planner: PathPlanner) -> Cells:
        """Return the means of the clusters of the frontier (`GOALS`)."""
        frontier = self.frontier(situation, planner)
        if not len(frontier):
            return frontier
        team = self.team(situation)
        at_least = len(team) if self.options.candidates == "anr" else 0
        range_cells = self.settings.scale_cells
        clusters = segment_clusters(frontier, range_cells, at_least)
        costs = self.costs_of(team, np.rint(clusters.means).astype(np.int32), planner)
        reached: Bools = np.isfinite(costs.min(axis=0))
        robots = np.array(list(team.values()), np.int32)
        return mean_goals(situation.grid, clusters, reached, robots, range_cells)

    def _drive(self, situation: Situation, planner: PathPlanner, goal: Cell | None) -> bool:
        found = super()._drive(situation, planner, goal)
        self._route.cells = straighten(planner.floor, situation.here, self._route.cells)
        return found


class Greedy(_Allocating):
    """GA: greedy assignment."""

    name = "greedy"
    summary = "robots, in random order, take the nearest goal that is left"
    source = "Faigl and Vanek 2014, GA (section 3.1)"

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Assign goals; the order of robots is random, the same for all members."""
        return greedy(table.costs, self.draw("order", situation).permutation(len(table.robots)))


class Iterative(_Allocating):
    """IA: iterative assignment."""

    name = "iterative"
    summary = "the nearest pair of robot and goal first, then the nearest of those left"
    source = "Faigl and Vanek 2014, IA (section 3.1), after Werger and Mataric"

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Assign goals to robots by the cost of the pairs."""
        return iterative(table.costs)


class Hungarian(_Allocating):
    """HA: Hungarian assignment."""

    name = "hungarian"
    summary = "the assignment of least total distance"
    source = "Faigl and Vanek 2014, HA (section 3.1)"

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Assign goals by the Hungarian method."""
        return hungarian(table.costs)


class HungarianDepot(Hungarian):
    """HAd: Hungarian assignment with the way to the depot."""

    name = "hungarian-depot"
    summary = "as hungarian, with the distances to the depot and traveled so far added"
    source = "Faigl and Vanek 2014, HAd (section 4.1.1, Eq. 2)"
    options_type = _DEPOT_OPTIONS
    clashes = (*_Allocating.clashes, _OPEN)

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Assign goals by the costs of Eq. (2)."""
        homes = np.array([situation.homes[robot] for robot in table.robots], np.int32)
        back = _way_back(planner, table.goals, homes)
        traveled = np.array([situation.traveled.get(robot, 0.0) for robot in table.robots])
        return super().assign(
            replace(table, costs=table.costs + back + traveled[:, None]), situation, planner
        )


class Mtsp(_Allocating):
    """MA: multiple traveling salesmen."""

    name = "mtsp"
    summary = "goals clustered around the robots; each follows its cluster's shortest tour"
    source = "Faigl and Vanek 2014, MA (section 3.1)"
    options_type: ClassVar[type] = _TOURING_OPTIONS
    clashes = (
        *_Allocating.clashes,
        Clash(
            ("candidates",),
            lambda parts: parts.candidates == "cells",
            "a tour needs the way between every two goals; rfe and anr make few of them",
        ),
    )

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Assign a goal to this robot alone; the tours of the others are not needed."""
        fills = self.options.empty_clusters == "filled"
        if fills and len(table.goals) < len(table.robots):
            return iterative(table.costs)
        given = np.full(len(table.robots), -1)
        me = table.robots.index(self.settings.robot)
        mine = np.flatnonzero(cluster_goals(table, fills=fills) == me)
        mine = mine[np.isfinite(table.costs[me, mine])]
        if len(mine):
            given[me] = self._first_stop(table, mine, situation, planner)
        return given

    def _first_stop(self, table: Table, mine: Int64s, situation: Situation, planner: PathPlanner) -> int:
        """Return the first goal of a short tour through the goals of a cluster (`TOURS`).

        Goals that the robot reaches only through its own cell, and not from the nearest goal, are left out. A robot may
        stand in a cell that its map bars, between two parts of the floor.
        """
        costs = table.costs[table.robots.index(self.settings.robot)]
        mine = mine[np.argsort(costs[mine], kind="stable")]
        shortest = chained_tour
        if self.options.tours == "nearest-12":
            mine, shortest = mine[:LONGEST], open_tour
        cells = table.goals[mine]
        between = planner.costs_between(cells, cells)
        joined = np.isfinite(between[0])
        mine, cells, between = mine[joined], cells[joined], between[np.ix_(joined, joined)]
        tour = shortest(costs[mine], (between + between.T) / 2, self._to_end(cells, situation, planner))
        return int(mine[tour[0]])

    def _to_end(self, cells: Cells, situation: Situation, planner: PathPlanner) -> Floats:
        """Cost of the way from each goal to the end of the tour; 0, as the tour ends at a goal."""
        return np.zeros(len(cells))


class MtspDepot(Mtsp):
    """MAd: multiple traveling salesmen with a depot."""

    name = "mtsp-depot"
    summary = "as mtsp, with tours that end at the depot"
    source = "Faigl and Vanek 2014, MAd (section 4.1.1)"
    options_type = _TOURING_DEPOT_OPTIONS
    clashes = (*Mtsp.clashes, _OPEN)

    def _to_end(self, cells: Cells, situation: Situation, planner: PathPlanner) -> Floats:
        back: Floats = _way_back(planner, cells, np.array([situation.home], np.int32))[0]
        return back


def _way_back(planner: PathPlanner, goals: Cells, homes: Cells) -> Costs:
    """Cost of the way from each goal to each depot, shape (depots, goals).

    The straight distance if there is no way: a wrongly reported wall may bar it for a while.
    """
    back = planner.costs_between(homes, goals)
    straight = np.hypot(*(homes[:, None] - goals[None]).transpose(2, 0, 1))
    return np.where(np.isfinite(back), back, straight)


def cluster_goals(table: Table, *, fills: bool = True) -> Int64s:
    """Cluster the goals around the robots by k-means; return for each goal the index of its robot.

    If `fills`, a robot with an empty cluster gets the nearest goal of a robot that has several.
    """
    _, owner = k_means(table.goals.astype(np.float64), table.cells.astype(np.float64))
    for robot in range(len(table.robots) if fills else 0):
        if (owner == robot).any():
            continue
        counts = np.bincount(owner, minlength=len(table.robots))
        costs = np.where(counts[owner] > 1, table.costs[robot], np.inf)
        if np.isfinite(costs).any():
            owner[np.argmin(costs)] = robot
    return owner
