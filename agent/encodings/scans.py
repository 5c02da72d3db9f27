"""The `scans` encoding: raw laser scans (Burgard et al. 2005, section III-B).

It is the exact and expensive encoding, with which the thesis compares its polygons. A robot logs a scan in each step in
which the scan differs from the last one.
"""

from __future__ import annotations

from agent.encodings.received_grid import GridEncoding
from agent.settings import Settings
from protocol import packets
from protocol.errors import ProtocolError
from protocol.grid import Grid, RayTable, ray_table
from protocol.scans import NONE, Change, Scan, contents, decode_scan, draw, encode_scan, fragments, scan_size


class ScanEncoding(GridEncoding):
    """Encodes scans as fragments, and draws the scans of all teammates onto one grid."""

    name = "scans"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._ray_tables = [ray_table(cells, settings.beams) for cells in settings.ranges_cells]
        self._size = scan_size(settings.beams)
        self._most = settings.frame_bytes or packets.Fragment.size
        self._partial: dict[int, bytes] = {}
        self._last = b""

    def encode_changes(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Encode the scan, unless it repeats the last one or has no readings."""
        del delivered
        self.own_changes.add(own, change)
        data = encode_scan(scan)
        if data == self._last or (scan.readings == NONE).all():
            return []
        self._last = data
        return fragments(data, self._most)

    def _forget_received(self) -> None:
        super()._forget_received()
        self._partial.clear()

    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Reassemble fragments, and draw the scans that are complete."""
        partial, size = self._partial.get(map_id, b""), self._size
        data = partial + contents(frame, size, len(partial))
        end = len(data) - len(data) % size
        scans = [self._read(map_id, data[at : at + size]) for at in range(0, end, size)]
        if scans:
            x, y = [scan.x for scan in scans], [scan.y for scan in scans]
            box = min(x), min(y), max(x) + 1, max(y) + 1
            self._reachability.check(map_id, box, len(scans), step=step, sender=sender)
        self._partial[map_id] = data[end:]
        for scan in scans:
            change = draw(self.received, self._ray_table_of(map_id), scan.x, scan.y, scan.readings)
            if change.cells:
                self.received_changed(change.box)

    def _ray_table_of(self, map_id: int) -> RayTable:
        """The ray table of the map's author."""
        return self._ray_tables[self.settings.author_of(map_id)]

    def _read(self, map_id: int, data: bytes) -> Scan:
        scan = decode_scan(data, self._ray_table_of(map_id))
        height, width = self.received.shape
        if scan.x >= width or scan.y >= height:
            reason = f"cell ({scan.x}, {scan.y}) is outside the {width} x {height} grid"
            raise ProtocolError("scan", 0, reason)
        return scan
