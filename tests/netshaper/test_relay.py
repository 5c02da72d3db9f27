"""The relay process on the memory bus: required participants, their rights, and losses."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netshaper.ledger import CAUSES, EVERYONE, ROW
from netshaper.process import RelayNode
from netshaper.settings import RadioSettings
from protocol import keys as names
from protocol.budget import UNLIMITED, Budget
from protocol.bus import Bus
from protocol.grid import MAX_ROBOTS
from protocol.keys import RELAY, Keys
from protocol.memory_bus import MemoryHub
from protocol.message_codec import pack, unpack
from protocol.message_fields import MAX_CONNECTIONS
from protocol.messages import (
    Begin,
    Broadcasts,
    Close,
    Delivery,
    End,
    ErrorReport,
    FaultEvent,
    Lost,
    Move,
    Open,
    OutgoingFrame,
    Positions,
    RadioReport,
    Reconnected,
    RelayUpdate,
    RequestMaps,
    RobotFrames,
    Shutdown,
    Stop,
)
from protocol.packet_codec import encode
from protocol.packets import Offer, Passed, Pose, Target

KEYS = Keys("relay")
WORLD, RECORDER = names.WORLD, names.RECORDER


class Run:
    """A relay on a memory bus, and the other ends, which the test operates."""

    def __init__(
        self, robots: int = 2, *, begun: bool = True, budget: Budget = UNLIMITED, **more: Any
    ) -> None:
        self.hub = MemoryHub(KEYS.run)
        self._relay_bus = self.hub.join(names.RELAY)
        self.relay = RelayNode(self._relay_bus, KEYS, RadioSettings(robots, 0, 100.0, budget), **more)
        self.ends: dict[str, Bus] = {}
        self.robots = [names.robot(number) for number in range(robots)]
        if begun:
            for name in (WORLD, RECORDER, *self.robots):
                self.join(name)
            assert self.received(WORLD) == [Begin()]

    def join(self, name: str) -> None:
        self.ends[name] = self.hub.join(name)
        self.work()

    def leave(self, name: str) -> None:
        self.ends.pop(name).close()
        self.work()

    def work(self) -> None:
        while (message := self._relay_bus.receive()) is not None:
            self.relay.handle(message)

    def send(self, name: str, message: object) -> None:
        if isinstance(message, RobotFrames):
            self.radio(name, pack(message))
        else:
            payload = message if isinstance(message, bytes) else pack(message)
            self.ends[name].put(KEYS.control_tx(name), payload)
            self.work()

    def radio(self, sender: str, payload: bytes) -> None:
        self.ends[sender].put(KEYS.radio_tx(sender), payload)
        self.work()

    def record_keys(self, note: Callable[[str], object]) -> None:
        """Call `note` with the key of each message that the relay puts from now on."""
        put = self._relay_bus.put

        def put_and_note(key: str, payload: bytes) -> None:
            note(key)
            put(key, payload)

        self._relay_bus.put = put_and_note

    def received(self, name: str) -> list[Any]:
        """Return the relay's messages since the last call, with the events of its updates."""
        found: list[Any] = []
        while (message := self.ends[name].receive()) is not None:
            assert names.parts(message.key)[3] == names.RELAY
            decoded = unpack(message.payload)
            found += decoded.events if isinstance(decoded, RelayUpdate) else [decoded]
        return found

    def begin_step(self, step: int = 1) -> None:
        numbers = [names.number(name) for name in self.robots if name in self.ends]
        self.send(WORLD, Positions(step, numbers, numbers, numbers))

    def finish_step(self, step: int = 1) -> list[RadioReport]:
        """Let robots send empty frames until the medium closes; return the recorder's reports."""
        for _ in range(2):
            for name in self.robots:
                for message in self.received(name) if name in self.ends else []:
                    if isinstance(message, Open):
                        self.send(name, RobotFrames(step, message.round, "offers"))
        return [message for message in self.received(RECORDER) if isinstance(message, RadioReport)]


def test_the_run_begins_when_all_participants_have_joined_and_not_before() -> None:
    run = Run(begun=False)
    for name, missing in [(WORLD, [RECORDER, "r0", "r1"]), ("r1", [RECORDER, "r0"]), (RECORDER, ["r0"])]:
        run.join(name)
        assert run.relay.missing() == sorted(missing)
        assert run.received(WORLD) == []
    run.join("r0")
    assert run.relay.missing() == []
    assert run.received(WORLD) == [Begin()]


