"""Strategies that choose a target, drive to it, and choose again: all but the potential field.

Such a strategy consists of parts that vary independently, as in the papers. A strategy has a default for each part,
which an option can replace, and its own rule that chooses one of the goals.

    candidates  the goals among the frontier cells (`agent.planning.candidates`)
    costs       the cost of a way (`agent.planning.path_planner`)
    replan      when to choose a new target
    mission     the end of the run
    scan        when the scanner works
    share       when map changes are sent to teammates
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from agent.memo_cache import NO_CACHE, MemoCache
from agent.planning.breadth_first import is_wide_frontier
from agent.planning.candidates import CANDIDATES, SEARCHED, goal_candidates, searched_candidate
from agent.planning.frontier import is_frontier
from agent.planning.path_planner import COSTS, PathPlanner
from agent.planning.route import Route
from agent.planning.utility import covers
from agent.planning.yielding import MOBILE, YieldBehavior
from agent.settings import Settings
from agent.strategies.base import Decision, Situation, Strategy
from agent.strategies.homing import Homing
from agent.strategies.options import option
from protocol.arrays import Cells
from protocol.errors import shown
from protocol.grid import Cell
from protocol.plugins import PluginError

REPLANNING = ("at-goal", "at-once", "after-turn")
"""When a robot chooses a new target. ``at-goal``: at its target. ``at-once``: as soon as its target is no frontier any
more. ``after-turn``: at its target, after a full turn of the scanner. Robots that assign targets together choose when
this holds for any of them."""

MISSIONS = ("open", "return")
"""The end of the run. ``open``: nothing is left to explore. ``return``: all robots have driven home. A robot that
teammates block repeatedly near its depot counts as home, and so does a robot that finds no way home for long."""

SCANNING = ("always", "at-target")
"""When the scanner works. ``at-target``: not on the way, unless an unknown wall stops the robot."""

SHARING = ("always", "at-target")
"""When map changes are sent. ``at-target``: when a target is reached or replaced."""

MAX_CACHED_RESULTS = 256
"""Capacity of the cache of path searches and other results that the robots of a process share."""


class Clash(NamedTuple):
    """Options that conflict, the condition on all options under which they do, and the reason."""

    names: tuple[str, ...]
    holds: Callable[[Any], bool]
    reason: str


def is_searched(parts: Any) -> bool:
    """Return whether a search finds a single candidate."""
    return parts.candidates in SEARCHED


SINGLE_CANDIDATE = Clash(
    ("candidates",), is_searched, "breadth-first search finds a single cell, so there are no goals to compare"
)


@dataclass(frozen=True)
class Parts:
    """The parts of a strategy, as options."""

    candidates: str = option("cells", "the goals among the frontier cells", CANDIDATES)
    costs: str = option("shortest", "the cost of a way", COSTS)
    replan: str = option("at-once", "when to choose a new target", REPLANNING)
    mission: str = option("open", "the end of the run", MISSIONS)
    scan: str = option("always", "when the scanner works", SCANNING)
    share: str = option("always", "when map changes are sent to teammates", SHARING)


@dataclass(frozen=True)
class BarringParts(Parts):
    """The parts of a strategy that may bar cells of high occupancy (Burgard et al. 2005, II-A; Meier 2005, Eq. 4.3)."""

    occ_max: float = option(
        1.0, "cells with more occupancy on the smoothed map are obstacles; no cell from 0.9 on", least=0
    )


class TargetStrategy(Strategy):
    """A strategy made of parts; a subclass chooses a goal in `choose`."""

    options_type: ClassVar[type] = Parts
    clashes: ClassVar[tuple[Clash, ...]] = (
        Clash(
            ("scan", "replan"),
            lambda parts: parts.scan == "at-target" and parts.replan != "after-turn",
            "a robot that scans at its target alone must stay for a full turn before it chooses again",
        ),
        Clash(
            ("candidates", "costs"),
            lambda parts: is_searched(parts) and parts.costs != "shortest",
            "breadth-first search visits cells in the order of their distance, not of weighted costs",
        ),
    )

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self.defers_publication = self.options.share == "at-target"
        self.has_diagonal_frontier = self.options.candidates == "hops"
        self.target: Cell | None = None
        """The goal that the robot has chosen; None if it has none."""
        self._route = Route()
        self._goal: Cell | None = None
        """The end of the route: the target, a viewpoint (`stand`), or the depot."""
        body = settings.body
        self._yielding = YieldBehavior(settings.seed, settings.robot, body.range_cells, body.speed)
        self._homing = Homing(settings)
        self._scanner_steps = 0
        """Steps in which the scanner has worked since the robot came to its cell, `_at`."""
        self._at: Cell | None = None
        self._scans = True
        """Whether the scanner works since the last decision."""
        self._cache = NO_CACHE

    def use_shared_cache(self, cache: dict[str, Any]) -> None:
        """Share path searches and frontiers with robots of this process that have the same planning grid."""
        if self.settings.robots > 1:
            self._cache = cache.setdefault("ways", MemoCache(MAX_CACHED_RESULTS))

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> Any:
        """Return the options; ValueError names an invalid option, or options that conflict, and the reason."""
        chosen = super().check(options)
        for names, holds, reason in cls.clashes:
            if holds(chosen):
                given = ", ".join(f"{name} = {getattr(chosen, name)}" for name in names)
                raise ValueError(f"{cls.name} cannot have {given}: {reason}")
        return chosen

    @classmethod
    def returns(cls, options: Mapping[str, Any]) -> bool:
        """Return whether all robots must drive home."""
        return bool(cls.check(options).mission == "return")

    @abstractmethod
    def choose(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Cell | None:
        """Choose one of the goals, of which there is at least one; None leaves them to teammates.

        The planner has costs and paths on the planning grid.
        """

    def is_due(self, situation: Situation) -> bool:
        """Return whether to choose a target; always true without a target, and if the robot `herds`."""
        if self.options.replan == "after-turn":
            is_there = self.target in (None, situation.here)
            has_scanned = is_there and self._scanner_steps >= self.settings.body.turn_steps
            return has_scanned or self.herds(situation)
        is_done = self.target is None or self.is_spent(situation, self.target, situation.here)
        return is_done or self.herds(situation)

    def is_spent(self, situation: Situation, target: Cell, at: Cell) -> bool:
        """Return whether a robot in cell `at` is done with its target."""
        if self.options.replan == "at-once":
            is_left = is_wide_frontier if self.has_diagonal_frontier else is_frontier
            return not is_left(situation.grid, *target)
        return target == at

    def herds(self, situation: Situation) -> bool:
        """Apply the rule against herding, with the option `herding`: robots that choose from the same map choose alike.

        Returns whether a lower-numbered teammate has just sent a target in sight of this robot's target and nearer
        to it than that teammate's sensor range.
        """
        if self.target is None or not getattr(self.options, "herding", False):
            return False
        return any(
            other < self.settings.robot
            and covers(situation.grid, target, self.target, self.settings.bodies[other].range_cells)
            for other, target in situation.new_targets.items()
        )

    def team_size(self, situation: Situation) -> int:
        """Return the number of robots that choose together."""
        return 1

    def decide(self, situation: Situation) -> Decision:
        """Choose a target if it is time, replan the route if it is blocked, and drive on."""
        here = situation.here
        self._scanner_steps = (self._scanner_steps if here == self._at else 0) + self._scans
        self._at = here
        self._route.advance_to(*here)
        self._yielding.note(self._route, here, situation.step, stopped=situation.blocked in MOBILE)
        planner = self.planner(situation)
        before, left, gives_up = self.target, True, self._yielding.gives_up()
        if gives_up or self.is_due(situation):
            left = self._renew(situation, planner)
        elif not self._route.is_open(planner.floor, here) or self._is_stranded(here):
            left = self._drive(situation, planner, self.target) or self._renew(situation, planner)
        elif self.target is None:
            searches = self.options.candidates in SEARCHED
            left = len((self.goals if searches else self.frontier)(situation, planner)) > 0
        if self.target != before:
            self._yielding.begin()
        is_home = self._comes_home(situation, planner)
        if is_home:
            self._route.clear()
        elif self._yielding.has_waited:
            left = self._pass_by(situation, planner) and left
        at_rest = not len(self._route.cells) or situation.blocked == "wall"
        self._scans = self.options.scan == "always" or at_rest
        return Decision(
            target=self.target,
            path=self._route.cells[: int(self.settings.body.speed) + 2],
            heading=self.heading(situation, is_there=self.target == here),
            explored=not left and (self.options.mission == "open" or is_home),
            look=self._scans,
            publish=self.target is None or self.target != before or gives_up,
            status=self._status(here, left),
        )

    def planner(self, situation: Situation) -> PathPlanner:
        """Return a path planner on the planning grid; with the option `occ_max`, cells above it are obstacles."""
        return PathPlanner(
            situation.grid,
            self.options.costs,
            self.settings.body.radius_cells,
            occ_max=getattr(self.options, "occ_max", 1.0),
            cache=self._cache,
        )

    def goals(self, situation: Situation, planner: PathPlanner) -> Cells:
        """Return the goals."""
        kind = self.options.candidates
        if kind in SEARCHED:
            ranges = self.settings.ranges_of(situation.targets)
            return searched_candidate(kind, planner, situation.here, list(situation.targets.values()), ranges)
        frontier = self.frontier(situation, planner)
        return goal_candidates(kind, frontier, self.settings.scale_cells, self.team_size(situation))

    def frontier(self, situation: Situation, planner: PathPlanner) -> Cells:
        """Return the reachable frontier cells, row by row."""
        return planner.frontier(*situation.here)

    def select(self, situation: Situation, planner: PathPlanner) -> tuple[Cell | None, bool]:
        """Return the chosen goal, and whether there are goals at all."""
        goals = self.goals(situation, planner)
        chosen = self.choose(situation, goals.copy(), planner) if len(goals) else None
        if chosen is None:
            return None, len(goals) > 0
        try:
            x, y = map(int, chosen)
        except (TypeError, ValueError):
            raise PluginError(
                f"strategy {self.name}: choose must return a goal (x, y), or None; it returned {shown(chosen)}"
            ) from None
        if not ((goals[:, 0] == x) & (goals[:, 1] == y)).any():
            raise PluginError(f"strategy {self.name} chose {x, y}, which is not one of its goals")
        return (x, y), True

    def stand(self, situation: Situation, planner: PathPlanner) -> Cell | None:
        """Return the cell to drive to for the current target; a subclass may return a viewpoint."""
        return self.target

    def _renew(self, situation: Situation, planner: PathPlanner) -> bool:
        """Choose a target; return whether there was any goal."""
        self.target, left = self.select(situation, planner)
        goal = self.stand(situation, planner)
        if goal is None and self.options.mission == "return":
            goal = situation.home
        is_under_way = self._goal == goal and len(self._route.cells) > 0
        if self.target is None and is_under_way and self._route.is_open(planner.floor, situation.here):
            return left
        self._drive(situation, planner, goal)
        return left

    def _drive(self, situation: Situation, planner: PathPlanner, goal: Cell | None) -> bool:
        """Plan a route to a cell; stay for None. Return whether there is a route."""
        self._goal = goal
        if goal is None:
            self._route.clear()
            return False
        return self._route.plan(planner, situation.here, goal)

    def _is_stranded(self, here: Cell) -> bool:
        """Whether the route has ended in another cell than the target, after a detour."""
        return self.target is not None and self.target != here and not len(self._route.cells)

    def _pass_by(self, situation: Situation, planner: PathPlanner) -> bool:
        """Drive around a teammate; give up a target on which it stands. Return whether there is a goal left."""
        left = True
        if self.target is not None and len(self._route.cells) == 1:
            left = self._renew(situation, planner)
        if self._goal is not None:
            self._yielding.pass_by(self._route, planner, situation.here, self._goal, situation.step)
        return left

    def _comes_home(self, situation: Situation, planner: PathPlanner) -> bool:
        """Whether the robot has no target and counts as home (`MISSIONS`)."""
        if self.target is not None or self.options.mission == "open":
            self._homing.reset()
            return False
        return self._homing.is_home(situation, planner, self._route)

    def _status(self, here: Cell, left: bool) -> str:
        if self._yielding.waited:
            return "waiting: a teammate is in the way"
        if self.target is None and len(self._route.cells):
            return "driving home"
        if self._homing.cut_off:
            return "idle: the map shows no way home"
        if not left:
            return "idle: no reachable frontier on the planning grid"
        if self.target is None and self.options.replan == "after-turn":
            return "scanning before the next choice"
        if self.target is None:
            return "waiting: teammates have taken all goals"
        return "scanning at the target" if self.target == here else "driving to the target"
