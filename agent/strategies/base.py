"""The interface of exploration strategies: the situation that a strategy receives, and its decision."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, ClassVar, NamedTuple

import numpy as np

from agent.settings import Settings
from agent.strategies.options import read_options
from protocol.arrays import NO_CELLS, Cells
from protocol.grid import FREE, UNKNOWN, Cell, Grid

_STRAIGHT = ((1, 0, 0), (0, 1, 2), (-1, 0, 4), (0, -1, 6))
_DIAGONAL = ((1, 1, 1), (-1, 1, 3), (-1, -1, 5), (1, -1, 7))
"""The straight and the diagonal neighbors (dx, dy), and the heading toward each in eighths of a turn."""

FULL_TURN = 360.0
"""Degrees."""


def array_of(cells: Collection[Cell]) -> Cells:
    """Return cells as an array of shape (n, 2), in half the time of `numpy.array`."""
    return np.fromiter(chain.from_iterable(cells), np.int32, 2 * len(cells)).reshape(-1, 2)


def cell_at(cells: Cells, index: int | np.integer[Any]) -> Cell:
    """Return one of some cells, given as an array of shape (n, 2)."""
    x, y = cells[index].tolist()
    return x, y


class TeammatePose(NamedTuple):
    """The cell that a teammate broadcast as its pose, and whether it leads."""

    x: int
    y: int
    leads: bool


@dataclass(frozen=True)
class Situation:
    """Input of a robot's decision."""

    step: int
    """The current step."""
    grid: Grid
    """The planning grid, shape (h, w)."""
    x: int
    y: int
    """`x`, `y`: the robot's cell."""
    offset: Cell = (0, 0)
    """The robot's position in this cell, in thousandths of a cell from the center."""
    heading: int = 0
    """The robot's heading in eighths of a turn."""
    blocked: str = ""
    """Why the last move stopped short (`worldsim.motion`); empty if it did not."""
    homes: Mapping[int, Cell] = field(default_factory=dict)
    """The depots: this robot's start cell, and the first received pose of each teammate."""
    home: Cell = (0, 0)
    """This robot's depot."""
    peers: tuple[int, ...] = ()
    """Teammates in radio range, ascending."""
    connected: tuple[int, ...] = ()
    """Teammates out of radio range but connected through others, ascending; needs relayed states."""
    poses: Mapping[int, TeammatePose] = field(default_factory=dict)
    """The last received pose of each teammate, by ascending number."""
    last_moved: Mapping[int, int] = field(default_factory=dict)
    """The step of the last change of each of these poses."""
    traveled: Mapping[int, float] = field(default_factory=dict)
    """Distance in cells along the received poses of a teammate, and along this robot's own poses."""
    targets: Mapping[int, Cell] = field(default_factory=dict)
    """The last received target of each teammate, by ascending number."""
    target_steps: Mapping[int, int] = field(default_factory=dict)
    """The step in which each of these targets arrived."""
    new_targets: Mapping[int, Cell] = field(default_factory=dict)
    """Targets received since the last decision."""
    log_entries: int = 0
    """Entries of this robot's log."""
    backlog: int = 0
    """Entries of this robot's log that teammates lack, summed over all teammates."""

    @property
    def here(self) -> Cell:
        """The robot's cell."""
        return self.x, self.y

    def facing_the_unknown(self, *, diagonally: bool = False) -> int:
        """Return the heading toward an unknown 4-neighbor of the robot's cell, for a laser of a limited field of view.

        If there is none, and with `diagonally`, return the heading toward an unknown diagonal neighbor that has a free
        cell beside it. Otherwise return the current heading.
        """
        grid, (height, width) = self.grid, self.grid.shape
        for dx, dy, heading in (*_STRAIGHT, *_DIAGONAL) if diagonally else _STRAIGHT:
            x, y = self.x + dx, self.y + dy
            is_unknown = 0 <= x < width and 0 <= y < height and grid[y, x] == UNKNOWN
            if is_unknown and (heading % 2 == 0 or FREE in (grid[self.y, x], grid[y, self.x])):
                return heading
        return self.heading


