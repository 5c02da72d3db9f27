"""The `predictive` encoding: what receivers cannot predict from the map that they hold (ours; docs/predictive.md).

Of exact lasers, updates contain scans: a receiver that holds the same map predicts a scan by ray casting, so the sender
transmits the prediction errors alone. Of noisy lasers, they contain tiles of the grid in which receivers' copies lie
outside a tolerance (`agent.predictive`).

A robot collects changes for a few steps. Then it encodes one update of all cells that its log does not contain yet, or
with base `team` no log that it has received. If no teammate has received the last update by the next step, the robot
retracts it and encodes a new one: meanwhile, teammates may have reported some of its cells.

If entries of another log were dropped because their author did not write them (`agent.replication.replica`), updates
that depend on them are wrong. The robot then withdraws those of its own: an update without content withdraws the last
one that has not been withdrawn. Teammates decode the remaining updates again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from agent.encodings.base import NO_SENDER, Dependency
from agent.encodings.predictive_streams import make_author, make_stream
from agent.encodings.received_grid import GridEncoding
from agent.encodings.update_log import UpdateLog
from agent.encodings.update_packets import UpdateLimits
from agent.predictive.history import DecodedUpdate, History
from agent.predictive.shared_decoder import CachedReader, SharedDecoderCache
from agent.predictive.stream import Stream
from agent.settings import Settings
from protocol.errors import ProtocolError
from protocol.grid import Cell, Grid
from protocol.packet_codec import encode
from protocol.packets import UPDATE_NUMBERS, Update
from protocol.range_scans import RangeScan
from protocol.scans import GridChange, Scan

RETURN_STEPS = 8
"""Steps for which a robot waits until dropped updates on which its own ones depend have arrived again."""


class PredictiveEncoding(GridEncoding):
    """Encodes this robot's updates, and decodes those of all other logs."""

    name = "predictive"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._own_map = settings.own_map
        self._limits = UpdateLimits.of(settings)
        self.update_steps = self._limits.full_steps
        self._histories = [History() for _ in range(settings.maps)]
        scratch = np.empty((2 * settings.height * settings.width, 2), np.int32)
        self._stream = partial(make_stream, settings, self._limits, scratch)
        """Makes the encoder or decoder of a log, at its beginning."""
        self._author = make_author(settings, self._limits, self._stream(settings.own_map, self._histories))
        self._streams: dict[int, Stream | CachedReader] = {settings.own_map: self._author.stream}
        """Encoder or decoder of each log of which an update exists."""
        self._caches: dict[int, SharedDecoderCache] | None = None
        """Decoded updates by map ID, if the robots of this process share them."""
        self._last: DecodedUpdate | None = None
        self._logs = [UpdateLog() for _ in range(settings.maps)]
        """By map ID."""
        self._bases_changed = 0
        """Steps since updates on which this robot's own ones may depend were dropped; 0: none, or all are there."""
        self._dependencies: list[list[Dependency]] = [[] for _ in range(settings.maps)]
        self._step = 0
        """The step in which entries arrived last."""
        self._undecoded: set[int] = set()
        """Maps with complete updates that await decoding."""

    def use_shared_cache(self, cache: dict[str, Any]) -> None:
        """Share decoded updates with the robots of this process."""
        self._caches = cache.setdefault(self.name, {})

    def _decoder(self, map_id: int) -> Stream | CachedReader:
        """Return the decoder of a log; make it for the first update."""
        if map_id not in self._streams:
            if self._caches is None:
                self._streams[map_id] = self._stream(map_id, self._histories)
            else:
                cache = self._cache(self._caches, map_id)
                self._streams[map_id] = CachedReader(cache, map_id, self._histories)
        return self._streams[map_id]

    def _cache(self, caches: dict[int, SharedDecoderCache], map_id: int) -> SharedDecoderCache:
        """Return the cache of a log; make it for the first robot."""
        if map_id not in caches:
            caches[map_id] = SharedDecoderCache(map_id, self._stream)
        return caches[map_id]

    def encode_changes(
        self, own: Grid, scan: Scan | RangeScan, change: GridChange, *, delivered: bool
    ) -> list[bytes]:
        """Encode an update, if teammates hold the last one and enough cells have changed.

        Before, withdraw updates that depend on other updates than those that their authors wrote. The first scan is
        encoded at once, although the robot does not know yet who is in range.
        """
        self.own_changes.add(own, change)
        packets = self._withdraw_invalid()
        author = self._author
        is_first = not (author.has_changes or self._logs[self._own_map].packets)
        author.add(scan, change)
        if not author.has_changes:
            return packets
        if delivered or not self.is_settled:
            self.retractable = 0
        may_send = (delivered or is_first) and not self._bases_changed
        if may_send and author.is_due(own, self.log_odds, self.received):
            packets += self._encode_pending(own)
        return packets

    def _encode_pending(self, own: Grid) -> list[bytes]:
        """Encode updates up to the budget of a step; the rest stays pending."""
        map_id = self.settings.own_map
        author, log, limits = self._author, self._logs[map_id], self._limits
        doubted = self.doubted
        maps = range(self.settings.maps) if doubted else ()
        author.stream.avoided = {each for each in maps if self.settings.author_of(each) in doubted}
        packets: list[bytes] = []
        size = updates = 0
        while author.has_changes and size < limits.step_bytes:
            key = self._histories[map_id].last_key
            encoded = author.encode(own, self.log_odds, limits.step_bytes - size)
            if encoded is None:
                break
            message, self._last = encoded
            if self._caches is not None:
                self._cache(self._caches, map_id).add(key, self._last)
            self.urgency = author.urgency
            self._count_votes(self._last)
            packets += limits.packets(message, log.updates, log.packets + len(packets))
            log.ends.append(log.packets + len(packets))
            log.updates += 1
            self._note_dependency(map_id, self._last)
            updates += 1
            size += len(message)
            if limits.is_narrow:  # several updates of a step could not be retracted
                break
        log.packets += len(packets)
        self.retractable = len(packets) if updates == 1 else 0
        self.is_settled = author.is_full
        return packets

    def has_news(self, own: Grid, *, delivered: bool) -> bool:
        """Return whether teammates lack tiles that would change their plans."""
        return self._author.has_news(own, self.log_odds, self.received, delivered=delivered)

    def retract_last(self) -> None:
        """Remove the last update from the log; its changes become pending again."""
        assert self._last is not None
        map_id = self.settings.own_map
        self._author.retract()
        self._histories[map_id].pop()
        log, dependencies = self._logs[map_id], self._dependencies[map_id]
        log.packets -= self.retractable
        log.updates -= 1
        end = log.ends.pop()
        if dependencies and dependencies[-1].end == end:
            dependencies.pop()
        self._count_votes(replace(self._last, states=self._last.before))
        self._last = None
        super().retract_last()

    def _withdraw_invalid(self) -> list[bytes]:
        """Withdraw this robot's updates from the first one on whose bases are not there; return the packets for that.

        Dropped updates usually arrive again within `RETURN_STEPS` steps, and then nothing is wrong.
        """
        if not self._bases_changed:
            return []
        map_id, log = self.settings.own_map, self._logs[self.settings.own_map]
        updates = self._histories[map_id].between(0, len(self._histories[map_id]))
        valid = next((at for at, each in enumerate(updates) if not self._has_bases(each)), len(updates))
        if valid < len(updates) and self._bases_changed < RETURN_STEPS:
            self._bases_changed += 1
            return []
        self._bases_changed = 0
        if valid == len(updates):
            return []
        withdrawn = updates[valid:]
        self._histories[map_id] = History()
        stream = self._streams[map_id] = self._stream(map_id, self._histories)
        for update in updates[:valid]:
            stream.decode(update.message)
            stream.commit()
        self._author.restart(stream, withdrawn)
        del log.ends[valid:]
        end = log.ends[-1] if log.ends else 0
        self._dependencies[map_id] = [each for each in self._dependencies[map_id] if each.end <= end]
        self._last, self.retractable = None, 0
        packets = [
            encode([Update((log.updates + each) % UPDATE_NUMBERS, b"")]) for each in range(len(withdrawn))
        ]
        log.updates += len(packets)
        log.packets += len(packets)
        self._decode_again()
        self._decode_waiting(self._step, NO_SENDER)
        self._bases_changed = 0
        return packets

    def _has_bases(self, update: DecodedUpdate) -> bool:
        """Return whether all updates on which one depends are decoded, and are those that its author had."""
        return all(self._histories[base.map_id].key_before(base.end) == base.key for base in update.bases)

    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Reassemble updates, and decode those of all logs whose dependencies are there.

        With digests, an update that cannot be decoded is refused only once. If it arrives again, its author has
        probably received other entries of the maps on which it depends. It waits until the author withdraws it.
        """
        log, history = self._logs[map_id], self._histories[map_id]
        if log.error and not self.settings.replication.digests:
            raise ProtocolError(Update.name, 0, log.error)
        self._step = step
        reading = log.read(frame)
        kept, withdraws = reading.kept, reading.kept < len(log.messages)
        if kept <= len(history):
            log.error = ""
        before = log.take(reading)
        if sender != NO_SENDER and len(history) == kept and not withdraws:
            try:
                self._decode_next(map_id, step, sender)
            except ProtocolError as error:
                message = log.messages[kept]
                if not (self.settings.replication.digests and message == log.refused):
                    log.refused = message
                    log.take(before)
                    raise
                log.error = error.reason
        if withdraws and len(history) > kept:
            self._decode_again()
        elif len(log.messages) > len(history) and not log.error:
            self._undecoded.add(map_id)
        if self._undecoded:
            self._decode_waiting(step, sender)

    def forget_received(self) -> None:
        """Forget everything decoded from the logs of others."""
        self._logs = [
            log if map_id == self.settings.own_map else UpdateLog() for map_id, log in enumerate(self._logs)
        ]
        self._decode_again()

    def _decode_again(self) -> None:
        """Forget everything decoded from the logs of others, and let their updates await decoding."""
        own = self.settings.own_map
        self._reachability.forget()
        super().forget_received()
        for map_id, log in enumerate(self._logs):
            if map_id != own:
                self._histories[map_id] = History()
                self._streams.pop(map_id, None)
                self._dependencies[map_id] = []
                log.error = ""
                if log.messages:
                    self._undecoded.add(map_id)
        for update in self._histories[own].between(0, len(self._histories[own])):
            self._count_votes(update)
        self._bases_changed, self.is_settled = 1, False

    def _decode_waiting(self, step: int, sender: int) -> None:
        """Decode all updates whose dependencies are there; a malformed update ends its log."""
        progress = True
        while progress:
            progress = False
            for map_id in sorted(self._undecoded):
                try:
                    while self._decode_next(map_id, step, sender):
                        progress = True
                except ProtocolError as error:
                    self._logs[map_id].error = error.reason
                    self._undecoded.discard(map_id)
                if len(self._histories[map_id]) == len(self._logs[map_id].messages):
                    self._undecoded.discard(map_id)

    def _decode_next(self, map_id: int, step: int, sender: int) -> bool:
        """Decode the next update of a log; return whether there was one, and its dependencies are there."""
        messages, number = self._logs[map_id].messages, len(self._histories[map_id])
        update = self._decode(map_id, messages[number], step, sender) if number < len(messages) else None
        if update is not None:
            self._count_votes(update, map_id)
            self.is_settled = False
        return update is not None

    def _decode(self, map_id: int, message: bytes, step: int, sender: int) -> DecodedUpdate | None:
        """Decode an update and check its area; None if a dependency is missing."""
        stream = self._decoder(map_id)
        update = stream.decode(message)
        if update is None:
            return None
        try:
            self._reachability.check(map_id, update.box, step=step, sender=sender)
        except ProtocolError:
            stream.rollback()
            self._histories[map_id].pop()
            raise
        self._note_dependency(map_id, update)
        stream.commit()
        return update

    def _note_dependency(self, map_id: int, update: DecodedUpdate) -> None:
        """Note the logs on which the last update of a log depends.

        An update of this robot is final as soon as a received update claims to depend on it, be the claim true or
        forged: retracting it would remove a state on which the decoder of that log relies.
        """
        if not update.bases:
            return
        logs = self._logs
        ends, number = logs[map_id].ends, len(self._histories[map_id]) - 1
        requires = tuple([(base.map_id, logs[base.map_id].ends[base.end - 1]) for base in update.bases])
        first = ends[number - 1] if number else 0
        self._dependencies[map_id].append(Dependency(first, ends[number], requires))
        if (self._own_map, logs[self._own_map].packets) in requires:
            self.retractable = 0

    def dependencies(self, map_id: int) -> Sequence[Dependency]:
        """Dependencies of the decoded updates of a log, where they exceed those of the update before."""
        return self._dependencies[map_id]

    def scan_cell(self, map_id: int) -> Cell | None:
        """Cell (x, y) of the last scan in a log."""
        return self._streams[map_id].pose if map_id in self._streams else None

    def _count_votes(self, update: DecodedUpdate, map_id: int | None = None) -> None:
        """Count the reports of an update of a map; default: this robot's."""
        robot = self.settings.robot if map_id is None else self.settings.author_of(map_id)
        self.votes.count(robot, update.places, update.states)
        if len(update.places):
            self.received_changed(update.box)
