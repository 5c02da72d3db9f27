"""The other end of the edit scripts: rebuilding a teammate's approximation from its packets (section 4.2.3).

Packets build up a draft; only a save point commits it. A stream that contradicts itself, or that says what
cannot be, is refused: the draft is dropped, the last saved state stands.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.edits import Held, unpacked
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

_Outline = tuple[NDArray[np.int32], bool]
"""An object's vertices, as symbols, and whether it is the inside object."""


class Receiver:
    """Holds one teammate's approximation and applies the packets that change it.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the grid, in cells; no vertex may lie beyond the rim of one cell around it.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._saved: dict[int, _Outline] = {}
        self._held: Held | None = Held.nothing(shape)
        self.rollback()

    @property
    def held(self) -> Held:
        """The approximation as of the last save point."""
        if self._held is None:
            numbers = sorted(self._saved)
            outlines = [self._saved[number] for number in numbers]
            start = np.zeros(len(outlines) + 1, np.int32)
            np.cumsum([len(vertices) for vertices, _ in outlines], out=start[1:])
            symbols = np.concatenate([vertices for vertices, _ in outlines])
            inside = np.array([is_inside for _, is_inside in outlines], np.bool_)
            self._held = Held(np.array(numbers, np.int32), unpacked(self._shape, symbols, start, inside))
        return self._held

    def rollback(self) -> None:
        """Forget everything after the last save point."""
        self._draft = dict(self._saved)
        self._decoder = Decoder()
        self._open: int | None = None
        self._vertices: list[int] = []
        self._count = 0
        self._inside = False
        self._read = 0

    def feed(self, data: bytes) -> None:
        """Read a piece of the stream, cut anywhere.

        Raises
        ------
        ProtocolError
            The stream is broken. It has been rolled back to its last save point, from which it may be sent
            again. The offset counts from where feeding began, or began again after the last error.
        """
        try:
            for packet in self._decoder.feed(data):
                self._apply(packet)
        except ProtocolError:
            self.rollback()
            raise

    def apply(self, packet: AnyPacket) -> None:
        """Apply one whole packet.

        Raises
        ------
        ProtocolError
            As `feed` does.
        """
        try:
            self._apply(packet)
        except ProtocolError:
            self.rollback()
            raise

    def _apply(self, packet: AnyPacket) -> None:
        match packet:
            case Insert() | Replace() | Delete():
                self._edit_vertex(packet)
            case Emerge() | Change():
                self._close(packet)
                self._begin(packet)
            case Remove():
                self._close(packet)
                if packet.object not in self._draft:
                    raise self._error(packet, f"there is no object {packet.object}")
                del self._draft[packet.object]
            case Save():
                self._close(packet)
                inside = sum(is_inside for _, is_inside in self._draft.values())
                if inside != 1:
                    raise self._error(packet, f"{inside} inside objects: there must be exactly one")
                self._saved = self._draft
                self._draft = dict(self._saved)
                self._held = None
            case _:
                raise self._error(packet, "this packet does not belong in a map's stream")
        self._read += packet.size

    def _begin(self, packet: Emerge | Change) -> None:
        known = packet.object in self._draft
        if isinstance(packet, Emerge) and known:
            raise self._error(packet, f"object {packet.object} is there already")
        if isinstance(packet, Change) and not known:
            raise self._error(packet, f"there is no object {packet.object}")
        if not 2 <= packet.count <= MAX_VERTICES:
            raise self._error(packet, f"{packet.count} vertices: an object has 2 to {MAX_VERTICES}")
        self._open = packet.object
        self._count = packet.count
        self._inside = bool(packet.inside)
        self._vertices = self._draft[packet.object][0].tolist() if known else []

    def _edit_vertex(self, packet: Insert | Replace | Delete) -> None:
        if self._open is None:
            raise self._error(packet, "no object has been named that it speaks of")
        last = len(self._vertices) - 1
        if isinstance(packet, Insert):
            last += 1
            if last >= MAX_VERTICES:
                raise self._error(packet, f"object {self._open} is full with {MAX_VERTICES} vertices")
        if not 0 <= packet.index <= last:
            raise self._error(packet, f"index {packet.index} is outside 0 to {last}")
        if isinstance(packet, Delete):
            del self._vertices[packet.index]
            return
        height, width = self._shape
        if not (-1 <= packet.x <= width and -1 <= packet.y <= height):
            raise self._error(packet, f"cell ({packet.x}, {packet.y}) is outside the {width} x {height} grid")
        symbol = (packet.y + 1) << 15 | (packet.x + 1) << 3 | packet.side << 1 | packet.occupied
        if isinstance(packet, Insert):
            self._vertices.insert(packet.index, symbol)
        else:
            self._vertices[packet.index] = symbol

    def _close(self, packet: AnyPacket) -> None:
        """End the edits of the open object."""
        if self._open is None:
            return
        if len(self._vertices) != self._count:
            raise self._error(
                packet,
                f"object {self._open} has {len(self._vertices)} vertices, {self._count} were announced",
            )
        self._draft[self._open] = np.array(self._vertices, np.int32), self._inside
        self._open = None

    def _error(self, packet: AnyPacket, reason: str) -> ProtocolError:
        return ProtocolError(packet.name, self._read, reason)
