"""The log of one robot's map: units in the order in which their maker wrote them, as one run of bytes."""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Iterable
from itertools import accumulate


class Log:
    """Units numbered from 0; the oldest may be forgotten once everyone holds them."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        """The units that are held, one behind the other."""
        self._ends = array("q")
        """Where each of them ends, in bytes of all units ever logged."""
        self._forgotten = 0
        self._gone = 0
        """Bytes of the units that are forgotten."""

    def __len__(self) -> int:
        """All units ever logged, those forgotten included."""
        return self._forgotten + len(self._ends)

    @property
    def oldest(self) -> int:
        """Number of the first unit that is still held."""
        return self._forgotten

    def append(self, units: list[bytes]) -> None:
        """Add units at the end."""
        self.extend(b"".join(units), accumulate(map(len, units)))

    def extend(self, frame: bytes, ends: Iterable[int]) -> None:
        """Add units that stand behind each other in a frame, given where in it each ends."""
        behind = self._gone + len(self._bytes)
        self._ends.extend([behind + end for end in ends])
        self._bytes += frame

    def retract(self, count: int, heard: int) -> bool:
        """Take the last `count` units back, if they are behind the first `heard` ones; say whether."""
        left = len(self) - count
        if left < heard:
            return False
        del self._bytes[self._begin(left) - self._gone :]
        del self._ends[left - self._forgotten :]
        return True

    def since(self, index: int, room: int | None, until: int | None = None) -> bytes:
        """Units from `index` on, as many as fit into `room` bytes (None: all), or up to `until` as is no longer.

        `index` must not lie before `oldest`.
        """
        begin = self._begin(index)
        end = self._gone + len(self._bytes) if until is None else self._begin(until)
        if room is not None and begin + room < end:
            end = self._begin(self.reached(index, room))
        return bytes(self._bytes[begin - self._gone : end - self._gone])

    def reached(self, index: int, size: int) -> int:
        """Up to which unit `size` bytes go that begin with unit `index`."""
        return self._forgotten + bisect_right(self._ends, self._begin(index) + size)

    def forget(self, before: int) -> None:
        """Drop the units before number `before`."""
        before = min(before, len(self))
        if before > self._forgotten:
            gone = self._begin(before)
            del self._bytes[: gone - self._gone]
            del self._ends[: before - self._forgotten]
            self._forgotten, self._gone = before, gone

    def _begin(self, index: int) -> int:
        """Where a unit begins, as `_ends` counts."""
        return self._ends[index - self._forgotten - 1] if index > self._forgotten else self._gone
