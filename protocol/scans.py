"""Laser scans: readings, their binary form, and how a scan is drawn on a grid.

A scan is taken at the center of the robot's cell. Beam directions are fixed in the map's frame
(`protocol.grid.ray_table`), so a scan consists of a cell and one reading per beam. A reading is a uint16: the number of
cells that the beam crossed, plus the bit `HIT` if the next cell stopped it. `NONE` is a beam outside the field of view.
A teammate ends a beam without a hit, and its cell counts as crossed: robots recognize each other, and the floor
beneath a robot is free.

The binary form has 2 * (beams + 2) bytes, big-endian: x, y, readings; 724 for 360 beams. It is sent in
fragments of at most 64 bytes (`protocol.packets.Fragment`), which can be cut and resumed.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from protocol.arrays import NO_CELLS, Cells, Int32Rows, Int32s, Uint16s
from protocol.boxes import NO_BOXES, Box, Boxes, bounding_box
from protocol.errors import ProtocolError
from protocol.grid import FREE, MAX_SIDE, OCCUPIED, UNKNOWN, Grid, RayTable
from protocol.kernels import kernel
from protocol.packet_codec import decode_kind, encode
from protocol.packets import FRAGMENT_DATA, LENGTH_HEAD, Fragment

HIT = 0x8000
NONE = 0x7FFF

Readings = Uint16s


@dataclass(frozen=True)
class Scan:
    """One scan: the cell in which it was taken, and uint16 readings of shape (beams,)."""

    x: int
    y: int
    readings: Readings


def scan_size(beams: int) -> int:
    """Return the bytes of a scan in its binary form."""
    return 2 * (beams + 2)


def encode_scan(scan: Scan) -> bytes:
    """Encode a scan in its binary form."""
    return struct.pack(">HH", scan.x, scan.y) + scan.readings.astype(">u2").tobytes()


def decode_scan(data: bytes, ray_table: RayTable) -> Scan:
    """Decode a scan.

    Raises ProtocolError for a wrong length, a cell outside any grid, or a reading that is longer than its beam.
    """
    if len(data) != scan_size(ray_table.beams):
        raise ProtocolError("scan", 0, f"{len(data)} bytes instead of {scan_size(ray_table.beams)}")
    x, y = struct.unpack_from(">HH", data)
    if x >= MAX_SIDE or y >= MAX_SIDE:
        raise ProtocolError("scan", 0, f"cell ({x}, {y}) is outside {MAX_SIDE} x {MAX_SIDE}")
    readings = np.frombuffer(data, ">u2", offset=4).astype(np.uint16)
    check_readings(readings, ray_table)
    return Scan(x, y, readings)


def check_readings(readings: Readings, ray_table: RayTable) -> None:
    """Raise ProtocolError if a reading has more cells than its beam."""
    if len(readings) != ray_table.beams:
        raise ProtocolError("scan", 0, f"{len(readings)} readings for {ray_table.beams} beams")
    beam = _first_too_long(readings, ray_table.start)
    if beam >= 0:
        touched = (readings[beam] & NONE) + (readings[beam] >> 15)
        most = ray_table.start[beam + 1] - ray_table.start[beam]
        reason = f"beam {beam} touches {touched} cells, but its range is {most}"
        raise ProtocolError("scan", 4 + 2 * beam, reason)


@kernel
def _first_too_long(readings: Readings, start: Int32s) -> int:
    """Return the first beam whose reading has more cells than the beam; -1 if there is none."""
    for beam in range(len(readings)):
        reading = np.int64(readings[beam])
        if reading != NONE and (reading & NONE) + (reading >> 15) > start[beam + 1] - start[beam]:
            return beam
    return -1


def fragments(data: bytes, most: int = Fragment.size) -> list[bytes]:
    """Split the binary form of a scan into `Fragment` packets of at most `most` bytes."""
    size = FRAGMENT_DATA if most >= Fragment.size else most - LENGTH_HEAD
    pieces = (data[at : at + size] for at in range(0, len(data), size))
    return [encode([Fragment(piece)]) for piece in pieces]


def contents(frame: bytes, size: int = 0, held: int = 0) -> bytes:
    """Return the joined content of a frame of fragments, which are parts of messages of `size` bytes (0: unknown).

    `held` bytes of the first message have arrived before this frame. Raises ProtocolError if the frame holds another
    packet, or a fragment extends beyond the end of its message.
    """
    pieces = [packet.data for packet in decode_kind(frame, Fragment)]
    for piece in pieces if size else ():
        held += len(piece)
        if held > size:
            reason = f"a fragment extends beyond the {size} bytes of its message"
            raise ProtocolError(Fragment.name, 0, reason)
        held %= size
    return b"".join(pieces)


class GridChange(NamedTuple):
    """The cells of a grid that a scan has changed: their state, or with noisy lasers also how certain it is."""

    cells: int
    """Number of changed cells."""
    box: Box
    """A box that contains them; empty if there are none."""

    @property
    def boxes(self) -> Boxes:
        """The box as an array of one row; no row if nothing changed."""
        return np.array([self.box], np.int32) if self.cells else NO_BOXES

    def joined(self, other: GridChange) -> GridChange:
        """Return this change and another one as one."""
        if not (self.cells and other.cells):
            return self if self.cells else other
        return GridChange(self.cells + other.cells, bounding_box([self.box, other.box]))


def draw(
    grid: Grid, ray_table: RayTable, x: int, y: int, readings: Readings, driven: Cells = NO_CELLS
) -> GridChange:
    """Draw a scan taken in cell (x, y) on a grid, in place: crossed cells become free, cells that were hit occupied.

    The robot's cell and the cells that it has `driven` over, int32 of shape (n, 2), become free as well. Only unknown
    cells change, because the lasers of one world do not contradict each other. Cells outside the grid are ignored, as
    is a scan taken there. The readings must be valid (`check_readings`).
    """
    cells, flat = ray_table.cells, ray_table.flat(grid.shape[1])
    changed, x0, y0, x1, y1 = _draw(
        grid, cells, flat, ray_table.start, ray_table.shared, x, y, readings, driven
    )
    return GridChange(changed, (x0, y0, x1, y1))


@kernel
def _draw(
    grid: Grid,
    cells: Int32Rows,
    flat: Int32s,
    start: Int32s,
    shared: Int32s,
    x: int,
    y: int,
    readings: Readings,
    driven: Int32Rows,
) -> tuple[int, int, int, int, int]:
    # As an unsigned number, a cell beyond the left or upper border is very large; and indexing is twice as fast.
    height, width = np.uint64(grid.shape[0]), np.uint64(grid.shape[1])
    lying = grid.reshape(grid.size)
    here = y * grid.shape[1] + x
    changed = 0
    x0, y0, x1, y1 = grid.shape[1], grid.shape[0], 0, 0
    on_grid = np.uint64(x) < width and np.uint64(y) < height
    if on_grid and grid[y, x] == UNKNOWN:
        grid[y, x] = FREE
        changed, x0, y0, x1, y1 = 1, x, y, x + 1, y + 1
    for at in range(len(driven)):
        column, row = driven[at, 0], driven[at, 1]
        if np.uint64(column) < width and np.uint64(row) < height and grid[row, column] == UNKNOWN:
            grid[row, column] = FREE
            changed += 1
            x0, x1 = min(x0, column), max(x1, column + 1)
            y0, y1 = min(y0, row), max(y1, row + 1)
    touched = np.uint64(0)
    for beam in range(len(readings)):
        reading = readings[beam]
        if reading == NONE or not on_grid:
            touched = np.uint64(0)
            continue
        first = np.uint64(start[beam])
        hit = first + np.uint64(reading & NONE)
        end = hit + np.uint64(reading >> 15)
        # A beam never turns back: if its last cell is on the grid, all are.
        while end > first:
            last = end - np.uint64(1)
            if np.uint64(x + cells[last, 0]) < width and np.uint64(y + cells[last, 1]) < height:
                break
            end = last
        # The cells shared with the beam before, as far as that beam reached, are drawn already.
        before, touched = touched, end - first
        known = min(np.uint64(shared[beam]), before, touched)
        for at in range(first + known, end):
            cell = np.uint64(here + flat[at])
            if lying[cell] == UNKNOWN:
                lying[cell] = FREE if at < hit else OCCUPIED
                changed += 1
                x0, x1 = min(x0, x + cells[at, 0]), max(x1, x + cells[at, 0] + 1)
                y0, y1 = min(y0, y + cells[at, 1]), max(y1, y + cells[at, 1] + 1)
    return changed, x0, y0, x1, y1
