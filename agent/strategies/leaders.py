"""Exploration by an artificial potential field, with and without leaders (leader paper, section III).

    potential-field   all are troopers: repelled by robots and obstacles, drawn to the closest frontier point
    leaders           leaders drive to their closest frontier point along the shortest way, without forces

With real sensors, robots of the first kind leave local minima: a robot that makes no way drives to its closest frontier
point as leaders do (option `escape`, which is not in the paper).

Robots broadcast their poses, and whether they lead. Both kinds move continuously (`agent.planning.forces`).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from agent.planning import forces
from agent.planning.escape import NEAR_M, STEPS, Escape
from agent.planning.path_planner import PathPlanner
from agent.planning.route import Route, corners, crossed
from agent.planning.visibility import shortest_way
from agent.planning.yielding import MOBILE, YieldBehavior
from agent.settings import Settings
from agent.strategies.base import Decision, Situation, Strategy, cell_at
from agent.strategies.options import option
from protocol.arrays import Cells, FloatRows
from protocol.grid import FINE, Cell, Point, cell_of

STALL_STEPS = 60
"""A robot is stalled after this many steps without a change of its map or its place."""

STALL_METERS = 1.0
"""Distance in meters that counts as a change of place; at most half of what the robot can drive in that time."""

ESCAPES = ("real-sensors", "always", "never")
"""When robots leave local minima by path planning (`agent.planning.escape`). ``real-sensors``: if lasers or poses have
errors."""

TEAMMATES = ("still", "moving")
"""Where teammates are during a step. ``still``: in the cells of their last poses. ``moving``: they repeat the motion
since the step before; a teammate that was out of range then stays in its cell."""

NOT_HERE = "forces move the robots, so there are no targets to choose from"


@dataclass(frozen=True)
class FieldOptions:
    """Options of the potential field, in meters, seconds and newtons; a robot has a mass of 1 kg."""

    rho_robots: float = option(2.0, "range in which robots repel each other, in meters")
    rho_obstacles: float = option(0.4, "range in which the closest obstacle repels, in meters")
    gain_robots: float = option(0.2, "k of the repulsion between robots (Eq. 2)", least=0)
    gain_obstacles: float = option(0.01, "k of the repulsion of obstacles (Eq. 2)", least=0)
    gain_frontier: float = option(1.0, "k of the attraction of the closest frontier point (Eq. 6)", least=0)
    damping: float = option(1.5, "viscous damping, newtons for each meter a second", least=0)
    teammates: str = option("still", "where teammates that repel a robot are during a step", TEAMMATES)


WAYS = ("cells", "visibility")
"""Path planning of leaders. ``cells``: over cells, straightened afterwards. ``visibility``: the shortest way in the
continuous plane, from a visibility graph (section III-A)."""


@dataclass(frozen=True)
class LeaderOptions(FieldOptions):
    """Options of `leaders`."""

    way: str = option("cells", "path planning of leaders", WAYS)
    rho_lead: float = option(4.0, "a robot without a leader within this distance becomes one, in meters")
    first: int = option(1, "number of permanent leaders, from robot 0 on", least=0)
    dynamic: bool = option(True, "whether others may become leaders")


@dataclass(frozen=True)
class TrooperOptions(FieldOptions):
    """Options of `potential-field`."""

    escape: str = option(
        "real-sensors", "when a robot in a local minimum drives to a frontier by path planning", ESCAPES
    )


class FieldStrategy(Strategy):
    """The common part of both strategies: robots that forces move, unless they lead or escape."""

    refused = dict.fromkeys(("candidates", "costs", "replan", "mission", "scan", "share"), NOT_HERE)
    publishes_target = False
    publishes_pose = True

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self._field = forces.FieldParameters(
            *(getattr(self.options, name) for name in forces.FieldParameters._fields)
        )
        self._velocity = np.zeros(2)
        self._route = Route()
        body = settings.body
        self._yielding = YieldBehavior(settings.seed, settings.robot, body.range_cells, body.speed)
        self._anchor: tuple[float, float] = (0.0, 0.0)
        self._anchor_step = 0
        self._known = -1
        """`_anchor`, `_anchor_step`, `_known`: the robot's place, the step, and the known cells of its planning grid
        when it last made progress (`_is_stalled`)."""
        self._poses: dict[int, Cell] = {}
        """The cells of the teammates that were in range at the last decision."""
        self._escape: Escape | None = None

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> Any:
        """Read the options; the ranges must be in the paper's order (Eqs. 4 and 8)."""
        chosen = super().check(options)
        ranges = _ranges(chosen)
        if chosen.rho_obstacles <= 0 or any(low > high for (_, low), (_, high) in pairwise(ranges)):
            given = ", ".join(f"{name} = {value:g}" for name, value in ranges)
            reason = "robots must react to each other before they react to walls, and to a leader before it repels them"
            raise ValueError(
                f"{cls.name} needs 0 < {' <= '.join(name for name, _ in ranges)}, not {given}: {reason}"
            )
        return chosen

    @classmethod
    def check_range(cls, options: Mapping[str, Any], range_m: float) -> None:
        """Raise ValueError unless robots receive poses from the whole range of a force or of leadership (Eq. 8)."""
        name, farthest = _ranges(cls.check(options))[-1]
        if farthest > range_m:
            reasons = {
                "rho_robots": "a robot out of radio range repels no other",
                "rho_lead": "no robot follows a leader out of radio range",
            }
            raise ValueError(
                f"{cls.name} needs {name} <= range, not {name} = {farthest:g} m with a range of {range_m:g} m: "
                f"{reasons[name]}"
            )

    def decide(self, situation: Situation) -> Decision:
        """Return the motion of the next second: by forces, or along a leader's way."""
        size = self.settings.resolution
        at = situation.x + situation.offset[0] / FINE, situation.y + situation.offset[1] / FINE
        planner = PathPlanner(situation.grid, radius_cells=self.settings.body.radius_cells)
        frontier = planner.frontier(*situation.here)
        robots, drifts = self._teammates(situation)
        if situation.blocked:
            self._velocity = np.zeros(2)
        stalled = self._is_stalled(situation, at)
        if not len(frontier):
            return Decision(
                explored=True,
                heading=situation.heading,
                stalled=stalled,
                status="idle: no reachable frontier on the planning grid",
            )
        self.leads = self.is_leader(situation)
        escapes = self._escape is not None and self._escape.is_needed(at, situation.step, planner, frontier)
        if self.leads or escapes:
            self._velocity = np.zeros(2)
            target, points = self._lead(situation, planner, frontier)
        else:
            path, self._velocity = forces.glide(
                planner.floor, size, at, self._velocity, frontier,
                robots, self._field, self.settings.body.speed * size, drifts,
            )  # fmt: skip
            gap = (frontier[:, 0] - at[0]) ** 2 + (frontier[:, 1] - at[1]) ** 2
            target = cell_at(frontier, np.argmin(gap))
            points = np.rint(path * FINE).astype(np.int32)
        return Decision(
            target=target,
            points=points,
            heading=self.heading(situation, is_there=True),
            stalled=stalled,
            status=self._status(stalled=stalled, escapes=escapes),
        )

    def _teammates(self, situation: Situation) -> tuple[FloatRows, FloatRows]:
        """Return the cells of teammates in range, and the ways that they drive during the step, each shape (m, 2)."""
        poses = {peer: situation.poses[peer][:2] for peer in situation.peers if peer in situation.poses}
        before, self._poses = self._poses, poses
        robots = np.array(list(poses.values()), np.float64).reshape(-1, 2)
        last = [before.get(peer, cell) for peer, cell in poses.items()]
        drifts = robots - np.array(last, np.float64).reshape(-1, 2)
        return robots, drifts if self.options.teammates == "moving" else np.zeros_like(robots)

    def _status(self, *, stalled: bool, escapes: bool) -> str:
        if escapes:
            return "driving out of a local minimum"
        return "stalled" if stalled else "leading" if self.leads else "drawn to its closest frontier"

    def _change_of_place(self, steps: int) -> float:
        """Return the distance in meters that counts as a change of place within some steps."""
        return min(STALL_METERS, steps / 2 * self.settings.body.speed * self.settings.resolution)

    @abstractmethod
    def is_leader(self, situation: Situation) -> bool:
        """Return whether this robot leads."""

    def straight_way(
        self, planner: PathPlanner, start: Point, frontier: Cells, length: float
    ) -> Cells | None:
        """Return waypoints of a way in the continuous plane to the frontier; None: over cells.

        `length` is that of the shortest way over cells.
        """
        return None

    def _lead(self, situation: Situation, planner: PathPlanner, frontier: Cells) -> tuple[Cell, Cells]:
        """Return the closest frontier cell, and waypoints of the shortest way to it."""
        costs = planner.costs(*situation.here)[frontier[:, 1], frontier[:, 0]]
        goal = cell_at(frontier, np.argmin(costs))
        self._route.advance_to(*situation.here)
        stopped = situation.blocked in MOBILE
        self._yielding.note(self._route, situation.here, situation.step, stopped=stopped)
        self._route.plan(planner, situation.here, goal)
        if self._yielding.has_waited:
            planner = self._yielding.pass_by(self._route, planner, situation.here, goal, situation.step)
        start = situation.x * FINE + situation.offset[0], situation.y * FINE + situation.offset[1]
        points = None
        if not self._yielding.has_waited:
            points = self.straight_way(planner, start, frontier, float(costs.min()))
        if points is None:
            points = corners(planner.floor, start, self._route.cells)
        else:
            x, y = points[-1].tolist()
            goal = cell_of((x, y))
        self._route.cells = crossed(start, points, self.settings.body.speed)
        return goal, points

    def _is_stalled(self, situation: Situation, at: tuple[float, float]) -> bool:
        """Whether neither the robot's place nor its map has changed for `STALL_STEPS`."""
        known = int(np.count_nonzero(situation.grid))
        away = np.hypot(at[0] - self._anchor[0], at[1] - self._anchor[1]) * self.settings.resolution
        if known != self._known or away > self._change_of_place(STALL_STEPS):
            self._known, self._anchor, self._anchor_step = known, at, situation.step
        return situation.step - self._anchor_step >= STALL_STEPS


