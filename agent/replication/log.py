"""A log of encoded map updates, stored as one run of bytes; entries have offsets from 0.

The author may remove entries at the end while no other robot can hold them; a receiver removes those that are forged.
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

    def read(self, first: int, budget: int | None = None, end: int | None = None, head: bytes = b"") -> bytes:
        """Return whole entries from `first` on, before `end`, behind a header; no header if there are no entries.

        Both fit into `budget` bytes (None: no limit).
        """
        begin = self._begin(first)
        stop = len(self._bytes) if end is None else self._begin(min(end, len(self)))
        if budget is not None and begin + budget - len(head) < stop:
            stop = self._begin(self.offset_after(first, budget - len(head)))
        return head + self._bytes[begin:stop] if begin < stop else b""

    def offset_after(self, first: int, size: int) -> int:
        """Return the offset after the whole entries in the `size` bytes that begin with entry `first`."""
        return bisect_right(self._ends, self._begin(first) + size)

    def _begin(self, offset: int) -> int:
        """Return where an entry begins, or where the log ends, which may have been cut meanwhile."""
        offset = min(offset, len(self._ends))
        return self._ends[offset - 1] if offset else 0


class OwnLog(Log):
    """The log that this robot writes."""

    def __init__(self) -> None:
        super().__init__()
        self.shared = 0
        """Offset before which other robots may hold entries; those from there on may change."""
        self.last_append = 0
        """Offset of the entries that were appended last."""
        self.digest_length = 0
        """Number of entries whose digest is due, after some time or if a peer may hold others; 0: none is due."""

    def append(self, entries: list[bytes]) -> None:
        """Add entries at the end."""
        if entries:
            self.last_append = self.length
        super().append(entries)

    def retract(self, count: int) -> bool:
        """Remove the last `count` entries if no other robot can hold any of them; return whether it did."""
        left = self.length - count
        if left < self.shared:
            return False
        self.cut(left)
        return True

    def sent(self, end: int) -> None:
        """Note that other robots may hold the entries before offset `end` now."""
        self.shared = max(self.shared, end)

    def request_digest(self, length: int) -> None:
        """Send a digest of the first `length` entries, or of fewer if that is requested already."""
        if length:
            self.digest_length = min(length, self.digest_length or length)
