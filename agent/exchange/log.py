"""The log of one robot's map: units in the order in which their maker wrote them."""

from __future__ import annotations


class Log:
    """Units numbered from 0; the oldest may be forgotten once everyone holds them."""

    def __init__(self) -> None:
        self._units: list[bytes] = []
        self._forgotten = 0

    def __len__(self) -> int:
        """All units ever logged, those forgotten included."""
        return self._forgotten + len(self._units)

    @property
    def oldest(self) -> int:
        """Number of the first unit that is still held."""
        return self._forgotten

    def append(self, units: list[bytes]) -> None:
        """Add units at the end."""
        self._units += units

    def retract(self, count: int, heard: int) -> bool:
        """Take the last `count` units back, if they are behind the first `heard` ones; say whether."""
        if len(self) - count < heard:
            return False
        del self._units[len(self._units) - count :]
        return True

    def since(self, index: int, room: int | None) -> list[bytes]:
        """Units from `index` on, as many as fit into `room` bytes (None: all).

        `index` must not lie before `oldest`.
        """
        first = index - self._forgotten
        if room is None:
            return self._units[first:]
        end = first
        while end < len(self._units) and len(self._units[end]) <= room:
            room -= len(self._units[end])
            end += 1
        return self._units[first:end]

    def forget(self, before: int) -> None:
        """Drop the units before number `before`."""
        drop = min(before - self._forgotten, len(self._units))
        if drop > 0:
            del self._units[:drop]
            self._forgotten += drop
