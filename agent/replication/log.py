"""A log of encoded map updates, stored as one run of bytes.

Entries have offsets from 0. The author may remove entries at the end while no other robot can hold them; a receiver
removes entries at the end that are not the author's.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Iterable
from itertools import accumulate


class Log:
    """Entries by offset."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        """The entries, one after the other."""
        self._ends = array("q")
        """Where each of them ends, in bytes."""
        self.length = 0
        """Number of entries: the offset of the next one."""

    def __len__(self) -> int:
        """Return `length`, which is faster to read."""
        return self.length

    def append(self, entries: list[bytes]) -> None:
        """Add entries at the end."""
        self.extend(b"".join(entries), accumulate(map(len, entries)))

    def extend(self, frame: bytes, ends: Iterable[int]) -> None:
        """Add the entries of a frame, given where in the frame each one ends."""
        before = len(self._bytes)
        self._ends.extend([before + end for end in ends])
        self._bytes += frame
        self.length = len(self._ends)

    def cut(self, length: int) -> None:
        """Remove all entries but the first `length`."""
        del self._bytes[self._begin(length) :]
        del self._ends[length:]
        self.length = len(self._ends)

    def read(self, first: int, budget: int | None = None, end: int | None = None) -> bytes:
        """Return whole entries from `first` on, before `end`, that fit into `budget` bytes (None: no limit)."""
        begin = self._begin(first)
        stop = len(self._bytes) if end is None else self._begin(min(end, len(self)))
        if budget is not None and begin + budget < stop:
            stop = self._begin(self.offset_after(first, budget))
        return bytes(self._bytes[begin:stop])

    def offset_after(self, first: int, size: int) -> int:
        """Return the offset after the whole entries in the `size` bytes that begin with entry `first`."""
        return bisect_right(self._ends, self._begin(first) + size)

    def _begin(self, offset: int) -> int:
        """Return where an entry begins, or where the log ends, which may have been cut meanwhile."""
        offset = min(offset, len(self._ends))
        return self._ends[offset - 1] if offset else 0