@dataclass(frozen=True)
class Decision:
    """A robot's actions until the next step."""

    target: Cell | None = None
    """The cell to which the robot drives."""
    path: Cells = field(default_factory=lambda: NO_CELLS)
    """Cells to drive over, shape (n, 2)."""
    points: Cells = field(default_factory=lambda: NO_CELLS)
    """Waypoints in thousandths of a cell, instead of cells, shape (n, 2)."""
    heading: int = 0
    """The heading of a robot that stays."""
    explored: bool = False
    """Nothing is left to explore."""
    stalled: bool = False
    """The robot has made no progress for long: frontiers are left, for it or for smaller robots, that it does not get
    nearer to. A run ends when all robots are stalled."""
    look: bool = True
    """Whether the scanner works on the way."""
    publish: bool = True
    """Whether to publish the map changes that a strategy with `defers_publication` has held back."""
    status: str = ""
    """The current activity, as text."""


@dataclass(frozen=True)
class NoOptions:
    """Options of a strategy without options."""


class Strategy(ABC):
    """An exploration strategy; `agent.strategies.registry` finds subclasses by their names.

    `options` are values by name, from a scenario; ValueError if one is unknown or invalid (`check`).
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    """One line of description, for the list of strategies."""
    source: ClassVar[str]
    """The paper and the section that describe the strategy."""
    options_type: ClassVar[type] = NoOptions
    """The dataclass of the options (`agent.strategies.options`)."""
    refused: ClassVar[Mapping[str, str]] = {}
    """Options of other strategies that do not apply, each with the reason."""
    explores: ClassVar[bool] = True
    """Whether robots explore; others are not listed among the strategies."""
    publishes_target: ClassVar[bool] = True
    """Whether robots broadcast their targets."""
    publishes_pose: ClassVar[bool] = False
    """Whether robots broadcast their poses."""
    observes_from_distance: ClassVar[bool] = False
    """Whether robots observe small frontiers from viewpoints on their way, so that these frontiers cost little."""
    forwards_state: bool = False
    """Whether robots forward the poses and targets of teammates (`agent.team_state`)."""
    defers_publication: bool = False
    """Whether map changes wait until a decision publishes them."""
    leads: bool = False
    """Whether this robot leads; broadcast with its pose."""
    has_diagonal_frontier: bool = False
    """Whether a free cell also counts as a frontier cell if only a diagonal neighbor is unknown."""

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        self.options: Any = self.check(options)
        self.settings = settings

    def use_shared_cache(self, cache: dict[str, Any]) -> None:
        """Share results of planning with the other robots of this process; decisions do not change.

        The caller passes the same `cache` to all robots, before the first step.
        """

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> Any:
        """Return the options as a dataclass; ValueError names an unknown, invalid or conflicting option."""
        return read_options(cls.options_type, options, cls.name, cls.refused)

    @classmethod
    def check_range(cls, options: Mapping[str, Any], range_m: float) -> None:
        """Raise ValueError if the options need a longer communication range than `range_m` meters."""

    @classmethod
    def returns(cls, options: Mapping[str, Any]) -> bool:
        """Return whether the run ends when all robots are home, not when the first has nothing left to explore."""
        return False

    def heading(self, situation: Situation, *, is_there: bool) -> int:
        """Return the heading of a robot that stays: toward an unknown neighbor if it is at its target (`is_there`).

        A robot with a limited field of view that a wall has stopped turns by an eighth of a turn per step: its disc
        may touch an obstacle beside its way.
        """
        if situation.blocked == "wall" and self.settings.body.field_of_view < FULL_TURN:
            return (situation.heading + 1) % 8
        if not is_there:
            return situation.heading
        return situation.facing_the_unknown(diagonally=self.has_diagonal_frontier)

    @abstractmethod
    def decide(self, situation: Situation) -> Decision:
        """Return the decision for the next step; called once per step."""
