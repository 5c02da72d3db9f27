"""Minimum-latency tours for the whole team (our own strategy, of no paper).

The traveling repairman problem orders goals into a tour that minimizes the sum of their arrival times, weighted by
their importance: the minimum-latency tour (Blum et al. 1994). A traveling salesman's tour minimizes length, and may
reach large unknown areas late. `agent.planning.team_tours` plans such tours for k robots.

Every frontier segment is a goal, however small. Its weight is the expected gain, predicted from the unknown area in
sight of it (`agent.planning.gain`), plus a small constant. A small frontier has hardly any gain, but it must be
visited at some time, and returning for it later costs a long way. So its cost grows faster than its arrival time. A
robot observes a goal from some distance, so each goal is a neighborhood. Each robot drives to the first goal of its own
tour, and plans anew in every step.

Long tours cost time only if robots are scarce. So the weight of the lengths of all tours decreases when the team has
more robots than goals of large gain: at the start, in narrow corridors, and toward the end. Then more robots get tours.

Robots know poses and maps of their teammates several steps late, so their plans differ: of the last goals, two robots
may each compute that the other one visits them. So a robot without a tour drives to a goal of a teammate, even if that
goal does not need a second robot. With `mission=return` it does not: it would drive away from home.

A robot observes a small frontier from a viewpoint that lies on or near its tour (`agent.planning.viewpoint`). In a
scenario with a single robot, that robot drives the shortest tour through all goals, whatever their gain
(`agent.planning.single_robot_tour`): no teammate visits the goals that it leaves behind.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from agent.planning.assignment import Assignment
from agent.planning.candidates import components, count_representatives, thin_out
from agent.planning.clusters import cluster_groups
from agent.planning.frontier import are_frontier, is_frontier
from agent.planning.gain import expected_gain
from agent.planning.path_planner import PathPlanner
from agent.planning.route import is_line_free, straighten
from agent.planning.single_robot_tour import single_robot_tour
from agent.planning.team_tours import Task, team_tours
from agent.planning.viewpoint import best_viewpoint, tour_viewpoints
from agent.planning.yielding import MEMORY
from agent.settings import Settings
from agent.strategies.base import FULL_TURN, Situation, array_of
from agent.strategies.options import option
from agent.strategies.targets import Parts
from agent.strategies.team import PLAN_ALONE_AFTER, Table, TeamStrategy
from protocol.arrays import NO_CELLS, Cells, FloatRows, Floats, Int64s
from protocol.grid import Cell, Grid, ray_table
from protocol.kernels import kernel

PLENTY = 1 / 8
"""A goal whose expected gain is at least this share of the sensor's disc has weight 1."""

WORTHWHILE = 1 / 2
"""A robot without a tour follows teammates to goals whose gain is at least this share of the largest one. In narrow
corridors, all gains are small."""

LEAST_WORTH = 1 / 20
"""Weight by expected gain below which a goal does not need a second robot; robots without a tour drive to such goals if
there are no others and they need not return."""

SAME = 1 / 4
"""A goal within this many sensor ranges of a robot's last target counts as the same target."""


GAP = 1 / 10
"""Goals in sight of each other and nearer than this many sensor ranges are merged; the distance grows while there are
more than `MAX_GOALS`."""

SPREAD = 3 / 4
"""If robots outnumber goals, segments are divided into goals of at most this many sensor ranges of cells."""

NEAR = 3 / 10
"""Radius of a goal's neighborhood in sensor ranges: from there a robot observes the goal."""

REMAINS = 1 / 20
"""Share of the way inside a neighborhood that counts, so that the nearer of two goals comes first."""

SINGLE_ROBOT_HYSTERESIS = 1 / 4
"""Target hysteresis of a single robot, as a share of that of a team."""

MAX_GOALS = 96
"""Approximate limit of the goals of a plan: every step searches the ways between all pairs of them."""

