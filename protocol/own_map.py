"""A part of a robot's own map, from a body that makes its map itself: a box of cells and their states.

The binary form has 16 bytes and one per cell: the box (x0, y0, x1, y1) as big-endian int32, then rows of states.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from protocol.boxes import Box
from protocol.errors import ProtocolError
from protocol.grid import OCCUPIED, Grid

_HEAD = struct.Struct(">4i")
HEAD_BYTES = _HEAD.size


@dataclass(frozen=True, eq=False)
class OwnMapPart:
    """The states of the cells in a box, uint8 of shape (y1 - y0, x1 - x0); unknown cells have no meaning."""

    box: Box
    states: Grid


def encode_own_map(part: OwnMapPart) -> bytes:
    """Encode a part in its binary form."""
    return _HEAD.pack(*part.box) + part.states.tobytes()


def decode_own_map(data: bytes, height: int, width: int) -> OwnMapPart:
    """Decode a part of a grid of this size; ProtocolError if it is malformed, or lies outside of the grid."""
    if len(data) < HEAD_BYTES:
        raise ProtocolError("map part", 0, f"{len(data)} bytes instead of {HEAD_BYTES} or more")
    x0, y0, x1, y1 = _HEAD.unpack_from(data)
    if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
        raise ProtocolError(
            "map part", 0, f"box {(x0, y0, x1, y1)} does not lie in the {width} x {height} grid"
        )
    cells = (y1 - y0) * (x1 - x0)
    if len(data) != HEAD_BYTES + cells:
        raise ProtocolError("map part", 0, f"{len(data)} bytes instead of {HEAD_BYTES + cells}")
    states = np.frombuffer(data, np.uint8, offset=HEAD_BYTES).reshape(y1 - y0, x1 - x0)
    if states.max() > OCCUPIED:
        raise ProtocolError(
            "map part", HEAD_BYTES, f"a cell has state {states.max()}; the last one is {OCCUPIED}"
        )
    return OwnMapPart((x0, y0, x1, y1), states)
