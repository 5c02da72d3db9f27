"""The grid exchange: cells that have changed, packed (ours: what one would write first, and what others are held to).

A robot tells which cells of its map are other than it has told, as a patch: the box around them, and for each cell of
the box, row by row, whether it has changed and to what. The patch travels as runs or as a zstd frame (RFC 8878),
whichever is smaller (docs/protocol.md). While teammates have not heard the last patch the next one waits, and grows.
"""

from __future__ import annotations

import sys
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from agent.encodings.base import MapEncoding
from agent.encodings.reachability_check import Reception
from agent.encodings.received_grid import Heard
from agent.replication.map_ids import MapId
from agent.settings import Settings
from protocol import packet_index, packets
from protocol.boxes import NO_BOXES, union
from protocol.errors import ProtocolError
from protocol.grid import OCCUPIED, Grid
from protocol.scans import Change, Scan, fragments

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

RUNS, ZSTD = 0, 1
"""How a patch is packed."""

SAME = 0
"""What a patch says of a cell that has not changed; of others one more than their state."""

SHORT = 1 << 6
"""Runs of fewer cells take one byte."""

LEVEL = 19
"""How hard zstd tries."""

WINDOW = 22
"""Bits of the window that a zstd frame may ask for."""

PACKETS_A_STEP = 3
"""Fragments that a step's budget has room for at least, if it has room for as many of `LEAST` bytes."""

LEAST = 8

MOST_DIGITS = 4
"""Bytes of a number at most."""

Patch = NDArray[np.uint8]


