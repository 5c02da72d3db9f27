"""No exchange: each robot plans on what it has seen itself."""

from __future__ import annotations

from collections.abc import Collection

from agent.encodings.base import MapEncoding
from agent.encodings.reachability_check import Reception
from agent.encodings.received_grid import Heard
from agent.replication.map_ids import MapId
from agent.settings import Settings
from protocol.errors import ProtocolError
from protocol.grid import Grid
from protocol.scans import Change, Scan


class NoEncoding(MapEncoding):
    """Robots tell each other their targets and nothing else."""

    name = "none"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._heard = Heard((settings.height, settings.width))

    def record(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Tell nothing."""
        del scan, delivered
        self._heard.seen(own, change)
        return []

    def take(self, map_id: MapId, frame: bytes, reception: Reception) -> None:
        """Refuse what nobody should have sent."""
        del reception
        raise ProtocolError(
            "data", 0, f"{len(frame)} bytes of robot {map_id.robot}'s map where none are exchanged"
        )

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Plan on the robot's own grid, of which nothing is known otherwise."""
        del peers
        return self._heard.under(own)
