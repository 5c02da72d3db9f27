"""The interface of all worlds: which robots take part, where they are, and their readings in each step.

The world owns the clock. `worldsim.process` drives it: it applies the robots' moves, and sends each robot its
readings. `worldsim.world` simulates a building; `worldsim.recorded.world` replays logs of real robots.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from protocol.faults import FaultSchedule
from protocol.grid import Cell, Grid, Mask
from protocol.messages import FaultEvent, Move, Sense

if TYPE_CHECKING:
    from worldsim.world import WorldSettings

EXPLORED = "explored"
STALLED = "stalled: there is a frontier left, and no robot gets nearer to it"


class BaseWorld(ABC):
    """The state that all worlds have. `truth`, uint8 of shape (h, w), is the map of the world."""

    finished = EXPLORED
    """Reason of a run's end: all robots have finished."""
    stalled = STALLED
    """Reason of a run's end: no robot makes progress."""
    reachable: Mask
    """The free cells that the team can see, shape (h, w)."""

    def __init__(self, truth: Grid, settings: WorldSettings) -> None:
        self.truth = truth
        self.settings = settings
        self.step = 0
        self.cells: dict[int, Cell] = dict(enumerate(settings.starts))
        """Cell (x, y) of each robot in the world."""
        self.offsets = dict.fromkeys(self.cells, (0, 0))
        """Position (x, y) of each robot in its cell, in thousandths of a cell from the center."""
        self.headings = dict.fromkeys(self.cells, 0)
        """Heading of each robot, in eighths of a turn."""
        self.driven = [0.0] * len(settings.starts)
        """Distance driven by each robot, in cells."""
        self.seen_cells = 0
        """Number of reachable free cells that the team has seen."""
        self.faults = FaultSchedule(settings.faults)
        self.absent: set[int] = set()
        """Robots in the world that take no part in this step, because they still work on an earlier one."""
        self._last_cells = dict(self.cells)
        """Last cell of each robot that has been removed."""

    @cached_property
    def reachable_cells(self) -> int:
        """Number of free cells that the team can see."""
        return int(np.count_nonzero(self.reachable))

    @property
    def people(self) -> list[Cell]:
        """The cell of each person in the building."""
        return []

    @abstractmethod
    def share_seen(self, robot: int) -> float:
        """Return the share of the cells that a robot can reach which the team has seen."""

    @abstractmethod
    def move_robots(self, moves: Mapping[int, Move]) -> Iterator[tuple[int, Sense]]:
        """Begin the next step: move the robots, and return an iterator over what each one senses."""

    @abstractmethod
    def restore(self, robot: int) -> None:
        """Put a removed robot back."""

    def advance(self, moves: Mapping[int, Move]) -> dict[int, Sense]:
        """Begin the next step: move the robots, in ascending order, and return all that they sense."""
        return dict(self.move_robots(moves))

    def may_end(self) -> bool:
        """Return whether the robots' reports that they are done, or stalled, may end the run."""
        return True

    def is_stalled(self, moves: Mapping[int, Move]) -> bool:
        """Return whether robots that send these moves make no progress."""
        return bool(moves) and all(move.stalled for move in moves.values())

    def remove(self, robot: int) -> None:
        """Remove a robot from the world; the others no longer collide with it."""
        if robot in self.cells:
            self._last_cells[robot] = self.cells.pop(robot)
            self.absent.discard(robot)
            self.faults.active["stop"].pop(robot, None)

    def due_faults(self) -> list[FaultEvent]:
        """Remove the faults of the next step from the schedule and return them, in order."""
        return self.faults.due(self.step + 1, self.cells)

    def is_active(self, robot: int) -> bool:
        """Return whether a robot takes part in this step: it is in the world, not stopped and not absent."""
        return robot in self.cells and robot not in self.faults.active["stop"] and robot not in self.absent

    def active_robots(self) -> list[int]:
        """Return the robots that take part in this step, in ascending order."""
        return sorted(self.cells.keys() - self.faults.active["stop"].keys() - self.absent)

    def present_robots(self) -> list[int]:
        """Return the robots that are in the world and not stopped, absent ones included, in ascending order."""
        return sorted(self.cells.keys() - self.faults.active["stop"].keys())

    @property
    def active_count(self) -> int:
        """Number of robots that take part in this step."""
        return len(self.cells) - len(self.faults.active["stop"]) - len(self.absent)

    def is_deserted(self) -> bool:
        """Return whether no robot takes part in this step, and none will take part again by the schedule."""
        if self.absent:
            return False
        restarts = any(fault.kind == "restart" for fault in self.faults.pending)
        recovers = any(until < math.inf for until in self.faults.active["stop"].values())
        return not self.active_count and not restarts and not recovers

    def smallest_robots(self) -> list[int]:
        """Return the robots of the smallest radius; they reach all that any robot reaches."""
        radii = {robot: self.settings.bodies[robot].radius_cells for robot in self.present_robots()}
        return [robot for robot, radius in radii.items() if radius == min(radii.values())]
