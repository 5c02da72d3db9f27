"""The radio with gossip: receivers, order of senders, and refused frames."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netshaper.airtime import BROADCAST_PART
from netshaper.ledger import BROADCAST, EVERYONE, NEWS
from netshaper.settings import RadioSettings
from protocol import packet_index, packets
from protocol.budget import UNLIMITED, Budget
from protocol.messages import Open, OutgoingFrame, RobotFrames
from protocol.packet_codec import encode
from protocol.packets import Offer, Save, Target
from tests.netshaper.network import Network
from tests.netshaper.scenes import gossip, play
from tests.netshaper.scripted_robots import Gossiper, Mute


class Sends(Gossiper):
    """A robot that sends the same frames in every round: a target, a frame, a priority."""

    def __init__(self, number: int, broadcast: bytes, *frames: OutgoingFrame, priority: int = 0) -> None:
        super().__init__(number, 0, 0)
        self.broadcast, self.frames, self.priority = broadcast, list(frames), priority

    def opens(self, event: Open) -> list[RobotFrames]:
        broadcast = b"" if event.round else self.broadcast
        return [RobotFrames(event.step, event.round, "offers", broadcast, self.frames, self.priority)]


def entry(size: int) -> OutgoingFrame:
    return OutgoingFrame(EVERYONE, encode([packets.Fragment(bytes(size))]))


@given(gossip())
def test_news_reach_all_robots_in_range_and_reports_have_the_carried_bytes(scene: Any) -> None:
    silent = {
        number for number, robot in scene[1].items() if isinstance(robot, Mute)
    }  # lost, so they receive nothing
    for step in play(scene, deadly=False):
        reach = {robot: [*{*event.peers} - silent] for robot, event in step.opened}
        carried: Counter[tuple[int, int]] = Counter()
        received: Counter[int] = Counter()
        for row in step.rows[(step.rows["frame"] == NEWS) & (step.rows["carried"] == 1)]:
            sender, size = int(row["sender"]), int(row["bytes"])
            assert int(row["received_by"]) == len(reach[sender])
            carried[sender, int(row["round"])] += size
            received[sender] += size * len(reach[sender])
        reported = Counter({(robot, r.round): sum(each.sent for each in r.sent) for robot, r in step.reports})
        assert +reported == +carried
        delivered: Counter[int] = Counter()
        for frame in step.delivered:
            if frame.kind == "data":
                delivered[frame.sender] += len(frame.payload)
        assert delivered == +received


@given(gossip())
def test_news_are_cut_between_packets(scene: Any) -> None:
    for step in play(scene):
        for frame in step.delivered:
            if frame.kind == "data":
                assert b"".join(packet_index.split(frame.payload)) == frame.payload


def test_news_of_the_highest_priority_go_first_and_a_shorter_packet_may_use_the_rest() -> None:
    robots = {n: Sends(n, b"", entry(size), priority=10 * n % 20) for n, size in enumerate((40, 30, 3))}
    network = Network(RadioSettings(3, 0, math.inf, Budget(40), 1, gossip=True), robots)
    rows = network.step(1, {number: (number, 0) for number in range(3)}).rows
    assert [(int(row["sender"]), int(row["carried"])) for row in rows] in (
        [(1, 1), (0, 0), (2, 1)],
        [(1, 1), (2, 1), (0, 0)],
    )


@pytest.mark.parametrize(
    ("payload", "receiver", "reason"),
    [
        (encode([Offer(1, 0)]), EVERYONE, "no Offer of this kind"),
        (encode([Target(1, 2), Save()]), EVERYONE, "no targ of this kind"),
        (6 * b"\xff", EVERYONE, "no packet begins with 0xffff"),
        (b"", EVERYONE, "nothing in it"),
        (encode([Save()]), 1, "sent to one robot"),
    ],
)
def test_frames_that_are_not_news_are_refused_and_logged(payload: bytes, receiver: int, reason: str) -> None:
    network = Network(
        RadioSettings(2, 0, math.inf, UNLIMITED, 1, gossip=True),
        {0: Sends(0, b"", OutgoingFrame(receiver, payload)), 1: Sends(1, b"")},
    )
    step = network.step(1, {0: (0, 0), 1: (1, 0)})
    assert not step.delivered
    ((sender, why),) = network.radio.protocol_errors
    assert sender == 0
    assert reason in why
    assert step.rows["bytes"].sum() == len(payload)


def test_targets_leave_most_of_a_narrow_medium_to_news() -> None:
    robots = {n: Sends(n, encode([Target(n, 1)]), entry(6)) for n in range(8)}
    network = Network(RadioSettings(8, 0, math.inf, Budget(48), 1, gossip=True), robots)
    rows = network.step(1, {number: (number, 0) for number in range(8)}).rows
    carried = rows[rows["carried"] == 1]
    assert carried["bytes"][carried["frame"] == BROADCAST].sum() == 3
    assert carried["bytes"][carried["frame"] == NEWS].sum() == 40


def broadcast_bytes(
    robots: int, budget: int, broadcast: bytes, steps: int, *, left: int, has_short: bool = False
) -> list[int]:
    """Return the bytes of broadcasts carried in each step, if robots always have one, and news that leave `left`.

    `has_short`: robot 0 has news of 3 bytes instead, of a lower priority.
    """
    long = entry(min(budget - 2 - left, 63))
    sending = {n: Sends(n, broadcast, long, priority=1) for n in range(robots)}
    if has_short:
        sending[0] = Sends(0, broadcast, entry(1))
    network = Network(RadioSettings(robots, 0, math.inf, Budget(budget), 1, gossip=True), sending)
    cells = {number: (number, 0) for number in range(robots)}
    every = [network.step(step, cells).rows for step in range(1, steps + 1)]
    return [int(rows["bytes"][(rows["carried"] == 1) & (rows["frame"] == BROADCAST)].sum()) for rows in every]


POSE = encode([packets.Pose(1, 2, 0)])
POSE_AND_TARGET = encode([packets.Pose(1, 2, 0), Target(3, 4)])


def share_of_broadcasts(robots: int, budget: int) -> int:
    return max(budget // BROADCAST_PART, budget // (robots + 1), 1)


@given(
    st.integers(2, 12), st.integers(10, 41), st.sampled_from([POSE_AND_TARGET, POSE, encode([Target(3, 4)])])
)
def test_poses_and_targets_take_a_sixth_of_a_narrow_budget_or_the_share_of_one_robot(
    robots: int, budget: int, broadcast: bytes
) -> None:
    carried = broadcast_bytes(robots, budget, broadcast, 24, left=2, has_short=True)
    share = share_of_broadcasts(robots, budget)
    assert max(carried) > 0
    assert sum(carried) <= 24 * share + len(broadcast)
    assert sum(carried) >= 24 * min(share, len(broadcast)) - share - len(broadcast)


@given(st.integers(2, 12), st.integers(14, 41), st.sampled_from([POSE_AND_TARGET, POSE]))
def test_poses_beside_which_no_news_fit_pay_for_the_whole_budget(
    robots: int, budget: int, broadcast: bytes
) -> None:
    """Robots always have a pose, and news that leave three bytes: they exclude each other."""
    carried = broadcast_bytes(robots, budget, broadcast, 60, left=3)
    steps = 60 * share_of_broadcasts(robots, budget) / budget
    assert steps - 1 <= np.count_nonzero(carried) <= steps + 1


@given(st.integers(2, 12), st.integers(10, 17))
def test_a_target_that_waits_uses_what_news_leave(robots: int, budget: int) -> None:
    assert broadcast_bytes(robots, budget, encode([Target(3, 4)]), 24, left=3) == 24 * [3]


@given(st.integers(2, 12), st.integers(42, 200))
def test_a_wide_medium_carries_a_pose_and_a_target_in_each_step(robots: int, budget: int) -> None:
    carried = broadcast_bytes(robots, budget, POSE_AND_TARGET, 8, left=2, has_short=True)
    size = len(POSE_AND_TARGET)
    frames = min(robots, max(1, budget // (robots + 1) // size))
    assert carried == 8 * [frames * size]