class CellEncoding(MapEncoding):
    """Patches; what teammates told is kept in one grid, in which the last word counts."""

    name = "cells"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        shape = settings.height, settings.width
        self._most = settings.frame_bytes or packets.Fragment.size
        if settings.bandwidth is not None:
            self._most = min(self._most, max(int(settings.bandwidth) // PACKETS_A_STEP, LEAST))
        self._told: Grid = np.zeros(shape, np.uint8)
        self._untold = NO_BOXES
        """Where the robot's own grid has changed since the last patch."""
        self._heard = Heard(shape)
        self._partial: dict[MapId, bytes] = {}

    def record(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Tell what has changed, once all in range have heard what was told before."""
        del scan
        self._heard.seen(own, change)
        self._untold = union(self._untold, change.boxes)
        if not delivered or not len(self._untold):
            return []
        x0, y0 = self._untold[:, :2].min(axis=0).tolist()
        x1, y1 = self._untold[:, 2:].max(axis=0).tolist()
        self._untold = NO_BOXES
        now, before = own[y0:y1, x0:x1], self._told[y0:y1, x0:x1]
        patch: Patch = np.where(now != before, now + np.uint8(1), np.uint8(SAME))
        before[:] = now
        return fragments(pack(x0, y0, patch), self._most) if patch.any() else []

    def take(self, map_id: MapId, frame: bytes, reception: Reception) -> None:
        """Put fragments together, and write the patches that are complete."""
        data = self._partial.get(map_id, b"") + packet_index.contents(frame)
        patches = []
        while (read := unpack(data, self._heard.grid.shape)) is not None:
            x0, y0, patch, data = read
            patches.append((x0, y0, patch))
        for x0, y0, patch in patches:
            self.reachability_check.claim(
                map_id, (x0, y0, x0 + patch.shape[1], y0 + patch.shape[0]), reception
            )
        self._partial[map_id] = data
        for x0, y0, patch in patches:
            height, width = patch.shape
            there = self._heard.grid[y0 : y0 + height, x0 : x0 + width]
            there[patch != SAME] = patch[patch != SAME] - 1
            self._heard.told((x0, y0, x0 + width, y0 + height))

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Lay the robot's own grid over what it heard, where either has changed."""
        del peers
        return self._heard.under(own)


def pack(x0: int, y0: int, patch: Patch) -> bytes:
    """Write a patch: how it is packed, its box, the bytes that follow, and these.

    Parameters
    ----------
    x0, y0 : int
        Its first column and row.
    patch : uint8 array, shape (h, w)
        `SAME`, or the state plus one, of each cell.
    """
    runs, frame = pack_runs(patch), zstd.compress(patch.tobytes(), LEVEL)
    how, body = (RUNS, runs) if len(runs) <= len(frame) else (ZSTD, frame)
    height, width = patch.shape
    return bytes([how]) + b"".join(map(_digits, (x0, y0, width, height, len(body)))) + body


def unpack(data: bytes, shape: tuple[int, int]) -> tuple[int, int, Patch, bytes] | None:
    """Read the patch with which some bytes begin: (x0, y0, patch, what follows); None if its end has not come.

    Raises
    ------
    ProtocolError
        It is no patch of a grid of this shape.
    """
    if not data:
        return None
    if data[0] not in (RUNS, ZSTD):
        raise ProtocolError("cells", 0, f"no patch is packed in way {data[0]}")
    numbers, at = [], 1
    for _ in range(5):
        number = _number(data, at)
        if number is None:
            return None
        value, at = number
        numbers.append(value)
    x0, y0, width, height, size = numbers
    if not (0 < width <= shape[1] - x0 and 0 < height <= shape[0] - y0):
        reason = (
            f"{width} x {height} cells from ({x0}, {y0}) on are not inside the {shape[1]} x {shape[0]} grid"
        )
        raise ProtocolError("cells", 1, reason)
    cells = width * height
    if size > cells:
        raise ProtocolError("cells", 1, f"{size} bytes for {cells} cells")
    if len(data) < at + size:
        return None
    body = data[at : at + size]
    flat = unpack_runs(body, cells) if data[0] == RUNS else _unzstd(body, cells)
    if (flat > OCCUPIED + 1).any():
        raise ProtocolError("cells", at, "a cell has a state that there is not")
    return x0, y0, flat.reshape(height, width), data[at + size :]


def pack_runs(patch: Patch) -> bytes:
    """Write runs of equal cells: two bits for what, six for how many; 0 of them: the number follows."""
    flat = patch.reshape(-1)
    ends = np.append(np.flatnonzero(flat[1:] != flat[:-1]) + 1, len(flat))
    out = bytearray()
    for what, count in zip(flat[ends - 1].tolist(), np.diff(ends, prepend=0).tolist(), strict=True):
        out += bytes([what << 6 | count]) if count < SHORT else bytes([what << 6]) + _digits(count)
    return bytes(out)


def unpack_runs(data: bytes, cells: int) -> Patch:
    """Read runs, of so many cells in all; ProtocolError if they are not."""
    flat = np.empty(cells, np.uint8)
    filled = at = 0
    while at < len(data):
        what, count = data[at] >> 6, data[at] & SHORT - 1
        at += 1
        if not count:
            number = _number(data, at)
            if number is None:
                raise ProtocolError("cells", at, "a run is cut off")
            count, at = number
        if filled + count > cells:
            break
        flat[filled : filled + count] = what
        filled += count
    if filled != cells or at != len(data):
        raise ProtocolError("cells", at, f"runs are not of {cells} cells")
    return flat


def _unzstd(data: bytes, cells: int) -> Patch:
    reader = zstd.ZstdDecompressor(options={zstd.DecompressionParameter.window_log_max: WINDOW})
    try:
        flat = reader.decompress(data, cells + 1)
    except zstd.ZstdError as error:
        raise ProtocolError("cells", 0, str(error)) from None
    if len(flat) != cells or not reader.eof or reader.unused_data:
        raise ProtocolError("cells", 0, f"a frame is not of {cells} cells")
    return np.frombuffer(flat, np.uint8)


def _digits(number: int) -> bytes:
    """A number in bytes of seven bits, the lowest first; all but the last have the eighth set."""
    out = bytearray()
    while number >= 1 << 7:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def _number(data: bytes, at: int) -> tuple[int, int] | None:
    """Read such a number: what it is, and where it ends; None if its end has not come."""
    number = 0
    for place, byte in enumerate(data[at : at + MOST_DIGITS]):
        number |= (byte & 127) << 7 * place
        if byte < 1 << 7:
            return number, at + place + 1
    if len(data) >= at + MOST_DIGITS:
        raise ProtocolError("cells", at, f"a number of more than {MOST_DIGITS} bytes")
    return None
