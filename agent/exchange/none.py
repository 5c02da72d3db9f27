"""No exchange: each robot plans on what it has seen itself."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from agent.exchange.base import Exchange
from agent.exchange.changed_cells import ChangedCells
from agent.settings import Settings
from protocol.errors import ProtocolError
from protocol.grid import Grid
from protocol.scans import Change, Scan


class NoExchange(Exchange):
    """Robots tell each other their targets and nothing else."""

    name = "none"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._news = ChangedCells()
        self._planning: Grid = np.zeros((0, 0), np.uint8)

    def record(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Tell nothing."""
        del scan, delivered
        self._news.add(own, change)
        return []

    def take(self, about: int, units: list[bytes]) -> None:
        """Refuse what nobody should have sent."""
        raise ProtocolError("data", 0, f"{len(units)} units of robot {about}'s map where none are exchanged")

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Plan on the robot's own grid."""
        del peers
        changed = self._news.take(own)
        if changed is None:
            self._planning = own.copy()
        else:
            for x0, y0, x1, y1 in changed.tolist():
                self._planning[y0:y1, x0:x1] = own[y0:y1, x0:x1]
        return self._planning
