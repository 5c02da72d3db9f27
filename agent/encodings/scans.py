"""The `scans` encoding: raw laser scans (Burgard et al. 2005, section III-B).

It is the exact and expensive encoding, with which the thesis compares its polygons. A robot logs a scan in each step in
which the scan differs from the last one.
"""

from __future__ import annotations

import numpy as np

from agent.encodings.received_grid import GridEncoding
from agent.settings import Settings
from protocol import packets
from protocol.arrays import Int32Rows, Int32s, Uint8s, Uint16s
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, Grid, RayTable, ray_table
from protocol.kernels import kernel
from protocol.scans import NONE, Change, Scan, contents, decode_scan, encode_scan, fragments, scan_size


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
        beams = self._ray_table_of(map_id)
        table, shape = (beams.cells, beams.start, beams.shared), self.received.shape
        for scan in scans:
            places, states, seen = _observed(*table, scan.x, scan.y, scan.readings, *shape)
            self.votes.count(self.settings.author_of(map_id), places, states, revises=False)
            self.received_changed(seen)

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


@kernel
def _observed(
    cells: Int32Rows,
    start: Int32s,
    shared: Int32s,
    x: int,
    y: int,
    readings: Uint16s,
    height: int,
    width: int,
) -> tuple[Int32s, Uint8s, tuple[int, int, int, int]]:
    """Return the cells that a scan from (x, y) shows, as indices of the flat grid, their states, and a box of them."""
    places, states = np.empty(len(cells) + 1, np.int32), np.empty(len(cells) + 1, np.uint8)
    places[0], states[0], count = y * width + x, FREE, 1
    x0, y0, x1, y1 = x, y, x + 1, y + 1
    before = 0
    for beam in range(len(readings)):
        crossed, touched = 0, 0
        if readings[beam] != NONE:
            crossed = int(readings[beam] & NONE)
            touched = crossed + int(readings[beam] >> 15)
        for at in range(min(int(shared[beam]), before, touched), touched):
            column, row = x + cells[start[beam] + at, 0], y + cells[start[beam] + at, 1]
            if not (0 <= column < width and 0 <= row < height):
                touched = at
                break
            x0, x1, y0, y1 = min(x0, column), max(x1, column + 1), min(y0, row), max(y1, row + 1)
            places[count], states[count] = row * width + column, FREE if at < crossed else OCCUPIED
            count += 1
        before = touched
    return places[:count].copy(), states[:count].copy(), (x0, y0, x1, y1)
