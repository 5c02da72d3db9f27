"""No map exchange: each robot plans on its self-explored grid."""

from __future__ import annotations

from collections.abc import Collection

from agent.encodings.base import MapEncoding
from agent.encodings.received_grid import ReceivedGrid
from agent.settings import Settings
from protocol.errors import ProtocolError
from protocol.grid import Grid
from protocol.scans import Change, Scan


class NoEncoding(MapEncoding):
    """Encodes nothing: robots send each other targets and poses alone."""

    name = "none"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._received = ReceivedGrid((settings.height, settings.width))

    def encode_changes(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Return no packets."""
        del scan, delivered
        self._received.own_changed(own, change)
        return []

    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Reject map data: in this team no robot sends any."""
        del step, sender
        raise ProtocolError("data", 0, f"{len(frame)} bytes of map {map_id}, but this team exchanges no maps")

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Return the self-explored grid as the planning grid."""
        del peers
        return self._received.overlaid(own)
