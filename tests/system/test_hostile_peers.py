"""Neighbours that lie: nothing that is said stops a robot, spoils what it holds, or goes unreported."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from agent.encodings.polygons import PolygonEncoding
from agent.process import AgentNode
from agent.robot import Robot
from agent.settings import Settings
from deploy.run import in_memory
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol import messages, packet_index, packets
from protocol.budget import Budget
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.grid import FREE, UNKNOWN, ray_table
from protocol.keys import Keys
from protocol.messages import (
    EVERYONE,
    Broadcasts,
    Close,
    Configure,
    ConnectionReport,
    Delivery,
    End,
    Fault,
    Maps,
    MediumEvent,
    Move,
    Open,
    OutgoingFrame,
    PhaseDelivery,
    RobotFrames,
    RoundReport,
    Sense,
    pack,
    unpack,
)
from protocol.packets import (
    Answer,
    Block,
    Change,
    Decline,
    Delete,
    Emerge,
    Fragment,
    From,
    FromEarly,
    Gone,
    Held,
    Insert,
    Offer,
    Packet,
    Pose,
    Remove,
    Replace,
    Save,
    Target,
    Update,
    encode,
)
from protocol.scans import Scan, draw
from tests.system.team import Member, Team, corridor, plan_on, small_plan
from worldsim.laser import cast

LIAR = 1

LIES: dict[str, list[Packet]] = {
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


class Liar(Member):
    """A robot that sends nonsense wherever it should send data."""

    def __init__(self, settings: Settings, lie: list[Packet]) -> None:
        super().__init__(settings)
        self.lie = encode(lie)

    def take(self, event: MediumEvent) -> RobotFrames | None:
        frames = super().take(event)
        if frames is not None and frames.phase == "data":
            return replace(frames, frames=[replace(frame, payload=self.lie) for frame in frames.frames])
        return frames


@pytest.mark.parametrize("lie", LIES)
def test_a_liar_is_distrusted_and_reported_and_the_honest_go_on_with_each_other(lie: str) -> None:
    plan = small_plan("office", robots=3, bandwidth="unlimited")
    team = Team(plan, {LIAR: Liar(plan.robot_settings[LIAR], LIES[lie])})
    team.explore(200)
    assert any(move.explored for move in team.moves.values())
    for number in (0, 2):
        robot = team.robot_settings[number].robot
        assert robot.distrusted == {LIAR}
        assert {fault.peer for fault in robot.faults} == {LIAR}
        assert robot.faults[0].reason
        assert team.held(number, LIAR) is None
        assert team.held(number, 2 - number) == team.held(2 - number, 2 - number)
        assert not (team.truth != FREE)[robot.planning == FREE].any()
    assert not team.robot_settings[LIAR].robot.distrusted


class _Forger:
    """The end of the bus of a robot whose data frames somebody garbles."""

    def __init__(self, inner: Bus) -> None:
        self._inner = inner
        self.receive = inner.receive
        self.close = inner.close

    def put(self, key: str, payload: bytes) -> None:
        said = unpack(payload)
        if isinstance(said, RobotFrames):
            lie, edits = encode(LIES["two save points in a row"]), ("em", "chg", "rm")
            frames = [
                replace(frame, payload=lie) if packets.name(frame.payload) in edits else frame
                for frame in said.frames
            ]
            loads = [lie if packets.name(load) in edits else load for load in said.replies.loads]
            payload = pack(replace(said, frames=frames, replies=replace(said.replies, loads=loads)))
        self._inner.put(key, payload)


def test_a_liar_is_named_in_the_laboratorys_records() -> None:
    def wrap(name: str, bus: Bus) -> Bus:
        return _Forger(bus) if name == names.robot(LIAR) else bus

    records = in_memory.run(small_plan(robots=3, steps=30), wrap=wrap)
    assert set(records.protocol_errors) >= {
        f"{names.robot(honest)}: heard nonsense from {names.robot(LIAR)}: "
        "save at byte 0: nothing has changed since the last one"
        for honest in (0, 2)
    }
    assert records.lost == {}


# --- a neighbour that says anything --------------------------------------------------------------------

WIDTH, HEIGHT, STEPS = 32, 9, 8
side, bit, small = st.integers(0, 3), st.integers(0, 1), st.integers(0, 6)
vertex = st.integers(-1, WIDTH + 1), st.integers(-1, HEIGHT + 1), side, bit
edits = st.one_of(
    st.builds(Insert, small, *vertex),
    st.builds(Replace, small, *vertex),
    st.builds(Delete, small),
    st.builds(Emerge, small, small, bit),
    st.builds(Change, small, small, bit),
    st.builds(Remove, small),
    st.just(Save()),
)
others = st.one_of(
    st.builds(Fragment, st.binary(min_size=1, max_size=63)),
    st.builds(Offer, st.integers(0, 5), st.integers(0, 63)),
    st.builds(Answer, st.integers(0, 4095)),
    st.builds(Block, st.integers(0, 63)),
    st.just(Decline()),
    st.builds(Target, st.integers(0, 40) | st.just(2047), st.integers(0, 10)),
    st.builds(Pose, st.integers(0, 40) | st.just(2047), st.integers(0, 10), bit),
)


def a_frame(*kinds: st.SearchStrategy[Packet]) -> st.SearchStrategy[bytes]:
    return st.lists(st.one_of(kinds), max_size=8).map(encode)


def a_map(draw: st.DrawFn) -> bytes:
    """What a robot might truly say."""
    corners = draw(st.lists(st.tuples(*vertex), min_size=2, max_size=6, unique=True))
    return encode([Emerge(0, len(corners), 1), *(Insert(i, *v) for i, v in enumerate(corners)), Save()])


data_frames = st.one_of(a_frame(edits), a_frame(edits, others), st.composite(a_map)(), st.binary(max_size=40))
any_frames = st.lists(st.one_of(a_frame(edits, others), a_frame(others), st.binary(max_size=9)), max_size=3)


@cache
def a_small_plan() -> Plan:
    plan = plan_on(corridor(WIDTH - 2, HEIGHT - 4), robots=3, sensor_range=1.0)
    assert plan.map.cells.shape == (HEIGHT, WIDTH)
    return plan


def round_report(step: int, arrived: list[tuple[int, bytes]]) -> RoundReport:
    """Handshakes of which the data arrived, on connections numbered from 0."""
    carried = [ConnectionReport(number, 2, 2, len(data)) for number, (_, data) in enumerate(arrived)]
    deliveries = [Delivery(peer, data, number) for number, (peer, data) in enumerate(arrived)]
    return RoundReport(step, 0, carried, [], deliveries, False)


@cache
def sensed(step: int) -> Sense:
    """What a robot senses that drives along the corridor."""
    plan = a_small_plan()
    truth, (x, y) = plan.map.cells, (3 + step, 4)
    readings = cast(truth, np.zeros(truth.shape, np.bool_), ray_table(plan.world.bodies[0].range_cells), x, y)
    return Sense(step, x, y, 0, b"", readings.tobytes(), "", 0, 0)


@cache
def honest_words() -> list[tuple[bytes, object]]:
    """What robot 2 says of its map in each step, and what it means."""
    settings = a_small_plan().robot_settings[2]
    map_encoding = PolygonEncoding(settings)
    own = np.full((HEIGHT, WIDTH), UNKNOWN, np.uint8)
    said: list[tuple[bytes, object]] = []
    for step in range(1, 1 + STEPS):
        sense = sensed(step)
        scan = Scan(sense.x, sense.y, np.frombuffer(sense.readings, np.uint16).copy())
        change = draw(own, ray_table(settings.range_cells), scan.x, scan.y, scan.readings)
        units = map_encoding.encode_changes(own, scan, change, delivered=True)
        said.append((b"".join(units), map_encoding.polygons[2].canonical()))
    return said


@given(st.lists(data_frames, min_size=1, max_size=STEPS))
def test_hostile_data_never_stops_a_robot_nor_changes_a_saved_state(lies: list[bytes]) -> None:
    robot = Robot(a_small_plan().robot_settings[0])
    for step, lie in enumerate(lies, 1):
        robot.perceive(sensed(step))
        robot.replication.open_round(0, [LIAR, 2], 1000)
        robot.replication.answer(
            [Delivery(LIAR, encode([Offer(LIAR, 0)]), 0), Delivery(2, encode([Offer(2, 0)]), 1)]
        )
        before = robot.polygons.get(LIAR)
        words, meant = honest_words()[step - 1]
        robot.close_round(round_report(step, [(LIAR, lie), (2, words)]))
        now = robot.polygons.get(LIAR)
        if now is not before:
            assert now is not None
            assert now.inside.sum() == 1
            assert encode([Save()]) in packet_index.split(lie)
            assert LIAR not in robot.distrusted
        assert robot.distrusted <= {LIAR}
        assert {fault.peer for fault in robot.faults} == robot.distrusted
        assert robot.polygons[2].canonical() == meant
        assert robot.decide().step == step


def test_who_contradicts_a_lie_that_another_told_of_its_map_is_not_distrusted() -> None:
    robot = Robot(a_small_plan().robot_settings[0])
    forged = encode([Emerge(7, 2, 1), Insert(0, 1, 1, 0, 0), Insert(1, 9, 1, 0, 0), Save()])
    maps = [words for words, _ in honest_words()]

    def hear(step: int, peer: int, map_id: int, data: bytes) -> None:
        robot.replication.open_round(0, [LIAR, 2], 1000)
        robot.replication.answer([Delivery(peer, encode([Offer(map_id, 0)]), 0)])
        robot.close_round(round_report(step, [(peer, data)]))

    robot.perceive(sensed(1))
    hear(1, LIAR, 2, forged)
    hear(2, 2, 2, maps[1])
    assert [fault.peer for fault in robot.faults] == [2]
    assert robot.distrusted == set()
    hear(3, 2, 1, maps[0])
    assert robot.polygons[1].canonical() == honest_words()[0][1]
    hear(4, LIAR, 2, encode(LIES["two save points in a row"]))
    assert robot.distrusted == {LIAR}


def test_who_passes_on_one_of_two_stories_of_a_liar_is_not_distrusted() -> None:
    honest, deceived = (Robot(a_small_plan().robot_settings[number]) for number in (0, 2))

    def outline(corners: int) -> bytes:
        return encode([Emerge(0, corners, 1), *(Insert(i, 3 + i, 3, 0, 0) for i in range(corners)), Save()])

    def hear(robot: Robot, peer: int, map_id: int, data: bytes) -> None:
        robot.replication.open_round(0, [peer], 1000)
        robot.replication.answer([Delivery(peer, encode([Offer(map_id, 0)]), 0)])
        robot.close_round(round_report(1, [(peer, data)]))

    for robot in (honest, deceived):
        robot.perceive(sensed(1))
    hear(deceived, LIAR, LIAR, outline(2))
    hear(honest, LIAR, LIAR, outline(6) + encode([Change(0, 5, 1), Delete(5), Save()]))
    passed_on = honest.replication.logs[LIAR].read(len(deceived.replication.logs[LIAR]), None)
    hear(deceived, 0, LIAR, passed_on)
    assert [fault.peer for fault in deceived.faults] == [0]
    assert deceived.distrusted == set()
    hear(deceived, 0, LIAR, passed_on)
    assert len(deceived.faults) == 1, "this map is not taken from there again"
    hear(deceived, 0, 0, honest_words()[0][0])
    assert deceived.polygons[0].canonical() == honest_words()[0][1]


NONSENSE: dict[str, list[Packet]] = {
    "a unit of noise": [Update(0, bytes(range(1, 60)))],
    "another unit than its next": [Update(3, b"ab")],
    "raw scans": [Fragment(b"noise")],
    "another's map": [FromEarly(2, 0), Update(0, bytes(range(1, 60)))],
    "reports of maps that nobody has": [Held(2, 4000), Held(0, 4000), Gone(0), Gone(2)],
    "a map from its middle on": [From(1, 4000), Update(0, b"ab")],
}


class Gossip(Member):
    """A robot that says its lie wherever it should say news, as often and as urgently as it can."""

    def __init__(self, settings: Settings, lie: list[Packet]) -> None:
        super().__init__(settings)
        self.lie = encode(lie)

    def take(self, event: MediumEvent) -> RobotFrames | None:
        frames = super().take(event)
        if isinstance(event, Open) and event.peers:
            lie = [OutgoingFrame(EVERYONE, self.lie)]
            return RobotFrames(event.step, event.round, "offers", b"", lie, 10**6)
        return frames


@pytest.mark.parametrize("lie", NONSENSE)
@pytest.mark.parametrize("bandwidth", ["unlimited", 120])
def test_who_lies_to_all_does_not_stop_the_honest_from_sharing_all_they_see(
    lie: str, bandwidth: str | int
) -> None:
    plan = small_plan(
        "office", robots=4, map_encoding="predictive", dissemination="gossip", bandwidth=bandwidth, seed=2
    )
    team = Team(plan, {LIAR: Gossip(plan.robot_settings[LIAR], NONSENSE[lie])})
    team.explore(400)
    assert any(move.explored for move in team.moves.values())
    honest = [team.robot_settings[number].robot for number in (0, 2, 3)]
    if lie != "another's map":
        seen = np.max([robot.own for robot in honest], axis=0)
        for robot in honest:
            wrong = (robot.planning != seen) & (seen != UNKNOWN)
            assert wrong.mean() < 0.01
    for robot in honest:
        assert not (team.truth != robot.own)[robot.own != UNKNOWN].any()
        assert {fault.peer for fault in robot.faults} <= {LIAR}


class Hoarse(Member):
    """A robot whose news are cut, said twice, or turned round: each time in another way."""

    def take(self, event: MediumEvent) -> RobotFrames | None:
        frames = super().take(event)
        if isinstance(event, Open) and frames is not None:
            spoilt = [
                replace(frame, payload=self._spoilt(frame.payload, event.step % 3)) for frame in frames.frames
            ]
            return replace(frames, frames=spoilt)
        return frames

    def _spoilt(self, frame: bytes, way: int) -> bytes:
        words = packet_index.split(frame)
        return b"".join((words[::-1], words + words, words[: len(words) // 2 + 1])[way])


@pytest.mark.parametrize("liar", ["noise", "hoarse"])
def test_one_liar_among_eight_does_not_stop_the_honest(liar: str) -> None:
    plan = small_plan(
        "office", robots=8, map_encoding="predictive", dissemination="gossip", bandwidth=200, seed=4
    )
    settings = plan.robot_settings[LIAR]
    mind = Gossip(settings, NONSENSE["a unit of noise"]) if liar == "noise" else Hoarse(settings)
    team = Team(plan, {LIAR: mind})
    team.explore(400)
    assert any(move.explored for move in team.moves.values())
    honest = [robot for number, robot in enumerate(team.robots) if number != LIAR]
    seen = np.max([robot.own for robot in honest], axis=0)
    for robot in honest:
        assert ((robot.planning != seen) & (seen != UNKNOWN)).mean() < 0.01
        assert {fault.peer for fault in robot.faults} <= {LIAR}


def test_a_unit_of_a_liar_that_makes_no_sense_is_reported_and_no_more_is_taken_from_it() -> None:
    plan = small_plan(
        "office", robots=3, map_encoding="predictive", dissemination="gossip", bandwidth="unlimited"
    )
    liar = Gossip(plan.robot_settings[LIAR], NONSENSE["a unit of noise"])
    team = Team(plan, {LIAR: liar})
    team.explore(10)
    for number in (0, 2):
        robot = team.robot_settings[number].robot
        assert robot.distrusted == {LIAR}
        assert [fault.peer for fault in robot.faults] == [LIAR]
        assert robot.faults[0].reason


class Decliner(Member):
    """A robot that wants nothing."""

    def take(self, event: MediumEvent) -> RobotFrames | None:
        frames = super().take(event)
        if frames is not None and frames.phase == "answers":
            declined = [replace(frame, payload=encode([Decline()])) for frame in frames.frames]
            return replace(frames, frames=declined)
        return frames


def test_who_wants_nothing_silences_nobody() -> None:
    plan = small_plan("office", robots=3, bandwidth="unlimited")
    team = Team(plan, {LIAR: Decliner(plan.robot_settings[LIAR])})
    plain = Team(plan)
    team.explore(400)
    plain.explore(400)
    for number in (0, 2):
        told, usual = (len(some.robots[number].replication.logs[number]) for some in (team, plain))
        assert told > usual / 2
        assert team.held(number, 2 - number) == team.held(2 - number, 2 - number)


class Antenna:
    """A bus end that keeps what is put on it."""

    def __init__(self) -> None:
        self.said: list[object] = []

    def put(self, key: str, payload: bytes) -> None:
        del key
        self.said.append(unpack(payload))

    def receive(self, timeout_s: float | None = None) -> Message | None:
        del timeout_s
        return None

    def close(self) -> None:
        """Nobody listens."""


@given(st.lists(st.tuples(any_frames, any_frames, any_frames, any_frames), min_size=1, max_size=STEPS))
def test_no_frame_stops_a_robots_process(steps: list[tuple[list[bytes], ...]]) -> None:
    antenna, keys = Antenna(), Keys("lies")
    node = AgentNode(antenna, keys, 0)

    def tell(message: messages.Record) -> None:
        if isinstance(message, MediumEvent):
            node.handle(Message(keys.radio_rx("r0", names.RELAY), pack(messages.RelayUpdate([message]))))
        else:
            key = (
                keys.body("r0", names.WORLD)
                if isinstance(message, Sense)
                else keys.control("r0", names.RELAY)
            )
            node.handle(Message(key, pack(message)))

    tell(Configure(0, a_small_plan().robot_settings[0].encode()))
    for step, (broadcasts, offers, answers, more) in enumerate(steps, 1):
        antenna.said.clear()
        tell(sensed(step))
        tell(Broadcasts(step, [Delivery(LIAR, frame) for frame in broadcasts]))
        tell(Open(step, 0, [LIAR, 2], Budget(1000)))
        numbered = [Delivery(LIAR, frame, number, LIAR) for number, frame in enumerate(offers)]
        tell(PhaseDelivery(step, 0, "offers", numbered))
        tell(
            PhaseDelivery(
                step, 0, "answers", [Delivery(LIAR, frame, 90 + n, 0) for n, frame in enumerate(answers)]
            )
        )
        data = [Delivery(LIAR, frame, n, LIAR) for n, frame in enumerate(more[: len(offers)])]
        sizes = [len(each.payload) for each in data] + [0] * len(offers)
        reports = [ConnectionReport(n, 2, 2, size) for n, size in enumerate(sizes[: len(offers)])]
        tell(RoundReport(step, 0, reports, [], data, False))
        tell(Close(step))
        phases = [said.phase for said in antenna.said if isinstance(said, RobotFrames)]
        assert phases == ["offers", "answers", "data"]
        assert [said.step for said in antenna.said if isinstance(said, Move)] == [step]
        faults = [said.what for said in antenna.said if isinstance(said, Fault)]
        assert faults or all(_is_a_broadcast(frame) for frame in broadcasts)
    tell(End(len(steps), "enough", -1))
    maps = antenna.said[-1]
    assert isinstance(maps, Maps)
    known, plan = np.frombuffer(maps.own, np.uint8), np.frombuffer(maps.planning, np.uint8)
    assert (plan[known != UNKNOWN] == known[known != UNKNOWN]).all()


def _is_a_broadcast(frame: bytes) -> bool:
    try:
        said = packets.decode(frame)
    except ProtocolError:
        return False
    return all(isinstance(p, Target | Pose) and p.x < WIDTH and p.y < HEIGHT for p in said)
