"""The decoded updates of a map, in the order of its log.

Each update has a key, a hash of all messages on which its content depends. Decoders whose last updates have equal keys
are in the same state, so robots can share one decoder (`agent.predictive.shared_decoder`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from protocol.arrays import Int32Rows
from protocol.boxes import Box
from protocol.grid import Cell
from protocol.kernels import kernel


@dataclass(frozen=True)
class Base:
    """An update depends on the updates of map `map_id` before number `end`; `key` is the key of the last of them."""

    map_id: int
    end: int
    key: bytes


@dataclass(frozen=True)
class DecodedUpdate:
    """The content of an update."""

    places: NDArray[np.int32]
    """Reported cells, as indices of the flat grid, each once, shape (n,)."""
    states: NDArray[np.uint8]
    before: NDArray[np.uint8]
    """`states`, `before`, shape (n,): the reported state of each cell, and the author's previous report of it: unknown
    if there was none."""
    box: Box
    """The bounding box of the cells."""
    message: bytes = b""
    """The encoded update."""
    bases: tuple[Base, ...] = ()
    """Dependencies that the update names, by ascending map ID."""
    ends: tuple[int, ...] = ()
    """Number of updates of each map on which the update depends, named or not; 0 of its own map."""
    pose: Cell | None = None
    """Cell of the author's last scan; None before the first."""
    key: bytes = b""
    """Hash of the messages on which this content depends (`key_of`)."""


def key_of(before: bytes, message: bytes, bases: Sequence[Base]) -> bytes:
    """Return the key of an update; `before` is the key of the update before it, empty for the first."""
    return blake2b(b"".join([before, *(base.key for base in bases), message]), digest_size=16).digest()


class History:
    """The decoded updates of a map, numbered from 0."""

    def __init__(self) -> None:
        self._updates: list[DecodedUpdate] = []
        self._boxes = np.empty((16, 4), np.int32)

    def __len__(self) -> int:
        """Return the number of updates decoded so far."""
        return len(self._updates)

    @property
    def last(self) -> DecodedUpdate | None:
        """The last update; None if there is none."""
        return self._updates[-1] if self._updates else None

    @property
    def last_key(self) -> bytes:
        """The key of the last update; empty if there is none."""
        return self._updates[-1].key if self._updates else b""

    def append(self, update: DecodedUpdate) -> None:
        """Append an update."""
        if len(self._updates) == len(self._boxes):
            self._boxes = np.concatenate([self._boxes, np.empty_like(self._boxes)])
        self._boxes[len(self._updates)] = update.box
        self._updates.append(update)

    def pop(self) -> None:
        """Remove the last update, which no other log depends on."""
        self._updates.pop()

    def key_before(self, end: int) -> bytes | None:
        """Return the key of update `end` - 1; None if it is not decoded yet."""
        return self._updates[end - 1].key if end <= len(self._updates) else None

    def between(self, first: int, end: int) -> list[DecodedUpdate]:
        """Return updates `first` to `end` - 1."""
        return self._updates[first:end]

    def last_near(self, first: int, end: int, near: Box) -> int:
        """Return the last of updates `first` to `end` - 1 whose box meets `near`; -1 if there is none."""
        return int(_last_meeting(self._boxes, first, end, near))


@kernel
def _last_meeting(boxes: Int32Rows, first: int, end: int, near: Box) -> int:
    """Return the last of boxes `first` to `end` - 1 that meets the box `near`; -1 if there is none."""
    x0, y0, x1, y1 = near
    for number in range(end - 1, first - 1, -1):
        box = boxes[number]
        if box[0] < x1 and x0 < box[2] and box[1] < y1 and y0 < box[3]:
            return number
    return -1
