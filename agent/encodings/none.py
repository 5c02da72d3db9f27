"""The `none` encoding: robots exchange no maps, and each plans on its own grid."""

from __future__ import annotations

from agent.encodings.received_grid import GridEncoding
from protocol.errors import ProtocolError
from protocol.grid import Grid
from protocol.range_scans import RangeScan
from protocol.scans import GridChange, Scan


class NoEncoding(GridEncoding):
    """Encodes nothing: robots send each other targets and poses alone."""

    name = "none"

    def encode_changes(
        self, own: Grid, scan: Scan | RangeScan, change: GridChange, *, delivered: bool
    ) -> list[bytes]:
        """Return no packets."""
        self.own_changes.add(own, change)
        return []

    def forget_received(self) -> None:
        """Do nothing: there are no logs."""

    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Reject map data: in this team no robot sends any."""
        raise ProtocolError("data", 0, f"{len(frame)} bytes of map {map_id}, but this team exchanges no maps")
