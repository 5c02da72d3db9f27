"""When a robot that drives home counts as home: at its depot, or where it comes no nearer."""

from __future__ import annotations

from agent.planning.path_planner import PathPlanner
from agent.planning.route import Route
from agent.settings import Settings
from agent.strategies.base import Situation

MIN_BERTH_M = 0.3
"""Least length in meters that a robot takes up in a queue at the depot."""

HOME_AFTER = 10
"""A robot counts as home after teammates have stopped it this often near its depot, or after this many steps without a
way home."""


class Homing:
    """One robot's way home, in steps without a target."""

    def __init__(self, settings: Settings) -> None:
        self.cut_off = 0
        """Steps in a row in which the robot stayed because its map shows no way home."""
        self._stops = 0
        """How often teammates have stopped it near its depot."""
        berth_m = MIN_BERTH_M / settings.resolution
        self._queue_cells = settings.robots * max(1.0, 2 * settings.body.radius_cells, berth_m)
        """Length of a queue of all robots."""

    def reset(self) -> None:
        """Begin again: the robot has a target."""
        self._stops = self.cut_off = 0

    def is_home(self, situation: Situation, planner: PathPlanner, route: Route) -> bool:
        """Return whether the robot counts as home; call it in each step without a target."""
        if situation.blocked == "robot" and self._is_near(situation, planner):
            self._stops += 1
        is_cut_off = not len(route.cells) and planner.path(situation.here, situation.home) is None
        self.cut_off = self.cut_off + 1 if is_cut_off else 0
        return situation.here == situation.home or max(self._stops, self.cut_off) >= HOME_AFTER

    def _is_near(self, situation: Situation, planner: PathPlanner) -> bool:
        """Whether the way home is at most twice as long as a queue of all robots."""
        way = planner.path(situation.here, situation.home)
        return way is not None and len(way) <= 2 * self._queue_cells
