"""Robots that follow a script, and the air between them: `Air` plays whole steps of a radio in one thread.

What a robot does depends on its seed and on what it hears, never on the order in which the relay happens to
read what different robots put; that order is drawn from `interleaving`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from netshaper.imperfect import radio
from netshaper.ledger import EVERYONE, ROW
from netshaper.radio import Frame, Note, Outgoing, RadioSettings
from protocol import packets
from protocol.messages import Close, Open, Outcome, PhaseDelivery, RadioReport, Said

Put = tuple[int, bytes]
"""A frame: receiver and payload."""
Heard = list[tuple[int, bytes]]
"""Frames as they came: sender and payload."""


class Robot:
    """A robot that keeps to the protocol, and offers, answers and sends as its seed has it."""

    def __init__(self, number: int, robots: int, seed: int) -> None:
        self.number = number
        self.robots = robots
        self.seed = seed

    def draw(self, *key: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, self.number, *key])

    def opens(self, note: Open) -> list[Put | Said]:
        rng = self.draw(note.step, note.round, 0)
        said: list[Put | Said] = []
        if note.round == 0 and rng.random() < 0.6:
            said.append((EVERYONE, packets.encode([packets.Target(*rng.integers(0, 2048, 2).tolist())])))
        # Drawn for all, so that a teammate more or less in range changes nothing for the others.
        for peer in range(self.robots):
            maps = rng.permutation(self.robots)[: rng.integers(0, 3)].tolist()
            block = int(rng.integers(64))
            if peer in note.peers:
                said += [(peer, packets.encode([packets.Offer(map_id, block)])) for map_id in maps]
        return [*said, Said(note.step, note.round, "offers", [])]

    def takes_turn(self, note: PhaseDelivery, heard: Heard) -> list[Put | Said]:
        phase = "answers" if note.phase == "offers" else "data"
        said: list[Put | Said] = []
        numbers = []
        for number, map_id, (peer, payload) in zip(note.connections, note.maps, heard, strict=True):
            rng = self.draw(note.step, note.round, 1, peer, map_id, phase == "data")
            frame = self.answer(rng) if phase == "answers" else self.data(rng, payload)
            if frame:
                said.append((peer, frame))
                numbers.append(number)
        return [*said, Said(note.step, note.round, phase, numbers)]

    def answer(self, rng: np.random.Generator) -> bytes:
        index, block = packets.Answer(int(rng.integers(4096))), packets.Block(int(rng.integers(64)))
        choices: list[list[packets.Packet]] = [[index], [block, index], [packets.Decline()]]
        return packets.encode(choices[rng.integers(3)])

    def data(self, rng: np.random.Generator, answer: bytes) -> bytes:
        if answer == packets.encode([packets.Decline()]) or rng.random() < 0.2:
            return b""
        kinds = [
            packets.Save(),
            packets.Delete(5),
            packets.Insert(1, 2, 3, 0, 1),
            packets.Fragment(bytes(63)),
        ]
        return packets.encode([kinds[kind] for kind in rng.integers(0, 4, rng.integers(1, 12))])

    def rests(self, _note: Close) -> list[Put | Said]:
        return []


class Gossiper(Robot):
    """A robot that broadcasts news, and a target now and then."""

    def opens(self, note: Open) -> list[Put | Said]:
        rng = self.draw(note.step, note.round, 6)
        said: list[Put | Said] = []
        if note.round == 0 and rng.random() < 0.6:
            said.append((EVERYONE, packets.encode([packets.Target(*rng.integers(0, 2048, 2).tolist())])))
        kinds = [
            packets.Save(),
            packets.Insert(1, 2, 3, 0, 1),
            packets.Fragment(bytes(63)),
            packets.Update(None, bytes(8)),
            packets.Update(2, b"new"),
            packets.FromEarly(1, 7),
            packets.Held(0, 300),
            packets.Gone(1),
        ]
        news = packets.encode([kinds[kind] for kind in rng.integers(0, len(kinds), rng.integers(0, 9))])
        if news:
            said.append((EVERYONE, news))
        return [*said, Said(note.step, note.round, "offers", [], int(rng.integers(0, 256)))]


class Liar(Robot):
    """A robot that says anything at any time, but ends its phases, at last, as it should."""

    def noise(self, rng: np.random.Generator, step: int) -> list[Put | Said]:
        said: list[Put | Said] = []
        for _ in range(rng.integers(0, 8)):
            if rng.random() < 0.2:
                phase = ("offers", "answers", "data", "nonsense")[rng.integers(4)]
                said.append(Said(int(step), int(rng.integers(-1, 3)), phase, rng.integers(-3, 9, 4).tolist()))
            else:
                said.append((int(rng.integers(-99, self.robots + 3)), self.frame(rng)))
        return said

    def frame(self, rng: np.random.Generator) -> bytes:
        choices: list[Callable[[], bytes]] = [
            lambda: rng.bytes(int(rng.integers(0, 30))),
            lambda: b"",
            lambda: packets.encode([packets.Offer(int(rng.integers(64)), 0)]),
            lambda: 2 * packets.encode([packets.Offer(int(rng.integers(self.robots)), 0)]),
            lambda: packets.encode([packets.Target(1, 2)]),
            lambda: self.answer(rng),
            lambda: Robot.data(self, rng, b""),
        ]
        return choices[rng.integers(len(choices))]()

    def opens(self, note: Open) -> list[Put | Said]:
        rng = self.draw(note.step, note.round, 2)
        *honest, end = super().opens(note)
        return [*self.noise(rng, note.step), *honest, *honest, end, *self.noise(rng, note.step)]

    def takes_turn(self, note: PhaseDelivery, heard: Heard) -> list[Put | Said]:
        rng = self.draw(note.step, note.round, 3, note.phase == "offers")
        phase = "answers" if note.phase == "offers" else "data"
        noise = [item for item in self.noise(rng, note.step) if not isinstance(item, Said)]
        numbers = [int(number) for number in rng.permutation([*note.connections, *range(-2, 9)])]
        end = Said(note.step, note.round, phase, numbers)
        return [*noise, *super().takes_turn(note, heard)[:-1], end, end, *self.noise(rng, note.step)]

    def rests(self, note: Close) -> list[Put | Said]:
        return self.noise(self.draw(note.step, 4), note.step)


class Mute(Robot):
    """A robot that is there and says nothing at all."""

    def opens(self, _note: Open) -> list[Put | Said]:
        return []


def together(said: list[Put | Said]) -> Iterator[Said]:
    """Frames with the note behind them; those without one are said when it is nobody's turn."""
    puts: list[Put] = []
    for item in [*said, Said(0, 0, "late", [])]:
        if not isinstance(item, Said):
            puts.append(item)
        elif puts or item.phase != "late":
            receivers, frames = [receiver for receiver, _ in puts], [frame for _, frame in puts]
            yield replace(item, receivers=receivers, frames=frames)
            puts = []