class PotentialField(FieldStrategy):
    """A potential field in which no robot leads."""

    name = "potential-field"
    summary = "robots repel each other, obstacles repel them, the closest frontier draws them; it may stall"
    source = "leader paper, section III-B; without leaders as in its Figs. 3b and 4b"
    options_type: ClassVar[type] = TrooperOptions

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        escape = self.options.escape
        if escape == "always" or (escape == "real-sensors" and settings.laser is not None):
            size = settings.resolution
            self._escape = Escape(self._change_of_place(STEPS) / size, NEAR_M / size)

    def is_leader(self, situation: Situation) -> bool:
        """Return that it does not."""
        return False


class Leaders(FieldStrategy):
    """A potential field with leaders."""

    name = "leaders"
    summary = "a potential field whose leaders drive the shortest way, past local minima"
    source = "leader paper, sections III-A to III-C"
    options_type: ClassVar[type] = LeaderOptions

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self.leads = settings.robot < self.options.first

    def is_leader(self, situation: Situation) -> bool:
        """Return whether this robot leads (section III-C); the hierarchy is the order of robot numbers."""
        reach = self.options.rho_lead / self.settings.resolution
        sensed = [
            peer
            for peer in situation.peers
            if peer in situation.poses and situation.poses[peer].leads
            and math.dist(situation.poses[peer][:2], situation.here) <= reach
        ]  # fmt: skip
        robot = self.settings.robot
        return elect(robot, self.leads, sensed, self.options.first, dynamic=self.options.dynamic)

    def straight_way(
        self, planner: PathPlanner, start: Point, frontier: Cells, length: float
    ) -> Cells | None:
        """Return the way by a visibility graph, with ``way = "visibility"``."""
        if self.options.way != "visibility":
            return None
        return shortest_way(planner.floor, start, frontier, length)


def elect(robot: int, leads: bool, leaders_sensed: list[int], first: int, *, dynamic: bool = True) -> bool:
    """Return whether a robot leads from now on (section III-C).

    The first robots always lead. Another robot becomes a leader when it senses none, and stops leading when it senses
    a leader with a lower number.
    """
    if robot < first or not dynamic:
        return robot < first
    if not leads:
        return not leaders_sensed
    return all(other > robot for other in leaders_sensed)


def _ranges(chosen: FieldOptions) -> list[tuple[str, float]]:
    """Return the ranges by name, in the order that Eqs. 4 and 8 require."""
    ranges = [("rho_obstacles", chosen.rho_obstacles), ("rho_robots", chosen.rho_robots)]
    return ranges + ([("rho_lead", chosen.rho_lead)] if isinstance(chosen, LeaderOptions) else [])
