"""Local conflict resolution: a robot gets past teammates and people in its way without communication.

The robot waits for some steps. Robots that take several steps to leave a cell wait for a random time: two of them would
stop, wait, and turn aside in the same steps, again and again. Then the robot drives around all cells in which teammates
have stopped it lately. Without this memory, a robot between two teammates would turn back and forth forever. If there
is no other way, or a much longer one, the robot yields: it drives to a random cell near by, each time up to twice as
far. If teammates stop it repeatedly in one cell, it chooses another target.
"""

from __future__ import annotations

import math

import numpy as np

from agent.planning.path_planner import PathPlanner
from agent.planning.route import Route
from protocol.grid import Cell
from protocol.keyed_random import keyed_random

MOBILE = ("robot", "person")
"""Obstacles that may move out of the way (`protocol.messages.Sense.blocked`)."""

WAIT = 2
"""Steps for which the robot waits first, at least."""

MEMORY = 20
"""Steps for which the robot avoids a cell in which a teammate stopped it."""

FARTHEST = 4
"""Largest number of doublings of the yield distance."""

GIVE_UP = 10
"""Number of stops in one cell after which the robot chooses another target."""


class YieldBehavior:
    """Yield state of one robot.

    `seed` and `robot` draw the yield cells, and how long a slow robot waits. `near` is the first yield distance in
    cells, `speed` is in cells per step.
    """

    def __init__(self, seed: int, robot: int, near: float, speed: float) -> None:
        self.waited = 0
        """Consecutive steps in which a teammate has stopped the robot."""
        self._seed = seed
        self._robot = robot
        self._near = near
        self._cell_steps = math.ceil(1 / speed)
        """Steps in which the robot leaves a cell."""
        self._wait = WAIT
        """Steps for which the robot waits this time."""
        self._at: Cell | None = None
        self._stops = 0
        """How often the robot was stopped since it came to its cell, `_at`."""
        self._held: dict[Cell, int] = {}
        """Cells in which a teammate stopped it, and the step of the last time."""
        self._doublings = 0
        """How often the yield distance was doubled for this target."""

    def note(self, route: Route, here: Cell, step: int, *, stopped: bool) -> None:
        """Take the result of the last move along `route`."""
        if stopped and not self.waited and self._cell_steps > 1:
            random = keyed_random(self._seed, "step aside", self._robot, step)
            self._wait = WAIT + int(random.integers(2 * self._cell_steps))
        self.waited = self.waited + 1 if stopped else 0
        self._stops = (self._stops if here == self._at else 0) + stopped
        self._at = here
        if stopped and len(route.cells):
            self._held[int(route.cells[0][0]), int(route.cells[0][1])] = step

    @property
    def has_waited(self) -> bool:
        """Whether the robot has waited long enough, and should drive another way."""
        return self.waited >= self._wait

    def gives_up(self) -> bool:
        """Return whether to choose another target; a true result resets the count of stops."""
        if self._stops < GIVE_UP:
            return False
        self._stops = 0
        return True

    def begin(self) -> None:
        """Reset the yield distance for a new target."""
        self._doublings = 0

    def pass_by(self, route: Route, planner: PathPlanner, here: Cell, end: Cell, step: int) -> PathPlanner:
        """Replan the route around the cells of recent stops; if that does not help, to a random yield cell.

        Returns a planner with these cells as obstacles.
        """
        self._held = {cell: since for cell, since in self._held.items() if step - since < MEMORY}
        around = planner.without([cell for cell in self._held if cell != here])
        reach = self._near * 2**self._doublings
        cost = around.costs_to(*here, np.array([end], np.int32)).item()
        if cost < len(route.cells) + reach:
            around.note_cost(here, end, cost)
            route.plan(around, here, end)
            return around
        ys, xs = np.nonzero(around.costs(*here) <= reach)
        pick = int(keyed_random(self._seed, "step aside", self._robot, step).integers(len(xs)))
        route.plan(around, here, (int(xs[pick]), int(ys[pick])))
        self._doublings = min(self._doublings + 1, FARTHEST)
        return around
