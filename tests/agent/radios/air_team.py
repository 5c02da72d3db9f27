"""Robots that share a map without a relay, in virtual time: each has a body in a simulated world and a radio.

The steps of all robots begin at the same time, as if their clocks agreed; frames travel in between.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from agent.field import FieldFiles, FieldRobot
from agent.pose_guard import PoseGuard
from agent.radios.options import LinkOptions
from agent.radios.sealing import KEY_BYTES, OVERHEAD
from agent.radios.transport import Transport
from agent.robot import Robot
from deploy.scenario.plan import Plan
from protocol.messages import Move, Sense
from protocol.nanoseconds import SECOND

KEY = bytes(range(KEY_BYTES))

Join = Callable[[int], Transport]
"""Opens the transport of a robot."""


class Wire:
    """A transport that keeps all frames that it sends."""

    def __init__(self, transport: Transport) -> None:
        self.sent: list[bytes] = []
        self.receive, self.fileno, self.close = transport.receive, transport.fileno, transport.close
        self._transport = transport

    def send(self, frame: bytes) -> bool:
        self.sent.append(frame)
        return self._transport.send(frame)


class WorldBody:
    """The body of a robot in a simulated world: the world sets `sensed`, and takes `moved`.

    Steps are those of the robot, which counts them from its start.
    """

    def __init__(self) -> None:
        self.sensed: Sense | None = None
        self.moved: Move | None = None
        self.stops = 0

    def sense(self, step: int) -> Sense | None:
        return None if self.sensed is None else replace(self.sensed, step=step)

    def move(self, move: Move, target: tuple[int, int] | None) -> None:
        self.moved = move

    def stop(self) -> None:
        self.moved = None
        self.stops += 1


class Member:
    """A robot in the field, the session of its radio, and the frames that it sent; it starts after step `began`.

    It assumes that its teammates have the same hardware.
    """

    def __init__(
        self, plan: Plan, number: int, options: LinkOptions, transport: Transport, state: Path, began: int
    ) -> None:
        self.began = began
        settings = plan.robot_settings[number]
        settings = replace(settings, incarnations=2, bodies=(settings.body,) * settings.robots)
        self.files = FieldFiles.open(state, KEY, settings)
        guard = PoseGuard(settings.body.speed, slack=1.0, settle=5 * SECOND)
        self.body, self.wire, now = WorldBody(), Wire(transport), began * SECOND
        self.field = FieldRobot(settings, options, self.files, self.body, self.wire, guard, now, pytest.fail)
        self.robot, self.medium, self.sent = self.field.robot, self.field.medium, self.wire.sent


class AirTeam:
    """The robots of a plan; `set_time` is called with the time before frames travel.

    Robots in `late` are in the world from the beginning, but their processes start with `start`.
    """

    def __init__(
        self,
        plan: Plan,
        options: LinkOptions,
        join: Join,
        state: Path,
        set_time: Callable[[int], object] = lambda _: None,
        late: Collection[int] = (),
    ) -> None:
        self.plan = plan
        self.world = plan.make_world()
        self.step = 0
        self._options, self._join, self._state, self._set_time = options, join, state, set_time
        self.members: dict[int, Member] = {}
        for number in plan.robot_settings:
            if number not in late:
                self.start(number)

    @property
    def robots(self) -> list[Robot]:
        return [member.robot for _, member in sorted(self.members.items())]

    @property
    def moves(self) -> Mapping[int, Move]:
        return {number: each.body.moved for number, each in self.members.items() if each.body.moved}

    def sent_bytes(self) -> int:
        return sum(len(frame) for member in self.members.values() for frame in member.sent)

    def sent_packet_bytes(self) -> int:
        """The same without the seals, which have no counterpart behind a relay."""
        return self.sent_bytes() - OVERHEAD * self.sent_frames()

    def sent_frames(self) -> int:
        return sum(len(member.sent) for member in self.members.values())

    def start(self, number: int) -> None:
        """Start the process of a robot."""
        transport = self._join(number)
        self.members[number] = Member(self.plan, number, self._options, transport, self._state, self.step)

    def leave(self, number: int) -> Member:
        """Kill a robot's process; return what it was."""
        member = self.members.pop(number)
        member.files.session.close()
        member.wire.close()
        return member

    def restart(self, number: int) -> None:
        """Start a robot's process again; kill it first if it runs."""
        if number in self.members:
            self.leave(number)
        self.start(number)

    def play(self, *, moving: bool = True, ticks: int = 20) -> None:
        """Play one step of a second; frames travel at `ticks` times in it."""
        self.step += 1
        moves = self.moves
        if not moving:
            moves = {robot: Move(move.step, b"", move.heading, False) for robot, move in moves.items()}
        senses = {robot: sense for robot, sense in self.world.advance(moves).items() if robot in self.members}
        begin = self.step * SECOND
        for number, sense in senses.items():
            member = self.members[number]
            member.body.sensed = sense
            member.field.begin_step(self.step - member.began, begin)
        for tick in range(ticks):
            now = begin + tick * SECOND // ticks
            self._set_time(now)
            for number in senses:
                self.members[number].field.exchange(now)
        for number in senses:
            self.members[number].field.end_step()

    def explore(self, steps: int) -> None:
        """Explore until a robot is done, for at most `steps` steps."""
        while self.step < steps and not any(move.explored for move in self.moves.values()):
            self.play()

    def stand(self, steps: int) -> None:
        """Exchange maps without moving."""
        for _ in range(steps):
            self.play(moving=False)

    def close(self) -> None:
        """End all robots."""
        for member in self.members.values():
            self._end(member)

    def end(self, number: int) -> None:
        """End a robot after the last step; the others wait until it has."""
        self._end(self.members.pop(number))

    def _end(self, member: Member) -> None:
        now = (self.step + 1) * SECOND

        def wait(duration: int) -> None:
            nonlocal now
            now += duration
            self._set_time(now)

        member.field.end(lambda: now, wait)


def exchange_all(team: AirTeam, steps: int) -> None:
    """Stand still until all robots hold all maps, for at most `steps` steps."""
    last = team.step + steps
    while team.step < last and any(robot.replication.undelivered() for robot in team.robots):
        team.stand(1)


def assert_maps_agree(team: AirTeam) -> None:
    first, *others = team.robots
    lengths = first.replication.replica.lengths()
    for robot in others:
        assert np.array_equal(robot.replication.replica.lengths(), lengths)
        assert np.array_equal(robot.planning, first.planning)
    known = first.planning != 0
    assert np.array_equal(first.planning[known], team.plan.map.cells[known])