LONGEST_RANGE_M = 10.0
"""Lengths in plans grow with the sensor range up to this one, in meters. In buildings, walls limit longer views."""

SMALL_FRONTIER = 1 / 4
"""Longest frontier segment, in sensor ranges, that is observed from a viewpoint; longer ones show more from near by."""

SMALL_FRONTIER_M = 1.25
"""Longest such segment in meters, about a wide door. Behind longer ones, whole rooms or halls may lie."""

SMALL_FRONTIER_CELLS = 2
"""A segment of at most this many cells is observed from a viewpoint even if the sensor range is short."""

AHEAD = 5
"""Goals after the next one that influence the choice of its viewpoint."""

NO_TARGET = -1, -1
"""Stands for the target of a robot that has none."""

STILL = 3
"""Steps in one cell after which a teammate counts as idle or stuck."""

RECALL = 200
"""Steps for which a teammate out of range is assumed to be at its last received target."""

EACH_STEP = "each-step"


@dataclass(frozen=True)
class Options(Parts):
    """Options of the strategy."""

    candidates: str = option("edges", "which cells are worth going to", ("edges",))
    replan: str = option(EACH_STEP, "when a new target is chosen", (EACH_STEP, "at-once", "at-goal"))
    small_frontier: float = option(
        0.02, "weight of a goal without expected gain; a goal of large gain has 1", least=0
    )
    latency_weight: float = option(
        0.2, "growth of a goal's weight per sensor range of way until it is reached", least=0
    )
    longest_tour: float = option(6.0, "weight of the length of the longest tour", least=0)
    total_length: float = option(
        6.0, "weight of the lengths of all tours; lower if robots outnumber goals of large gain", least=0
    )
    viewpoint_range: float = option(
        0.9, "sensor ranges from which a small frontier is observed; 0: robots drive up to it", least=0
    )
    expected_work: float = option(
        1.5, "sensor ranges of way expected behind a goal of large gain, counted in its robot's tour", least=0
    )
    target_hysteresis: float = option(
        0.2, "sensor ranges by which a robot's last target counts as nearer", least=0
    )


