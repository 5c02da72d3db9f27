"""One robot's medium: which events the robot gets, which frames it sends, and what it drops."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from agent.radios.options import MIN_FRAME, LinkOptions
from agent.radios.peer_medium import FRAME_OVERHEAD, MAX_BROADCAST, MAX_WAITING, WORTHWHILE, PeerMedium
from agent.radios.sealing import KEY_BYTES, OVERHEAD, Opener, Sealer
from protocol.budget import Budget
from protocol.messages import (
    EVERYONE,
    Broadcasts,
    Close,
    Delivery,
    Open,
    OutgoingFrame,
    RobotFrames,
    RoundReport,
    SendReport,
)
from protocol.nanoseconds import SECOND
from protocol.packet_codec import encode
from protocol.packets import HeldEarly, Pose
from tests.agent.radios.memory_air import Faults, MemoryAir

KEY = bytes(range(KEY_BYTES))
OPTIONS = LinkOptions("udp", interface="lo", bytes_per_s=100, frame_bytes=200, interval_s=1.0)
POSE = encode([Pose(3, 4, 0)])
REPORT = encode([HeldEarly(1, 2)])


def medium(robot: int = 0, options: LinkOptions = OPTIONS, **more: Any) -> PeerMedium:
    return PeerMedium(
        robot,
        options.longest,
        Sealer(KEY, robot, 1),
        Opener(KEY, robot, 3),
        options.pacer(1, robot, 0),
        options.timing(),
        **more,
    )


def step(
    end: PeerMedium, number: int, broadcast: bytes = b"", gossip: bytes = b""
) -> tuple[Open, list[bytes], list[object]]:
    """Play a step of a second in which nothing arrives: its first event, its frames, and its last events."""
    opened = end.begin_step(number, number * SECOND)
    frames = [OutgoingFrame(EVERYONE, gossip)] if gossip else []
    end.submit(RobotFrames(number, 0, "offers", broadcast, frames), number * SECOND)
    return opened, end.poll((number + 1) * SECOND - 1), list(end.end_step())


def test_what_a_robot_sends_reaches_the_others_as_the_events_of_a_relay() -> None:
    sender, receiver = medium(0), medium(1)
    opened, frames, events = step(sender, 1, POSE, REPORT)
    assert opened == Open(1, 0, [], Budget(200 - FRAME_OVERHEAD))
    assert [len(frame) for frame in frames] == [FRAME_OVERHEAD + len(POSE) + len(REPORT)]
    assert events == [RoundReport(1, 0, [], [SendReport(0, len(REPORT))], [], True), Close(1)]
    receiver.begin_step(7, 7 * SECOND)
    receiver.receive(frames[0], 7 * SECOND)
    assert receiver.end_step() == [
        Broadcasts(7, [Delivery(0, POSE)]),
        RoundReport(7, 0, [], [], [Delivery(0, REPORT)], False),
        Close(7),
    ]
    assert receiver.begin_step(8, 8 * SECOND).peers == [0]
    assert receiver.end_step() == [RoundReport(8, 0, [], [], [], False), Close(8)]
    sent, received = sender.records[0], receiver.records[0]
    assert (sent.sender, sent.session, sent.counter) == (0, 1, 0) == received[2:5]
    assert (sent.broadcast, sent.gossip) == (POSE, REPORT) == (received.broadcast, received.gossip)
    assert (sent.step, received.step, received.time) == (1, 7, 7 * SECOND)


def test_a_robot_without_neighbors_says_hello_and_continues() -> None:
    end, receiver = medium(0), medium(1)
    sent = {number: frames for number in range(1, 30) if (frames := step(end, number)[1])}
    assert len(sent) == 4
    assert all(later - earlier in (8, 9) for earlier, later in zip(list(sent), list(sent)[1:], strict=False))
    for number, (frame,) in sent.items():
        assert len(frame) == OVERHEAD
        receiver.receive(frame, number * SECOND)
    assert receiver.end_step()[0] == RoundReport(0, 0, [], [], [], False)
    assert receiver.begin_step(30, 30 * SECOND).peers == [0]
    assert receiver.begin_step(62, 62 * SECOND).peers == []


def test_a_robot_never_sends_more_than_its_budget_and_its_interval_allow() -> None:
    options = dataclasses.replace(OPTIONS, bytes_per_s=20, interval_s=2.0)
    end, total, last = medium(0, options), 0, -2
    for number in range(1, 60):
        opened, frames, _ = step(end, number, b"", REPORT * 80)
        assert opened.budget.limit is not None
        assert opened.budget.limit + FRAME_OVERHEAD >= min(200, WORTHWHILE) or not opened.budget.limit
        for frame in frames:
            assert len(frame) <= opened.budget.limit + FRAME_OVERHEAD
            total += len(frame)
            assert total <= 200 + 20 * number
            assert number - last >= 2
            last = number
    assert total > 20 * 50


def test_gossip_beyond_the_budget_is_cut_between_packets_and_reported() -> None:
    opened, frames, events = step(medium(), 1, POSE, REPORT * 90)
    space = 200 - FRAME_OVERHEAD
    assert opened.budget == Budget(space)
    fitting = (space - len(POSE)) // len(REPORT) * len(REPORT)
    assert events[0] == RoundReport(1, 0, [], [SendReport(0, fitting)], [], True)
    assert len(frames[0]) == FRAME_OVERHEAD + len(POSE) + fitting


def test_a_broadcast_that_no_frame_can_hold_is_left_out_and_the_gossip_is_sent() -> None:
    _, frames, events = step(medium(), 1, POSE * (MAX_BROADCAST // len(POSE) + 1), REPORT)
    assert events[0] == RoundReport(1, 0, [], [SendReport(0, len(REPORT))], [], False)
    assert len(frames[0]) == FRAME_OVERHEAD + len(REPORT)


def test_frames_to_single_robots_are_refused() -> None:
    end = medium()
    end.begin_step(1, SECOND)
    with pytest.raises(ValueError, match="dissemination = gossip"):
        end.submit(RobotFrames(1, 0, "offers", b"", [OutgoingFrame(2, REPORT)]), SECOND)


def test_frames_that_do_not_hold_what_they_announce_and_floods_are_counted() -> None:
    end, other = medium(), Sealer(KEY, 2, 1)
    end.receive(other.seal(bytes([5]) + POSE), SECOND)
    assert end.dropped == {"malformed": 1}
    for _ in range(MAX_WAITING + 3):
        end.receive(other.seal(bytes([len(POSE)]) + POSE), SECOND)
    assert end.dropped == {"malformed": 1, "too many": 3}
    end.receive(Sealer(bytes(KEY_BYTES), 2, 9).seal(b""), SECOND)
    assert end.dropped == {"malformed": 1, "too many": 3, "not authentic": 1}
    end.receive(Sealer(KEY, 1, 1).seal(b""), 2 * SECOND)
    assert end.begin_step(0, 2 * SECOND).peers == [1, 2], (
        "a teammate is in range even if its frame was dropped"
    )
    (broadcasts, *_) = end.end_step()
    assert broadcasts == Broadcasts(0, [Delivery(2, POSE)] * MAX_WAITING)


def test_an_accepted_number_is_stored_before_the_frame_is_used() -> None:
    stored: list[tuple[int, int, int]] = []
    end = medium(accepted=lambda sender, number: stored.append((sender, number, len(end.records))))
    other = Sealer(KEY, 2, 5)
    frames = [other.seal(b"") for _ in range(2)]
    for frame in (*frames, *frames, Sealer(bytes(KEY_BYTES), 2, 9).seal(b"")):
        end.receive(frame, SECOND)
    assert stored == [(2, 5 << 24, 0), (2, 5 << 24 | 1, 1)]


def test_memory_air_loses_repeats_and_delays_the_same_frames_in_each_run() -> None:
    def arrivals(seed: int) -> list[tuple[int, bytes]]:
        air = MemoryAir(seed, Faults(loss=0.3, duplication=0.3, delay=SECOND))
        ends = [air.join(number, 100) for number in range(2)]
        arrived = []
        for number in range(200):
            air.now = number * SECOND // 10
            ends[0].send(bytes([number]))
            arrived += [(number, frame) for frame in ends[1].receive()]
        assert not ends[0].receive()
        return arrived

    assert arrivals(1) == arrivals(1) != arrivals(2)
    numbers = [frame[0] for _, frame in arrivals(1)]
    assert 0.5 < len(set(numbers)) / 200 < 0.85
    assert len(numbers) > len(set(numbers))
    assert numbers != sorted(numbers)


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"medium": "lora"}, "must be 'udp' or 'serial'"),
        ({"preset": "wify"}, "did you mean wifi"),
        ({"interface": ""}, "interface is missing"),
        ({"medium": "serial"}, "serial_port is missing"),
        ({"medium": "serial", "serial_port": "/dev/ttyUSB0", "bytes_per_s": 0}, "needs a preset"),
        ({"baud": 1234}, "baud = 1234"),
        ({"duty_cycle": 0.0}, "duty_cycle = 0"),
        ({"udp_port": 0}, "udp_port = 0"),
        ({"bytes_per_s": -1}, "bytes_per_s = -1"),
        ({"frame_bytes": MIN_FRAME - 1}, f"must be {MIN_FRAME} to 1400"),
        ({"frame_bytes": 1401}, "must be"),
        ({"hello_s": float("nan")}, "hello_s = nan: must be 0 to 604800"),
        ({"hello_s": 1e300}, r"hello_s = 1e\+300: must be 0 to 604800"),
        ({"neighbor_timeout_s": float("inf")}, "neighbor_timeout_s = inf: must be 0 to 604800"),
        ({"interval_s": -1.0}, "interval_s = -1: must be 0 to 604800"),
        ({"bytes_per_s": 10**30}, "bytes_per_s = 1000000000000000000000000000000: must be"),
        ({"duty_cycle": 5e-324}, "duty_cycle = 4.94066e-324: must be 1e-06 to 1"),
        ({"duty_cycle": 1e-4, "preset": "lora-sf12"}, "no room for a frame"),
        ({"interval_s": 9.0, "hello_s": 8.0}, "interval_s = 9, hello_s = 8, .*must not exceed"),
        ({"hello_s": 30.0, "neighbor_timeout_s": 30.0}, "hello_s = 30, neighbor_timeout_s = 30: .*shorter"),
    ],
)
def test_options_that_cannot_work_are_refused(settings: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        dataclasses.replace(OPTIONS, **settings)


def test_a_preset_gives_frames_rate_and_airtime() -> None:
    lora = LinkOptions("serial", preset="lora-sf9", serial_port="/dev/ttyUSB0", duty_cycle=0.01)
    assert (lora.longest, lora.rate, lora.packet_bytes) == (115, 169, 115 - FRAME_OVERHEAD)
    assert lora.airtime(115) == pytest.approx(0.6769 * SECOND, rel=1e-3)
    assert LinkOptions("udp", interface="wlan0").longest == 1400
    assert lora.timing().hello > 50 * SECOND  # a frame of 90 bytes per minute is all that 1 % allows
    assert lora.timing().neighbor_timeout == 4 * lora.timing().hello


def test_a_frame_and_its_back_off_take_several_steps_on_a_slow_radio() -> None:
    lora = LinkOptions("serial", preset="lora-sf9", serial_port="/dev/ttyUSB0", duty_cycle=0.01)
    seconds = 5 * lora.airtime(lora.longest) / SECOND
    assert lora.transit_steps(0.2) - 1 < seconds / 0.2 <= lora.transit_steps(0.2)
    assert lora.transit_steps(60.0) == 1
    assert LinkOptions("udp", interface="wlan0").transit_steps(1.0) == 1


def test_a_robot_that_must_save_for_a_frame_sends_packets_and_no_hellos() -> None:
    options = dataclasses.replace(OPTIONS, bytes_per_s=2)
    end = medium(0, options)
    sizes = [len(frame) for number in range(1, 600) for frame in step(end, number, b"", REPORT * 25)[1]]
    assert min(sizes) > WORTHWHILE - len(REPORT)
    assert sum(sizes) > 1000


def farewell(end: PeerMedium, now: int) -> bytes:
    """The frame of a farewell, which may be sent at once."""
    assert end.say_farewell(now)
    (frame,) = end.poll(now + 10 * SECOND)
    assert len(frame) == OVERHEAD + 1
    return frame


def test_a_robot_that_said_farewell_is_out_of_range_until_it_starts_again() -> None:
    sender, receiver = medium(0), medium(1)
    late, usual = (step(sender, number, POSE)[1][0] for number in (1, 5))
    receiver.receive(usual, 6 * SECOND)
    assert (receiver.neighbors.current(6 * SECOND), receiver.neighbors.ended()) == ([0], frozenset())
    receiver.receive(farewell(sender, 9 * SECOND), 9 * SECOND)
    assert (receiver.neighbors.current(9 * SECOND), receiver.neighbors.ended()) == ([], {0})
    receiver.end_step()
    receiver.receive(late, 10 * SECOND)
    assert (receiver.neighbors.current(10 * SECOND), receiver.neighbors.ended()) == ([], {0}), (
        "an earlier frame, which came late"
    )
    assert receiver.end_step()[0] == Broadcasts(0, [Delivery(0, POSE)])
    again = Sealer(KEY, 0, 2)
    receiver.receive(again.seal(b""), 11 * SECOND)
    assert (receiver.neighbors.current(11 * SECOND), receiver.neighbors.ended()) == ([0], frozenset())


def test_a_farewell_waits_for_the_budget() -> None:
    end = medium(0)
    step(end, 1, POSE, REPORT * 90)
    assert not end.say_farewell(SECOND + SECOND // 10)
    end.poll(20 * SECOND)
    farewell(end, 20 * SECOND)
