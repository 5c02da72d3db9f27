"""What a strategy sees, and what it decides."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.settings import Settings
from agent.strategies.options import read_options
from protocol.grid import UNKNOWN, Grid

Cell = tuple[int, int]

_FACES = ((1, 0, 0), (0, 1, 2), (-1, 0, 4), (0, -1, 6))
"""The four neighbours (dx, dy) and the heading that looks at each."""

FULL_TURN = 360.0
"""Degrees."""

NO_CELLS = np.empty((0, 2), np.int32)


class Pose(NamedTuple):
    """Where a teammate said to be, and whether it leads."""

    x: int
    y: int
    leads: bool


@dataclass(frozen=True)
class Situation:
    """What one robot knows when it has to decide.

    Attributes
    ----------
    step : int
    grid : uint8 array, shape (h, w)
        Its planning grid.
    x, y : int
        Its cell.
    offset : (x, y)
        Where in that cell it is, in thousandths of a cell from the centre.
    heading : int
        Eighths of a turn.
    blocked : str
        Why its last move stopped short (`worldsim.cell_motion`); empty if it did not.
    homes : dict of robot to (x, y)
        The depots: the cell in which it started itself, and where each teammate was first heard of.
    home : (x, y)
        Its own depot.
    peers : tuple of int
        Teammates in radio range, ascending.
    connected : tuple of int
        Teammates out of radio range that are connected through others, ascending; only where poses are passed on.
    poses : dict of robot to Pose
        The last pose heard of each teammate that tells it, by ascending number.
    last_moved : dict of robot to step
        When each of these was last heard to be elsewhere than before.
    traveled : dict of robot to float
        Way in cells, straight from pose to pose: those heard of it, its own of every step.
    targets : dict of robot to (x, y)
        The last target heard of each teammate that has one, by ascending number.
    target_steps : dict of robot to step
        When each of these was heard.
    new_targets : dict of robot to (x, y)
        Those heard since the last decision.
    """

    step: int
    grid: Grid
    x: int
    y: int
    offset: Cell = (0, 0)
    heading: int = 0
    blocked: str = ""
    homes: Mapping[int, Cell] = field(default_factory=dict)
    home: Cell = (0, 0)
    peers: tuple[int, ...] = ()
    connected: tuple[int, ...] = ()
    poses: Mapping[int, Pose] = field(default_factory=dict)
    last_moved: Mapping[int, int] = field(default_factory=dict)
    traveled: Mapping[int, float] = field(default_factory=dict)
    targets: Mapping[int, Cell] = field(default_factory=dict)
    target_steps: Mapping[int, int] = field(default_factory=dict)
    new_targets: Mapping[int, Cell] = field(default_factory=dict)

    @property
    def here(self) -> Cell:
        """The robot's cell."""
        return self.x, self.y

    def facing_the_unknown(self) -> int:
        """Heading that looks at an unknown neighbour of its cell, for a laser that does not look everywhere.

        Its own heading if there is none.
        """
        height, width = self.grid.shape
        for dx, dy, heading in _FACES:
            x, y = self.x + dx, self.y + dy
            if 0 <= x < width and 0 <= y < height and self.grid[y, x] == UNKNOWN:
                return heading
        return self.heading


@dataclass(frozen=True)
class Decision:
    """What a robot does until the next step.

    Attributes
    ----------
    target : (x, y), optional
        The cell that it is headed for.
    path : int32 array, shape (n, 2)
        Cells to drive over.
    points : int32 array, shape (n, 2)
        Way points instead of cells, in thousandths of a cell.
    heading : int
        The heading to take if it stays.
    explored : bool
        It has nothing left to do.
    stalled : bool
        It sees no way on, though there is something left to do.
    look : bool
        Whether its scanner works on the way.
    publish : bool
        Whether teammates may have all that it has seen by now, where the strategy defers_publication news.
    status : str
        What it is at, for people.
    """

    target: Cell | None = None
    path: NDArray[np.int32] = field(default_factory=lambda: NO_CELLS)
    points: NDArray[np.int32] = field(default_factory=lambda: NO_CELLS)
    heading: int = 0
    explored: bool = False
    stalled: bool = False
    look: bool = True
    publish: bool = True
    status: str = ""


@dataclass(frozen=True)
class NoOptions:
    """For strategies without options."""


class Strategy(ABC):
    """An exploration strategy: a subclass with a name is found by `agent.strategies.strategy`.

    Parameters
    ----------
    options : mapping
        By name, as a scenario gives them.
    settings : Settings
        The robot's task.

    Raises
    ------
    ValueError
        As `check`.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    """One line for people who choose among strategies."""
    source: ClassVar[str]
    """The paper and section that it builds."""
    options_type: ClassVar[type] = NoOptions
    """The dataclass of its options (`agent.strategies.options`)."""
    refused: ClassVar[Mapping[str, str]] = {}
    """Options of other strategies that make no sense here, and why."""
    publishes_target: ClassVar[bool] = True
    """Whether its robots tell each other their targets."""
    publishes_pose: ClassVar[bool] = False
    """Whether its robots tell each other where they are."""
    observes_from_distance: ClassVar[bool] = False
    """Whether its robots look at crumbs from where they pass, so that more of these cost little."""
    forwards_state: bool = False
    """Whether its robots pass on what teammates have told of poses and targets."""
    defers_publication: bool = False
    """Whether news waits until a decision publishes it."""
    leads: bool = False
    """Whether this robot leads; it is told with its pose."""

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        self.options: Any = self.check(options)
        self.settings = settings

    def use_shared_cache(self, cache: dict[str, Any]) -> None:
        """Hold what follows from the planning grid together with the other robots of this process.

        As `agent.encodings.base.MapEncoding.use_shared_cache` has it.
        """
        del cache

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> Any:
        """Read the options; ValueError says which is unknown, wrong, or does not go with another, and why."""
        return read_options(cls.options_type, options, cls.name, cls.refused)

    @classmethod
    def check_range(cls, options: Mapping[str, Any], range_m: float) -> None:
        """Raise ValueError if robots must hear each other farther than `range_m` metres, and say why."""
        del options, range_m

    @classmethod
    def returns(cls, options: Mapping[str, Any]) -> bool:
        """Whether the run ends when all robots are home, not when the first has nothing left to do."""
        del options
        return False

    def heading(self, situation: Situation, *, is_there: bool) -> int:
        """Where to look from where it stands: at what is unknown if it `is_there` for that.

        Around, an eighth of a turn a step, where a wall stops it and its laser does not look everywhere: a disc
        may touch what lies beside its way.
        """
        if situation.blocked == "wall" and self.settings.field_of_view < FULL_TURN:
            return (situation.heading + 1) % 8
        return situation.facing_the_unknown() if is_there else situation.heading

    @abstractmethod
    def decide(self, situation: Situation) -> Decision:
        """Decide what to do until the next step; called once a step."""
