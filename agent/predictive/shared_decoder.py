"""Share decoded updates among the robots of a process.

The decoder of a log holds a grid of the whole map. With a process per robot that is one grid per teammate; with
hundreds of robots in one process it would be one per pair of robots. The content of an update follows from the updates
before it (`agent.predictive.stream`), and its author knows it. So the author adds each update to the cache. Other
robots reuse it if they hold the same updates before it and the same dependencies, which their keys show. An update that
its author did not write is decoded: the first robot that reaches it continues a decoder of the same log, or begins one
at the beginning of the log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from agent.predictive.history import DecodedUpdate, History
from agent.predictive.stream import Stream
from protocol.grid import Cell

MAX_DECODERS = 4
"""Decoders kept per log; a dropped one that is needed again restarts from the beginning of the log."""

MakeStream = Callable[[int, Sequence[History]], Stream]
"""Make the decoder of a map's log, from its map ID and the histories of all maps, at the beginning of the log."""


class SharedDecoderCache:
    """Decoded updates of one log, shared by the robots of a process; `make_stream` makes a decoder."""

    def __init__(self, map_id: int, make_stream: MakeStream) -> None:
        self._map_id = map_id
        self._make_stream = make_stream
        self._decoders: list[Stream] = []
        """The most recently used one is last."""
        self._decoded: dict[tuple[bytes, bytes], list[DecodedUpdate]] = {}
        """Updates by the key of the update before and by message, one for each set of dependencies."""

    def add(self, key: bytes, update: DecodedUpdate) -> None:
        """Add an update that its author has encoded, given the key of the update before; empty for the first."""
        self._decoded.setdefault((key, update.message), []).append(update)

    def decode(self, message: bytes, histories: Sequence[History]) -> DecodedUpdate | None:
        """Decode a message as `Stream.decode` does, for a robot with these histories."""
        key = histories[self._map_id].last_key
        for update in self._decoded.get((key, message), ()):
            keys = [histories[base.map_id].key_before(base.end) for base in update.bases]
            if None in keys:
                return None
            if keys == [base.key for base in update.bases]:
                histories[self._map_id].append(update)
                return update
        decoder = self._decoder(histories)
        decoder.histories = histories
        new = decoder.decode(message)
        if new is not None:
            decoder.commit()
            self.add(key, new)
        return new

    def _decoder(self, histories: Sequence[History]) -> Stream:
        """Return a decoder that has decoded exactly the updates of the map's history."""
        others = [*histories[: self._map_id], History(), *histories[self._map_id + 1 :]]
        updates = histories[self._map_id].between(0, len(histories[self._map_id]))
        decoded = {b"": 0} | {update.key: number for number, update in enumerate(updates, 1)}
        known = [decoder for decoder in self._decoders if decoder.key in decoded]
        decoder = max(known, key=lambda each: decoded[each.key], default=None)
        if decoder is None:
            decoder = self._make_stream(self._map_id, others)
        else:
            self._decoders.remove(decoder)
        decoder.histories = others
        for update in updates[decoded[decoder.key] :]:
            decoder.decode(update.message)
            decoder.commit()
        self._decoders = [*self._decoders[1 - MAX_DECODERS :], decoder]
        return decoder


class CachedReader:
    """One robot's view of a `SharedDecoderCache`, with the decoding interface of a `Stream`."""

    def __init__(self, cache: SharedDecoderCache, map_id: int, histories: Sequence[History]) -> None:
        self._cache = cache
        self._histories = histories
        self._map_id = map_id

    @property
    def pose(self) -> Cell | None:
        """Cell (x, y) of the author's last scan; None before the first."""
        last = self._histories[self._map_id].last
        return last.pose if last is not None else None

    def decode(self, message: bytes) -> DecodedUpdate | None:
        """Decode a message as `Stream.decode` does."""
        return self._cache.decode(message, self._histories)

    def rollback(self) -> None:
        """Do nothing: the state is the history, from which the caller removes the update."""

    def commit(self) -> None:
        """Do nothing: the shared decoder has made the update final."""
