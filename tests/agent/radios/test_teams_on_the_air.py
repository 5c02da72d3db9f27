"""Teams without a relay: maps agree after loss and a partition, attackers change nothing, robots restart."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.field import team_context
from agent.radios.options import LinkOptions
from agent.radios.sealing import KEY_BYTES, Sealer
from agent.radios.transport import Transport
from protocol.grid import UNKNOWN
from protocol.nanoseconds import SECOND
from tests.agent.radios.air_team import KEY, AirTeam, assert_maps_agree, exchange_all
from tests.agent.radios.memory_air import Faults, MemoryAir
from tests.system.team import small_plan

TEAM: dict[str, Any] = {
    "side_m": 10.0, "map_encoding": "predictive", "strategy": "repairmen", "dissemination": "gossip", "seed": 4,
}  # fmt: skip
OPTIONS = LinkOptions("udp", interface="lo", bytes_per_s=1000)
ROUGH = Faults(loss=0.1, duplication=0.1, delay=SECOND // 2)

Tap = Callable[[Transport, int], Transport]


def on_the_air(
    state: Path,
    robots: int,
    *,
    options: LinkOptions = OPTIONS,
    apart: range = range(0),
    tap: Tap | None = None,
    late: Collection[int] = (),
    **settings: Any,
) -> AirTeam:
    """A team on an air that loses frames; during the seconds `apart`, the first two robots are out of range."""

    def separated(sender: int, receiver: int, now: int) -> bool:
        return now // SECOND in apart and (sender < 2) != (receiver < 2)

    def set_time(now: int) -> None:
        air.now = now

    def join(number: int) -> Transport:
        end = air.join(number, options.longest)
        return end if tap is None else tap(end, number)

    air = MemoryAir(7, ROUGH, separated)
    return AirTeam(small_plan(robots=robots, **(TEAM | settings)), options, join, state, set_time, late)


def test_maps_agree_after_loss_and_a_partition(tmp_path: Path) -> None:
    team = on_the_air(tmp_path, 4, apart=range(15, 75))
    team.explore(50)
    cells = [int(np.count_nonzero(robot.planning)) for robot in team.robots]
    assert len(set(cells)) > 1
    team.explore(300)
    exchange_all(team, 200)
    assert_maps_agree(team)


def test_a_team_with_fifty_bytes_per_second_shares_its_map(tmp_path: Path) -> None:
    options = LinkOptions("udp", interface="lo", bytes_per_s=25, frame_bytes=100)
    team = on_the_air(tmp_path, 2, options=options)
    team.explore(300)
    exchange_all(team, 300)
    assert_maps_agree(team)
    assert team.sent_bytes() <= 2 * (100 + 25 * (team.step + 1))


class Attacked:
    """A transport near attackers, which repeat and damage all frames that arrive, and send their own."""

    def __init__(self, transport: Transport, number: int) -> None:
        self._transport = transport
        self._recorded: list[bytes] = []
        self._stranger = Sealer(bytes(KEY_BYTES), 1 - number % 2, 9)
        self.send, self.fileno, self.close = transport.send, transport.fileno, transport.close

    def receive(self) -> list[bytes]:
        frames = self._transport.receive()
        self._recorded += frames
        forged = [self._stranger.seal(frame) for frame in frames]
        damaged = [frame[:-1] + bytes([frame[-1] ^ 1]) for frame in frames]
        return [*forged, *damaged, *frames, *(self._recorded if frames else [])]


def test_a_stranger_and_a_replaying_attacker_change_nothing(tmp_path: Path) -> None:
    plain = on_the_air(tmp_path / "plain", 3, apart=range(10, 30))
    attacked = on_the_air(tmp_path / "attacked", 3, apart=range(10, 30), tap=Attacked)
    for _ in range(45):
        plain.play()
        attacked.play()
        for one, other in zip(plain.robots, attacked.robots, strict=True):
            assert np.array_equal(one.planning, other.planning)
        assert plain.moves == attacked.moves
    for number, member in attacked.members.items():
        assert member.sent == plain.members[number].sent
        dropped = member.medium.dropped
        assert dropped["replayed"] > 20
        assert dropped["not authentic"] > 20
        assert not member.robot.peer_errors


def test_a_restarted_robot_continues_and_frames_of_its_former_life_are_dropped(tmp_path: Path) -> None:
    team = on_the_air(tmp_path, 3)
    for _ in range(25):
        team.play()
    before = team.members[1]
    team.restart(1)
    team.explore(300)
    exchange_all(team, 200)
    restarted = team.members[1]
    assert restarted.files.session.session == 2
    assert restarted.robot.settings.incarnation == 1
    assert_maps_agree(team)
    peer = team.members[0].medium
    dropped = peer.dropped.get("replayed", 0)
    for frame in before.sent[-3:]:
        peer.receive(frame, team.step * SECOND)
    assert peer.dropped["replayed"] == dropped + 3


def test_a_restarted_receiver_takes_no_recorded_frame_again(tmp_path: Path) -> None:
    team = on_the_air(tmp_path, 2)
    for _ in range(25):
        team.play()
    recorded = team.members[0].sent
    team.restart(1)
    receiver = team.members[1].medium
    for frame in recorded:
        receiver.receive(frame, team.step * SECOND)
    assert len(receiver.records) <= 1  # the last one, if it was lost before
    receiver.receive(Sealer(KEY, 0, 2, team_context(team.robots[0].settings)).seal(b""), team.step * SECOND)
    assert receiver.begin_step(team.step, team.step * SECOND).peers == [0]


def log_bytes(team: AirTeam) -> int:
    """Return the bytes of all logs."""
    return sum(len(log.read(0)) for log in team.robots[0].replication.replica.logs)


@pytest.mark.parametrize("kind", ["exact", "noisy"])
def test_a_robot_that_starts_late_receives_the_whole_map_in_few_bytes(tmp_path: Path, kind: str) -> None:
    noisy = {"laser": {"preset": "rplidar-a1"}, "pose": {"preset": "graph-slam"}} if kind == "noisy" else {}
    team = on_the_air(tmp_path, 3, late=(2,), side_m=16.0, **noisy)
    team.explore(400)
    before, frames = team.sent_bytes(), team.sent_frames()
    team.start(2)
    exchange_all(team, 200)
    sent, frames = team.sent_bytes() - before, team.sent_frames() - frames
    late, other = team.members[2].robot, team.members[0].robot
    assert np.array_equal(late.replication.replica.lengths(), other.replication.replica.lengths())
    assert np.mean(late.planning[other.planning != UNKNOWN] != UNKNOWN) > 0.99
    assert sent < 1.5 * log_bytes(team) + 40 * frames
    assert frames < 60


def test_a_robot_that_leaves_for_good_does_not_keep_the_others_from_exploring_all(tmp_path: Path) -> None:
    team = on_the_air(tmp_path, 3)
    for _ in range(25):
        team.play()
    team.leave(1)
    team.explore(400)
    assert any(move.explored for move in team.moves.values())
    for _ in range(200):
        team.stand(1)
        if not any(robot.replication.undelivered_to(2 - robot.settings.robot) for robot in team.robots):
            break
    first, second = team.robots
    assert np.array_equal(first.planning, second.planning)
    assert team.world.seen_cells / np.count_nonzero(team.world.reachable) > 0.97
    assert first.replication.undelivered() > 0, "the robot that left lacks entries"


def test_a_robot_that_returns_with_a_new_process_continues(tmp_path: Path) -> None:
    team = on_the_air(tmp_path, 3)
    for _ in range(25):
        team.play()
    known = np.count_nonzero(team.leave(1).robot.own)
    for _ in range(30):
        team.play()
    team.start(1)
    team.explore(400)
    exchange_all(team, 200)
    returned = team.members[1].robot
    assert returned.settings.incarnation == 1
    assert np.count_nonzero(returned.planning) > known
    assert_maps_agree(team)


def test_receivers_accept_what_teammates_with_better_sensors_have_seen(tmp_path: Path) -> None:
    """Each robot assumes that the other sees as far and drives as fast as it does itself."""
    robots = [
        {"robot": 0, "sensor_range": 1.0, "speed": 0.2},
        {"robot": 1, "sensor_range": 8.0, "speed": 1.0},
    ]
    team = on_the_air(tmp_path, 2, late=(0,), robot=robots, side_m=16.0, laser={"preset": "utm-30lx"})
    for _ in range(20):
        team.play()
    team.start(0)
    for _ in range(40):
        team.play()
    exchange_all(team, 100)
    near, far = team.members[0].robot, team.members[1].robot
    seen = far.own != UNKNOWN
    assert np.count_nonzero(seen) > 10 * np.count_nonzero(near.own != UNKNOWN)
    assert np.mean(near.planning[seen] != UNKNOWN) > 0.95


def test_nothing_is_undelivered_to_a_robot_that_has_ended_until_it_starts_again(tmp_path: Path) -> None:
    team = on_the_air(tmp_path, 3)
    for _ in range(25):
        team.play()
    team.end(1)
    team.explore(300)
    exchange_all(team, 200)
    first, last = team.robots
    assert first.replication.undelivered() == last.replication.undelivered() == 0
    assert team.members[0].medium.neighbors.ended() == {1}
    own = first.replication.peers.own
    assert first.replication.peers.acked[1, own] < len(first.replication.own_log)
    assert_maps_agree(team)
    team.restart(1)
    team.stand(20)
    assert team.members[0].medium.neighbors.ended() == frozenset()
    exchange_all(team, 200)
    assert first.replication.peers.acked[1, own] == len(first.replication.own_log)
    assert_maps_agree(team)
