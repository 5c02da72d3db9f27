"""What the units of a stream say, in the order in which they have been read.

Each unit has a key, which follows from all that had to be read before it: two who have read units of the same key hold
the same stream, and hardly anything else can have led there. So they may share what they hold (`agent.predictive.shared_decoder`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from protocol.boxes import Box
from protocol.kernels import kernel


@dataclass(frozen=True)
class Base:
    """Up to which unit of a robot's stream a unit is built on, `end` - 1, where that is more than before; its key."""

    robot: int
    end: int
    key: bytes


@dataclass(frozen=True)
class DecodedUpdate:
    """What a unit says.

    Attributes
    ----------
    places : int32 array
        Cells, as places in the flat grid, each once.
    states, before : uint8 array
        What its maker tells of them, and what it had told of them before: unknown where nothing.
    box : Box
        Around them.
    message : bytes
        The unit itself.
    bases : tuple of Base
        What it is built on that the units before it are not, by ascending robot.
    pose : (x, y), optional
        From where its maker looked last, if it has said so by now.
    key : bytes
        What it follows from (`key_of`).
    """

    places: NDArray[np.int32]
    states: NDArray[np.uint8]
    before: NDArray[np.uint8]
    box: Box
    message: bytes = b""
    bases: tuple[Base, ...] = ()
    pose: tuple[int, int] | None = None
    key: bytes = b""


def key_of(before: bytes, message: bytes, bases: Sequence[Base]) -> bytes:
    """Key of a unit that follows another one of its stream, of key `before`; empty: it is the first."""
    return blake2b(b"".join([before, *(base.key for base in bases), message]), digest_size=16).digest()


class History:
    """The units of a stream that have been read, numbered from 0; the oldest are forgotten once they are built on."""

    def __init__(self) -> None:
        self._units: list[DecodedUpdate] = []
        self._forgotten = 0
        self._boxes = np.empty((16, 4), np.int32)

    def __len__(self) -> int:
        """All units ever read."""
        return self._forgotten + len(self._units)

    @property
    def last(self) -> DecodedUpdate | None:
        """The last unit, if it has not been forgotten."""
        return self._units[-1] if self._units else None

    def append(self, unit: DecodedUpdate) -> None:
        """Add a unit at the end."""
        if len(self._units) == len(self._boxes):
            self._boxes = np.concatenate([self._boxes, np.empty_like(self._boxes)])
        self._boxes[len(self._units)] = unit.box
        self._units.append(unit)

    def pop(self) -> None:
        """Take the last unit back."""
        self._units.pop()

    def between(self, first: int, end: int) -> list[DecodedUpdate]:
        """Units `first` to `end` - 1."""
        return self._units[first - self._forgotten : end - self._forgotten]

    def last_near(self, first: int, end: int, near: Box) -> int:
        """The last of units `first` to `end` - 1 with a box that meets another one; -1 if there is none."""
        found = _last_meeting(self._boxes, first - self._forgotten, end - self._forgotten, *near)
        return int(found) + self._forgotten if found >= 0 else -1

    def forget(self, before: int) -> None:
        """Drop the units before number `before`."""
        if before > self._forgotten:
            drop = before - self._forgotten
            del self._units[:drop]
            self._boxes[: len(self._units)] = self._boxes[drop : drop + len(self._units)].copy()
            self._forgotten = before


@kernel("int64(int32[:,::1], int64, int64, int64, int64, int64, int64)")
def _last_meeting(boxes: NDArray[np.int32], first: int, end: int, x0: int, y0: int, x1: int, y1: int) -> int:
    """The last of boxes `first` to `end` - 1 that meets another one; -1 if there is none."""
    for number in range(end - 1, first - 1, -1):
        box = boxes[number]
        if box[0] < x1 and x0 < box[2] and box[1] < y1 and y0 < box[3]:
            return number
    return -1
