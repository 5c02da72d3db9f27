"""A robot in the field: steps by its own clock, silence without a pose, and what a team must have in common."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.encodings.catalog import ENCODINGS
from agent.field import FAREWELLS, FieldFiles, FieldRobot, drive, field_settings, team_context
from agent.pose_guard import PoseGuard
from agent.radios.options import LinkOptions
from agent.radios.sealing import KEY_BYTES, OVERHEAD, Sealer
from agent.radios.session_file import SessionFileError
from agent.settings import EncodingSettings, Settings
from protocol.budget import Budget
from protocol.messages import Move, Sense
from protocol.nanoseconds import SECOND
from protocol.range_scans import Laser
from tests.agent.radios.air_team import Wire, WorldBody
from tests.agent.radios.memory_air import Faults, MemoryAir
from tests.system.team import small_plan
from worldsim.base import BaseWorld

KEY = bytes(range(KEY_BYTES))
OPTIONS = LinkOptions("udp", interface="lo", bytes_per_s=1000)
PLAN = small_plan(side_m=10.0, map_encoding="predictive", dissemination="gossip", robots=2)
STEP = SECOND // 5
HELLO = OVERHEAD
"""Bytes of a hello."""


class Alone(WorldBody):
    """The body of the only robot that moves in a world.

    It loses its pose in the steps `lost`; in step `jump`, its position jumps by 50 cells, and back in the next.
    """

    def __init__(self, world: BaseWorld, lost: range = range(0), jump: int = 0) -> None:
        super().__init__()
        self.steps: list[int] = []
        self._world, self._lost, self._jump = world, lost, jump

    def sense(self, step: int) -> Sense | None:
        self.steps.append(step)
        senses = self._world.advance({} if self.moved is None else {0: self.moved})
        sense = replace(senses[0], step=step)
        if step == self._jump:
            sense = replace(sense, x=(sense.x + 50) % PLAN.map.width)
        return None if step in self._lost else sense


class Clock:
    """A clock that only waiting moves on; work takes `work` nanoseconds in each call."""

    def __init__(self, work: int = 0) -> None:
        self.now = 5 * SECOND
        self.work = work

    def __call__(self) -> int:
        self.now += self.work
        return self.now

    def wait(self, duration: int) -> None:
        assert duration >= 0
        self.now += max(1, duration)


def field_robot(
    folder: Path,
    body: WorldBody,
    settings: Settings = PLAN.robot_settings[0],
    options: LinkOptions = OPTIONS,
) -> FieldRobot:
    wire = Wire(MemoryAir(1, Faults()).join(0, options.longest))
    guard = PoseGuard(5 * settings.body.speed, slack=1.0, settle=3 * SECOND)
    files = FieldFiles.open(folder, KEY, settings)
    robot = FieldRobot(settings, options, files, body, wire, guard, 5 * SECOND)
    robot.sent = wire.sent  # type: ignore[attr-defined]
    return robot


def test_a_robot_that_receives_nothing_explores_alone_step_by_step(tmp_path: Path) -> None:
    body, clock = Alone(PLAN.make_world()), Clock()
    robot = field_robot(tmp_path, body)
    known: list[int] = []
    times: list[int] = []

    def is_over(step: int) -> bool:
        known.append(robot.robot.known_cells)
        times.append(clock.now)
        return step == 40

    assert drive(robot, STEP, clock, clock.wait, is_over) == 0
    assert body.steps == list(range(1, 41))
    assert times[-1] == 5 * SECOND + 40 * STEP
    assert known[-1] > known[1] > known[0]
    assert body.stops == 1
    sent = robot.sent  # type: ignore[attr-defined]
    assert [len(frame) for frame in sent] == [HELLO, *[HELLO + 1] * FAREWELLS], (
        "a hello, and in 8 s none more"
    )


def test_steps_that_take_too_long_are_counted_and_shift_later_ones(tmp_path: Path) -> None:
    body, clock = Alone(PLAN.make_world()), Clock(work=2 * STEP)
    assert drive(field_robot(tmp_path, body), STEP, clock, clock.wait, lambda step: step == 5) == 5
    assert body.steps == [1, 2, 3, 4, 5]


def test_a_body_that_does_not_know_its_pose_stands_still_and_the_robot_is_silent(tmp_path: Path) -> None:
    body, clock = Alone(PLAN.make_world(), lost=range(1, 20)), Clock()
    robot = field_robot(tmp_path, body)
    moves: list[tuple[int, Move | None]] = []

    def is_over(step: int) -> bool:
        moves.append((step, robot.move))
        return step == 25

    drive(robot, SECOND, clock, clock.wait, is_over)
    assert all((move is None) == (step < 20) for step, move in moves)
    assert body.stops == 19 + 1
    sent = robot.sent  # type: ignore[attr-defined]
    assert len(sent) == 1 + FAREWELLS


def test_a_robot_whose_pose_jumps_stays_silent_until_it_has_settled(tmp_path: Path) -> None:
    body, clock = Alone(PLAN.make_world(), jump=4), Clock()
    robot = field_robot(tmp_path, body)
    still: list[int] = []

    def is_over(step: int) -> bool:
        if robot.move is None:
            still.append(step)
        return step == 12

    drive(robot, SECOND, clock, clock.wait, is_over)
    # Before the first step; the jump, the jump back, and three seconds without one.
    assert still == [0, 4, 5, 6, 7]


def test_the_body_stops_and_the_files_are_released_if_the_robot_fails(tmp_path: Path) -> None:
    body, clock = Alone(PLAN.make_world()), Clock()
    robot = field_robot(tmp_path, body)
    with pytest.raises(SessionFileError, match="in use"):
        field_robot(tmp_path, body)

    def fail(step: int) -> bool:
        raise RuntimeError("the motors are on fire")

    with pytest.raises(RuntimeError, match="fire"):
        drive(robot, STEP, clock, clock.wait, fail)
    assert body.stops == 1
    with pytest.raises(ValueError, match="used up its 1 incarnations"):
        field_robot(tmp_path, body)


def test_the_files_are_released_if_the_body_cannot_stop(
    tmp_path: Path,
) -> None:
    settings = replace(PLAN.robot_settings[0], incarnations=3)
    body = Alone(PLAN.make_world())
    robot = field_robot(tmp_path, body, settings)

    def fail() -> None:
        raise OSError("the motors do not answer")

    body.stop = fail  # type: ignore[method-assign]
    clock = Clock()
    with pytest.raises(OSError, match="do not answer"):
        robot.end(clock, clock.wait)
    field_robot(tmp_path, Alone(PLAN.make_world()), settings).end(clock, clock.wait)


def test_frames_of_robots_with_other_maps_do_not_open(tmp_path: Path) -> None:
    settings, peer = (field_settings(PLAN.robot_settings[number], OPTIONS) for number in (0, 1))
    robot = field_robot(tmp_path, Alone(PLAN.make_world()))
    other = replace(settings, robot=1, width=settings.width + 1)
    assert team_context(settings) == team_context(peer) != team_context(other)
    real = replace(settings.body, laser=Laser(4, 0, 49152, 8000))
    noisy = replace(settings, bodies=(real,) * settings.robots)
    assert team_context(noisy) != team_context(settings)
    assert len({team_context(settings, common) for common in ((), (0.0,), (0.5,), (0.5, "code"))}) == 4
    robot.medium.receive(Sealer(KEY, 1, 1, team_context(other)).seal(b""), 0)
    robot.medium.receive(Sealer(KEY, 1, 1, team_context(settings)).seal(b""), 0)
    assert robot.medium.dropped == {"not authentic": 1}


def test_teams_with_exact_lasers_need_equal_bandwidths_and_hardware() -> None:
    settings = PLAN.robot_settings[0]
    narrow = replace(settings, medium=replace(settings.medium, bandwidth=Budget(20)))
    far = replace(settings.body, range_cells=2 * settings.body.range_cells)
    mixed = replace(settings, bodies=(settings.body, far))
    assert len({team_context(each) for each in (settings, narrow, mixed)}) == 3
    real = replace(settings.body, laser=Laser(4, 0, 49152, 8000))
    noisy = [replace(each, bodies=(real, real)) for each in (settings, narrow)]
    assert team_context(noisy[0]) == team_context(noisy[1])


def test_only_encodings_that_send_scans_need_equal_lasers() -> None:
    settings = PLAN.robot_settings[0]
    teams = []
    for beams in (4, 8):
        body = replace(settings.body, laser=Laser(beams, 0, 49152, 8000))
        teams.append(replace(settings, bodies=(body,) * settings.robots))
    for name in ENCODINGS:
        one, other = (team_context(replace(each, encoding=EncodingSettings(name))) for each in teams)
        assert (one == other) == (name not in ("scans", "slam-toolbox")), name


def test_a_dissemination_that_needs_a_relay_is_refused() -> None:
    settings = small_plan(side_m=10.0, dissemination="backoff", robots=2).robot_settings[0]
    with pytest.raises(ValueError, match="dissemination = 'backoff': must be 'gossip'"):
        field_settings(settings, OPTIONS)


def test_a_robot_without_teammates_and_one_that_may_not_send_end_without_a_farewell(tmp_path: Path) -> None:
    plan = small_plan(side_m=10.0, map_encoding="predictive", dissemination="gossip", robots=1)
    alone = field_robot(tmp_path / "alone", WorldBody(), plan.robot_settings[0])
    clock = Clock()
    drive(alone, STEP, clock, clock.wait, lambda step: True)
    assert (alone.sent, clock.now) == ([], 5 * SECOND)  # type: ignore[attr-defined]
    seldom = LinkOptions("udp", interface="lo", preset="lora-sf9", duty_cycle=0.01)
    robot = field_robot(tmp_path / "seldom", WorldBody(), options=seldom)
    clock = Clock()
    drive(robot, STEP, clock, clock.wait, lambda step: True)
    assert robot.sent == []  # type: ignore[attr-defined]
    assert clock.now >= 10 * SECOND
