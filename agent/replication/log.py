"""An append-only log of encoded map updates, stored as one run of bytes and truncated from the front.

Entries have offsets from 0. The author may retract entries at the end while no other robot can hold them. Entries that
every teammate acknowledged are truncated, as in any replicated log.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Iterable
from itertools import accumulate


class Log:
    """Entries by offset; the oldest may have been truncated."""

    def __init__(self) -> None:
        self.start = 0
        """Offset of the first entry that is still stored."""
        self._bytes = bytearray()
        """The stored entries, one after the other."""
        self._ends = array("q")
        """Where each of them ends, in bytes of all entries ever appended."""
        self._truncated = 0
        """Bytes of the entries before `start`."""

    def __len__(self) -> int:
        """Number of all entries ever appended: the offset of the next one."""
        return self.start + len(self._ends)

    def append(self, entries: list[bytes]) -> None:
        """Add entries at the end."""
        self.extend(b"".join(entries), accumulate(map(len, entries)))

    def extend(self, frame: bytes, ends: Iterable[int]) -> None:
        """Add the entries of a frame, given where in the frame each one ends."""
        before = self._truncated + len(self._bytes)
        self._ends.extend([before + end for end in ends])
        self._bytes += frame

    def retract(self, count: int, shared: int) -> bool:
        """Remove the last `count` entries, unless that removes a shared or truncated one; return whether it did.

        `shared` is the offset before which other robots may hold entries.
        """
        left = len(self) - count
        if left < max(shared, self.start):
            return False
        del self._bytes[self._begin(left) - self._truncated :]
        del self._ends[left - self.start :]
        return True

    def read(self, first: int, budget: int | None, end: int | None = None) -> bytes:
        """Return whole entries from `first` on, before `end`, that fit into `budget` bytes (None: no limit).

        `first` must not be less than `start`.
        """
        begin = self._begin(first)
        stop = self._truncated + len(self._bytes) if end is None else self._begin(end)
        if budget is not None and begin + budget < stop:
            stop = self._begin(self.offset_after(first, budget))
        return bytes(self._bytes[begin - self._truncated : stop - self._truncated])

    def offset_after(self, first: int, size: int) -> int:
        """Return the offset after the whole entries in the `size` bytes that begin with entry `first`."""
        return self.start + bisect_right(self._ends, self._begin(first) + size)

    def truncate(self, before: int) -> None:
        """Drop the entries before offset `before`."""
        if before > self.start:
            before = min(before, len(self))
            begin = self._begin(before)
            del self._bytes[: begin - self._truncated]
            del self._ends[: before - self.start]
            self.start, self._truncated = before, begin

    def _begin(self, offset: int) -> int:
        """Return where an entry begins, counted as in `_ends`."""
        return self._ends[offset - self.start - 1] if offset > self.start else self._truncated
