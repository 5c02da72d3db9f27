"""The `predictive` encoding: scan positions and prediction errors (ours; docs/predictive.md).

It is as exact as raw scans, and hundreds of times shorter. A receiver that holds the same map predicts a scan by ray
casting, so the sender transmits the prediction errors alone (`agent.predictive`).

A robot collects changes until there are a few new cells, or a few steps have passed. Then it encodes one update of all
cells that its log does not contain yet, or with base `team` no log that it has received. If no teammate has received
the last update by the next step, the robot retracts it and encodes a new one: meanwhile, teammates may have reported
some of its cells.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from agent.encodings.base import Dependency
from agent.encodings.options import PredictiveOptions
from agent.encodings.received_grid import GridEncoding
from agent.predictive.history import DecodedUpdate, History
from agent.predictive.scan_updates import REPORTED
from agent.predictive.shared_decoder import CachedReader, SharedDecoderCache
from agent.predictive.stream import Stream
from agent.settings import Settings
from protocol.boxes import Box, bounding_box
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, Grid, ray_table
from protocol.kernels import kernel
from protocol.packets import (
    LAST_UPDATE_DATA,
    SHORT_HEAD,
    UPDATE_DATA,
    UPDATE_NUMBERS,
    Update,
    decode_kind,
    encode,
)
from protocol.scans import Change, Scan

ENOUGH_CELLS = 14
"""New cells that are sent at once; fewer may wait (`ENOUGH_STEPS`)."""

ENOUGH_STEPS = 4
"""Steps for which fewer new cells wait at most, if bandwidth is scarce."""

FAIR_SHARE = 28
"""Bytes per robot and step for which they wait one step; with half of it they wait two steps, and so on."""

PACKETS_A_STEP = 3
"""Packets are short enough that the budget of one step holds this many: a packet that does not fit into the rest of
a budget leaves that rest unused."""


@dataclass
class _Pending:
    """Input of the next update: cells from which the robot scanned, and where its grid has changed since the last."""

    poses: list[tuple[int, int]] = field(default_factory=list)
    boxes: list[Box] = field(default_factory=list)
    steps: int = 0


@dataclass
class _Incoming:
    """Updates of one log as they arrive: fragments of the next one, and complete ones that await decoding."""

    fragments: bytes = b""
    complete: list[bytes] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)
    """Packets up to the end of each complete update, from the beginning of the log."""
    packets: int = 0
    error: str = ""
    """Why an update could not be decoded; none behind it can be decoded then."""


@dataclass(frozen=True)
class _Limits:
    """Sizes and waiting times that depend on the bandwidth."""

    packet_bytes: int
    """Content of the last packet of an update, in bytes."""
    step_bytes: float
    """Bytes after which a step encodes no more: changes that wait can still be merged with later ones."""
    wait_steps: int
    """Steps for which few new cells wait (`ENOUGH_STEPS`)."""

    @classmethod
    def of(cls, settings: Settings) -> _Limits:
        """Derive the limits from the team's budget and the frame size."""
        size, step_bytes, wait_steps = LAST_UPDATE_DATA, math.inf, 1
        if (bandwidth := settings.bandwidth.limit) is not None:
            size = bandwidth // PACKETS_A_STEP - SHORT_HEAD
            step_bytes = max(bandwidth, 1)
            scarcity = FAIR_SHARE * settings.robots / max(bandwidth, 1)
            wait_steps = min(max(math.ceil(scarcity), 1), ENOUGH_STEPS)
        if settings.frame_bytes is not None:
            size = min(size, settings.frame_bytes - SHORT_HEAD)
        return cls(min(max(size, UPDATE_DATA), LAST_UPDATE_DATA), step_bytes, wait_steps)


