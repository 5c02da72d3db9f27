"""A peer that sends arbitrary frames: none stops a robot, corrupts its maps, or goes unreported."""

from __future__ import annotations

from functools import cache

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from agent.encodings.polygons import PolygonEncoding
from agent.process import AgentNode
from agent.robot import Robot
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol import map_parts, messages, packet_codec, packet_index
from protocol.budget import Budget
from protocol.bus import Message
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, ray_table
from protocol.keys import Keys
from protocol.message_codec import pack, unpack
from protocol.messages import (
    Broadcasts,
    Close,
    Configure,
    ConnectionReport,
    Delivery,
    ErrorReport,
    MapPart,
    MediumEvent,
    Move,
    Open,
    PhaseDelivery,
    RequestMaps,
    RobotFrames,
    RoundReport,
    Sense,
)
from protocol.packet_codec import encode
from protocol.packets import (
    DECLINED,
    Answer,
    Block,
    Change,
    Delete,
    Emerge,
    Fragment,
    Insert,
    Offer,
    Packet,
    Pose,
    Remove,
    Replace,
    Save,
    Target,
)
from protocol.scans import Scan, draw
from tests.agent.outline.edit_scripts import canonical
from tests.system.team import corridor, plan_on
from worldsim.laser import cast

BYZANTINE = 1

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
    st.just(Block(DECLINED)),
    st.builds(Target, st.integers(0, 40) | st.just(2047), st.integers(0, 10)),
    st.builds(Pose, st.integers(0, 40) | st.just(2047), st.integers(0, 10), bit),
)


def frames_of(*kinds: st.SearchStrategy[Packet]) -> st.SearchStrategy[bytes]:
    return st.lists(st.one_of(kinds), max_size=8).map(encode)


def valid_map(draw: st.DrawFn) -> bytes:
    """A well-formed map update."""
    corners = draw(st.lists(st.tuples(*vertex), min_size=2, max_size=6, unique=True))
    return encode([Emerge(0, len(corners), 1), *(Insert(i, *v) for i, v in enumerate(corners)), Save()])


data_frames = st.one_of(
    frames_of(edits), frames_of(edits, others), st.composite(valid_map)(), st.binary(max_size=40)
)
any_frames = st.lists(
    st.one_of(frames_of(edits, others), frames_of(others), st.binary(max_size=9)), max_size=3
)


@cache
def tiny_plan() -> Plan:
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
    """The sensor readings of a robot that drives along the corridor."""
    plan = tiny_plan()
    truth, (x, y) = plan.map.cells, (3 + step, 4)
    readings = cast(truth, np.zeros(truth.shape, np.bool_), ray_table(plan.world.bodies[0].range_cells), x, y)
    return Sense(step, x, y, 0, b"", readings.tobytes(), "", 0, 0)


@cache
def honest_updates() -> list[tuple[bytes, object]]:
    """The map updates of robot 2 in each step, and the polygons that they encode."""
    settings = tiny_plan().robot_settings[2]
    map_encoding = PolygonEncoding(settings)
    own = np.full((HEIGHT, WIDTH), UNKNOWN, np.uint8)
    updates: list[tuple[bytes, object]] = []
    for step in range(1, 1 + STEPS):
        sense = sensed(step)
        scan = Scan(sense.x, sense.y, np.frombuffer(sense.readings, np.uint16).copy())
        change = draw(own, ray_table(settings.body.range_cells), scan.x, scan.y, scan.readings)
        entries = map_encoding.encode_changes(own, scan, change, delivered=True)
        updates.append((b"".join(entries), canonical(map_encoding.polygons[2])))
    return updates


@given(st.lists(data_frames, min_size=1, max_size=STEPS))
def test_hostile_data_never_stops_a_robot_nor_changes_a_saved_state(frames: list[bytes]) -> None:
    robot = Robot(tiny_plan().robot_settings[0])
    for step, frame in enumerate(frames, 1):
        robot.perceive(sensed(step))
        robot.replication.open_round(0, [BYZANTINE, 2], 1000)
        robot.replication.answer(
            [Delivery(BYZANTINE, encode([Offer(BYZANTINE, 0)]), 0), Delivery(2, encode([Offer(2, 0)]), 1)]
        )
        before = robot.polygons.get(BYZANTINE)
        data, meant = honest_updates()[step - 1]
        robot.close_round(round_report(step, [(BYZANTINE, frame), (2, data)]))
        now = robot.polygons.get(BYZANTINE)
        if now is not before:
            assert now is not None
            assert now.inside.sum() == 1
            assert encode([Save()]) in packet_index.split(frame)
            assert BYZANTINE not in robot.replication.replica.distrusted
        assert robot.replication.replica.distrusted <= {BYZANTINE}
        assert (
            robot.replication.replica.distrusted <= {error.peer for error in robot.peer_errors} <= {BYZANTINE}
        )
        assert canonical(robot.polygons[2]) == meant
        assert robot.decide().step == step


def test_a_robot_whose_own_map_contradicts_a_forged_copy_is_not_distrusted() -> None:
    robot = Robot(tiny_plan().robot_settings[0])
    forged = encode([Emerge(7, 2, 1), Insert(0, 1, 1, 0, 0), Insert(1, 9, 1, 0, 0), Save()])
    maps = [data for data, _ in honest_updates()]

    def receive(step: int, peer: int, map_id: int, data: bytes) -> None:
        robot.replication.open_round(0, [BYZANTINE, 2], 1000)
        robot.replication.answer([Delivery(peer, encode([Offer(map_id, 0)]), 0)])
        robot.close_round(round_report(step, [(peer, data)]))

    robot.perceive(sensed(1))
    receive(1, BYZANTINE, 2, forged)
    receive(2, 2, 2, maps[1])
    assert [error.peer for error in robot.peer_errors] == [2]
    assert robot.replication.replica.distrusted == set()
    receive(3, 2, 1, maps[0])
    assert canonical(robot.polygons[1]) == honest_updates()[0][1]
    receive(4, BYZANTINE, 2, encode([Save(), Save()]))
    assert [error.peer for error in robot.peer_errors] == [2, BYZANTINE]


