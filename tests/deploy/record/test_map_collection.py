"""Maps at the end of a run: requested in turns, part by part, whatever the robots send."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from deploy.record.map_collection import IN_TURN, MapCollection
from deploy.run.in_memory import MemoryRun
from protocol import keys as names
from protocol import map_parts
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN
from protocol.map_parts import FinalMaps
from protocol.message_fields import PART_CELLS
from protocol.messages import MapPart
from tests.system.team import small_plan

SHAPE = (1000, 900)
CELLS = SHAPE[0] * SHAPE[1]
ON_THE_WAY = 4 << 20
"""Bytes on the way to the recorder that are always acceptable."""


def cells() -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    own, planning, shared, settled = np.random.default_rng(1).integers(0, 3, (4, *SHAPE), np.uint8)
    return map_parts.join(FinalMaps(own, planning, shared, (settled == 0) & (own != UNKNOWN)))


class Congestion:
    """Counts the bytes that robots have sent to the recorder and that it has not received."""

    def __init__(self) -> None:
        self.bytes = self.most = 0

    def wrap(self, name: str, bus: Bus) -> Bus:
        return Counted(self, name, bus)


class Counted:
    """A participant's end of the bus that reports to a `Congestion`."""

    def __init__(self, congestion: Congestion, name: str, inner: Bus) -> None:
        self._congestion, self._name, self._inner = congestion, name, inner
        self.close = inner.close

    def put(self, key: str, payload: bytes) -> None:
        if names.parts(key)[2] == names.RECORDER and names.is_robot(self._name):
            self._congestion.bytes += len(payload)
            self._congestion.most = max(self._congestion.most, self._congestion.bytes)
        self._inner.put(key, payload)

    def receive(self, timeout_s: float | None = None) -> Message | None:
        message = self._inner.receive(timeout_s)
        if message is not None and self._name == names.RECORDER:
            from_robot = names.is_robot(names.parts(message.key)[3])
            self._congestion.bytes -= len(message.payload) if from_robot else 0
        return message


def test_robots_never_have_large_maps_on_the_way_at_the_same_time() -> None:
    congestion = Congestion()
    plan = small_plan(side_m=100.0, robots=6, steps=1, strategy="greedy", map_encoding="scans")
    records = MemoryRun(plan, wrap=congestion.wrap).complete()
    assert sorted(records.own) == sorted(records.planning) == list(range(6))
    assert sum(grid.size for grid in records.own.values()) > ON_THE_WAY
    assert 0 < congestion.most < ON_THE_WAY


def test_maps_arrive_part_by_part_and_unchanged() -> None:
    collection, sent = MapCollection(SHAPE), cells()
    assert collection.begin([3]) == [(3, 0)]
    assert map_parts.count(CELLS) == -(-CELLS // PART_CELLS) == 2
    assert collection.take(3, MapPart(0, map_parts.encode(sent, 0))) is None
    grids = collection.take(3, MapPart(1, map_parts.encode(sent, 1)))
    assert grids is not None
    assert (map_parts.join(grids) == sent).all()
    assert collection.parts_received == 2
    assert collection.under_way == []


def test_only_a_few_robots_send_at_the_same_time_and_a_lost_one_makes_room() -> None:
    collection, due = MapCollection(SHAPE), list(range(10))
    assert collection.begin(due) == [(robot, 0) for robot in range(IN_TURN)]
    assert collection.begin(due) == []
    assert collection.begin(due[1:]) == [(IN_TURN, 0)]
    assert collection.under_way == list(range(1, IN_TURN + 1))


@pytest.mark.parametrize(
    "part",
    [
        MapPart(1, map_parts.encode(cells(), 1)),
        MapPart(0, map_parts.encode(cells(), 1)),
        MapPart(0, b"\x01"),
        MapPart(0, zlib.compress(bytes(PART_CELLS + 1))),
        MapPart(0, zlib.compress(bytes(1 << 26))),
        MapPart(0, zlib.compress(bytes(PART_CELLS)) + b"more"),
        MapPart(0, zlib.compress(PART_CELLS * b"\x03")),
        MapPart(0, zlib.compress(PART_CELLS * b"\x0c")),
        MapPart(0, zlib.compress(PART_CELLS * b"\x10")),
        MapPart(0, zlib.compress(PART_CELLS * b"\x61")),
        MapPart(0, zlib.compress(PART_CELLS * b"\x81")),
    ],
    ids=lambda part: f"{part.part}-{len(part.cells)}",
)
def test_a_part_that_was_not_requested_or_is_malformed_is_a_protocol_error(part: MapPart) -> None:
    collection = MapCollection(SHAPE)
    collection.begin([0])
    with pytest.raises(ProtocolError):
        collection.take(0, part)
    with pytest.raises(ProtocolError):
        collection.take(1, MapPart(0, map_parts.encode(cells(), 0)))
    assert collection.take(0, MapPart(0, map_parts.encode(cells(), 0))) is None
