"""The `zstd-maps` encoding: whole maps every few seconds, as teams do that merge the maps of their robots (a baseline).

A map has one byte per cell, as in the ROS message nav_msgs/OccupancyGrid, and is compressed by zstd. In the log, the
length of the compressed map in four bytes precedes it. Each map replaces the one before. A robot sends a map every
`INTERVAL` steps, but not before the teammates in range hold the last one.
"""

from __future__ import annotations

import numpy as np

from agent.encodings.compression import compress, decompress
from agent.encodings.received_grid import GridEncoding
from agent.settings import Settings
from protocol import packets
from protocol.boxes import NO_BOX, box_of
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.range_scans import RangeScan
from protocol.scans import GridChange, Scan, contents, fragments

INTERVAL = 5
"""Least number of steps from one map to the next: nav2 publishes its map every 5 s."""

LEVEL = 3
"""Compression level, zstd's default."""

HEAD = 4
"""Bytes of the length of a compressed map."""

OVERHEAD = 64
"""Bytes by which a compressed map may exceed the cells of the map."""

VALUES = np.zeros(3, np.int8)
"""The value of each state in OccupancyGrid: a probability in percent, or -1 if the state is unknown."""
VALUES[[UNKNOWN, FREE, OCCUPIED]] = -1, 0, 100


class ZstdMapEncoding(GridEncoding):
    """Encodes the robot's whole map, and keeps the last map of each teammate."""

    name = "zstd-maps"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._most = settings.medium.frame_bytes or packets.Fragment.size
        self._partial: dict[int, bytes] = {}
        """The beginning of a message of which the rest has not arrived, by map ID."""
        self._maps: dict[int, Grid] = {}
        """The last received map, by map ID."""
        self._sent: Grid = np.zeros_like(self.received)
        self._waited = INTERVAL
        """Steps since the last map was sent."""

    def encode_changes(
        self, own: Grid, scan: Scan | RangeScan, change: GridChange, *, delivered: bool
    ) -> list[bytes]:
        """Encode the map if it is time."""
        self.own_changes.add(own, change)
        self._waited += 1
        if not delivered or self._waited < INTERVAL or np.array_equal(own, self._sent):
            return []
        self._sent, self._waited = own.copy(), 0
        frame = compress(VALUES[own].tobytes(), LEVEL)
        return fragments(len(frame).to_bytes(HEAD, "big") + frame, self._most)

    def forget_received(self) -> None:
        """Forget everything decoded from the logs of others."""
        super().forget_received()
        self._partial.clear()
        self._maps.clear()

    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Reassemble fragments, and take over the last map that is complete."""
        data, maps = self._partial.get(map_id, b"") + contents(frame), []
        while len(data) >= HEAD:
            size = int.from_bytes(data[:HEAD], "big")
            if not 0 < size <= self.received.size + OVERHEAD:
                reason = f"a map of {self.received.size} cells takes {size} bytes"
                raise ProtocolError("zstd-maps", 0, reason)
            if len(data) < HEAD + size:
                break
            maps.append(self._decode(data[HEAD : HEAD + size]))
            data = data[HEAD + size :]
        if maps:
            self._take_over(map_id, maps[-1], len(maps), step=step, sender=sender)
        self._partial[map_id] = data

    def _decode(self, frame: bytes) -> Grid:
        values = decompress(frame, self.received.size, self.name).view(np.int8)
        states = np.full(values.shape, UNKNOWN, np.uint8)
        for state in (FREE, OCCUPIED):
            states[values == VALUES[state]] = state
        if not np.array_equal(VALUES[states], values):
            raise ProtocolError(self.name, 0, f"cells have other values than {', '.join(map(str, VALUES))}")
        return states.reshape(self.received.shape)

    def _take_over(self, map_id: int, states: Grid, entries: int, *, step: int, sender: int) -> None:
        """Count the last of `entries` complete maps instead of the one before."""
        box = box_of(states != UNKNOWN)
        if box != NO_BOX:
            self._reachability.check(map_id, box, entries, step=step, sender=sender)
        before = self._maps.get(map_id)
        changed = np.flatnonzero(states if before is None else states != before).astype(np.int32)
        self._maps[map_id] = states
        if len(changed):
            self.votes.count(self.settings.author_of(map_id), changed, states.reshape(-1)[changed])
            rows = changed // states.shape[1]
            self.received_changed((0, int(rows.min()), states.shape[1], int(rows.max()) + 1))