def test_the_relay_waits_again_for_a_participant_that_leaves_before_the_beginning() -> None:
    run = Run(begun=False)
    for name in (WORLD, RECORDER, "r0"):
        run.join(name)
    run.leave("r0")
    run.join("r1")
    assert run.received(WORLD) == []
    assert run.relay.missing() == ["r0"]
    run.join("r0")
    assert run.received(WORLD) == [Begin()]


def test_a_step_opens_the_medium_for_all_and_ends_with_a_report() -> None:
    run = Run()
    run.begin_step()
    assert run.relay.waiting_for() == [0, 1]
    (report,) = run.finish_step()
    assert (report.step, report.carried, report.rows) == (1, 0, b"")
    assert [type(message) for message in run.received("r0")] == [Close]


def test_the_relay_sends_a_robot_s_events_at_once_and_the_ledger_after_all_of_them() -> None:
    run = Run(robots=3)
    run.begin_step()
    receivers: list[str] = []
    run.record_keys(lambda key: receivers.append(names.parts(key)[2]))
    for sender, number in zip(run.robots, range(3), strict=True):
        target, offer = encode([Target(number, 1)]), encode([Offer(number, 0)])
        others = [receiver for receiver in range(3) if receiver != number]
        offers = [OutgoingFrame(receiver, offer) for receiver in others]
        run.send(sender, RobotFrames(1, 0, "offers", target, offers))
    assert receivers == ["r0", "r1", "r2"], "two targets, two offers and the phase, each"
    receivers.clear()
    for phase in ("answers", "data"):
        for robot in run.robots:
            run.send(robot, RobotFrames(1, 0, phase))
    for robot in run.robots:
        run.send(robot, RobotFrames(1, 1, "offers"))
    assert receivers[-5:] == ["r0", "r1", "r2", WORLD, RECORDER]


def test_a_robot_that_dies_is_reported_and_the_relay_does_not_wait_for_it() -> None:
    run = Run()
    run.begin_step()
    run.leave("r1")
    assert run.received(WORLD) == [Lost(1, "its process ended")]
    assert run.received(RECORDER) == [Lost(1, "its process ended")]
    assert run.relay.waiting_for() == [0]
    assert len(run.finish_step()) == 1


def test_a_lost_robot_is_reported_once_even_if_it_leaves_later() -> None:
    run = Run()
    run.begin_step()
    run.relay.give_up_on(1, "it sent nothing")
    run.leave("r1")
    assert run.received(WORLD) == [Lost(1, "it sent nothing")]


def test_a_robot_whose_connection_is_restored_continues_and_is_reported() -> None:
    resent: list[str] = []
    run = Run(resend=resent.append)
    run.begin_step()
    resent.clear()
    run.leave("r1")
    assert run.relay.away == {1}
    assert run.received(WORLD) == run.received(RECORDER) == []
    run.join("r1")
    assert run.relay.away == set()
    assert resent == ["r1"]
    assert run.received("r1") == run.received(WORLD) == run.received(RECORDER) == [Reconnected(1)]


def test_a_robot_whose_connection_is_not_restored_is_lost_and_may_not_start_again() -> None:
    run = Run(resend=lambda _: None, may_return=False)
    run.begin_step()
    run.leave("r1")
    run.relay.give_up_on(1, "it stays away")
    assert run.relay.away == set()
    assert run.received(WORLD) == run.received(RECORDER) == [Lost(1, "it stays away")]
    run.join("r1")
    assert run.received("r1") == [Shutdown()]
    assert run.received(WORLD) == []
    assert [type(message) for message in run.received(RECORDER)] == [ErrorReport]


def test_the_relay_does_not_wait_for_a_robot_that_a_fault_kills() -> None:
    run = Run(resend=lambda _: None)
    run.begin_step()
    run.send(WORLD, FaultEvent(2, 1, "kill"))
    run.leave("r1")
    assert run.received(WORLD) == [Lost(1, "its process ended")]


def test_a_robot_that_dies_before_it_has_sent_its_maps_is_reported_too() -> None:
    run = Run()
    run.send(WORLD, End(7, "explored", 0))
    assert run.received(RECORDER) == [End(7, "explored", 0)]
    run.leave("r1")
    assert run.received(RECORDER) == [Lost(1, "its process ended")]