class Repairmen(TeamStrategy):
    """Minimum-latency tours of the whole team."""

    name = "repairmen"
    summary = "minimum-latency tours of the team through all frontier segments"
    source = "Murmur, after the k-traveling repairmen problem (minimum latency)"
    options_type = Options
    observes_from_distance = True

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self._detour_until = 0
        """The step in which a detour around a teammate ends."""
        self._known = 0
        """Known cells of the planning grid in the last step."""
        self._lengths = np.empty(0, np.int64)
        self._between = np.empty((0, 0))
        """`_lengths`, `_between`: the number of cells of each goal's segment, and the costs between goals."""
        self._tour: list[int] = []
        """This robot's tour, as indices of the goals."""
        self._next = NO_CELLS, np.empty(0, np.bool_)
        """The first goals of the tour, and which of them are small frontiers."""
        self._observed_in_vain: set[Cell] = set()
        """Targets of which a scan from a viewpoint showed nothing new."""
        self._given_up: dict[int, int] = {}
        """By teammate that the robot no longer relies on: the step of its last received target at that time."""
        self._members: tuple[Situation | None, int, dict[int, Cell]] = None, 0, {}
        """The last result of `team`, and its inputs: the situation and `_waited`."""

    @property
    def _range_cells(self) -> float:
        """The sensor range with which plans compute, in cells."""
        return min(self.settings.scale_cells, LONGEST_RANGE_M / self.settings.resolution)

    def is_due(self, situation: Situation) -> bool:
        """Return whether to plan: in each step that changes the planning grid, so that robots do not oscillate.

        With another `replan` option, and during a detour around a teammate: as `TeamStrategy`.
        """
        known = int(np.count_nonzero(situation.grid))
        changed, self._known = known != self._known, known
        each_step = self.options.replan == EACH_STEP and situation.step >= self._detour_until
        return (each_step and changed) or super().is_due(situation)

    def is_spent(self, situation: Situation, target: Cell, at: Cell) -> bool:
        """Return whether a target is no frontier any more; with other `replan` options as `TargetStrategy`."""
        if self.options.replan == EACH_STEP:
            return not is_frontier(situation.grid, *target)
        return super().is_spent(situation, target, at)

    def _spent_teammates(self, situation: Situation) -> set[tuple[int, Cell]]:
        """Return the same as `TeamStrategy`, but test the targets of all teammates at once."""
        if self.options.replan != EACH_STEP:
            return super()._spent_teammates(situation)
        known = situation.targets
        sent = [(peer, known[peer]) for peer in self.team(situation) if peer in known]
        are_left = are_frontier(situation.grid, array_of([target for _, target in sent]))
        return {sent[number] for number in np.flatnonzero(~are_left).tolist()}

    def _drive(self, situation: Situation, planner: PathPlanner, goal: Cell | None) -> bool:
        """Plan a route to a cell; a target in a straight line of free cells is approached on that line.

        While the frontier recedes, the robot then keeps its direction. Of equally short ways on the grid, the planner
        returns one with a long part along an axis, which a robot that replans in each step would never leave.
        """
        found = super()._drive(situation, planner, goal)
        if goal is None or goal != self.target or self.options.costs != "shortest":
            return found
        if is_line_free(planner.floor, *situation.here, *goal):
            self._route.cells = straighten(planner.floor, situation.here, self._route.cells)
        return found

    def _pass_by(self, situation: Situation, planner: PathPlanner) -> bool:
        self._detour_until = situation.step + MEMORY
        return super()._pass_by(situation, planner)

    def team(self, situation: Situation) -> dict[int, Cell]:
        """Return the sub-team and teammates that left it lately; these are assumed to be at their last targets.

        A robot without a goal does not rely on teammates that stand still. If it stays without a goal for long, it
        relies on no teammate until that teammate sends a new target. Callers must not modify the result.
        """
        known, waited, members = self._members
        if known is not situation or waited != self._waited:
            members = self._reliable_team(situation)
            self._members = situation, self._waited, members
        return members

    def _reliable_team(self, situation: Situation) -> dict[int, Cell]:
        """Do the work of `team`."""
        members = super().team(situation)
        left = {
            peer: situation.targets[peer]
            for peer in situation.targets.keys() - members.keys()
            if situation.step - situation.target_steps.get(peer, 0) <= RECALL
        }
        if left:
            members = dict(sorted((members | left).items()))
        for peer in members if self._waited else ():
            stands = situation.step - situation.last_moved.get(peer, situation.step) >= STILL
            if self._waited >= PLAN_ALONE_AFTER or (stands and peer in situation.peers):
                self._given_up[peer] = situation.target_steps.get(peer, 0)
        if not self._given_up:
            return members
        return {
            peer: cell
            for peer, cell in members.items()
            if peer == self.settings.robot
            or situation.target_steps.get(peer, 0) > self._given_up.get(peer, -1)
        }

    def goals(self, situation: Situation, planner: PathPlanner) -> Cells:
        """Return representatives of all reachable frontier segments, merged if they are close to each other.

        Callers must not modify the cells: robots of one process share them.
        """
        frontier = self.frontier(situation, planner)
        if not len(frontier):
            return frontier
        shape = self._range_cells, self.team_size(situation)
        find = partial(_representatives, situation.grid, frontier, *shape)
        cells, self._lengths = planner.shared((_representatives, frontier.tobytes(), *shape), find)
        return cells

    def table(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Table:
        """Return the costs of all robots and goals; ways between goals come from the same search."""
        team = self.team(situation)
        radii = () if self._alike else {self.settings.bodies[robot].radius_cells for robot in team}
        if len(radii) > 1:
            _, self._between = planner.of_radius(min(radii)).costs_among(goals[:0], goals)
            return super().table(situation, goals, planner)
        cells = array_of(team.values())
        ways, self._between = planner.costs_among(cells, goals)
        return Table(tuple(team), cells, goals, ways)

    def choose(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Cell | None:
        """Return the first goal of this robot's tour; keep the next ones for the choice of a viewpoint."""
        self._tour = []
        chosen = super().choose(situation, goals, planner)
        numbers = self._tour[: 1 + AHEAD]
        small = min(SMALL_FRONTIER * self._range_cells, SMALL_FRONTIER_M / self.settings.resolution)
        small_cells = max(SMALL_FRONTIER_CELLS, small)
        self._next = goals[numbers], self._lengths[numbers] <= small_cells
        return chosen

    def stand(self, situation: Situation, planner: PathPlanner) -> Cell | None:
        """Return the viewpoint of a small frontier from which the way on through the tour is shortest, else the target.

        If a first observation did not change the map, the robot drives up to the target: a teammate may have hidden
        it, or the frontier exists only in the received approximation.
        """
        goals, are_small = self._next
        target = self.target
        if target is None or not len(goals) or not are_small[0] or not self._uses_viewpoints():
            return target
        if target in self._observed_in_vain:
            return target
        reach = min(self.options.viewpoint_range, 1.0) * self.settings.body.range_cells
        around = ray_table(self.settings.body.range_cells, self.settings.beams)
        views = tour_viewpoints(situation.grid, goals, are_small, around, reach)
        found = best_viewpoint(planner, situation.here, views, goals, self.settings.body.speed)
        if found is None:
            self._observed_in_vain.add(target)
        return found or target

    def _uses_viewpoints(self) -> bool:
        """Whether one scan, in any heading, observes everything within range."""
        settings = self.settings
        full_turn = settings.body.field_of_view >= FULL_TURN and settings.body.turn_steps == 1
        return full_turn and self.options.replan != "at-goal" and self.options.viewpoint_range > 0

    def _is_stranded(self, here: Cell) -> bool:
        """Whether the robot must drive on; after an observation without effect it drives up to the target."""
        stranded = super()._is_stranded(here)
        if stranded and self.target is not None:
            self._observed_in_vain.add(self.target)
        return stranded

    def assign(self, table: Table, situation: Situation, planner: PathPlanner) -> Assignment:
        """Return the first goal of each robot's tour: minimum latency for a team, least length for a single robot."""
        range_cells = self._range_cells
        nearer = self._with_hysteresis(table, situation)
        if self.settings.robots == 1:
            self._tour = single_robot_tour(nearer[0], self._between)
            return np.array((self._tour or [-1])[:1])
        near = NEAR * range_cells
        ways, between = _to_neighborhoods(nearer, near), _to_neighborhoods(self._between, near)
        gain = planner.shared(
            (expected_gain, table.goals.tobytes(), self._lengths.tobytes(), range_cells),
            partial(expected_gain, situation.grid, table.goals, self._lengths, range_cells),
        )
        worth = np.minimum(gain / PLENTY, 1.0)
        # Below 1, the team has more robots than goals of large gain.
        demand = min(1.0, math.fsum(worth.tolist()) / len(table.robots))
        task = Task(
            starts=ways,
            between=between,
            weights=worth + self.options.small_frontier,
            latency_weights=np.full(len(table.goals), self.options.latency_weight / (2 * range_cells)),
            longest_weight=self.options.longest_tour,
            length_weight=self.options.total_length * demand,
            loads=self.options.expected_work * range_cells * worth,
        )
        tours = self._cache.get(task.key(), partial(team_tours, task))
        self._tour = tours[table.robots.index(self.settings.robot)]
        firsts = np.array([tour[0] if tour else -1 for tour in tours])
        _follow(firsts, table.costs, worth, self._least_worth(worth.max(initial=0.0)))
        return firsts

    def _least_worth(self, most: float) -> float:
        """Return the least worth of goals to which robots without a tour drive, given the worth of the best goal."""
        if most < LEAST_WORTH and self.options.mission == "open":
            return 0.0
        return max(LEAST_WORTH, WORTHWHILE * most)

    def _with_hysteresis(self, table: Table, situation: Situation) -> FloatRows:
        """Return the costs of all goals, reduced for the goal nearest to each robot's last target."""
        range_cells = self._range_cells
        share = SINGLE_ROBOT_HYSTERESIS if self.settings.robots == 1 else 1.0
        less = self.options.target_hysteresis * share * range_cells
        last = {**situation.targets, self.settings.robot: self.target}
        targets = array_of([last.get(robot) or NO_TARGET for robot in table.robots])
        ways = table.costs.copy()
        _prefer(ways, table.goals, targets, SAME * range_cells, less)
        return ways


def _representatives(grid: Grid, frontier: Cells, range_cells: float, robots: int) -> tuple[Cells, Int64s]:
    """Return representatives of the segments of a frontier, merged if they are close to each other.

    If there are fewer than `robots`, long segments get more of them. With each, return the number of cells of its
    segment, shape (n,). `range_cells` is the sensor range.
    """
    segments, sizes = components(frontier)
    counts = np.minimum(sizes, count_representatives(sizes, range_cells))
    while counts.sum() < robots and (sizes / counts).max() > max(1.0, SPREAD * range_cells):
        counts[np.argmax(sizes / counts)] += 1
    cells, segment, _ = cluster_groups(segments, sizes, counts)
    lengths = sizes[segment]
    gap = GAP * range_cells
    stays = thin_out(grid, cells, lengths, gap)
    while len(stays) > MAX_GOALS and gap < range_cells:
        gap *= 1.5
        stays = thin_out(grid, cells, lengths, gap)
    return cells[stays], lengths[stays]


@kernel
def _to_neighborhoods(costs: FloatRows, near: float) -> FloatRows:
    """Return the costs of ways to goals up to their neighborhoods of radius `near`, plus a share of the rest."""
    shorter = np.empty(costs.shape)
    for row in range(len(costs)):
        for goal in range(costs.shape[1]):
            cost = costs[row, goal]
            shorter[row, goal] = max(cost - near, REMAINS * cost)
    return shorter


@kernel
def _prefer(ways: FloatRows, goals: Cells, targets: Cells, same: float, less: float) -> None:
    """Reduce the cost of the goal nearest to each robot's target, within `same` cells of it, by `less`, to 0 at least.

    Distances are Chebyshev distances. `targets` has `NO_TARGET` for robots without a target.
    """
    for robot in range(len(targets)):
        x, y = targets[robot]
        nearest, gap = -1, np.inf
        for goal in range(len(goals) if x >= 0 else 0):
            distance = float(max(abs(goals[goal, 0] - x), abs(goals[goal, 1] - y)))
            if distance < gap:
                nearest, gap = goal, distance
        if gap <= same:
            ways[robot, nearest] = max(0.0, ways[robot, nearest] - less)


@kernel
def _follow(firsts: Int64s, ways: FloatRows, worth: Floats, least: float) -> None:
    """Send robots without a tour, those of which the first goal is -1, after their teammates.

    Each follows to the nearest one of those goals to which the fewest robots drive. Goals count that it can reach, and
    whose worth is at least `least`.
    """
    headed = np.zeros(len(worth), np.int64)
    for goal in firsts:
        if goal >= 0:
            headed[goal] += 1
    for robot in range(len(firsts)):
        if firsts[robot] >= 0:
            continue
        best = -1
        for goal in range(len(worth)):
            rank, least_rank = (headed[goal], ways[robot, goal]), (headed[best], ways[robot, best])
            is_candidate = worth[goal] >= least and np.isfinite(ways[robot, goal])
            if is_candidate and (best < 0 or rank < least_rank):
                best = goal
        if best >= 0:
            firsts[robot] = best
            headed[best] += 1