class PredictiveEncoding(GridEncoding):
    """Encodes this robot's updates, and decodes those of all other logs."""

    name = "predictive"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._options = PredictiveOptions(**settings.predictive)
        self._histories = [History() for _ in range(settings.maps)]
        self._scratch = np.empty((2 * settings.height * settings.width, 2), np.int32)
        self._own = self._stream(settings.own_map, self._histories)
        self._streams: dict[int, Stream | CachedReader] = {settings.own_map: self._own}
        """Encoder or decoder of each log of which an update exists."""
        self._caches: dict[int, SharedDecoderCache] | None = None
        """Decoders by map ID, if the robots of this process share them."""
        self._needed = np.zeros((settings.maps, settings.maps), np.int64)
        """`needed[a, b]`: first update of log b that log a may still depend on."""
        self._limits = _Limits.of(settings)
        self._pending = _Pending()
        self._encoded = _Pending()
        """Input of the last update, to restore `_pending` if the update is retracted."""
        self._last: DecodedUpdate | None = None
        self._logged = 0
        """Packets of this robot's log."""
        self._incoming = [_Incoming() for _ in range(settings.maps)]
        """By map ID; for this robot's own map only `ends` is used."""
        self._dependencies: list[list[Dependency]] = [[] for _ in range(settings.maps)]
        self._undecoded: set[int] = set()
        """Maps with complete updates that await decoding."""

    def use_shared_cache(self, cache: dict[str, Any]) -> None:
        """Decode each log once for all robots of this process."""
        self._caches = cache.setdefault(self.name, {})

    def _stream(self, map_id: int, histories: Sequence[History]) -> Stream:
        """Make the encoder or decoder of a log, at its beginning."""
        settings = self.settings
        return Stream(
            map_id,
            np.zeros((settings.height, settings.width), np.uint8),
            ray_table(settings.ranges_cells[settings.author_of(map_id)], settings.beams),
            histories,
            self._scratch,
            team=self._options.base == "team",
            base_maps=settings.robots,
        )

    def _decoder(self, map_id: int) -> Stream | CachedReader:
        """Return the decoder of a log; make it for the first update."""
        if map_id not in self._streams:
            if self._caches is None:
                self._streams[map_id] = self._stream(map_id, self._histories)
            else:
                cache = self._caches.setdefault(map_id, SharedDecoderCache(map_id, self._stream))
                self._streams[map_id] = CachedReader(cache, map_id, self._histories)
        return self._streams[map_id]

    def encode_changes(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Encode an update, if teammates hold the last one and enough cells have changed."""
        self.own_changes.add(own, change)
        pending = self._pending
        if change.cells:
            pending.poses.append((scan.x, scan.y))
            pending.boxes.append(change.box)
        if not pending.boxes:
            return []
        pending.steps += 1
        self.retractable = 0
        if not delivered:
            return []
        new_cells = int(_unreported(self.received, self._own.grid, own, *bounding_box(pending.boxes)))
        if 0 < new_cells < ENOUGH_CELLS and pending.steps < self._limits.wait_steps:
            return []
        if not new_cells:
            self._pending = _Pending()
            return []
        return self._encode_pending(own)

    def _encode_pending(self, own: Grid) -> list[bytes]:
        """Encode updates up to the budget of a step; the rest stays pending."""
        map_id = self.settings.own_map
        stream, history = self._own, self._histories[map_id]
        stream.avoided = {
            each for each in range(self.settings.maps) if self.settings.author_of(each) in self.doubted
        }
        packets: list[bytes] = []
        size = updates = 0
        while self._pending.poses and size < self._limits.step_bytes:
            pending, number = self._pending, len(history)
            box = bounding_box(pending.boxes)
            update = stream.encode(own, pending.poses, box, most=self._limits.step_bytes - size)
            self._pending = _Pending()
            if update is None:
                break
            message, self._last, scans = update
            self._encoded = _Pending(pending.poses[:scans], [box], pending.steps)
            if scans < len(pending.poses):
                self._pending = _Pending(pending.poses[scans:], [box], pending.steps)
            self._count_votes(self._last)
            packets += fragments(message, number, self._limits.packet_bytes)
            self._incoming[map_id].ends.append(self._logged + len(packets))
            self._note_dependency(map_id, self._last)
            updates += 1
            size += len(message)
        self._logged += len(packets)
        self.retractable = len(packets) if updates == 1 else 0
        return packets

    def retract_last(self) -> None:
        """Remove the last update from the log; its changes become pending again."""
        assert self._last is not None
        map_id = self.settings.own_map
        self._own.rollback()
        self._histories[map_id].pop()
        self._logged -= self.retractable
        ends, dependencies = self._incoming[map_id].ends, self._dependencies[map_id]
        end = ends.pop()
        if dependencies and dependencies[-1].end == end:
            dependencies.pop()
        self._count_votes(replace(self._last, states=self._last.before))
        encoded, pending = self._encoded, self._pending
        self._pending = _Pending(
            encoded.poses + pending.poses, encoded.boxes + pending.boxes, encoded.steps + pending.steps
        )
        self._last = None
        super().retract_last()

    def apply(self, map_id: int, frame: bytes, *, step: int, sender: int) -> None:
        """Reassemble updates, and decode those of all logs whose dependencies are there."""
        incoming = self._incoming[map_id]
        if incoming.error:
            raise ProtocolError(Update.name, 0, incoming.error)
        packets = decode_kind(frame, Update)
        rest, complete = incoming.fragments, []
        ends: list[int] = []
        for count, packet in enumerate(packets, incoming.packets + 1):
            number, rest = packet.number, rest + packet.data
            if number is not None:
                expected = (len(incoming.ends) + len(ends)) % UPDATE_NUMBERS
                if number != expected:
                    raise ProtocolError(Update.name, 0, f"update {number}, expected {expected}")
                complete.append(rest)
                ends.append(count)
                rest = b""
        before = len(incoming.ends)
        incoming.ends += ends
        if complete and not incoming.complete:
            try:
                first = self._decode(map_id, complete[0], step, sender)
            except ProtocolError:
                del incoming.ends[before:]
                raise
            if first is not None:
                self._count_votes(first, map_id)
                complete = complete[1:]
        incoming.fragments, incoming.packets = rest, incoming.packets + len(packets)
        incoming.complete += complete
        if incoming.complete:
            self._undecoded.add(map_id)
        if self._undecoded:
            self._decode_waiting(step, sender)

    def _decode_waiting(self, step: int, sender: int) -> None:
        """Decode all updates whose dependencies are there; a malformed update ends its log."""
        progress = True
        while progress:
            progress = False
            for map_id in sorted(self._undecoded):
                incoming = self._incoming[map_id]
                while incoming.complete:
                    try:
                        update = self._decode(map_id, incoming.complete[0], step, sender)
                    except ProtocolError as error:
                        incoming.error = error.reason
                        incoming.complete.clear()
                        break
                    if update is None:
                        break
                    self._count_votes(update, map_id)
                    del incoming.complete[0]
                    progress = True
                if not incoming.complete:
                    self._undecoded.discard(map_id)

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
        if isinstance(stream, Stream):
            self._needed[map_id] = stream.first_needed()
        return update

    def _note_dependency(self, map_id: int, update: DecodedUpdate) -> None:
        """Note the logs on which the last update of a log depends.

        An update of this robot is final as soon as a received update claims to depend on it, be the claim true or
        forged: retracting it would remove a state on which the decoder of that log relies.
        """
        ends, number = self._incoming[map_id].ends, len(self._histories[map_id]) - 1
        requires = tuple(
            (base.map_id, self._incoming[base.map_id].ends[base.end - 1]) for base in update.bases
        )
        if requires:
            first = ends[number - 1] if number else 0
            self._dependencies[map_id].append(Dependency(first, ends[number], requires))
        if (self.settings.own_map, self._logged) in requires:
            self.retractable = 0

    def dependencies(self, map_id: int) -> Sequence[Dependency]:
        """Dependencies of the decoded updates of a log, where they exceed those of the update before."""
        return self._dependencies[map_id]

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Return the planning grid as `GridEncoding`; forget updates on which no log can depend any more."""
        if self._caches is None and len(self._histories) > 1:
            self._needed[self.settings.own_map] = self._own.first_needed()
            np.fill_diagonal(self._needed, np.iinfo(np.int64).max)
            for history, needed in zip(self._histories, self._needed.min(axis=0).tolist(), strict=True):
                history.forget(needed)
        return super().merge(own, peers)

    def scan_cell(self, map_id: int) -> tuple[int, int] | None:
        """Cell (x, y) of the last scan in a log."""
        return self._streams[map_id].pose if map_id in self._streams else None

    def _count_votes(self, update: DecodedUpdate, map_id: int | None = None) -> None:
        """Count the reports of an update of a map; default: this robot's."""
        robot = self.settings.robot if map_id is None else self.settings.author_of(map_id)
        self.votes.count(robot, update.places, update.states)
        if len(update.places):
            self.received_changed(update.box)


def fragments(message: bytes, number: int, most: int) -> list[bytes]:
    """Split an update into packets; the last packet has at most `most` bytes of content."""
    packets = []
    while len(message) > most:
        packets.append(encode([Update(None, message[:UPDATE_DATA])]))
        message = message[UPDATE_DATA:]
    return [*packets, encode([Update(number % UPDATE_NUMBERS, message)])]


@kernel
def _unreported(received: Grid, logged: Grid, own: Grid, x0: int, y0: int, x1: int, y1: int) -> int:
    """Count the cells of a box whose state in `own` neither this robot's log nor a received log reports."""
    count = 0
    for y in range(y0, y1):
        for x in range(x0, x1):
            truth = own[y, x]
            if truth == UNKNOWN:
                count += logged[y, x] & REPORTED != 0
            else:
                count += received[y, x] != truth and logged[y, x] != truth | REPORTED
    return count
