"""The `cells` encoding: changed cells as compressed patches (ours; the baseline for the other encodings).

A patch covers the box around all cells that have changed since the last patch. It holds for each cell of the box, row
by row, its new state or `SAME`. It travels as run lengths or as a zstd frame (RFC 8878), whichever is smaller
(docs/protocol.md). While teammates in range lack the last patch, the next one waits and grows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.encodings.compression import compress, decompress
from agent.encodings.received_grid import GridEncoding
from agent.settings import Settings
from protocol import packets
from protocol.boxes import NO_BOXES, bounding_box, union
from protocol.errors import ProtocolError
from protocol.grid import OCCUPIED, Grid
from protocol.range_scans import RangeScan
from protocol.scans import GridChange, Scan, contents, fragments

RUNS, ZSTD = 0, 1
"""Compression of a patch: run lengths, or a zstd frame."""

SAME = 0
"""Patch value of an unchanged cell; a changed cell has its state plus 1."""

SHORT = 1 << 6
"""Runs of fewer cells take one byte."""

LEVEL = 19
"""Compression level of zstd."""

PACKETS_A_STEP = 3
"""Fragments are short enough that the budget of one step holds this many, but no shorter than `LEAST`."""

LEAST = 8
"""Bytes of the shortest fragment that a small budget leads to."""

MOST_DIGITS = 4
"""Bytes of the longest variable-length number."""

Patch = NDArray[np.uint8]


class CellEncoding(GridEncoding):
    """Encodes patches, and applies the patches of all teammates to one grid; the last patch of a cell counts."""

    name = "cells"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        shape = settings.height, settings.width
        medium = settings.medium
        self._most = medium.frame_bytes or packets.Fragment.size
        if medium.bandwidth.limit is not None:
            self._most = min(self._most, max(medium.bandwidth.limit // PACKETS_A_STEP, LEAST))
        self._encoded: Grid = np.zeros(shape, np.uint8)
        """The self-explored grid as the patches so far describe it."""
        self._pending = NO_BOXES
        """Where the self-explored grid has changed since the last patch."""
        self._partial: dict[int, bytes] = {}
        """The beginning of a message of which the rest has not arrived, by map ID."""

    def encode_changes(
        self, own: Grid, scan: Scan | RangeScan, change: GridChange, *, delivered: bool
    ) -> list[bytes]:
        """Encode a patch of all changed cells, once all teammates in range hold the patches before."""
        self.own_changes.add(own, change)
        self._pending = union(self._pending, change.boxes)
        if not delivered or not len(self._pending):
            return []
        x0, y0 = self._pending[:, :2].min(axis=0).tolist()
        x1, y1 = self._pending[:, 2:].max(axis=0).tolist()
        self._pending = NO_BOXES
        now, before = own[y0:y1, x0:x1], self._encoded[y0:y1, x0:x1]
        patch: Patch = np.where(now != before, now + np.uint8(1), np.uint8(SAME))
        before[:] = now
        return fragments(pack(x0, y0, patch), self._most) if patch.any() else []

    def forget_received(self) -> None:
        """Forget everything decoded from the logs of others."""
        super().forget_received()
        self._partial.clear()

    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Reassemble fragments, and apply the patches that are complete."""
        data, patches = self._partial.get(map_id, b"") + contents(frame), []
        while (read := unpack(data, self.received.shape)) is not None:
            x0, y0, patch, data = read
            patches.append((patch, (x0, y0, x0 + patch.shape[1], y0 + patch.shape[0])))
        if patches:
            area = bounding_box([box for _, box in patches])
            self._reachability.check(map_id, area, len(patches), step=step, sender=sender)
        self._partial[map_id] = data
        for patch, box in patches:
            rows, columns = np.nonzero(patch != SAME)
            places = (rows + box[1]) * self.received.shape[1] + columns + box[0]
            states = patch[rows, columns] - np.uint8(1)
            self.votes.count(self.settings.author_of(map_id), places.astype(np.int32), states)
            self.received_changed(box)