def test_the_relay_forwards_a_request_for_maps_to_its_robot_alone() -> None:
    run = Run()
    run.send(RECORDER, RequestMaps(1, 7, 2))
    assert run.received("r1") == [RequestMaps(1, 7, 2)]
    assert run.received("r0") == []
    run.relay.give_up_on(1, "it sent nothing")
    run.send(RECORDER, RequestMaps(1, 7, 3))
    assert run.received("r1") == []


def test_when_the_world_dies_the_run_ends_once_for_all() -> None:
    run = Run()
    run.begin_step()
    run.leave(WORLD)
    assert [m for m in run.received(RECORDER) if isinstance(m, End)] == [End(-1, "the world died", -1)]
    for name in ("r0", "r1"):
        run.received(name)
    run.send(RECORDER, Shutdown())
    for name in (RECORDER, "r0", "r1"):
        assert run.received(name) == [Shutdown()]
        run.leave(name)
    assert run.relay.done


def test_a_world_that_dies_after_the_end_does_not_end_the_run_again() -> None:
    run = Run()
    run.send(WORLD, End(7, "explored", 0))
    run.leave(WORLD)
    assert run.received(RECORDER) == [End(7, "explored", 0)]


@pytest.mark.parametrize("ended", [False, True])
def test_when_the_recorder_dies_all_participants_shut_down(ended: bool) -> None:
    run = Run()
    if ended:
        run.send(WORLD, End(7, "explored", 0))
    run.leave(RECORDER)
    for name in (WORLD, "r0", "r1"):
        assert run.received(name)[-1] == Shutdown()
        run.leave(name)
    assert run.relay.done


def test_the_relay_is_done_when_all_have_received_shutdown_and_left() -> None:
    run = Run()
    run.send(WORLD, End(7, "explored", 0))
    run.send(RECORDER, Shutdown())
    for name in (WORLD, RECORDER, "r0", "r1"):
        assert run.relay.shutting_down
        assert not run.relay.done
        run.leave(name)
    assert run.relay.done


def test_the_relay_forwards_a_stop_of_the_recorder_to_the_world() -> None:
    run = Run()
    run.send(RECORDER, Stop("interrupted"))
    assert run.received(WORLD) == [Stop("interrupted")]


@pytest.mark.parametrize(
    "lie",
    [
        b"",
        b"\xc1",
        b"\xff\xff",
        Positions(1, [0, 1], [0, 0], [0, 0]),
        End(1, "I am done", 0),
        Stop("enough"),
        Shutdown(),
        Begin(),
        Lost(1, "I saw it die"),
        Move(1, b"", 0, explored=True),
        RadioReport(1, b"", 0, b""),
    ],
    ids=repr,
)
def test_messages_that_a_robot_may_not_send_are_reported_and_have_no_effect(lie: object) -> None:
    run = Run()
    run.begin_step()
    run.send("r1", lie)
    (fault,) = run.received(RECORDER)
    assert isinstance(fault, ErrorReport)
    assert fault.participant == "r1"
    assert run.received(WORLD) == []
    assert run.relay.waiting_for() == [0, 1]
    assert len(run.finish_step()) == 1


@given(st.binary(max_size=60))
def test_noise_on_a_robots_wire_stops_no_run(noise: bytes) -> None:
    run = Run()
    run.begin_step()
    run.send("r1", noise)
    run.radio("r1", noise)
    frames = [OutgoingFrame(0, noise), OutgoingFrame(EVERYONE, noise)]
    run.send("r1", RobotFrames(1, 0, "data", noise, frames))
    run.send("r1", RobotFrames(1, 0, "offers", noise, frames))
    assert len(run.finish_step()) == 1


def test_invalid_numbers_of_connections_at_the_end_of_a_phase_stop_no_run() -> None:
    run = Run()
    run.begin_step()
    frames = [OutgoingFrame(0, b"", 2**31 - 1), OutgoingFrame(0, b"", -1)]
    run.send("r1", RobotFrames(1, 0, "offers", frames=frames))
    assert run.relay.waiting_for() == [0]


@pytest.mark.parametrize(("step", "number"), [(0, 0), (2, 0), (2**31 - 1, 0), (1, 1), (1, 15)])
def test_frames_of_another_step_or_round_are_faults_of_their_sender(step: int, number: int) -> None:
    run = Run()
    run.begin_step()
    run.send("r1", RobotFrames(step, number, "offers", priority=255))
    (fault,) = run.received(RECORDER)
    assert isinstance(fault, ErrorReport)
    assert fault.participant == "r1"
    assert f"round {number} of step {step}" in fault.reason
    assert run.relay.waiting_for() == [0, 1]
    assert len(run.finish_step()) == 1


