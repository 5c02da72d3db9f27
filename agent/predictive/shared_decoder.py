"""One stream, read once for all robots of a process.

Who follows a stream holds a grid of the whole map for it. Where each robot has a process of its own, that is a grid a
teammate; where hundreds run in one process, it would be as many for each of them. But all that they could differ in is
how far they have read: what a unit says follows from what was read before it (`agent.predictive.stream`). So the first one
that comes to a unit reads it, and who comes later takes what was read, if it holds the very same units before it and
beneath it, by their keys. Should a liar have told them different units, the stream is read again from its beginning for
those who were told others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from agent.predictive.history import DecodedUpdate, History
from agent.predictive.stream import Stream

MOST = 4
"""Readings of a stream that are kept at most; one that is needed again begins anew."""

New = Callable[[int, Sequence[History]], Stream]
"""Makes the stream of a maker, on histories, that has not been read yet."""


class SharedDecoderCache:
    """What the robots of a process have read of one maker's stream.

    Parameters
    ----------
    maker : int
        Whose it is.
    new : New
        Makes it.
    """

    def __init__(self, maker: int, new: New) -> None:
        self._maker = maker
        self._new = new
        self._readings: list[Stream] = []
        """The one that was needed last comes last."""
        self._told: dict[tuple[bytes, bytes], list[DecodedUpdate]] = {}
        """What units say, by the key of the one before, and by their bytes."""

    def decode(self, message: bytes, histories: Sequence[History]) -> DecodedUpdate | None:
        """As `Stream.decode`, for who has read what is in `histories`; its maker's goes on."""
        key = _key(histories[self._maker])
        known = self._told.setdefault((key, message), [])
        for told in known:
            if any(len(histories[base.robot]) < base.end for base in told.bases):
                return None
            if all(
                histories[base.robot].between(base.end - 1, base.end)[0].key == base.key
                for base in told.bases
            ):
                histories[self._maker].append(told)
                return told
        reading = self._reading(key, histories)
        reading.histories = histories
        unit = reading.decode(message)
        if unit is not None:
            reading.settle()
            known.append(unit)
        return unit

    def _reading(self, key: bytes, histories: Sequence[History]) -> Stream:
        """A reading that is as far as the maker's history."""
        for place, reading in enumerate(self._readings):
            if reading.key == key:
                self._readings.append(self._readings.pop(place))
                return reading
        history = History()
        reading = self._new(self._maker, [*histories[: self._maker], history, *histories[self._maker + 1 :]])
        for unit in histories[self._maker].between(0, len(histories[self._maker])):
            reading.decode(unit.message)
            reading.settle()
        self._readings = [*self._readings[1 - MOST :], reading]
        return reading


class CachedReader:
    """One robot's end of a shelf; it stands where a `Stream` does for who only reads, and forgets nothing."""

    def __init__(self, shelf: SharedDecoderCache, maker: int, histories: Sequence[History]) -> None:
        self._shelf = shelf
        self._histories = histories
        self._maker = maker

    @property
    def pose(self) -> tuple[int, int] | None:
        """Where the maker looked from last, as (x, y)."""
        last = self._histories[self._maker].last
        return last.pose if last is not None else None

    def decode(self, message: bytes) -> DecodedUpdate | None:
        """As `Stream.decode`."""
        return self._shelf.decode(message, self._histories)

    def undo(self) -> None:
        """Go back to before the last unit: all that there is to that is in its history, and left to the caller."""

    def settle(self) -> None:
        """The last unit stands."""


def _key(history: History) -> bytes:
    return history.last.key if history.last is not None else b""
