"""The time limit for robots' replies, with a clock that stops while the waiting process is stopped."""

from __future__ import annotations

import time

import numpy as np
import pytest

from deploy.record.records import NO_MAPS, RecorderNode
from deploy.run.launch import attend
from deploy.run.reply_timeout import ReplyTimeout
from protocol import keys as names
from protocol import map_parts
from protocol.bus import Message
from protocol.keys import Keys
from protocol.map_parts import FinalMaps
from protocol.message_codec import pack
from protocol.messages import End, MapPart, WorldReport


class WaitingNode:
    """A relay that waits for robot 0."""

    phase = 0

    def __init__(self) -> None:
        self.lost: list[int] = []

    def waiting_for(self) -> list[int]:
        return [0]

    def give_up_on(self, robot: int, cause: str) -> None:
        self.lost.append(robot)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that the limit reads; tests set it."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_robot_that_does_not_reply_is_lost(clock: list[float]) -> None:
    node = WaitingNode()
    limit = ReplyTimeout(node, 2.0)
    for _ in range(9):
        clock[0] += 0.25
        assert not node.lost
        limit.check()
    assert node.lost == [0]


def test_time_during_which_the_waiting_process_was_stopped_does_not_count(clock: list[float]) -> None:
    node = WaitingNode()
    limit = ReplyTimeout(node, 2.0)
    clock[0] += 600.0
    assert limit.check() < 2.0
    clock[0] += 0.25
    limit.check()
    assert not node.lost


KEYS = Keys("run")
SHAPE = (4, 4)


class SlowRobot:
    """The recorder's end of a bus: the run is over, and robot 0 takes some seconds to send its maps."""

    def __init__(self, clock: list[float], takes_s: float, ends_after_s: float = 0.0) -> None:
        grid = np.zeros(SHAPE, np.uint8)
        maps = map_parts.join(FinalMaps(grid, grid, grid, grid == 1))
        self._waiting = [
            (
                0.0,
                Message(
                    KEYS.control(names.RECORDER, names.WORLD), pack(WorldReport(3, bytes(16), [0], 1, 9))
                ),
            ),
            (
                clock[0] + ends_after_s,
                Message(KEYS.control(names.RECORDER, names.RELAY), pack(End(3, "explored", 0))),
            ),
            (
                clock[0] + ends_after_s + takes_s,
                Message(KEYS.control(names.RECORDER, "r0"), pack(MapPart(0, map_parts.encode(maps, 0)))),
            ),
        ]
        self._clock = clock

    def put(self, key: str, payload: bytes) -> None:
        """Requests of the recorder."""

    def receive(self, timeout_s: float | None = None) -> Message | None:
        if self._waiting and self._waiting[0][0] <= self._clock[0]:
            return self._waiting.pop(0)[1]
        self._clock[0] += timeout_s or 0.0
        return None

    def close(self) -> None:
        """Leave the bus."""


@pytest.mark.parametrize(("takes_s", "lost"), [(50.0, {}), (70.0, {0: NO_MAPS})])
def test_a_robot_has_as_long_for_its_maps_as_for_any_other_reply(
    clock: list[float], takes_s: float, lost: dict[int, str]
) -> None:
    bus = SlowRobot(clock, takes_s)
    recorder = RecorderNode(bus, KEYS, 1, SHAPE)
    attend(bus, recorder, lambda _: False, lambda: False, reply_timeout_s=60.0, quiet_s=1000.0)
    assert recorder.records.lost == lost
    assert (0 in recorder.records.own) == (not lost)


def test_an_interrupted_step_may_take_as_long_as_any_other(clock: list[float]) -> None:
    bus = SlowRobot(clock, 1.0, ends_after_s=50.0)
    recorder = RecorderNode(bus, KEYS, 1, SHAPE)
    attend(bus, recorder, lambda _: True, lambda: False, reply_timeout_s=60.0, quiet_s=1000.0)
    assert recorder.records.end == End(3, "explored", 0)
    assert 0 in recorder.records.own
