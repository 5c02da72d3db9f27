"""The other end of the edit scripts: rebuilding a teammate's approximation from its packets (section 4.2.3).

Packets build up a draft; only a save point makes it the approximation that is used. A piece of the stream
that contradicts itself or what came before, or that says what cannot be, is refused as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from agent.outline.edits import Held, unpacked
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
    """Holds one teammate's approximation and takes the packets that change it.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the grid, in cells; no vertex may lie beyond the rim of one cell around it.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._draft = _Draft(shape)
        self._pending = b""
        self._saved: dict[int, _Outline] = {}
        self._held: Held | None = Held.nothing(shape)

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

    def feed(self, data: bytes) -> bool:
        """Take the next piece of the stream, cut anywhere; say whether a save point was in it.

        Raises
        ------
        ProtocolError
            The piece makes no sense; nothing has changed. Its offset counts from the first packet of which
            a part is in this piece.
        """
        decoder = Decoder()
        decoder.pending = self._pending
        draft = self._draft.copy()
        saved = None
        offset = 0
        for packet in decoder.feed(data):
            try:
                draft.apply(packet)
            except _RefusedError as refused:
                raise ProtocolError(packet.name, offset, str(refused)) from None
            if isinstance(packet, Save):
                saved = dict(draft.objects)
            offset += packet.size
        self._draft, self._pending = draft, decoder.pending
        if saved is not None:
            self._saved, self._held = saved, None
        return saved is not None


class _RefusedError(Exception):
    """What is wrong with a packet."""


@dataclass
class _Draft:
    """The approximation as far as it has been told, and the object that vertex packets speak of just now."""

    shape: tuple[int, int]
    objects: dict[int, _Outline] = field(default_factory=dict)
    open: int | None = None
    vertices: list[int] = field(default_factory=list)
    count: int = 0
    inside: bool = False
    edited: bool = False
    """Whether anything has come since the last save point."""

    def copy(self) -> _Draft:
        return replace(self, objects=dict(self.objects), vertices=self.vertices.copy())

    def apply(self, packet: AnyPacket) -> None:
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
                    raise _RefusedError("nothing has changed since the last one")
                inside = sum(is_inside for _, is_inside in self.objects.values())
                if inside != 1:
                    raise _RefusedError(f"{inside} inside objects: there must be exactly one")
            case _:
                raise _RefusedError("this packet does not belong in a map's stream")
        self.edited = not isinstance(packet, Save)

    def _begin(self, packet: Emerge | Change) -> None:
        known = packet.object in self.objects
        if isinstance(packet, Emerge) and known:
            raise _RefusedError(f"object {packet.object} is there already")
        if isinstance(packet, Change) and not known:
            raise _RefusedError(f"there is no object {packet.object}")
        if not 2 <= packet.count <= MAX_VERTICES:
            raise _RefusedError(f"{packet.count} vertices: an object has 2 to {MAX_VERTICES}")
        self.open, self.count, self.inside = packet.object, packet.count, bool(packet.inside)
        self.vertices = self.objects[packet.object][0].tolist() if known else []

    def _edit_vertex(self, packet: Insert | Replace | Delete) -> None:
        if self.open is None:
            raise _RefusedError("no object has been named that it speaks of")
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
        """End the edits of the open object."""
        if self.open is None:
            return
        if len(self.vertices) != self.count:
            raise _RefusedError(
                f"object {self.open} has {len(self.vertices)} vertices, not {self.count} as announced"
            )
        self.objects[self.open] = np.array(self.vertices, np.int32), self.inside
        self.open = None
