"""Past targets of teammates whose surroundings are not yet on this robot's map.

On a narrow radio, maps arrive many steps after the targets. A teammate that announces another target has probably seen
the surroundings of the last one. So frontiers around it are worth less to others, although it is still unknown there on
their maps.
"""

from __future__ import annotations

from agent.planning.frontier import is_frontier
from agent.strategies.base import Situation
from protocol.grid import UNKNOWN, Cell, Grid


class PastTargets:
    """The last targets of each teammate, at most `most` of each."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._current: dict[int, Cell] = {}
        self._past: dict[int, list[Cell]] = {}

    def note(self, situation: Situation) -> None:
        """Note the targets that teammates have left since the last step; forget those that the planning grid shows."""
        for robot, target in situation.new_targets.items():
            before = self._current.get(robot, target)
            if before != target:
                self._past.setdefault(robot, []).append(before)
            self._current[robot] = target
        for robot, past in self._past.items():
            current = self._current[robot]
            hidden = [cell for cell in past if cell != current and _is_hidden(situation.grid, cell)]
            self._past[robot] = hidden[-self._most :]

    def of_team(self) -> list[tuple[int, Cell]]:
        """Return each of these targets with its robot."""
        return [(robot, cell) for robot, past in self._past.items() for cell in past]


def _is_hidden(grid: Grid, cell: Cell) -> bool:
    """Return whether a cell is unknown, or borders on unknown cells."""
    x, y = cell
    return bool(grid[y, x] == UNKNOWN) or is_frontier(grid, x, y)
