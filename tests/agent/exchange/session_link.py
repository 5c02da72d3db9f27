"""A link between sessions, as a test wants it: lossless, with a budget, playing connections in a drawn order.

It stands for the relay, and does with frames what the relay does, in the plainest way. What robots tell each
other are numbered words, so that a word twice, missing, or in the wrong log would show.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from agent.exchange.outcome import Outcome
from agent.exchange.session import Session
from protocol import packet_index
from protocol.packets import Fragment, encode

Reach = Mapping[int, Sequence[int]]
"""Whom each robot has in range."""


def word(map_id: int, number: int) -> bytes:
    """Unit `number` of the log of robot `map_id`: different from all others, and of one of several lengths."""
    return encode([Fragment(struct.pack(">BI", map_id, number) + bytes(number % 4))])


def words(map_id: int, begin: int, end: int) -> list[bytes]:
    return [word(map_id, number) for number in range(begin, end)]


def held(session: Session, map_id: int) -> list[bytes]:
    """What a session still holds of a log, the part that was forgotten made up."""
    log = session.logs[map_id]
    return words(map_id, 0, log.oldest) + packet_index.split(log.since(log.oldest, None))


def everyone(robots: int) -> Reach:
    return {robot: [other for other in range(robots) if other != robot] for robot in range(robots)}


def line(robots: int) -> Reach:
    return {robot: [r for r in (robot - 1, robot + 1) if 0 <= r < robots] for robot in range(robots)}


@dataclass
class Played:
    """What one exchange put on the air, in bytes, and what came of its connections."""

    offers: int = 0
    answers: int = 0
    data: int = 0
    connections: list[tuple[int, int, int, list[int]]] = field(default_factory=list)
    """(sender, receiver, map, bytes carried of each frame)"""

    @property
    def carried(self) -> int:
        return self.offers + self.answers + self.data


class Link:
    """Sessions of one team and the air between them."""

    def __init__(self, robots: int, policy: str = "backoff", seed: int = 0) -> None:
        self.sessions = [Session(robot, robots, policy) for robot in range(robots)]
        self.distrusted: list[set[int]] = [set() for _ in range(robots)]
        self.understands: Callable[[int, int, list[bytes]], bool] = self._are_the_next_words
        """Whether a robot makes sense of the next units of a map; who sends others is not believed again."""
        self._recorded = [0] * robots
        self._rng = np.random.default_rng(seed)

    def record(self, robot: int, count: int) -> None:
        """Let a robot log so many new words."""
        begin = self._recorded[robot]
        self._recorded[robot] += count
        self.sessions[robot].record(words(robot, begin, begin + count))

    def recorded(self, robot: int) -> list[bytes]:
        """All that a robot has ever logged."""
        return words(robot, 0, self._recorded[robot])

    def step(self, reach: Reach, budget: int | None = None, rounds: int = 2) -> list[Played]:
        """Open the medium for a step; it closes when the budget is spent."""
        played = []
        left = budget
        for round_number in range(rounds):
            played.append(self.round(round_number, reach, left))
            if left is not None:
                left = 0 if self._closed else left - played[-1].carried
            if left == 0:
                break
        return played

    def round(self, round_number: int, reach: Reach, budget: int | None = None) -> Played:
        """One exchange: offers, answers, data, and what of them was put on the air."""
        frames = self._offers(round_number, reach, budget)
        for robot, peers in sorted(reach.items()):
            heard = [(n, s, f[0]) for n, (s, r, _, f) in enumerate(frames) if r == robot]
            if peers and heard:
                for number, peer, frame in self.sessions[robot].answers(heard):
                    assert (frames[number][0], frames[number][1]) == (peer, robot)
                    frames[number][3].append(frame)
        for robot, _ in sorted(reach.items()):
            answered = [(n, r, m, f[1]) for n, (s, r, m, f) in enumerate(frames) if s == robot and len(f) > 1]
            if answered:
                for number, peer, frame in self.sessions[robot].data(answered):
                    assert (frames[number][0], frames[number][1]) == (robot, peer)
                    frames[number][3].append(frame)
        return self._play(frames, reach, budget)

    def _offers(
        self, round_number: int, reach: Reach, room: int | None
    ) -> list[tuple[int, int, int, list[bytes]]]:
        frames = []
        for robot, peers in sorted(reach.items()):
            for peer, map_id, frame in self.sessions[robot].offers(round_number, list(peers), room):
                assert peer in peers
                frames.append((robot, peer, map_id, [frame]))
        return [frames[at] for at in self._rng.permutation(len(frames))]

    def _play(
        self, frames: list[tuple[int, int, int, list[bytes]]], reach: Reach, budget: int | None
    ) -> Played:
        left, self._closed = budget, False
        played = Played()
        for sender, receiver, map_id, said in frames:
            carried = [0, 0, 0]
            for at, frame in enumerate(said):
                size = len(frame)
                if left is not None and size > left:
                    size = packet_index.fitting(frame, left) if at == 2 else 0
                    self._closed = True
                    left = size
                carried[at] = size
                if left is not None:
                    left -= size
                if size < len(frame):
                    break
            played.connections.append((sender, receiver, map_id, carried))
        played.offers, played.answers, played.data = (
            sum(carried[at] for *_, carried in played.connections) for at in range(3)
        )
        for robot in sorted(reach):
            self._tell(robot, frames, played)
        return played

    def _tell(self, robot: int, frames: list[tuple[int, int, int, list[bytes]]], played: Played) -> None:
        mine = [n for n, (s, r, *_) in enumerate(frames) if robot in (s, r)]
        heard = [n for n in mine if frames[n][1] == robot and played.connections[n][3][2]]
        offers, answers, sent = ([played.connections[n][3][at] for n in mine] for at in range(3))
        outcome = Outcome(0, 0, mine, offers, answers, sent, heard, False)
        data = [(frames[n][0], frames[n][3][2][: played.connections[n][3][2]]) for n in heard]
        session = self.sessions[robot]
        for peer, map_id, frame in session.outcome(outcome, data):
            if peer in self.distrusted[robot]:
                continue
            units = packet_index.split(frame)
            if self.understands(robot, map_id, units):
                session.accept(peer, map_id, frame, packet_index.ends(frame))
            else:
                self.distrusted[robot].add(peer)

    def _are_the_next_words(self, robot: int, map_id: int, units: list[bytes]) -> bool:
        begin = len(self.sessions[robot].logs[map_id])
        return map_id != robot and units == self.recorded(map_id)[begin : begin + len(units)]
