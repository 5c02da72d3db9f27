"""The thesis' decentralised coordination (sections 4.4 and 4.5): the best trade-off of utility and cost.

Every robot chooses for itself the frontier cell t with the largest U(t) - beta V(t), where utilities are
lowered around the targets that it has heard of, and V is the way's length in sensor ranges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.planning.cost import Field
from agent.planning.frontier import frontier_cells
from agent.planning.utility import in_sight, utilities
from agent.strategies.base import Situation, Strategy, read_options


@dataclass(frozen=True)
class Options:
    """Options of the strategy.

    Attributes
    ----------
    beta : float
        Weight of cost against utility.
    herding : bool
        Whether a robot chooses again when it hears that a lower-numbered one is headed for the same place.
    """

    beta: float = 1.0
    herding: bool = True


class Meier(Strategy):
    """Utility against cost, each robot for itself."""

    name = "meier"
    summary = "each robot takes the frontier of best utility minus cost, and tells the others its target"
    source = "Meier 2005, sections 4.4 and 4.5"

    def __init__(self, options: dict[str, Any]) -> None:
        super().__init__(options)
        self._options = read_options(Options, options, self.name)

    def choose(self, situation: Situation, field: Field) -> tuple[int, int] | None:
        """Take the largest trade-off; of equals the first cell, row by row."""
        cells = frontier_cells(situation.grid, field)
        if not len(cells):
            return None
        worth = utilities(
            situation.grid, cells, list(situation.targets.values()), situation.range_cells
        )
        cost = field[cells[:, 1], cells[:, 0]] / situation.range_cells
        best = int(np.argmax(worth - self._options.beta * cost))
        return int(cells[best, 0]), int(cells[best, 1])

    def reconsiders(
        self, situation: Situation, target: tuple[int, int], news: dict[int, tuple[int, int]]
    ) -> bool:
        """The rule against herding: robots that choose at once from the same map choose alike.

        A target of a lower-numbered teammate within sensor range and in sight of one's own makes one choose
        again, once for each that is heard.
        """
        return self._options.herding and any(
            other < situation.robot
            and (x - target[0]) ** 2 + (y - target[1]) ** 2 < situation.range_cells**2
            and in_sight(situation.grid, x, y, *target)
            for other, (x, y) in news.items()
        )
