"""What a strategy sees, and what it decides."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar, TypeVar

from agent.planning.cost import Field
from protocol.grid import Grid


@dataclass(frozen=True)
class Situation:
    """What one robot knows when it has to choose.

    Attributes
    ----------
    robot : int
        Its number.
    step : int
    grid : uint8 array, shape (h, w)
        Its planning grid.
    x, y : int
        Its cell.
    range_cells : float
        Its sensor range.
    targets : dict of robot to (x, y)
        The last target heard of each teammate that has one, by ascending number.
    heard : dict of robot to step
        When each of these was heard.
    seed : int
        The run's seed; draw by `protocol.chance` with the robot's number.
    """

    robot: int
    step: int
    grid: Grid
    x: int
    y: int
    range_cells: float
    targets: dict[int, tuple[int, int]]
    heard: dict[int, int]
    seed: int


Options = TypeVar("Options")


def read_options(kind: type[Options], options: dict[str, Any], owner: str) -> Options:
    """Make a dataclass of options; ValueError names what is unknown or of the wrong type."""
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    for name, value in options.items():
        if name not in known:
            there_are = ", ".join(known) or "none"
            raise ValueError(f"{owner} has no option {name!r}; there are: {there_are}")
        wanted = type(known[name].default)
        if type(value) is not wanted and not (wanted is float and type(value) is int):
            raise ValueError(f"option {name} of {owner} must be {wanted.__name__}, not {value!r}")
    return kind(**options)


class Strategy(ABC):
    """An exploration strategy: a subclass with a name is found by `agent.strategies.strategy`."""

    name: ClassVar[str]
    summary: ClassVar[str]
    """One line for people who choose among strategies."""
    source: ClassVar[str]
    """The paper and section that it builds."""

    def __init__(self, options: dict[str, Any]) -> None:
        """Take options by name; ValueError names one that the strategy does not know."""

    @abstractmethod
    def choose(self, situation: Situation, field: Field) -> tuple[int, int] | None:
        """Choose the next target among the reachable frontier cells; None if there is none left.

        `field` holds the cost of every cell from the robot's own (`agent.planning.cost.costs`).
        """

    def reconsiders(
        self, situation: Situation, target: tuple[int, int], news: dict[int, tuple[int, int]]
    ) -> bool:
        """Whether targets just heard (`news`, by robot) make the robot give up its own and choose again."""
        del situation, target, news
        return False
