"""Exploration by an artificial potential field, with and without leaders (leader paper, section III).

    potential-field   all are troopers: repelled by robots and obstacles, drawn to the closest frontier point
    leaders           leaders drive to their closest frontier point along the shortest way, come what may

Robots tell each other their poses, and whether they lead. Both move continuously (`agent.planning.forces`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from agent.planning import forces
from agent.planning.path_planner import PathPlanner
from agent.planning.route import Route, corners, crossed
from agent.planning.visibility import shortest_way
from agent.planning.yielding import YieldBehavior
from agent.settings import Settings
from agent.strategies.base import Cell, Decision, Situation, Strategy
from agent.strategies.options import option

FINE = 1000
"""Way points are told in thousandths of a cell."""

STALL_STEPS = 60
"""A robot that has seen nothing new for so many steps, and has not got away from its place, is stalled."""

STALL_METRES = 1.0
"""How far it has to get; half of what it can drive in these steps, if that is less."""

NOT_HERE = "robots are moved by forces, there are no targets to choose among"


@dataclass(frozen=True)
class FieldOptions:
    """Options of the field, in metres, seconds and newtons; the mass is 1 kg."""

    rho_robots: float = option(2.0, "range in which robots repel each other, metres")
    rho_obstacles: float = option(0.4, "range in which the closest obstacle repels, metres")
    gain_robots: float = option(0.2, "k of the repulsion between robots (Eq. 2)", least=0)
    gain_obstacles: float = option(0.01, "k of the repulsion of obstacles (Eq. 2)", least=0)
    gain_frontier: float = option(1.0, "k of the attraction of the closest frontier point (Eq. 6)", least=0)
    damping: float = option(1.5, "viscous damping, newtons for each metre a second", least=0)


WAYS = ("cells", "visibility")
"""How a leader's way is found. ``cells``: from cell to cell, straightened afterwards. ``visibility``: the shortest in
the continuous plane, by a visibility graph (III-A)."""


@dataclass(frozen=True)
class LeaderOptions(FieldOptions):
    """Options of `leaders`."""

    way: str = option("cells", "how a leader's way is found", WAYS)
    rho_lead: float = option(4.0, "a robot that knows of no leader so near becomes one, metres")
    first: int = option(1, "how many robots, from number 0, lead throughout", least=0)
    dynamic: bool = option(True, "whether others may become leaders")


class PotentialField(Strategy):
    """Troopers only."""

    name = "potential-field"
    summary = "robots repel each other, obstacles repel them, the closest frontier draws them; it may stall"
    source = "leader paper, section III-B; without leaders as in its Figs. 3b and 4b"
    options_type: ClassVar[type] = FieldOptions
    refused = dict.fromkeys(("candidates", "costs", "replan", "mission", "scan", "share"), NOT_HERE)
    publishes_target = False
    publishes_pose = True

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        chosen = self.options
        self._field = forces.Field(
            chosen.rho_robots, chosen.rho_obstacles, chosen.gain_robots, chosen.gain_obstacles,
            chosen.gain_frontier, chosen.damping,
        )  # fmt: skip
        self._velocity = np.zeros(2)
        self._route = Route()
        self._giving_way = YieldBehavior(settings.seed, settings.robot, settings.range_cells)
        self._anchor: tuple[float, float] = (0.0, 0.0)
        self._anchor_step = 0
        self._known = -1

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> Any:
        """Read the options; the ranges must be in the paper's order (Eqs. 4 and 8)."""
        chosen = super().check(options)
        ranges = _ranges(chosen)
        if chosen.rho_obstacles <= 0 or any(low > high for (_, low), (_, high) in pairwise(ranges)):
            said = ", ".join(f"{name} = {value:g}" for name, value in ranges)
            reason = "robots must feel each other before they feel walls, and a leader before it repels them"
            raise ValueError(
                f"{cls.name} needs 0 < {' <= '.join(name for name, _ in ranges)}, not {said}: {reason}"
            )
        return chosen

    @classmethod
    def check_range(cls, options: Mapping[str, Any], range_m: float) -> None:
        """Robots must be heard as far as they are felt, or followed (Eq. 8)."""
        name, farthest = _ranges(cls.check(options))[-1]
        if farthest > range_m:
            silent = {
                "rho_robots": "a robot that cannot be heard repels nobody",
                "rho_lead": "a leader that cannot be heard cannot be followed",
            }
            raise ValueError(
                f"{cls.name} needs {name} <= range, not {name} = {farthest:g} m with a range of {range_m:g} m: "
                f"{silent[name]}"
            )

    def decide(self, situation: Situation) -> Decision:
        """Move for a second: by forces, or ahead as a leader."""
        size = self.settings.resolution
        at = situation.x + situation.offset[0] / FINE, situation.y + situation.offset[1] / FINE
        planner = PathPlanner(situation.grid, radius_cells=self.settings.radius_cells)
        frontier = planner.frontier(*situation.here)
        if situation.blocked:
            self._velocity = np.zeros(2)
        if not len(frontier):
            return Decision(
                explored=True, heading=situation.heading, status="idle: no reachable frontier is left"
            )
        stalled = self._is_stalled(situation, at)
        self.leads = self.is_leader(situation)
        if self.leads:
            self._velocity = np.zeros(2)
            target, points = self._lead(situation, planner, frontier)
        else:
            robots = [situation.poses[peer][:2] for peer in situation.peers if peer in situation.poses]
            path, self._velocity = forces.glide(
                planner.floor, size, at, self._velocity, frontier,
                np.array(robots, np.float64).reshape(-1, 2), self._field, self.settings.speed_cells * size,
            )  # fmt: skip
            gap = (frontier[:, 0] - at[0]) ** 2 + (frontier[:, 1] - at[1]) ** 2
            target = frontier[np.argmin(gap)]
            points = np.rint(path * FINE).astype(np.int32)
        return Decision(
            target=(int(target[0]), int(target[1])),
            points=points,
            heading=self.heading(situation, is_there=True),
            stalled=stalled,
            status="stalled" if stalled else "leads the way" if self.leads else "is drawn to its frontier",
        )

    def is_leader(self, situation: Situation) -> bool:
        """Nobody leads."""
        del situation
        return False

    def _lead(
        self, situation: Situation, planner: PathPlanner, frontier: NDArray[np.int32]
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """The closest frontier cell, and way points along the shortest way to it."""
        costs = planner.costs(*situation.here)[frontier[:, 1], frontier[:, 0]]
        target = frontier[np.argmin(costs)]
        goal = int(target[0]), int(target[1])
        self._route.drive_to(*situation.here)
        stopped = situation.blocked == "robot"
        self._giving_way.note(self._route, situation.here, situation.step, stopped=stopped)
        self._route.lead(planner, situation.here, goal)
        if self._giving_way.has_waited:
            planner = self._giving_way.pass_by(self._route, planner, situation.here, goal, situation.step)
        start = situation.x * FINE + situation.offset[0], situation.y * FINE + situation.offset[1]
        points = None
        if self.options.way == "visibility" and not self._giving_way.has_waited:
            points = shortest_way(planner.floor, start, frontier, float(costs.min()))
        if points is None:
            points = corners(planner.floor, start, self._route.cells)
        else:
            target = (points[-1] + FINE // 2) // FINE
        self._route.cells = crossed(start, points, self.settings.speed_cells)
        return target, points

    def _is_stalled(self, situation: Situation, at: tuple[float, float]) -> bool:
        """Whether it has stayed where it is, and its map as well."""
        known = int(np.count_nonzero(situation.grid))
        away = np.hypot(at[0] - self._anchor[0], at[1] - self._anchor[1]) * self.settings.resolution
        enough = min(STALL_METRES, STALL_STEPS / 2 * self.settings.speed_cells * self.settings.resolution)
        if known != self._known or away > enough:
            self._known, self._anchor, self._anchor_step = known, at, situation.step
        return situation.step - self._anchor_step >= STALL_STEPS


class Leaders(PotentialField):
    """Troopers and leaders."""

    name = "leaders"
    summary = "a potential field whose leaders take the shortest way, so that no local minimum ends it"
    source = "leader paper, sections III-A to III-C"
    options_type = LeaderOptions

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self.leads = settings.robot < self.options.first

    def is_leader(self, situation: Situation) -> bool:
        """Section III-C, with the robots' numbers as the hierarchy."""
        reach = self.options.rho_lead / self.settings.resolution
        sensed = [
            peer
            for peer in situation.peers
            if peer in situation.poses and situation.poses[peer].leads
            and _apart(situation.poses[peer][:2], situation.here) <= reach
        ]  # fmt: skip
        robot = self.settings.robot
        return elect(robot, self.leads, sensed, self.options.first, dynamic=self.options.dynamic)


def elect(robot: int, leads: bool, leaders_sensed: list[int], first: int, *, dynamic: bool = True) -> bool:
    """Say whether a robot leads from now on (section III-C).

    The first ones lead throughout. Another becomes a leader when it senses none, and stops being one when it
    senses one that is higher in the hierarchy, which is the robots' order.
    """
    if robot < first or not dynamic:
        return robot < first
    if not leads:
        return not leaders_sensed
    return all(other > robot for other in leaders_sensed)


def _ranges(chosen: FieldOptions) -> list[tuple[str, float]]:
    """Ranges by name, in the paper's order (Eqs. 4 and 8)."""
    ranges = [("rho_obstacles", chosen.rho_obstacles), ("rho_robots", chosen.rho_robots)]
    return ranges + ([("rho_lead", chosen.rho_lead)] if isinstance(chosen, LeaderOptions) else [])


def _apart(one: Cell, other: Cell) -> float:
    return float(np.hypot(one[0] - other[0], one[1] - other[1]))
