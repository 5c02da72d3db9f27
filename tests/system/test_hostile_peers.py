"""Byzantine robots in a team: they are reported, and the others still share their maps."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from agent.settings import Settings
from deploy.run.in_memory import MemoryRun
from protocol import keys as names
from protocol import packet_codec, packet_index
from protocol.bus import Bus
from protocol.grid import FREE, UNKNOWN
from protocol.message_codec import pack, unpack
from protocol.messages import (
    EVERYONE,
    MediumEvent,
    Open,
    OutgoingFrame,
    RobotFrames,
)
from protocol.packet_codec import encode
from protocol.packets import (
    DECLINED,
    Block,
    Change,
    Delete,
    Emerge,
    Fragment,
    From,
    FromFirst,
    Gone,
    Held,
    Insert,
    Packet,
    Save,
    Update,
)
from tests.system.team import Member, Team, small_plan

BYZANTINE = 1

MALFORMED_DATA: dict[str, list[Packet]] = {
    "an object that is not there": [Change(77, 2, 0), Delete(0), Save()],
    "an index beyond the last": [Emerge(4000, 2, 0), Insert(9, 1, 1, 0, 0)],
    "a cell beyond the map": [Emerge(4000, 2, 0), Insert(0, 4000, 4000, 0, 0)],
    "another count than announced": [Emerge(4000, 5, 0), Insert(0, 1, 1, 0, 0), Save()],
    "no inside object": [Emerge(4000, 2, 0), Insert(0, 1, 1, 0, 0), Insert(1, 9, 9, 0, 0), Save()],
    "two save points in a row": [Save(), Save()],
    "raw scans": [Fragment(b"noise")],
    "all of the building": [
        Emerge(0, 4, 1),
        *(Insert(i, *corner, 0, 1) for i, corner in enumerate([(1, 1), (1, 118), (118, 118), (118, 1)])),
        Save(),
    ],
}


class DataForger(Member):
    """A robot that sends forged packets in place of its data frames."""

    def __init__(self, settings: Settings, forged: list[Packet]) -> None:
        super().__init__(settings)
        self.forged = encode(forged)

    def take(self, event: MediumEvent) -> RobotFrames | None:
        frames = super().take(event)
        if frames is not None and frames.phase == "data":
            return replace(frames, frames=[replace(frame, payload=self.forged) for frame in frames.frames])
        return frames


@pytest.mark.parametrize("case", MALFORMED_DATA)
def test_a_byzantine_robot_is_reported_and_honest_robots_still_share_their_maps(
    case: str,
) -> None:
    plan = small_plan("office", robots=3, bandwidth="unlimited")
    team = Team(plan, {BYZANTINE: DataForger(plan.robot_settings[BYZANTINE], MALFORMED_DATA[case])})
    team.explore(200)
    assert any(move.explored for move in team.moves.values())
    for number in (0, 2):
        robot = team.members[number].robot
        assert robot.replication.replica.distrusted <= {BYZANTINE}
        assert {error.peer for error in robot.peer_errors} == {BYZANTINE}
        assert robot.peer_errors[0].reason
        assert team.held(number, 2 - number) == team.held(2 - number, 2 - number)
        if case != "all of the building":  # a robot that repeats this claim later may have been everywhere
            assert team.held(number, BYZANTINE) is None
            assert not (team.truth != FREE)[robot.planning == FREE].any()
    assert not team.members[BYZANTINE].robot.replication.replica.distrusted


class _Forger:
    """A bus connection that replaces the data frames of its robot by malformed ones."""

    def __init__(self, inner: Bus) -> None:
        self._inner = inner
        self.receive = inner.receive
        self.close = inner.close

    def put(self, key: str, payload: bytes) -> None:
        message = unpack(payload)
        if isinstance(message, RobotFrames):
            forged, edits = encode(MALFORMED_DATA["two save points in a row"]), ("em", "chg", "rm")
            frames = [
                replace(frame, payload=forged) if packet_codec.name(frame.payload) in edits else frame
                for frame in message.frames
            ]
            payload = pack(replace(message, frames=frames))
        self._inner.put(key, payload)


def test_a_byzantine_robot_is_named_in_the_records() -> None:
    def wrap(name: str, bus: Bus) -> Bus:
        return _Forger(bus) if name == names.robot(BYZANTINE) else bus

    records = MemoryRun(small_plan(robots=3, steps=30), wrap=wrap).complete()
    assert set(records.protocol_errors.texts) >= {
        f"{names.robot(honest)}: malformed message from {names.robot(BYZANTINE)}: "
        "save at byte 0: nothing has changed since the last save point"
        for honest in (0, 2)
    }
    assert records.lost == {}


MALFORMED_UPDATES: dict[str, list[Packet]] = {
    "an entry of noise": [Update(0, bytes(range(1, 60)))],
    "another entry than its next": [Update(1, b"ab")],
    "raw scans": [Fragment(b"noise")],
    "another's map": [FromFirst(2, 0), Update(0, bytes(range(1, 60)))],
    "reports of maps that no robot has": [Held(2, 4000), Held(0, 4000), Gone(0), Gone(2)],
    "a map from its middle on": [From(1, 4000), Update(0, b"ab")],
}


class GossipForger(Member):
    """A robot that broadcasts forged packets in place of its updates, in each round and with the highest priority."""

    def __init__(self, settings: Settings, forged: list[Packet]) -> None:
        super().__init__(settings)
        self.forged = encode(forged)

    def take(self, event: MediumEvent) -> RobotFrames | None:
        frames = super().take(event)
        if isinstance(event, Open) and event.peers:
            forged = [OutgoingFrame(EVERYONE, self.forged)]
            return RobotFrames(event.step, event.round, "offers", b"", forged, 10**6)
        return frames


@pytest.mark.parametrize("case", MALFORMED_UPDATES)
@pytest.mark.parametrize("bandwidth", ["unlimited", 120])
def test_malformed_broadcasts_do_not_keep_honest_robots_from_sharing_their_maps(
    case: str, bandwidth: str | int
) -> None:
    plan = small_plan(
        "office", robots=4, map_encoding="predictive", dissemination="gossip", bandwidth=bandwidth, seed=2
    )
    team = Team(plan, {BYZANTINE: GossipForger(plan.robot_settings[BYZANTINE], MALFORMED_UPDATES[case])})
    team.explore(400)
    assert any(move.explored for move in team.moves.values())
    honest = [team.members[number].robot for number in (0, 2, 3)]
    if case != "another's map":
        seen = np.max([robot.own for robot in honest], axis=0)
        for robot in honest:
            wrong = (robot.planning != seen) & (seen != UNKNOWN)
            assert wrong.mean() < 0.01
    for robot in honest:
        assert not (team.truth != robot.own)[robot.own != UNKNOWN].any()
        assert {error.peer for error in robot.peer_errors} <= {BYZANTINE}


class Garbler(Member):
    """A robot whose updates are truncated, repeated or reversed, in turn."""

    def take(self, event: MediumEvent) -> RobotFrames | None:
        frames = super().take(event)
        if isinstance(event, Open) and frames is not None:
            garbled = [
                replace(frame, payload=self._garbled(frame.payload, event.step % 3))
                for frame in frames.frames
            ]
            return replace(frames, frames=garbled)
        return frames

    def _garbled(self, frame: bytes, way: int) -> bytes:
        data = packet_index.split(frame)
        return b"".join((data[::-1], data + data, data[: len(data) // 2 + 1])[way])


@pytest.mark.parametrize("kind", ["noise", "garbled"])
def test_one_byzantine_robot_among_eight_does_not_stop_the_others(kind: str) -> None:
    plan = small_plan(
        "office", robots=8, map_encoding="predictive", dissemination="gossip", bandwidth=200, seed=4
    )
    settings = plan.robot_settings[BYZANTINE]
    rogue = (
        GossipForger(settings, MALFORMED_UPDATES["an entry of noise"])
        if kind == "noise"
        else Garbler(settings)
    )
    team = Team(plan, {BYZANTINE: rogue})
    team.explore(400)
    assert any(move.explored for move in team.moves.values())
    honest = [robot for number, robot in enumerate(team.robots) if number != BYZANTINE]
    seen = np.max([robot.own for robot in honest], axis=0)
    for robot in honest:
        assert ((robot.planning != seen) & (seen != UNKNOWN)).mean() < 0.01
        assert {error.peer for error in robot.peer_errors} <= {BYZANTINE}


def test_a_malformed_entry_is_reported() -> None:
    plan = small_plan(
        "office", robots=3, map_encoding="predictive", dissemination="gossip", bandwidth="unlimited"
    )
    rogue = GossipForger(plan.robot_settings[BYZANTINE], MALFORMED_UPDATES["an entry of noise"])
    team = Team(plan, {BYZANTINE: rogue})
    team.explore(10)
    for number in (0, 2):
        robot = team.members[number].robot
        assert {error.peer for error in robot.peer_errors} == {BYZANTINE}
        assert robot.peer_errors[0].reason


class Decliner(Member):
    """A robot that declines every offer."""

    def take(self, event: MediumEvent) -> RobotFrames | None:
        frames = super().take(event)
        if frames is not None and frames.phase == "answers":
            declined = [replace(frame, payload=encode([Block(DECLINED)])) for frame in frames.frames]
            return replace(frames, frames=declined)
        return frames


def test_a_robot_that_declines_everything_silences_no_robot() -> None:
    plan = small_plan("office", robots=3, bandwidth="unlimited")
    team = Team(plan, {BYZANTINE: Decliner(plan.robot_settings[BYZANTINE])})
    plain = Team(plan)
    team.explore(400)
    plain.explore(400)
    for number in (0, 2):
        logged, usual = (len(some.robots[number].replication.logs[number]) for some in (team, plain))
        assert logged > usual / 2
        assert team.held(number, 2 - number) == team.held(2 - number, 2 - number)
