"""No exchange: each robot plans on what it has seen itself."""

from __future__ import annotations

from collections.abc import Collection

from agent.exchange.base import Exchange
from protocol.errors import ProtocolError
from protocol.grid import Grid
from protocol.scans import Change, Scan


class NoExchange(Exchange):
    """Robots tell each other their targets and nothing else."""

    name = "none"

    def record(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Tell nothing."""
        del own, scan, change, delivered
        return []

    def take(self, about: int, units: list[bytes]) -> None:
        """Refuse what nobody should have sent."""
        raise ProtocolError("data", 0, f"{len(units)} units of robot {about}'s map where none are exchanged")

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Plan on the robot's own grid."""
        del peers
        return own.copy()