def test_a_robot_that_forwards_one_of_two_versions_of_a_byzantine_robot_s_map_is_not_distrusted() -> None:
    honest, deceived = (Robot(tiny_plan().robot_settings[number]) for number in (0, 2))

    def outline(corners: int) -> bytes:
        return encode([Emerge(0, corners, 1), *(Insert(i, 3 + i, 3, 0, 0) for i in range(corners)), Save()])

    def receive(robot: Robot, peer: int, map_id: int, data: bytes) -> None:
        robot.replication.open_round(0, [peer], 1000)
        robot.replication.answer([Delivery(peer, encode([Offer(map_id, 0)]), 0)])
        robot.close_round(round_report(1, [(peer, data)]))

    for robot in (honest, deceived):
        robot.perceive(sensed(1))
    receive(deceived, BYZANTINE, BYZANTINE, outline(2))
    receive(honest, BYZANTINE, BYZANTINE, outline(6) + encode([Change(0, 5, 1), Delete(5), Save()]))
    passed_on = honest.replication.logs[BYZANTINE].read(len(deceived.replication.logs[BYZANTINE]), None)
    receive(deceived, 0, BYZANTINE, passed_on)
    assert [error.peer for error in deceived.peer_errors] == [0]
    assert deceived.replication.replica.distrusted == set()
    receive(deceived, 0, BYZANTINE, passed_on)
    assert len(deceived.peer_errors) == 1, "this map is not accepted from that robot again"
    receive(deceived, 0, 0, honest_updates()[0][0])
    assert canonical(deceived.polygons[0]) == honest_updates()[0][1]


class Antenna:
    """A bus connection that records the messages put on it."""

    def __init__(self) -> None:
        self.sent: list[object] = []

    def put(self, key: str, payload: bytes) -> None:
        del key
        self.sent.append(unpack(payload))

    def receive(self, timeout_s: float | None = None) -> Message | None:
        del timeout_s
        return None

    def close(self) -> None:
        """There is nothing to close."""


@given(st.lists(st.tuples(any_frames, any_frames, any_frames, any_frames), min_size=1, max_size=STEPS))
def test_no_frame_stops_a_robots_process(steps: list[tuple[list[bytes], ...]]) -> None:
    antenna, keys = Antenna(), Keys("run")
    node = AgentNode(antenna, keys, 0)

    def deliver(message: messages.Record) -> None:
        if isinstance(message, MediumEvent):
            node.handle(Message(keys.radio_rx("r0", names.RELAY), pack(messages.RelayUpdate([message]))))
        else:
            key = (
                keys.body("r0", names.WORLD)
                if isinstance(message, Sense)
                else keys.control("r0", names.RELAY)
            )
            node.handle(Message(key, pack(message)))

    deliver(Configure(0, tiny_plan().robot_settings[0].encode()))
    for step, (broadcasts, offers, answers, more) in enumerate(steps, 1):
        antenna.sent.clear()
        deliver(sensed(step))
        deliver(Broadcasts(step, [Delivery(BYZANTINE, frame) for frame in broadcasts]))
        deliver(Open(step, 0, [BYZANTINE, 2], Budget(1000)))
        numbered = [Delivery(BYZANTINE, frame, number, BYZANTINE) for number, frame in enumerate(offers)]
        deliver(PhaseDelivery(step, 0, "offers", numbered))
        deliver(
            PhaseDelivery(
                step, 0, "answers", [Delivery(BYZANTINE, frame, 90 + n, 0) for n, frame in enumerate(answers)]
            )
        )
        data = [Delivery(BYZANTINE, frame, n, BYZANTINE) for n, frame in enumerate(more[: len(offers)])]
        sizes = [len(each.payload) for each in data] + [0] * len(offers)
        reports = [ConnectionReport(n, 2, 2, size) for n, size in enumerate(sizes[: len(offers)])]
        deliver(RoundReport(step, 0, reports, [], data, False))
        deliver(Close(step))
        phases = [message.phase for message in antenna.sent if isinstance(message, RobotFrames)]
        assert phases == ["offers", "answers", "data"]
        assert [message.step for message in antenna.sent if isinstance(message, Move)] == [step]
        faults = [message.reason for message in antenna.sent if isinstance(message, ErrorReport)]
        assert faults or all(_is_a_broadcast(frame) for frame in broadcasts)
    deliver(RequestMaps(0, len(steps), 0))
    part = antenna.sent[-1]
    assert isinstance(part, MapPart)
    maps = map_parts.split(map_parts.decode(part.cells, 0, WIDTH * HEIGHT), (HEIGHT, WIDTH))
    known = maps.own != UNKNOWN
    assert (maps.planning[known] == maps.own[known]).all()


def _is_a_broadcast(frame: bytes) -> bool:
    try:
        decoded = packet_codec.decode(frame)
    except ProtocolError:
        return False
    return all(isinstance(p, Target | Pose) and p.x < WIDTH and p.y < HEIGHT for p in decoded)
