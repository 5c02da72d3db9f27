"""The world's process on the memory bus: the step barrier, and the end of a run."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol import keys as names
from protocol.body import Body
from protocol.bus import Bus
from protocol.cell_bytes import cells_to_bytes, points_to_bytes
from protocol.grid import FREE
from protocol.keys import Keys
from protocol.memory_bus import MemoryHub
from protocol.message_codec import pack, unpack
from protocol.messages import (
    Begin,
    Close,
    End,
    ErrorReport,
    FaultEvent,
    Lost,
    Move,
    Positions,
    Sense,
    Shutdown,
    Stop,
    WorldReport,
)
from protocol.range_scans import Laser
from worldsim.base import EXPLORED, STALLED
from worldsim.clock import StepClock
from worldsim.ending import ALL_LOST, LONE_REPORT_STEPS, OUT_OF_STEPS
from worldsim.process import WorldNode
from worldsim.sensor_options import LaserOptions, PoseOptions
from worldsim.sensors import RobotSensors, SensorSettings
from worldsim.world import World, WorldSettings

KEYS = Keys("world")
STARTS = ((2, 2), (4, 2), (6, 2))


class Run:
    """A world on the memory bus, and the ends of all other participants, which the test uses."""

    def __init__(
        self,
        robots: int = 2,
        steps: int = 9,
        *,
        begun: bool = True,
        clock: StepClock | None = None,
        **settings: Any,
    ) -> None:
        hub = MemoryHub(KEYS.run)
        self.ends: dict[str, Bus] = {}
        for name in (names.RELAY, names.WORLD, names.RECORDER, *map(names.robot, range(robots))):
            self.ends[name] = hub.join(name)
        bodies = tuple(Body(3.0, 360.0, 1.0) for _ in range(robots))
        world = World(np.full((5, 9), FREE, np.uint8), WorldSettings(bodies, STARTS[:robots], 4, **settings))
        self.world = world
        self.closed = 0
        self.node = WorldNode(self.ends[names.WORLD], KEYS, world, steps, 100.0, clock=clock)
        self.received(names.RELAY)
        if begun:
            self.control(Begin())

    def work(self) -> None:
        while (message := self.ends[names.WORLD].receive()) is not None:
            self.node.handle(message)
            self.close()

    def close(self) -> None:
        """Close the medium of a step that has begun, as the relay does."""
        if self.world.step > self.closed:
            self.closed = self.world.step
            self.ends[names.RELAY].put(KEYS.control(names.WORLD, names.RELAY), pack(Close(self.closed)))

    def control(self, message: object) -> None:
        self.ends[names.RELAY].put(KEYS.control(names.WORLD, names.RELAY), pack(message))
        self.work()

    def move(self, robot: int, message: object) -> None:
        payload = message if isinstance(message, bytes) else pack(message)
        self.ends[names.robot(robot)].put(KEYS.body(names.WORLD, names.robot(robot)), payload)
        self.work()

    def stay(self, *robots: int, **settings: Any) -> None:
        for robot in robots:
            self.move(robot, Move(self.world.step, b"", 0, **({"explored": False} | settings)))

    def received(self, name: str) -> list[Any]:
        found = []
        while (message := self.ends[name].receive()) is not None:
            if names.parts(message.key)[0] != "presence":
                found.append(unpack(message.payload))
        return found

    def ended(self) -> End | None:
        return next((message for message in self.received(names.RELAY) if isinstance(message, End)), None)


def test_the_world_sends_the_first_senses_after_begin() -> None:
    run = Run(begun=False)
    run.work()
    assert run.received("r0") == []
    run.control(Begin())
    for number in range(2):
        (sense,) = run.received(names.robot(number))
        assert isinstance(sense, Sense)
        assert (sense.step, sense.x, sense.y) == (1, *STARTS[number])
    assert run.received(names.RELAY) == [Positions(1, [0, 1], [2, 4], [2, 2])]
    (report,) = run.received(names.RECORDER)
    assert isinstance(report, WorldReport)
    assert np.frombuffer(report.poses, "<i4").reshape(-1, 4).tolist() == [[0, 200, 200, 0], [1, 400, 200, 0]]


def test_a_step_ends_when_the_last_living_robot_has_moved() -> None:
    run = Run()
    run.stay(1)
    assert run.world.step == 1
    run.move(0, Move(1, cells_to_bytes(np.array([[2, 3]], np.int32)), 0, explored=False))
    assert run.world.step == 2
    assert run.world.cells == {0: (2, 3), 1: (4, 2)}


def test_robot_receives_only_its_own_scans() -> None:
    run = Run()
    run.stay(0, 1)
    for number in range(2):
        senses = [message for message in run.received(names.robot(number)) if isinstance(message, Sense)]
        assert [(sense.x, sense.y) for sense in senses] == 2 * [STARTS[number]]


@pytest.mark.parametrize("early", [True, False])
def test_step_does_not_wait_for_a_lost_robot(early: bool) -> None:
    run = Run()
    if early:
        run.stay(1)
    run.control(Lost(1, "its process ended"))
    run.stay(0)
    assert run.world.step == 2
    assert list(run.world.cells) == [0]
    run.stay(0)
    assert run.world.step == 3


def test_loss_of_the_last_awaited_robot_ends_the_step() -> None:
    run = Run()
    run.stay(0)
    run.control(Lost(1, "its process ended"))
    assert run.world.step == 2


def test_move_of_a_lost_robot_does_not_count() -> None:
    run = Run()
    run.stay(1, explored=True)
    run.control(Lost(1, "its process ended"))
    run.stay(0)
    assert run.ended() is None
    assert run.world.step == 2


def test_run_ends_with_the_lowest_of_the_robots_that_are_done_first() -> None:
    run = Run(3)
    run.stay(0)
    run.stay(1, 2, explored=True)
    assert run.ended() == End(1, EXPLORED, 1)


def test_run_that_ends_with_all_waits_for_all_and_names_the_first_one() -> None:
    run = Run(ends_with_all=True)
    run.stay(0)
    run.stay(1, explored=True)
    assert run.ended() is None
    run.stay(0, 1, explored=True)
    assert run.ended() == End(2, EXPLORED, 1)


def test_run_ends_when_stalled_when_out_of_steps_and_when_stopped() -> None:
    stalled, short, stopped = Run(), Run(steps=1), Run()
    stalled.stay(0, 1, stalled=True)
    assert stalled.ended() == End(1, STALLED, -1)
    short.stay(0, 1)
    assert short.ended() == End(1, OUT_OF_STEPS, -1)
    stopped.control(Stop("interrupted"))
    assert stopped.ended() is None
    stopped.stay(0, 1)
    assert stopped.ended() == End(1, "interrupted", -1)


def test_the_run_ends_when_all_robots_are_lost() -> None:
    run = Run()
    run.control(Lost(0, "x"))
    run.control(Lost(1, "x"))
    assert run.ended() == End(1, ALL_LOST, -1)


def test_world_ends_after_shutdown() -> None:
    run = Run()
    assert not run.node.done
    run.control(Shutdown())
    assert run.node.done


@pytest.mark.parametrize("step", [1, 2, 4])
def test_robot_breaks_down_at_the_start_of_the_scheduled_step(step: int) -> None:
    run = Run(faults=(FaultEvent(step, 1, "death"),))
    for number in range(1, step):
        assert run.world.step == number
        assert list(run.world.cells) == [0, 1]
        run.stay(0, 1)
    assert run.world.step == step
    assert list(run.world.cells) == [0]
    messages = run.received("r1")
    assert [message.step for message in messages if isinstance(message, Sense)] == list(range(1, step))
    events = [message for message in run.received(names.RECORDER) if isinstance(message, FaultEvent)]
    assert events == [FaultEvent(step, 1, "death")]


def test_run_ends_when_all_robots_break_down() -> None:
    run = Run(faults=(FaultEvent(1, 0, "death"), FaultEvent(1, 1, "death")))
    assert run.ended() == End(1, ALL_LOST, -1)


INVALID = [
    b"",
    b"\xc1",
    b"\xff\xff\xff",
    Begin(),
    Sense(1, 0, 0, 0, b"", b"", ""),
    Lost(0, "invalid"),
    End(1, "invalid", 1),
    Shutdown(),
    Stop("invalid"),
    Move(7, b"", 0, explored=False),
    msgspec.msgpack.encode([3, -1, b"", 0, True, True, False, b""]),
    msgspec.msgpack.encode([3, 1, b"abc", 0, True, True, False, b""]),
    msgspec.msgpack.encode([3, 1, b"", 0, True, True, False, b"abcd"]),
    msgspec.msgpack.encode([3, 1, b"", 8, True, True, False, b""]),
]


@pytest.mark.parametrize("message", INVALID, ids=repr)
def test_invalid_message_is_reported_and_the_step_waits_for_the_move(message: object) -> None:
    run = Run()
    run.received(names.RECORDER)
    run.move(1, message)
    (fault,) = run.received(names.RECORDER)
    assert isinstance(fault, ErrorReport)
    assert fault.participant == "r1"
    assert not run.node.done
    run.stay(0)
    assert run.world.step == 1
    run.stay(1)
    assert run.world.step == 2
    assert run.world.cells == {0: (2, 2), 1: (4, 2)}
    assert run.ended() is None


def test_second_move_in_a_step_is_reported_and_the_first_counts() -> None:
    run = Run()
    run.received(names.RECORDER)
    run.move(1, Move(1, cells_to_bytes(np.array([[4, 3]], np.int32)), 0, explored=False))
    run.move(1, Move(1, b"", 0, explored=True))
    (fault,) = run.received(names.RECORDER)
    assert fault == ErrorReport("r1", "Move at byte 0: a second one for step 1")
    run.stay(0)
    assert run.world.cells[1] == (4, 3)


@given(st.binary(max_size=60))
def test_random_bytes_from_a_robot_do_not_stop_the_run(noise: bytes) -> None:
    run = Run()
    run.move(1, noise)
    run.stay(0, 1)
    assert run.world.step == 2


@pytest.mark.parametrize("when", ["before the beginning", "after the end"])
def test_a_move_at_the_wrong_time_has_no_effect(when: str) -> None:
    run = Run(begun=when == "after the end")
    if when == "after the end":
        run.stay(0, 1, explored=True)
    run.move(1, Move(run.world.step, b"", 0, explored=True))
    step = run.world.step
    if when == "before the beginning":
        run.control(Begin())
        step = 1
    run.stay(0)
    assert run.world.step == step


@pytest.mark.parametrize(
    "path",
    [
        [[3000, 0]],
        [[-1, -1]],
        [[2, 2]],
        [[3, 3], [32767, -32768]],
        500 * [[3, 2], [2, 2]],
    ],
)
def test_robot_drives_the_valid_part_of_a_path(path: list[list[int]]) -> None:
    run = Run(1)
    run.move(0, Move(1, cells_to_bytes(np.array(path, np.int32)), 7, explored=False))
    assert run.world.step == 2
    x, y = run.world.cells[0]
    assert abs(x - 2) <= 1
    assert abs(y - 2) <= 1


@pytest.mark.parametrize("far", [2**31 - 1, -(2**31)])
def test_robot_drives_toward_waypoints_beyond_the_world(far: int) -> None:
    run = Run(1)
    points = points_to_bytes(np.array([[far, far], [0, far]], np.int32))
    run.move(0, Move(1, b"", 1, explored=False, points=points))
    assert run.world.step == 2
    assert run.world.driven[0] <= 1.0


def real_sensors(robots: int) -> SensorSettings:
    own = RobotSensors(LaserOptions(range_error_m=0.01), PoseOptions(), Laser(8, 0, 57_344, 300))
    return SensorSettings((own,) * robots, 0.1)


def ends(run: Run) -> list[End]:
    return [message for message in run.received(names.RELAY) if isinstance(message, End)]


def test_with_real_sensors_two_reports_end_a_run() -> None:
    run = Run(steps=40, sensors=real_sensors(2))
    run.stay(0, explored=True)
    run.stay(1)
    assert ends(run) == []
    run.stay(0, 1, explored=True)
    assert [end.reason for end in ends(run)] == [EXPLORED]


def test_with_real_sensors_one_robot_ends_a_run_only_if_it_reports_for_some_steps() -> None:
    run = Run(steps=40, sensors=real_sensors(2))
    for reports in (LONE_REPORT_STEPS - 1, 0, LONE_REPORT_STEPS - 1):
        for _ in range(reports):
            run.stay(0, explored=True)
            run.stay(1)
        assert ends(run) == []
        if not reports:
            run.stay(0, 1)
    run.stay(0, explored=True)
    run.stay(1)
    assert [end.first for end in ends(run)] == [0]
