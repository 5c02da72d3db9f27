"""The predictive exchange: a robot says from where it looked, and what was surprising (docs/predictive.md; ours, of no paper).

It is as exact as raw scans, and hundreds of times shorter: who holds the same map casts the scan again
(`agent.predictive`). A robot waits until there are a few new cells, or a few steps have gone by, then tells in one unit all
that has not been told: by itself, or with base `team` by anybody. A unit of which nobody has heard anything yet is
written anew in the next step, for by then others have told some of it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.encodings.base import MapEncoding
from agent.encodings.predictive_options import PredictiveOptions
from agent.encodings.reachability_check import Reception
from agent.encodings.received_grid import Heard
from agent.predictive.history import DecodedUpdate, History
from agent.predictive.scan_updates import TOLD
from agent.predictive.shared_decoder import CachedReader, SharedDecoderCache
from agent.predictive.stream import Stream
from agent.replication.log import Dependency
from agent.replication.map_ids import MapId
from agent.settings import Settings
from protocol import packet_index
from protocol.boxes import Box, bounding_box
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.kernels import kernel
from protocol.packets import LAST_UPDATE_DATA, SHORT_HEAD, UPDATE_DATA, UPDATE_NUMBERS, Update, encode, look
from protocol.scans import Change, Scan

ENOUGH_CELLS = 14
"""New cells for which a unit is worth its head."""

ENOUGH_STEPS = 4
"""Steps that fewer new cells wait at most, on a narrow medium."""

FAIR_SHARE = 28
"""Bytes a robot and step with which they wait for one step, with half of it for two, and so on."""


PACKETS_A_STEP = 3
"""Packets that a step's budget is to have room for at least, where it has room for the shortest: for what finds no
room at the end of a step is lost."""


@dataclass
class _Waiting:
    """What the next unit is to tell of: where the robot looked from, and where its grid has changed."""

    poses: list[tuple[int, int]] = field(default_factory=list)
    boxes: list[Box] = field(default_factory=list)
    steps: int = 0


@dataclass
class _Coming:
    """Units of a map as they come: pieces of the next one, and whole ones that have not been read yet."""

    pieces: bytes = b""
    whole: list[bytes] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)
    """Packets up to the end of each unit that has come whole."""
    packets: int = 0
    broken: str = ""
    """Why one of them could not be read; then none behind it can."""


class PredictiveEncoding(MapEncoding):
    """One robot's stream, and all others' as far as they came."""

    name = "predictive"

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        shape = settings.height, settings.width
        self._options = PredictiveOptions(**settings.predictive)
        self._histories = [History() for _ in range(settings.maps)]
        self._scratch = np.empty((2 * settings.height * settings.width, 2), np.int32)
        self._own = self._stream(settings.own_map, self._histories)
        self._streams: dict[int, Stream | CachedReader] = {settings.own_map: self._own}
        """Those of which something has come."""
        self._shelves: dict[int, SharedDecoderCache] | None = None
        """Where streams are read, if others in this process follow them as well."""
        self._needed = np.zeros((settings.maps, settings.maps), np.int64)
        """From which unit of each stream on a stream may still ask for what it says."""
        self._told_so: NDArray[np.uint16] = np.zeros((2, *shape), np.uint16)
        """How many makers tell of each cell that it is free, and that it is a wall."""
        self._heard = Heard(shape)
        room = (
            LAST_UPDATE_DATA
            if settings.bandwidth is None
            else int(settings.bandwidth) // PACKETS_A_STEP - SHORT_HEAD
        )
        if settings.frame_bytes is not None:
            room = min(room, settings.frame_bytes - SHORT_HEAD)
        self._most = min(max(room, UPDATE_DATA), LAST_UPDATE_DATA)
        self._patience = 1
        if settings.bandwidth is not None:
            scarce = FAIR_SHARE * settings.robots / max(settings.bandwidth, 1)
            self._patience = min(max(math.ceil(scarce), 1), ENOUGH_STEPS)
        self._enough = math.inf if settings.bandwidth is None else max(int(settings.bandwidth), 1)
        """Bytes behind which no more is told in a step: what nobody has room for can still be told otherwise."""
        self._waiting = _Waiting()
        self._said = _Waiting()
        """What the last unit told of."""
        self._last: DecodedUpdate | None = None
        self._logged = 0
        """Packets of one's own log."""
        self._coming = [_Coming() for _ in range(settings.maps)]
        """Of one's own map what has been written."""
        self._bases: list[list[Dependency]] = [[] for _ in range(settings.maps)]
        self._unread: set[int] = set()
        """Makers of which whole units have come that have not been read."""

    def share(self, common: dict[str, Any]) -> None:
        """Read streams together with the other robots of this process."""
        self._shelves = common.setdefault(self.name, {})

    def _stream(self, maker: int, histories: Sequence[History]) -> Stream:
        """A stream of which nothing is known yet."""
        settings = self.settings
        return Stream(
            maker,
            np.zeros((settings.height, settings.width), np.uint8),
            ray_table(settings.ranges_cells[self.maps[maker].robot], settings.beams),
            histories,
            self._scratch,
            team=self._options.base == "team",
            makers=settings.robots,
        )

    def _follow(self, maker: int) -> Stream | CachedReader:
        """A maker's stream."""
        if maker not in self._streams:
            if self._shelves is None:
                self._streams[maker] = self._stream(maker, self._histories)
            else:
                shelf = self._shelves.setdefault(maker, SharedDecoderCache(maker, self._stream))
                self._streams[maker] = CachedReader(shelf, maker, self._histories)
        return self._streams[maker]

    def record(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Write a unit, if the one before has been said and there is enough to tell."""
        self._heard.seen(own, change)
        waiting = self._waiting
        if change.cells:
            waiting.poses.append((scan.x, scan.y))
            waiting.boxes.append(change.box)
        if not waiting.boxes:
            return []
        waiting.steps += 1
        self.revisable = 0
        if not delivered:
            return []
        news = int(_news(self._heard.grid, self._own.grid, own, *bounding_box(waiting.boxes)))
        if 0 < news < ENOUGH_CELLS and waiting.steps < self._patience:
            return []
        if not news:
            self._waiting = _Waiting()
            return []
        return self._tell(own)

    def _tell(self, own: Grid) -> list[bytes]:
        """Write units as far as a step has room for them; what is left is told in the next ones."""
        maker = self.settings.own_map
        stream, history = self._own, self._histories[maker]
        packets: list[bytes] = []
        size = units = 0
        while self._waiting.poses and size < self._enough:
            waiting, number = self._waiting, len(history)
            box = bounding_box(waiting.boxes)
            unit = stream.encode(own, waiting.poses, box, most=self._enough - size)
            self._waiting = _Waiting()
            if unit is None:
                break
            message, self._last, looks = unit
            self._said = _Waiting(waiting.poses[:looks], [box], waiting.steps)
            if looks < len(waiting.poses):
                self._waiting = _Waiting(waiting.poses[looks:], [box], waiting.steps)
            self._lay(self._last)
            packets += pieces(message, number, self._most)
            self._coming[maker].ends.append(self._logged + len(packets))
            self._note_basis(maker, self._last)
            units += 1
            size += len(message)
        self._logged += len(packets)
        self.revisable = len(packets) if units == 1 else 0
        return packets

    def retract(self) -> None:
        """Take the last unit back: nobody has heard of it."""
        assert self._last is not None
        maker = self.settings.own_map
        self._own.undo()
        self._histories[maker].pop()
        self._logged -= self.revisable
        ends, bases = self._coming[maker].ends, self._bases[maker]
        end = ends.pop()
        if bases and bases[-1].end == end:
            bases.pop()
        self._lay(replace(self._last, states=self._last.before, before=self._last.states))
        said, waiting = self._said, self._waiting
        self._waiting = _Waiting(
            said.poses + waiting.poses, said.boxes + waiting.boxes, said.steps + waiting.steps
        )
        self._last = None
        super().retract()

    def take(self, map_id: MapId, frame: bytes, reception: Reception) -> None:
        """Put pieces together, and read the units that can be read by now, of all maps."""
        maker = map_id.number
        coming = self._coming[maker]
        if coming.broken:
            raise ProtocolError(Update.name, 0, coming.broken)
        units = packet_index.split(frame)
        rest, whole = coming.pieces, []
        ends: list[int] = []
        for count, unit in enumerate(units, coming.packets + 1):
            said, data = look(unit)
            rest += data
            if said is not None:
                number = (len(coming.ends) + len(ends)) % UPDATE_NUMBERS
                if said != number:
                    raise ProtocolError(Update.name, 0, f"unit {said} where {number} is the next")
                whole.append(rest)
                ends.append(count)
                rest = b""
        before = len(coming.ends)
        coming.ends += ends
        if whole and not coming.whole:
            try:
                first = self._decode(maker, whole[0], reception)
            except ProtocolError:
                del coming.ends[before:]
                raise
            if first is not None:
                self._lay(first)
                whole = whole[1:]
        coming.pieces, coming.packets = rest, coming.packets + len(units)
        coming.whole += whole
        if coming.whole:
            self._unread.add(maker)
        if self._unread:
            self._read_on(reception)

    def _read_on(self, reception: Reception) -> None:
        """Read all units for which what they are built on is there; one that makes no sense ends its stream."""
        progress = True
        while progress:
            progress = False
            for maker in sorted(self._unread):
                coming = self._coming[maker]
                while coming.whole:
                    try:
                        told = self._decode(maker, coming.whole[0], reception)
                    except ProtocolError as error:
                        coming.broken = error.reason
                        coming.whole.clear()
                        break
                    if told is None:
                        break
                    self._lay(told)
                    del coming.whole[0]
                    progress = True
                if not coming.whole:
                    self._unread.discard(maker)

    def _decode(self, maker: int, unit: bytes, reception: Reception) -> DecodedUpdate | None:
        """Decode an update of map `maker`; reject one that describes, or builds on, what its author cannot know."""
        stream = self._follow(maker)
        told = stream.decode(unit)
        if told is None:
            return None
        try:
            self._check_bases(told, reception)
            self.reachability_check.claim(self.maps[maker], told.box, reception)
        except ProtocolError:
            stream.undo()
            self._histories[maker].pop()
            raise
        self._note_basis(maker, told)
        stream.settle()
        if isinstance(stream, Stream):
            self._needed[maker] = stream.builds_from()
        return told

    def _check_bases(self, update: DecodedUpdate, reception: Reception) -> None:
        """Raise ProtocolError if an update builds on entries of this robot's log that no other robot can hold yet.

        This robot may still retract them.
        """
        own = self.settings.own_map
        for base in update.bases:
            end = self._coming[base.robot].ends[base.end - 1]
            if base.robot == own and end > reception.shared:
                reason = f"builds on {end} entries of map {own}, of which {reception.shared} were shared"
                raise ProtocolError(Update.name, 0, reason)

    def _note_basis(self, maker: int, told: DecodedUpdate) -> None:
        """Note what the last unit of a stream is built on."""
        ends, number = self._coming[maker].ends, len(self._histories[maker]) - 1
        on = tuple((base.robot, self._coming[base.robot].ends[base.end - 1]) for base in told.bases)
        if on:
            self._bases[maker].append(Dependency(ends[number - 1] if number else 0, ends[number], on))

    def dependencies(self, number: int) -> Sequence[Dependency]:
        """Return the log ranges of decoded updates that build on more of other logs than the ones before."""
        return self._bases[number]

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Lay the robot's own grid over what all have told."""
        del peers
        if self._shelves is None and len(self._histories) > 1:
            self._needed[self.settings.own_map] = self._own.builds_from()
            np.fill_diagonal(self._needed, np.iinfo(np.int64).max)
            for history, needed in zip(self._histories, self._needed.min(axis=0).tolist(), strict=True):
                history.forget(needed)
        return self._heard.under(own)

    def pose(self, map_id: MapId) -> tuple[int, int] | None:
        """From where the last look of a map's units was taken."""
        return self._streams[map_id.number].pose if map_id.number in self._streams else None

    def _lay(self, told: DecodedUpdate) -> None:
        """Write what a unit tells: a wall if anybody tells so, else free if anybody does."""
        _count(
            self._told_so.reshape(2, -1), told.places, told.before, told.states, self._heard.grid.reshape(-1)
        )
        if len(told.places):
            self._heard.told(told.box)


def pieces(message: bytes, number: int, most: int) -> list[bytes]:
    """Cut a unit into the packets in which it travels; the last has `most` bytes of content at most."""
    packets = []
    while len(message) > most:
        packets.append(encode([Update(None, message[:UPDATE_DATA])]))
        message = message[UPDATE_DATA:]
    return [*packets, encode([Update(number % UPDATE_NUMBERS, message)])]


@kernel("int64(uint8[:,::1], uint8[:,::1], uint8[:,::1], int64, int64, int64, int64)")
def _news(heard: Grid, told: Grid, own: Grid, x0: int, y0: int, x1: int, y1: int) -> int:
    """Count the cells of a box that nobody has told of as the robot knows them."""
    count = 0
    for y in range(y0, y1):
        for x in range(x0, x1):
            truth = own[y, x]
            if truth == UNKNOWN:
                count += told[y, x] & TOLD != 0
            else:
                count += heard[y, x] != truth and told[y, x] != truth | TOLD
    return count


@kernel("void(uint16[:,::1], int32[::1], uint8[::1], uint8[::1], uint8[::1])")
def _count(
    told_so: NDArray[np.uint16], places: NDArray[np.int32], before: Grid, states: Grid, heard: Grid
) -> None:
    """A maker tells other states of cells than `before`: count who tells what of them, and put `heard` together."""
    for index in range(len(places)):
        place = places[index]
        if before[index] != UNKNOWN:
            told_so[before[index] - FREE, place] -= 1
        if states[index] != UNKNOWN:
            told_so[states[index] - FREE, place] += 1
        free, wall = told_so[0, place], told_so[1, place]
        heard[place] = OCCUPIED if wall else FREE if free else UNKNOWN


assert FREE + 1 == OCCUPIED