class Delivered(NamedTuple):
    """A frame that reached a robot."""

    receiver: int
    sender: int
    payload: bytes


@dataclass
class Step:
    """What became of one step."""

    rows: NDArray[np.void]
    carried: int
    delivered: list[tuple[str, Delivered]] = field(default_factory=list)
    """Frames that reached a robot, with the phase in which they did."""
    said: list[tuple[int, int, bytes]] = field(default_factory=list)
    """Frames that robots put, as (sender, receiver, payload)."""
    opened: list[tuple[int, Open]] = field(default_factory=list)
    turns: list[tuple[int, PhaseDelivery, Heard]] = field(default_factory=list)
    outcomes: list[tuple[int, Outcome]] = field(default_factory=list)
    closed: list[int] = field(default_factory=list)

    def bytes_where(self, wanted: NDArray[np.bool_]) -> int:
        return int(self.rows["bytes"][wanted].sum())


class Air:
    """A radio and its robots."""

    def __init__(self, settings: RadioSettings, robots: Mapping[int, Robot], interleaving: int = 0) -> None:
        self.radio = radio(settings)
        self.robots = dict(robots)
        self.dead: set[int] = set()
        self._rng = np.random.default_rng(interleaving)
        self._to_do: dict[int, deque[Said]] = {number: deque() for number in robots}
        self._inbox: dict[int, Heard] = {number: [] for number in robots}

    def step(
        self, number: int, cells: Mapping[int, tuple[int, int]], deaths: Mapping[int, int] | None = None
    ) -> Step:
        """Play one step; `deaths` kills robots after so many things have been done in it."""
        result = Step(np.empty(0, ROW), -1)
        self._deliver(result, self.radio.begin(number, cells))
        done = 0
        while True:
            for robot, when in sorted((deaths or {}).items()):
                if when == done and robot not in self.dead:
                    self.kill(robot, result)
            done += 1
            busy = [robot for robot, todo in self._to_do.items() if todo]
            if busy:
                robot = int(self._rng.choice(busy))
                self._do(robot, self._to_do[robot].popleft(), result)
            elif result.carried < 0:
                mute = self.radio.waiting_for()
                assert mute, "nobody has anything to say, nobody is waited for, and the step does not end"
                assert all(isinstance(self.robots[robot], Mute) for robot in mute), f"{mute} are waited for"
                for robot in mute:
                    self.kill(robot, result)
            else:
                return result

    def kill(self, robot: int, result: Step) -> None:
        self.dead.add(robot)
        self._to_do[robot].clear()
        self._deliver(result, self.radio.lost(robot))

    def _do(self, robot: int, said: Said, result: Step) -> None:
        result.said += [(robot, receiver, payload) for receiver, payload in said.puts()]
        self._deliver(result, self.radio.said(robot, said))

    def _deliver(self, result: Step, outgoing: list[Outgoing]) -> None:
        for item in outgoing:
            if isinstance(item, Frame):
                assert not self.dead.intersection(item.receivers), "the dead hear nothing"
                for receiver in item.receivers:
                    self._inbox[receiver].append((item.sender, item.payload))
            elif isinstance(item, Note):
                self._inbox[item.receiver] += zip(item.senders, item.frames, strict=True)
                self._note(result, item)
            else:
                self._book(result, item.report())

    def _book(self, result: Step, report: RadioReport) -> None:
        assert result.carried == -1, "one report a step"
        result.rows = np.frombuffer(report.rows, ROW)
        result.carried = report.carried

    def _note(self, result: Step, note: Note) -> None:
        message, receiver = note.message, note.receiver
        assert receiver not in self.dead, "nobody talks to the dead"
        robot = self.robots[receiver]
        todo = self._to_do[receiver]
        if isinstance(message, Open):
            result.opened.append((receiver, message))
            todo += together(robot.opens(message))
        elif isinstance(message, PhaseDelivery):
            heard = self._take(result, receiver, len(message.connections), message.phase)
            result.turns.append((receiver, message, heard))
            todo += together(robot.takes_turn(message, heard))
        elif isinstance(message, Outcome):
            self._take(result, receiver, len(message.heard), "data")
            result.outcomes.append((receiver, message))
        elif isinstance(message, Close):
            self._take(result, receiver, 0, "")
            result.closed.append(receiver)
            todo += together(robot.rests(message))

    def _take(self, result: Step, receiver: int, count: int, phase: str) -> Heard:
        """The last `count` frames in the inbox belong to the phase, those before them are targets."""
        inbox, self._inbox[receiver] = self._inbox[receiver], []
        split = len(inbox) - count
        assert split >= 0, "fewer frames came than the relay says"
        for at, (sender, payload) in enumerate(inbox):
            kind = "targets" if at < split else phase
            result.delivered.append((kind, Delivered(receiver, sender, payload)))
        return inbox[split:]
