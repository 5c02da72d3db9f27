"""Strategies that choose a target, drive to it, and choose again: all but the potential field.

Such a strategy is made of parts that vary independently, as the papers vary them. It names its own and
writes down how it picks one of the goals; every part can be exchanged by an option.

    candidates  which cells are worth going to (`agent.planning.candidates`)
    costs       how ways are counted (`agent.planning.path_planner`)
    replan      when a new target is chosen
    mission     what comes after the last one
    scan        when the scanner works
    share       when teammates get what has been seen
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from agent.memo_cache import NO_CACHE, MemoCache
from agent.planning.breadth_first import is_wide_frontier
from agent.planning.candidates import CANDIDATES, SEARCHED, goal_candidates, searched_candidate
from agent.planning.frontier import is_frontier
from agent.planning.path_planner import COSTS, PathPlanner
from agent.planning.route import Route
from agent.planning.utility import in_predictive
from agent.planning.yielding import YieldBehavior
from agent.settings import Settings
from agent.strategies.base import Cell, Decision, Situation, Strategy
from agent.strategies.options import option

REPLANNING = ("at-goal", "at-once", "after-turn")
"""When a robot chooses again. ``at-goal``: at its target. ``at-once``: as soon as its target is no frontier
any more, whoever has opened it. ``after-turn``: at its target, after the scanner's full turn. Robots that
assign targets together choose again when this is so for any of them."""

MISSIONS = ("open", "return")
"""What comes when nothing is left. ``open``: the run ends. ``return``: all drive home, then it ends. Whom
those that are back already stop near its depot again and again is home where it is, and so is who sees no
way home for long."""

SCANNING = ("always", "at-target")
"""When the scanner works. ``at-target``: not on the way, unless a wall that it does not know stops it."""

SHARING = ("always", "at-target")
"""When teammates may have what was seen. ``at-target``: when a target has been reached or is replaced."""

BERTH_METRES = 0.3
"""Room that a robot takes up at the depot, at least."""

TURNED_AWAY = 10
"""Times that teammates stop a robot near its depot, after which it is home where it is; and steps on end in
which its map shows no way there."""

MOST_WAYS = 64
"""Searches whose results robots of one process keep for each other."""


@dataclass(frozen=True)
class Parts:
    """The parts of a strategy, as options."""

    candidates: str = option("cells", "which cells are worth going to", CANDIDATES)
    costs: str = option("shortest", "how ways are counted", COSTS)
    replan: str = option("at-once", "when a new target is chosen", REPLANNING)
    mission: str = option("open", "what comes after the last target", MISSIONS)
    scan: str = option("always", "when the scanner works", SCANNING)
    share: str = option("always", "when teammates get what was seen", SHARING)


class TargetStrategy(Strategy):
    """A strategy made of parts; a subclass says in `choose` which goal it takes."""

    options_type: ClassVar[type] = Parts

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self.defers_publication = self.options.share == "at-target"
        self.target: Cell | None = None
        self._route = Route()
        self._goal: Cell | None = None
        self._giving_way = YieldBehavior(settings.seed, settings.robot, settings.range_cells)
        self._turned_away = 0
        self._cut_off = 0
        self._turned = 0
        self._at: Cell | None = None
        self._looked = True
        self._cache = NO_CACHE

    def use_shared_cache(self, cache: dict[str, Any]) -> None:
        """Search for ways once for all robots of this process that have the same planning grid."""
        if self.settings.robots > 1:
            self._cache = cache.setdefault("ways", MemoCache(MOST_WAYS))

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> Any:
        """Read the options; ValueError says which is wrong, or which two do not go together, and why."""
        chosen = super().check(options)
        for names, reason in cls.clashes(chosen):
            said = ", ".join(f"{name} = {getattr(chosen, name)}" for name in names)
            raise ValueError(f"{cls.name} cannot have {said}: {reason}")
        return chosen

    @classmethod
    def clashes(cls, parts: Any) -> list[tuple[tuple[str, ...], str]]:
        """Options that do not go together, as (names, reason)."""
        found: list[tuple[tuple[str, ...], str]] = []
        if parts.scan == "at-target" and parts.replan != "after-turn":
            reason = "a robot that looks only at its target must stay for a turn before it chooses again"
            found.append((("scan", "replan"), reason))
        if parts.candidates in SEARCHED and parts.costs != "shortest":
            reason = "breadth-first search meets cells in the order of their distance, not of weighted costs"
            found.append((("candidates", "costs"), reason))
        return found

    @classmethod
    def returns(cls, options: Mapping[str, Any]) -> bool:
        """Whether all robots must come home."""
        return bool(cls.check(options).mission == "return")

    @abstractmethod
    def choose(self, situation: Situation, goals: NDArray[np.int32], planner: PathPlanner) -> Cell | None:
        """Choose one of `goals`, at least one cell (x, y), shape (n, 2); None leaves them to others.

        What is none of the goals is refused.
        """

    def is_due(self, situation: Situation) -> bool:
        """Whether it is time to choose; at all times while there is no target."""
        if self.options.replan == "after-turn":
            return self.target in (None, situation.here) and self._turned >= self.settings.turn_steps
        return self.target is None or self.is_spent(situation, self.target, situation.here)

    def is_spent(self, situation: Situation, target: Cell, at: Cell) -> bool:
        """Whether a robot which is `at` some cell is done with its target."""
        if self.options.replan == "at-once":
            is_left = is_wide_frontier if self.options.candidates == "hops" else is_frontier
            return not is_left(situation.grid, *target)
        return target == at

    def herds(self, situation: Situation) -> bool:
        """The rule against herding: robots that choose at once from the same map choose alike.

        A target of a lower-numbered teammate within that one's sensor range and in predictive of one's own makes one
        choose again, once for each that is heard.
        """
        if self.target is None:
            return False
        own_x, own_y = self.target
        return any(
            other < self.settings.robot
            and (x - own_x) ** 2 + (y - own_y) ** 2 < self.settings.ranges_cells[other] ** 2
            and in_predictive(situation.grid, x, y, own_x, own_y)
            for other, (x, y) in situation.new_targets.items()
        )

    def team_size(self, situation: Situation) -> int:
        """How many robots choose together."""
        del situation
        return 1

    def decide(self, situation: Situation) -> Decision:
        """Choose a target if it is time, mend the way if it is barred, and drive on."""
        here = situation.here
        self._count_turn(here)
        self._route.drive_to(*here)
        self._giving_way.note(self._route, here, situation.step, stopped=situation.blocked == "robot")
        planner = self.planner(situation)
        before, left, gives_up = self.target, True, self._giving_way.gives_up()
        if gives_up or self.is_due(situation):
            left = self._renew(situation, planner)
        elif not self._route.is_open(planner.floor, here) or self._is_stranded(here):
            left = self._drive(situation, planner, self.target) or self._renew(situation, planner)
        elif self.target is None:
            searches = self.options.candidates in SEARCHED
            left = len((self.goals if searches else self.frontier)(situation, planner)) > 0
        if self.target != before:
            self._giving_way.begin()
        is_home = self._comes_home(situation, planner)
        if is_home:
            self._route.clear()
        elif self._giving_way.has_waited:
            left = self._pass_by(situation, planner) and left
        at_rest = not len(self._route.cells) or situation.blocked == "wall"
        self._looked = self.options.scan == "always" or at_rest
        return Decision(
            target=self.target,
            path=self._route.next_cells(int(self.settings.speed_cells) + 2),
            heading=self.heading(situation, is_there=self.target == here),
            explored=not left and (self.options.mission == "open" or is_home),
            look=self._looked,
            publish=self.target is None or self.target != before or gives_up,
            status=self._status(here, left),
        )

    def planner(self, situation: Situation) -> PathPlanner:
        """The ways that the robot may take."""
        return PathPlanner(situation.grid, self.options.costs, self.settings.radius_cells, cache=self._cache)

    def goals(self, situation: Situation, planner: PathPlanner) -> NDArray[np.int32]:
        """The cells that are worth going to, shape (n, 2)."""
        kind = self.options.candidates
        if kind in SEARCHED:
            ranges = self.settings.ranges_of(situation.targets)
            return searched_candidate(kind, planner, situation.here, list(situation.targets.values()), ranges)
        frontier = self.frontier(situation, planner)
        return goal_candidates(kind, frontier, self.settings.scale_cells, self.team_size(situation))

    def frontier(self, situation: Situation, planner: PathPlanner) -> NDArray[np.int32]:
        """The frontier cells that can be reached, row by row, shape (n, 2)."""
        return planner.frontier(*situation.here)

    def select(self, situation: Situation, planner: PathPlanner) -> tuple[Cell | None, bool]:
        """Choose one of all goals, as `choose` has it; and whether there are any."""
        goals = self.goals(situation, planner)
        chosen = self.choose(situation, goals, planner) if len(goals) else None
        if chosen is None:
            return None, len(goals) > 0
        x, y = map(int, chosen)
        if not ((goals[:, 0] == x) & (goals[:, 1] == y)).any():
            raise ValueError(f"strategy {self.name} chose {x, y}, which is none of its goals")
        return (x, y), True

    def stand(self, situation: Situation, planner: PathPlanner) -> Cell | None:
        """Where to drive for the target: there itself."""
        del situation, planner
        return self.target

    def _count_turn(self, here: Cell) -> None:
        """Count the sectors that the scanner has seen from this cell."""
        self._turned = (self._turned if here == self._at else 0) + self._looked
        self._at = here

    def _renew(self, situation: Situation, planner: PathPlanner) -> bool:
        """Choose a target; whether there was any goal."""
        self.target, left = self.select(situation, planner)
        goal = self.stand(situation, planner)
        if goal is None and self.options.mission == "return":
            goal = situation.home
        if self.target is not None or not self._is_under_way(situation.here, goal, planner):
            self._drive(situation, planner, goal)
        return left

    def _drive(self, situation: Situation, planner: PathPlanner, goal: Cell | None) -> bool:
        """Take a way to a cell, or stay where that is none; whether there is one."""
        self._goal = goal
        if goal is None:
            self._route.clear()
            return False
        return self._route.lead(planner, situation.here, goal)

    def _is_under_way(self, here: Cell, goal: Cell | None, planner: PathPlanner) -> bool:
        """Whether it drives to a cell, or makes room on its way there."""
        return self._goal == goal and len(self._route.cells) > 0 and self._route.is_open(planner.floor, here)

    def _is_stranded(self, here: Cell) -> bool:
        """Whether a detour has led the robot elsewhere."""
        return self.target is not None and self.target != here and not len(self._route.cells)

    def _pass_by(self, situation: Situation, planner: PathPlanner) -> bool:
        """Get past a teammate; a target on which one stands is given up. Returns whether there is a goal left."""
        left = True
        if self.target is not None and len(self._route.cells) == 1:
            left = self._renew(situation, planner)
        if self._goal is not None:
            self._giving_way.pass_by(self._route, planner, situation.here, self._goal, situation.step)
        return left

    def _comes_home(self, situation: Situation, planner: PathPlanner) -> bool:
        """Whether it has nothing else to do and is at its depot; or as near as teammates, or its map, let it."""
        if self.target is not None or self.options.mission == "open":
            self._turned_away = self._cut_off = 0
            return False
        if situation.blocked == "robot" and self._is_near_home(situation, planner):
            self._turned_away += 1
        self._cut_off = self._cut_off + 1 if self._is_cut_off(situation, planner) else 0
        return situation.here == situation.home or max(self._turned_away, self._cut_off) >= TURNED_AWAY

    def _is_cut_off(self, situation: Situation, planner: PathPlanner) -> bool:
        """Whether it stays for want of a way home: by its map a wall bars it."""
        return not len(self._route.cells) and planner.path(situation.here, situation.home) is None

    def _is_near_home(self, situation: Situation, planner: PathPlanner) -> bool:
        """Whether its way home is no longer than a queue of all robots, there and back."""
        berth = max(1.0, 2 * self.settings.radius_cells, BERTH_METRES / self.settings.resolution)
        way = planner.path(situation.here, situation.home)
        return way is not None and len(way) <= 2 * self.settings.robots * berth

    def _status(self, here: Cell, left: bool) -> str:
        if self._giving_way.waited:
            return "waits: a teammate stands in the way"
        if self.target is None and len(self._route.cells):
            return "drives home"
        if self._cut_off:
            return "idle: its map shows no way home"
        if not left:
            return "idle: no reachable frontier is left on its planning grid"
        if self.target is None and self.options.replan == "after-turn":
            return "looks around before it chooses"
        if self.target is None:
            return "waits: its teammates have taken all goals"
        return "looks around at its target" if self.target == here else "drives to its target"
