"""The `scans` encoding: raw laser scans (Burgard et al. 2005, section III-B).

It is the exact and expensive encoding, with which the thesis compares its polygons. A robot logs a scan in each step in
which the scan differs from the last one. Scans of real lasers consist of a pose and ranges (`protocol.range_scans`).
"""

from __future__ import annotations

import numpy as np

from agent.encodings.received_grid import GridEncoding
from agent.mapping.estimator import Estimator
from agent.settings import Settings
from protocol import packets
from protocol.arrays import Int32Rows, Int32s, Uint8s, Uint16s
from protocol.boxes import Box
from protocol.grid import FREE, OCCUPIED, Grid, check_cell, ray_table
from protocol.kernels import kernel
from protocol.range_scans import (
    Laser,
    RangeScan,
    beam_ends,
    decode_range_scan,
    encode_range_scan,
    range_scan_size,
    smoothed,
)
from protocol.scans import NONE, GridChange, Scan, contents, decode_scan, encode_scan, fragments, scan_size

Report = tuple[Int32s, Uint8s, Box]
"""Cells, as indices of the flat grid, each once, their states, and a box that contains them."""

_Beams = tuple[Int32Rows, Int32s, Int32s, Int32s]
"""Of a `protocol.grid.RayTable`: `cells`, `flat` on the grid, `start`, and `shared`."""


class ScanEncoding(GridEncoding):
    """Encodes scans as fragments, and adds the scans of all teammates to one grid."""

    name = "scans"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._format = self.make_format(settings)
        self._most = settings.medium.frame_bytes or packets.Fragment.size
        self._partial: dict[int, bytes] = {}
        """The beginning of a message of which the rest has not arrived, by map ID."""
        self._last = b""
        """The last scan that was encoded."""

    def make_format(self, settings: Settings) -> ExactScans | RangeScans:
        """Return the format of the scans."""
        return ExactScans(settings) if settings.laser is None else RangeScans(settings)

    def encode_changes(
        self, own: Grid, scan: Scan | RangeScan, change: GridChange, *, delivered: bool
    ) -> list[bytes]:
        """Encode the scan, unless it repeats the last one or has no readings."""
        self.own_changes.add(own, change)
        data = self._format.encode(scan)
        if not data or data == self._last:
            return []
        self._last = data
        return fragments(data, self._most)

    def forget_received(self) -> None:
        """Forget everything decoded from the logs of others."""
        super().forget_received()
        self._partial.clear()
        self._format.forget()

    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Reassemble fragments, and add the scans that are complete."""
        partial, size = self._partial.get(map_id, b""), self._format.size(map_id)
        data = partial + contents(frame, size, len(partial))
        end = len(data) - len(data) % size
        scans = [self._read(map_id, data[at : at + size]) for at in range(0, end, size)]
        if scans:
            x, y = [scan.x for scan in scans], [scan.y for scan in scans]
            box = min(x), min(y), max(x) + 1, max(y) + 1
            self._reachability.check(map_id, box, len(scans), step=step, sender=sender)
        self._partial[map_id] = data[end:]
        robot, revises = self.settings.author_of(map_id), self.settings.laser is not None
        for scan in scans:
            places, states, box = self._format.report(map_id, scan, self.received)
            if len(places):
                self.votes.count(robot, places, states, revises=revises)
                self.received_changed(box)

    def _read(self, map_id: int, data: bytes) -> Scan | RangeScan:
        scan = self._format.decode(map_id, data)
        check_cell("scan", scan.x, scan.y, self.received)
        return scan


class ExactScans:
    """Scans of exact lasers: a cell reported once never changes."""

    def __init__(self, settings: Settings) -> None:
        self._size = scan_size(settings.beams)
        self._author_of = settings.author_of
        self._ray_tables = [ray_table(body.range_cells, settings.beams) for body in settings.bodies]

    def size(self, map_id: int) -> int:
        """Return the bytes of a scan of a map."""
        return self._size

    def encode(self, scan: Scan | RangeScan) -> bytes:
        """Encode a scan; nothing if it has no readings."""
        assert isinstance(scan, Scan)
        return b"" if (scan.readings == NONE).all() else encode_scan(scan)

    def decode(self, map_id: int, data: bytes) -> Scan:
        """Decode a scan of a map."""
        return decode_scan(data, self._ray_tables[self._author_of(map_id)])

    def report(self, map_id: int, scan: Scan | RangeScan, received: Grid) -> Report:
        """Return the cells in which a scan differs from the received ones."""
        assert isinstance(scan, Scan)
        beams = self._ray_tables[self._author_of(map_id)]
        table = beams.cells, beams.flat(received.shape[1]), beams.start, beams.shared
        found: Report = _news(received, table, scan.x, scan.y, scan.readings)
        return found

    def forget(self) -> None:
        """Do nothing: no state is kept."""


class RangeScans:
    """Scans of lasers with errors: receivers estimate each author's map as the author does."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._estimators: dict[int, Estimator] = {}
        """By map ID."""

    def laser_of(self, map_id: int) -> Laser:
        """Return the beams of the laser that scans for a map."""
        laser = self.settings.bodies[self.settings.author_of(map_id)].laser
        assert laser is not None
        return laser

    def size(self, map_id: int) -> int:
        """Return the bytes of a scan of a map."""
        return range_scan_size(self.laser_of(map_id))

    def encode(self, scan: Scan | RangeScan) -> bytes:
        """Encode a scan; nothing if it has no readings."""
        assert isinstance(scan, RangeScan)
        return encode_range_scan(scan) if scan.ranges.any() else b""

    def decode(self, map_id: int, data: bytes) -> RangeScan:
        """Decode a scan of a map."""
        return decode_range_scan(data, self.laser_of(map_id))

    def report(self, map_id: int, scan: Scan | RangeScan, received: Grid) -> Report:
        """Return the known cells of the author's map where a scan has changed it."""
        assert isinstance(scan, RangeScan)
        height, width = received.shape
        estimator = self._estimators.setdefault(map_id, Estimator(height, width))
        laser = self.laser_of(map_id)
        ends = beam_ends(smoothed(scan, laser), laser, self.settings.resolution)
        change = estimator.add(*scan.place, *ends)
        x0, y0, x1, y1 = change.box
        states = estimator.states[y0:y1, x0:x1]
        rows, columns = np.nonzero(states)
        places = ((rows + y0) * width + columns + x0).astype(np.int32)
        return places, states[rows, columns], change.box

    def forget(self) -> None:
        """Forget all estimated maps."""
        self._estimators.clear()


@kernel
def _news(received: Grid, beams: _Beams, x: int, y: int, readings: Uint16s) -> Report:
    """Return the cells in which a scan from (x, y) differs from the received ones."""
    cells, flat, start, shared = beams
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
