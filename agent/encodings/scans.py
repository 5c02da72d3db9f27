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

    def forget_received(self) -> None:
        """Forget everything decoded from the logs of others."""
        super().forget_received()
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
        beams, robot = self._ray_table_of(map_id), self.settings.author_of(map_id)
        table = beams.cells, beams.flat(self.received.shape[1]), beams.start, beams.shared
        for scan in scans:
            places, states, box = _news(self.received, *table, scan.x, scan.y, scan.readings)
            if len(places):
                self.votes.count(robot, places, states, revises=False)
                self.received_changed(box)

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
def _news(
    received: Grid,
    cells: Int32Rows,
    flat: Int32s,
    start: Int32s,
    shared: Int32s,
    x: int,
    y: int,
    readings: Uint16s,
) -> tuple[Int32s, Uint8s, tuple[int, int, int, int]]:
    """Return the cells in which a scan from (x, y) differs from the received ones.

    They are indices of the flat grid; their states and a box that contains them follow.
    """
    # Unsigned, a cell beyond the left or upper border is a very large number (as in `protocol.scans.draw`).
    height, width = np.uint64(received.shape[0]), np.uint64(received.shape[1])
    lying, here = received.reshape(received.size), y * received.shape[1] + x
    places, states = np.empty(len(cells) + 1, np.int32), np.empty(len(cells) + 1, np.uint8)
    count, x0, y0, x1, y1 = 0, x, y, x + 1, y + 1
    if lying[here] != FREE:
        places[0], states[0], count = here, FREE, 1
    touched = np.uint64(0)
    for beam in range(len(readings)):
        reading, before, first = readings[beam], touched, np.uint64(start[beam])
        touched = np.uint64(0)
        if reading == NONE:
            continue
        hit = first + np.uint64(reading & NONE)
        end = hit + np.uint64(reading >> 15)
        while end > first:
            last = end - np.uint64(1)
            if np.uint64(x + cells[last, 0]) < width and np.uint64(y + cells[last, 1]) < height:
                break
            end = last
        touched = end - first
        for at in range(first + min(np.uint64(shared[beam]), before, touched), end):
            cell, state = np.uint64(here + flat[at]), FREE if at < hit else OCCUPIED
            if lying[cell] != state:
                places[count], states[count], count = cell, state, count + 1
                x0, x1 = min(x0, x + cells[at, 0]), max(x1, x + cells[at, 0] + 1)
                y0, y1 = min(y0, y + cells[at, 1]), max(y1, y + cells[at, 1] + 1)
    return places[:count].copy(), states[:count].copy(), (x0, y0, x1, y1)
