"""Robots and the radio between them in one thread, so that a test can look into their minds at every step.

`Team` does what the shells and the bus do. Where robots stand is up to the test: they explore a `World`, or
are put where it wants them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.robot import Robot
from agent.settings import Settings
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from netshaper.imperfect import radio
from netshaper.ledger import EVERYONE, ROW
from netshaper.medium import UNLIMITED
from netshaper.radio import Frame, Note, Outgoing
from protocol.grid import FREE, OCCUPIED, Grid, ray_table
from protocol.messages import Close, Move, Open, Outcome, PhaseDelivery, Said, Sense
from worldsim import generators
from worldsim.laser import cast
from worldsim.maps import Map

Cell = tuple[int, int]
Put = tuple[int, bytes]
"""A frame: receiver and payload."""
Heard = list[tuple[int, bytes]]
"""Frames as they came: sender and payload."""


def small_plan(name: str = "office", side_m: float = 12.0, map_seed: int = 0, **settings: Any) -> Plan:
    """A plan on a small generated map, in memory."""
    world_map = generators.make(name, seed=map_seed, width_m=side_m, height_m=side_m)
    return plan_on(world_map, **settings)


def plan_on(world_map: Map, **settings: Any) -> Plan:
    """Of the thesis, as far as it is not said: polygons, and targets by Meier."""
    thesis = {"map_encoding": "polygons", "strategy": "meier"}
    return plans.make(parse({"bus": "memory", "sensor_range": 3.0} | thesis | settings), world_map)


def corridor(length: int, height: int = 5) -> Map:
    """A corridor of so many cells, with niches so that there is something to say about it."""
    cells = np.full((height + 4, length + 2), OCCUPIED, np.uint8)
    cells[2:-2, 1:-1] = FREE
    cells[1, 3:-1:4] = FREE
    cells[-2, 5:-1:6] = FREE
    return Map("corridor", cells, 0.1)


class Mind:
    """A robot and what its shell does for it."""

    def __init__(self, settings: Settings) -> None:
        self.robot = Robot(settings)

    def perceive(self, sense: Sense) -> None:
        self.robot.perceive(sense)

    def hear(
        self, note: Open | PhaseDelivery | Outcome | Close, heard: Heard
    ) -> tuple[list[Put], Said | None]:
        """Take a note of the relay, and the frames that came before it."""
        robot, session = self.robot, self.robot.session
        count = len(note.connections if isinstance(note, PhaseDelivery) else getattr(note, "heard", ()))
        for peer, payload in heard[: len(heard) - count]:
            robot.hear_broadcast(peer, payload)
        frames = heard[len(heard) - count :]
        match note:
            case Open():
                said = robot.announce(note.peers) if note.round == 0 else None
                puts = [(EVERYONE, said)] if said is not None and note.peers else []
                room = None if note.budget == UNLIMITED else note.budget
                dissemination = session.offers(note.round, note.peers, room)
                puts += [(peer, frame) for peer, _, frame in dissemination]
                return puts, Said(note.step, note.round, "offers", [], session.priority)
            case PhaseDelivery(phase="offers"):
                offered = [(n, *frame) for n, frame in zip(note.connections, frames, strict=True)]
                return self._put(note, "answers", session.answers(offered))
            case PhaseDelivery():
                named = zip(note.connections, frames, note.maps, strict=True)
                answers = [(n, peer, map_id, load) for n, (peer, load), map_id in named]
                return self._put(note, "data", session.data(answers))
            case Outcome():
                robot.settle(note, frames)
        return [], None

    def decide(self) -> Move:
        return self.robot.decide()

    def _put(
        self, note: PhaseDelivery, phase: str, said: list[tuple[int, int, bytes]]
    ) -> tuple[list[Put], Said | None]:
        puts = [(peer, frame) for _, peer, frame in said]
        return puts, Said(note.step, note.round, phase, [number for number, _, _ in said])


class Team:
    """All robots of a plan; `robot_settings` may stand in for some of them."""

    def __init__(self, plan: Plan, robot_settings: Mapping[int, Mind] | None = None) -> None:
        self.plan = plan
        self.truth: Grid = plan.map.cells
        self.world = plan.make_world()
        self.robot_settings = {
            number: Mind(settings) for number, settings in plan.robot_settings.items()
        } | dict(robot_settings or {})
        self.step = 0
        self.said: dict[int, int] = {}
        """Bytes that robots put on their antennas, by step."""
        self.moves: dict[int, Move] = {}
        self._radio = radio(plan.radio)
        self._rows: list[bytes] = []
        self._laser = ray_table(plan.world.bodies[0].range_cells, plan.world.beams)

    @property
    def robots(self) -> list[Robot]:
        return [mind.robot for _, mind in sorted(self.robot_settings.items())]

    def held(self, robot: int, map_id: int) -> object:
        """What a robot holds of a map, in a form that can be compared; None if nothing."""
        polygons = self.robot_settings[robot].robot.polygons.get(map_id)
        return None if polygons is None else polygons.canonical()

    def ledger(self) -> NDArray[np.void]:
        return np.frombuffer(b"".join(self._rows), ROW)

    def explore(self, steps: int) -> None:
        """Explore until the first robot is done, so many steps at most."""
        while self.step < steps and not any(move.explored for move in self.moves.values()):
            senses = self.world.advance(self.moves)
            self._play(senses, self.world.cells)

    def stand(self, cells: Mapping[int, Cell]) -> None:
        """Play one step with the robots in these cells."""
        nobody = np.zeros(self.truth.shape, np.bool_)
        senses = {
            robot: Sense(
                self.step + 1, x, y, 0, b"", cast(self.truth, nobody, self._laser, x, y).tobytes(), "", 0, 0
            )
            for robot, (x, y) in cells.items()
        }
        self._play(senses, cells)

    def kill(self, robot: int) -> None:
        """Let a robot's process end."""
        self.world.lose(robot)
        self._radio.lost(robot)

    def _play(self, senses: Mapping[int, Sense], cells: Mapping[int, Cell]) -> None:
        self.step += 1
        self.said[self.step] = 0
        for robot, sense in senses.items():
            self.robot_settings[robot].perceive(sense)
        inbox: dict[int, Heard] = {robot: [] for robot in senses}
        out: Sequence[Outgoing] = self._radio.begin(self.step, cells)
        while out:
            out = list(self._spread(out, inbox))
        self.moves = {robot: self.robot_settings[robot].decide() for robot in sorted(senses)}

    def _spread(self, out: Sequence[Outgoing], inbox: dict[int, Heard]) -> Iterable[Outgoing]:
        """Hand out what the relay says; yield what it says to what the robots say then."""
        for item in out:
            if isinstance(item, Frame):
                for receiver in item.receivers:
                    inbox[receiver].append((item.sender, item.payload))
            elif not isinstance(item, Note):
                self._rows.append(item.report().rows)
            else:
                inbox[item.receiver] += zip(item.senders, item.frames, strict=True)
                heard, inbox[item.receiver] = inbox[item.receiver], []
                note = item.message
                assert isinstance(note, Open | PhaseDelivery | Outcome | Close)
                puts, said = self.robot_settings[item.receiver].hear(note, heard)
                self.said[self.step] += sum(len(payload) for _, payload in puts)
                if said is not None:
                    receivers, frames = [receiver for receiver, _ in puts], [frame for _, frame in puts]
                    said = replace(said, receivers=receivers, frames=frames)
                    yield from self._radio.said(item.receiver, said)
