"""Plain reader of edit packets, one after the other; it gives the error of a malformed stream.

`agent.outline.edit_reader` reads whole chunks at once, but does not report the cause of an error.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError
from protocol.packets import (
    MAX_VERTICES,
    AnyPacket,
    Change,
    Decoder,
    Delete,
    Emerge,
    Insert,
    Remove,
    Replace,
    Save,
)

Outline = tuple[NDArray[np.int32], bool]
"""Vertices of an object, as symbols, and whether it is the inside object."""


class _RefusedError(Exception):
    """A packet does not fit the packets before it."""


@dataclass
class Draft:
    """State of an approximation between two packets.

    Attributes
    ----------
    shape : (int, int)
        Height and width of the grid, in cells.
    objects : dict of number to `Outline`
    open : int, optional
        Number of the object that is being edited, if any. `vertices` are its current vertices, as symbols
        (`agent.outline.objects.Objects`); `count` and `inside` are those announced.
    edited : bool
        Whether a packet followed the last save point.
    saved : dict, optional
        The objects at the last save point in this stream; None before the first.
    """

    shape: tuple[int, int]
    objects: dict[int, Outline] = field(default_factory=dict)
    open: int | None = None
    vertices: list[int] = field(default_factory=list)
    count: int = 0
    inside: bool = False
    edited: bool = False
    saved: dict[int, Outline] | None = None

    def read(self, pending: bytes, data: bytes) -> bytes:
        """Apply a chunk of the stream that continues the incomplete packet `pending`; return the new incomplete packet.

        Raises
        ------
        ProtocolError
            A packet is malformed or does not fit; this object must not be used afterwards.
        """
        decoder = Decoder()
        decoder.pending = pending
        offset = 0
        for packet in decoder.feed(data):
            try:
                self._apply(packet)
            except _RefusedError as refused:
                raise ProtocolError(packet.name, offset, str(refused)) from None
            offset += packet.size
        return decoder.pending

    def _apply(self, packet: AnyPacket) -> None:
        match packet:
            case Insert() | Replace() | Delete():
                self._edit_vertex(packet)
            case Emerge() | Change():
                self._close()
                self._begin(packet)
            case Remove():
                self._close()
                if packet.object not in self.objects:
                    raise _RefusedError(f"there is no object {packet.object}")
                del self.objects[packet.object]
            case Save():
                self._close()
                if not self.edited:
                    raise _RefusedError("nothing has changed since the last save point")
                inside = sum(is_inside for _, is_inside in self.objects.values())
                if inside != 1:
                    raise _RefusedError(f"{inside} inside objects: there must be exactly one")
                self.saved = dict(self.objects)
            case _:
                raise _RefusedError("edit streams have no packets of this kind")
        self.edited = not isinstance(packet, Save)

    def _begin(self, packet: Emerge | Change) -> None:
        known = packet.object in self.objects
        if isinstance(packet, Emerge) and known:
            raise _RefusedError(f"object {packet.object} already exists")
        if isinstance(packet, Change) and not known:
            raise _RefusedError(f"there is no object {packet.object}")
        if not 2 <= packet.count <= MAX_VERTICES:
            raise _RefusedError(f"{packet.count} vertices: an object has 2 to {MAX_VERTICES}")
        self.open, self.count, self.inside = packet.object, packet.count, bool(packet.inside)
        self.vertices = self.objects[packet.object][0].tolist() if known else []

    def _edit_vertex(self, packet: Insert | Replace | Delete) -> None:
        if self.open is None:
            raise _RefusedError("no object is being edited")
        last = len(self.vertices) - 1
        if isinstance(packet, Insert):
            last += 1
            if last >= MAX_VERTICES:
                raise _RefusedError(f"object {self.open} is full with {MAX_VERTICES} vertices")
        if packet.index > last:
            raise _RefusedError(f"index {packet.index} of object {self.open}: the last one is {last}")
        if isinstance(packet, Delete):
            del self.vertices[packet.index]
            return
        height, width = self.shape
        if packet.x > width or packet.y > height:
            raise _RefusedError(f"cell ({packet.x}, {packet.y}) is outside the {width} x {height} grid")
        symbol = (packet.y + 1) << 15 | (packet.x + 1) << 3 | packet.side << 1 | packet.occupied
        if isinstance(packet, Insert):
            self.vertices.insert(packet.index, symbol)
        else:
            self.vertices[packet.index] = symbol

    def _close(self) -> None:
        """Finish the object that is being edited."""
        if self.open is None:
            return
        if len(self.vertices) != self.count:
            raise _RefusedError(
                f"object {self.open} has {len(self.vertices)} vertices instead of the announced {self.count}"
            )
        self.objects[self.open] = np.array(self.vertices, np.int32), self.inside
        self.open = None
