"""Robots that share a map without a relay, in virtual time: each has a body in a simulated world and a radio.

The steps of all robots begin at the same time, as if their clocks agreed; frames travel in between.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.radio_events import respond
from agent.radios.options import LinkOptions
from agent.radios.pacing import SECOND
from agent.radios.peer_medium import PeerMedium
from agent.radios.sealing import KEY_BYTES, Opener, Sealer
from agent.radios.session_file import SessionFile
from agent.radios.transport import Transport
from agent.robot import Robot
from deploy.scenario.plan import Plan
from protocol.messages import Move

KEY = bytes(range(KEY_BYTES))

Join = Callable[[int], Transport]
"""Opens the transport of a robot."""


class Member:
    """A robot, its radio, and the files that survive its process."""

    def __init__(
        self, plan: Plan, number: int, options: LinkOptions, transport: Transport, state: Path
    ) -> None:
        settings = plan.robot_settings[number]
        self.transport = transport
        self.file = SessionFile(state / f"r{number}.session", KEY, number, settings.robots)
        self.robot = Robot(
            replace(
                settings,
                requires_acks=True,
                frame_bytes=options.packet_bytes,
                incarnations=2,
                incarnation=self.file.session - 1,
            )
        )
        self.medium = PeerMedium(
            number,
            options.longest,
            Sealer(KEY, number, self.file.session),
            Opener(KEY, number, settings.robots, self.file.highest),
            options.pacer(settings.seed, number, 0),
            options.timing(),
            self.file.note,
        )
        self.sent: list[bytes] = []
        """All sealed frames."""

    def begin_step(self, step: int, now: int) -> None:
        frames = respond(self.robot, self.medium.begin_step(step, now), pytest.fail)
        assert frames is not None
        self.medium.submit(frames, now)

    def exchange(self, now: int) -> None:
        """Send the frames that are due, and receive those that have arrived."""
        for frame in self.medium.poll(now):
            self.sent.append(frame)
            assert self.transport.send(frame)
        for frame in self.transport.receive():
            self.medium.receive(frame, now)

    def end_step(self) -> Move:
        for event in self.medium.end_step():
            respond(self.robot, event, pytest.fail)
        return self.robot.decide()


class AirTeam:
    """The robots of a plan; `set_time` is called with the time before frames travel."""

    def __init__(
        self,
        plan: Plan,
        options: LinkOptions,
        join: Join,
        state: Path,
        set_time: Callable[[int], object] = lambda _: None,
    ) -> None:
        self.plan = plan
        self.world = plan.make_world()
        self.step = 0
        self.moves: dict[int, Move] = {}
        self._options, self._join, self._state, self._set_time = options, join, state, set_time
        self.members = {number: self._start(number) for number in plan.robot_settings}

    @property
    def robots(self) -> list[Robot]:
        return [member.robot for _, member in sorted(self.members.items())]

    def sent_bytes(self) -> int:
        return sum(len(frame) for member in self.members.values() for frame in member.sent)

    def restart(self, number: int) -> None:
        """Kill a robot's process and start it again."""
        self.members[number].file.close()
        self.members[number].transport.close()
        self.members[number] = self._start(number)

    def play(self, *, moving: bool = True, ticks: int = 20) -> None:
        """Play one step of a second; frames travel at `ticks` times in it."""
        self.step += 1
        still = {robot: Move(move.step, b"", move.heading, False) for robot, move in self.moves.items()}
        senses = self.world.advance(self.moves if moving else still)
        begin = self.step * SECOND
        for number, sense in senses.items():
            self.members[number].robot.perceive(sense)
            self.members[number].begin_step(self.step, begin)
        for tick in range(ticks):
            now = begin + tick * SECOND // ticks
            self._set_time(now)
            for number in senses:
                self.members[number].exchange(now)
        self.moves = {number: self.members[number].end_step() for number in senses}

    def explore(self, steps: int) -> None:
        """Explore until a robot is done, for at most `steps` steps."""
        while self.step < steps and not any(move.explored for move in self.moves.values()):
            self.play()

    def stand(self, steps: int) -> None:
        """Exchange maps without moving."""
        for _ in range(steps):
            self.play(moving=False)

    def _start(self, number: int) -> Member:
        return Member(self.plan, number, self._options, self._join(number), self._state)
