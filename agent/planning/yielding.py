"""How a robot gets past teammates that stand in its way, without knowing who they are or what they are up to.

It waits a little. Then it drives around all cells in which teammates lately stopped it: without the memory a
robot between two teammates would turn from one to the other for good. Where no other way leads on, or it is much
longer, it makes room: it goes to a random place near by, and each time again up to twice as far. Stopped in one
cell again and again, it chooses another target.
"""

from __future__ import annotations

import numpy as np

from agent.planning.path_planner import PathPlanner
from agent.planning.route import Route
from protocol.keyed_random import keyed_random

WAIT = 2
"""Steps for which it waits."""

MEMORY = 20
"""Steps for which it keeps away from a cell that it could not enter for a teammate."""

FARTHEST = 4
"""How often the distance is doubled to which it makes room."""

GIVE_UP = 10
"""Times that teammates stop it in one cell, after which it chooses another target."""

Cell = tuple[int, int]


class YieldBehavior:
    """What one robot has met on its ways.

    Parameters
    ----------
    seed, robot : int
        Decide where it makes room.
    near : float
        How far it goes at first, in cells.
    """

    def __init__(self, seed: int, robot: int, near: float) -> None:
        self.waited = 0
        """Steps on end in which a teammate has stopped it."""
        self._seed = seed
        self._robot = robot
        self._near = near
        self._at: Cell | None = None
        self._stops = 0
        self._held: dict[Cell, int] = {}
        self._doublings = 0

    def note(self, route: Route, here: Cell, step: int, *, stopped: bool) -> None:
        """Take what became of the last move along `route`."""
        self.waited = self.waited + 1 if stopped else 0
        self._stops = (self._stops if here == self._at else 0) + stopped
        self._at = here
        if stopped and len(route.cells):
            self._held[int(route.cells[0][0]), int(route.cells[0][1])] = step

    @property
    def has_waited(self) -> bool:
        """Whether it is time to look for another way."""
        return self.waited >= WAIT

    def gives_up(self) -> bool:
        """Whether it is time to choose another target; it is again after as many stops."""
        if self._stops < GIVE_UP:
            return False
        self._stops = 0
        return True

    def begin(self) -> None:
        """It has another target: what it did for the last one does not count."""
        self._doublings = 0

    def pass_by(self, route: Route, planner: PathPlanner, here: Cell, end: Cell, step: int) -> PathPlanner:
        """Lead the route around the cells lately held; where that does not help, to where it makes room.

        Returns a planner without these cells.
        """
        self._held = {cell: since for cell, since in self._held.items() if step - since < MEMORY}
        around = planner
        for cell in self._held:
            if cell != here:
                around = around.without(*cell)
        reach = self._near * 2**self._doublings
        field = around.costs(*here)
        if field[end[1], end[0]] < len(route.cells) + reach:
            route.lead(around, here, end)
            return around
        ys, xs = np.nonzero(field <= reach)
        pick = int(keyed_random(self._seed, "step aside", self._robot, step).integers(len(xs)))
        route.lead(around, here, (int(xs[pick]), int(ys[pick])))
        self._doublings = min(self._doublings + 1, FARTHEST)
        return around