@pytest.mark.parametrize(
    "items",
    [
        [1, 0, "offers", b"", [[0, b"", 2**63]], 0],
        [-5, 99, "offers", b"", [], 0],
        [1, 0, "offers", b"", [], 256],
        [1, 0, "offers", b"", [[-2, b"", -1]], 0],
        [1, 0, "offers", b"", [[0, "text", -1]], 0],
        [1, 0, "offers", "text", [], 0],
    ],
    ids=repr,
)
def test_invalid_numbers_end_no_phase(items: list[Any]) -> None:
    run = Run()
    run.begin_step()
    run.radio("r1", msgspec.msgpack.encode([7, *items]))
    (fault,) = run.received(RECORDER)
    assert fault.participant == "r1"
    assert re.search("RobotFrames at byte 0: .*Expected", fault.reason)
    assert run.relay.waiting_for() == [0, 1]


@pytest.mark.parametrize("receiver", [1, 2, 9, 64, MAX_ROBOTS - 1])
def test_a_frame_for_an_unknown_robot_is_logged_as_out_of_range(receiver: int) -> None:
    run = Run()
    run.begin_step()
    run.send("r1", RobotFrames(1, 0, "offers", frames=[OutgoingFrame(receiver, encode([Offer(1, 0)]))]))
    (report,) = run.finish_step()
    rows = np.frombuffer(report.rows, ROW)
    assert [(row["sender"], row["bytes"], CAUSES[row["cause"]]) for row in rows] == [(1, 2, "range")]


def test_a_frame_longer_than_the_limit_is_reported_and_not_decoded() -> None:
    run = Run(budget=Budget(1000))
    run.begin_step()
    for size in (1065, 1 << 24, 20 << 20):
        run.send(
            "r1", RobotFrames(1, 0, "offers", frames=[OutgoingFrame(0, b""), OutgoingFrame(0, bytes(size))])
        )
    faults = run.received(RECORDER)
    assert [fault.participant for fault in faults] == 3 * ["r1"]
    assert "a frame of 1065 bytes, where 1064 are the most" in faults[0].reason
    assert run.relay.waiting_for() == [0, 1]
    (report,) = run.finish_step()
    assert report.rows == b""


def test_a_broadcast_of_relayed_positions_may_exceed_the_budget() -> None:
    run = Run(robots=40, budget=Budget(150))
    run.begin_step()
    sent = encode(
        [Pose(1, 1, 0), *(packet for r in range(1, 40) for packet in (Passed(r, 1, 2, 2), Target(3, 3)))]
    )
    run.send("r0", RobotFrames(1, 0, "offers", sent))
    assert run.received(RECORDER) == []
    assert 0 not in run.relay.waiting_for()


def test_a_robot_that_repeatedly_exceeds_the_connections_of_a_phase_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    most = 20
    monkeypatch.setattr("netshaper.process.MAX_PROTOCOL_ERRORS", most)
    run = Run()
    run.begin_step()
    frames = (MAX_CONNECTIONS + 1) * [OutgoingFrame(0, encode([Offer(1, 0)]))]
    sent = pack(RobotFrames(1, 0, "offers", frames=frames))
    for _ in range(most + 1):
        run.radio("r1", sent)
    assert [type(message) for message in run.received(RECORDER)] == [*most * [ErrorReport], Lost]
    assert run.relay.waiting_for() == [0]


def test_a_target_is_passed_on_with_its_sender() -> None:
    run = Run()
    run.begin_step()
    run.received("r0")
    run.send("r1", RobotFrames(1, 0, "offers", encode([Target(3, 4)])))
    run.send("r0", RobotFrames(1, 0, "offers"))
    message = run.ends["r0"].receive()
    assert message is not None
    assert message.key == KEYS.radio_rx("r0", RELAY)
    update = unpack(message.payload)
    assert isinstance(update, RelayUpdate)
    assert update.events[0] == Broadcasts(1, [Delivery(1, encode([Target(3, 4)]))])


@pytest.mark.parametrize("moment", ["before positions", "in the offers", "between steps"])
def test_a_death_at_any_time_lets_the_next_step_run(moment: str) -> None:
    run = Run(3)
    if moment == "before positions":
        run.leave("r1")
    run.begin_step()
    if moment == "in the offers":
        run.leave("r1")
    run.finish_step()
    if moment == "between steps":
        run.leave("r1")
    run.begin_step(2)
    assert len(run.finish_step(2)) == 1
