"""The air between robots as a test wants it: frames are lost, late, doubled and reordered, and nobody is told."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agent.exchange.confirmed import ConfirmedSession
from agent.exchange.confirmed_gossip import ConfirmedGossip
from agent.exchange.gossip import EVERYONE
from agent.exchange.outcome import Outcome
from protocol import packet_index
from tests.agent.exchange.session_link import Reach, words

Mind = ConfirmedSession | ConfirmedGossip

MAKERS: dict[str, Callable[[int, int], Mind]] = {
    "backoff": lambda robot, robots: ConfirmedSession(robot, robots, "backoff"),
    "thesis": lambda robot, robots: ConfirmedSession(robot, robots, "thesis"),
    "gossip": ConfirmedGossip,
}


class LossyLink:
    """Minds of one team, and what is on its way to them."""

    def __init__(
        self, policy: str, robots: int, seed: int, *, loss: float = 0.0, delay: int = 0, twice: float = 0.0
    ) -> None:
        self.robot_settings = [MAKERS[policy](robot, robots) for robot in range(robots)]
        self.loss, self.delay, self.twice = loss, delay, twice
        self.carried = 0
        self._recorded = [0] * robots
        self._rng = np.random.default_rng(seed)
        self._coming: list[tuple[int, int, int, bytes]] = []
        self._now = 0

    def record(self, robot: int, count: int) -> None:
        begin = self._recorded[robot]
        self._recorded[robot] += count
        self.robot_settings[robot].record(words(robot, begin, begin + count))

    def recorded(self, robot: int) -> list[bytes]:
        return words(robot, 0, self._recorded[robot])

    def step(self, reach: Reach, budget: int | None = None, rounds: int = 2) -> None:
        self._now += 1
        left = budget
        for round_number in range(rounds):
            sent: dict[int, list[int]] = {robot: [] for robot in reach}
            said = [
                (robot, to, frame)
                for robot, peers in sorted(reach.items())
                for to, _, frame in self.robot_settings[robot].offers(round_number, list(peers), left)
            ]
            for at in self._rng.permutation(len(said)):
                robot, to, frame = said[at]
                size = len(frame) if left is None else packet_index.fitting(frame, left)
                left = None if left is None else left - size
                said[at] = robot, to, frame[:size]
            for robot, to, frame in said:
                sent[robot].append(len(frame))
                self.carried += len(frame)
                self._carry(robot, [*reach[robot]] if to == EVERYONE else [to], frame)
            self._hand_over(reach, sent)
        for mind in self.robot_settings:
            mind.forget()

    def _carry(self, sender: int, hearers: list[int], frame: bytes) -> None:
        for hearer in hearers:
            for _ in range(1 + int(self._rng.random() < self.twice)):
                if frame and self._rng.random() >= self.loss:
                    due = self._now + int(self._rng.integers(0, self.delay + 1))
                    self._coming.append((due, hearer, sender, frame))

    def _hand_over(self, reach: Reach, sent: dict[int, list[int]]) -> None:
        now = [each for each in self._coming if each[0] <= self._now]
        self._coming = [each for each in self._coming if each[0] > self._now]
        for robot in sorted(reach):
            heard = [(sender, frame) for _, hearer, sender, frame in now if hearer == robot]
            own, mind = sent[robot], self.robot_settings[robot]
            nothing = [0] * len(own)
            outcome = Outcome(self._now, 0, [-1] * len(own), nothing, nothing, own, [-1] * len(heard), False)
            for peer, map_id, frame in mind.outcome(outcome, heard):
                units, held = packet_index.split(frame), len(mind.logs[map_id])
                assert map_id != robot
                assert units == self.recorded(map_id)[held : held + len(units)], "units out of place"
                mind.accept(peer, map_id, frame, packet_index.ends(frame))