def pack(x0: int, y0: int, patch: Patch) -> bytes:
    """Encode a patch: its compression, its box from column x0 and row y0, the size of its body, and the body.

    `patch`, shape (h, w), has `SAME`, or the state plus one, of each cell.
    """
    runs, frame = pack_runs(patch), compress(patch.tobytes(), LEVEL)
    compression, body = (RUNS, runs) if len(runs) <= len(frame) else (ZSTD, frame)
    height, width = patch.shape
    return bytes([compression]) + b"".join(map(_digits, (x0, y0, width, height, len(body)))) + body


def unpack(data: bytes, shape: tuple[int, int]) -> tuple[int, int, Patch, bytes] | None:
    """Decode the patch at the beginning of `data`, patches of a grid of `shape`, the last of which may be cut off.

    Returns (x0, y0, patch, rest): first column and row, uint8 array of shape (h, w), the bytes behind the patch; None
    if the patch is cut off. ProtocolError: the patch is malformed, or lies outside the grid.
    """
    if not data:
        return None
    if data[0] not in (RUNS, ZSTD):
        raise ProtocolError("cells", 0, f"unknown compression {data[0]} of a patch")
    numbers, at = [], 1
    for _ in range(5):
        number = _number(data, at)
        if number is None:
            return None
        value, at = number
        numbers.append(value)
    x0, y0, width, height, size = numbers
    if not (0 < width <= shape[1] - x0 and 0 < height <= shape[0] - y0):
        patch = f"a patch of {width} x {height} cells at ({x0}, {y0})"
        raise ProtocolError("cells", 1, f"{patch} leaves the {shape[1]} x {shape[0]} grid")
    cells = width * height
    if size > cells:
        raise ProtocolError("cells", 1, f"a patch of {cells} cells takes {size} bytes")
    if len(data) < at + size:
        return None
    body = data[at : at + size]
    flat = unpack_runs(body, cells) if data[0] == RUNS else decompress(body, cells, "cells")
    if (flat > OCCUPIED + 1).any():
        raise ProtocolError("cells", at, "unknown state of a cell")
    return x0, y0, flat.reshape(height, width), data[at + size :]


def pack_runs(patch: Patch) -> bytes:
    """Encode runs of equal cells: two bits of value, six of length; for length 0 the real length follows."""
    flat = patch.reshape(-1)
    ends = np.append(np.flatnonzero(flat[1:] != flat[:-1]) + 1, len(flat))
    out = bytearray()
    for value, count in zip(flat[ends - 1].tolist(), np.diff(ends, prepend=0).tolist(), strict=True):
        out += bytes([value << 6 | count]) if count < SHORT else bytes([value << 6]) + _digits(count)
    return bytes(out)


def unpack_runs(data: bytes, cells: int) -> Patch:
    """Decode runs of `cells` cells in total; ProtocolError if they are malformed."""
    flat = np.empty(cells, np.uint8)
    filled = at = 0
    while at < len(data):
        value, count = data[at] >> 6, data[at] & SHORT - 1
        at += 1
        if not count:
            number = _number(data, at)
            if number is None:
                raise ProtocolError("cells", at, "a run is cut off")
            count, at = number
        if filled + count > cells:
            break
        flat[filled : filled + count] = value
        filled += count
    if filled != cells or at != len(data):
        raise ProtocolError("cells", at, f"the runs do not cover {cells} cells")
    return flat


def _digits(number: int) -> bytes:
    """Encode a number as LEB128: seven bits per byte, the lowest first; all bytes but the last have bit 7 set."""
    out = bytearray()
    while number >= 1 << 7:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def _number(data: bytes, at: int) -> tuple[int, int] | None:
    """Decode a LEB128 number: (number, offset behind it); None if it is cut off."""
    number = 0
    for place, byte in enumerate(data[at : at + MOST_DIGITS]):
        number |= (byte & 127) << 7 * place
        if byte < 1 << 7:
            return number, at + place + 1
    if len(data) >= at + MOST_DIGITS:
        raise ProtocolError("cells", at, f"a number of more than {MOST_DIGITS} bytes")
    return None
