"""The raw-laser exchange: every scan travels as it was read (Burgard et al., section III-B).

It is the exact and expensive way of sharing maps, the one that the thesis compares itself with. A scan is
logged in every step that shows something the last one did not.
"""

from __future__ import annotations

from collections.abc import Collection

from agent.encodings.base import MapEncoding
from agent.encodings.reachability_check import Reception
from agent.encodings.received_grid import Heard
from agent.replication.map_ids import MapId
from agent.settings import Settings
from protocol import packet_index, packets
from protocol.errors import ProtocolError
from protocol.grid import Grid, RayTable, ray_table
from protocol.scans import NONE, Change, Scan, decode_scan, draw, encode_scan, fragments, scan_size


class ScanEncoding(MapEncoding):
    """Scans in fragments; what teammates saw is drawn onto one grid as it comes."""

    name = "scans"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._ray_tables = [ray_table(cells, settings.beams) for cells in settings.ranges_cells]
        self._size = scan_size(settings.beams)
        self._most = settings.frame_bytes or packets.Fragment.size
        self._heard = Heard((settings.height, settings.width))
        self._partial: dict[MapId, bytes] = {}
        self._last = b""

    def record(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Log the scan, unless it is the last one again or the scanner did not work."""
        del delivered
        self._heard.seen(own, change)
        data = encode_scan(scan)
        if data == self._last or (scan.readings == NONE).all():
            return []
        self._last = data
        return fragments(data, self._most)

    def take(self, map_id: MapId, frame: bytes, reception: Reception) -> None:
        """Put fragments together and draw the scans that are complete."""
        held, size = self._partial.get(map_id, b""), self._size
        data = held + packet_index.contents(frame, size, len(held))
        end = len(data) - len(data) % size
        scans = [self._read(map_id, data[at : at + size]) for at in range(0, end, size)]
        if scans:
            x, y = [scan.x for scan in scans], [scan.y for scan in scans]
            self.reachability_check.claim(
                map_id, (min(x), min(y), max(x) + 1, max(y) + 1), reception, len(scans)
            )
        self._partial[map_id] = data[end:]
        for scan in scans:
            change = draw(self._heard.grid, self._ray_table_of(map_id), scan.x, scan.y, scan.readings)
            if change.cells:
                self._heard.told(change.box)

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Lay the robot's own grid over what it heard, where either has changed."""
        del peers
        return self._heard.under(own)

    def _ray_table_of(self, map_id: MapId) -> RayTable:
        """The beams of the robot whose map it is."""
        return self._ray_tables[map_id.robot]

    def _read(self, map_id: MapId, data: bytes) -> Scan:
        scan = decode_scan(data, self._ray_table_of(map_id))
        height, width = self._heard.grid.shape
        if scan.x >= width or scan.y >= height:
            reason = f"cell ({scan.x}, {scan.y}) is outside the {width} x {height} grid"
            raise ProtocolError("scan", 0, reason)
        return scan
