"""Robots that follow a script: their frames depend only on their seed and on the events that they receive."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from netshaper.ledger import EVERYONE
from protocol import packet_codec, packets
from protocol.messages import (
    Close,
    Delivery,
    MediumEvent,
    Open,
    OutgoingFrame,
    PhaseDelivery,
    RobotFrames,
)


class Robot:
    """A correct robot; its seed determines its offers, answers and data."""

    def __init__(self, number: int, robots: int, seed: int) -> None:
        self.number = number
        self.robots = robots
        self.seed = seed

    def __call__(self, event: MediumEvent) -> Sequence[RobotFrames]:
        match event:
            case Open():
                return self.opens(event)
            case PhaseDelivery():
                return self.replies(event)
            case Close():
                return self.rests(event)
        return []

    def draw(self, *key: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, self.number, *key])

    def opens(self, event: Open) -> list[RobotFrames]:
        rng = self.draw(event.step, event.round, 0)
        frames = []
        broadcast = self.target(rng) if event.round == 0 and rng.random() < 0.6 else b""
        # Drawn for all robots, so that a teammate in or out of range does not change the others' draws.
        for peer in range(self.robots):
            maps = rng.permutation(self.robots)[: rng.integers(0, 3)].tolist()
            block = int(rng.integers(64))
            if peer in event.peers:
                frames += [
                    OutgoingFrame(peer, packet_codec.encode([packets.Offer(map_id, block)]))
                    for map_id in maps
                ]
        return [RobotFrames(event.step, event.round, "offers", broadcast, frames)]

    def target(self, rng: np.random.Generator) -> bytes:
        return packet_codec.encode([packets.Target(*rng.integers(0, 2048, 2).tolist())])

    def replies(self, event: PhaseDelivery) -> list[RobotFrames]:
        phase = "answers" if event.phase == "offers" else "data"
        return [RobotFrames(event.step, event.round, phase, frames=self.reply_to(event, event.deliveries))]

    def reply_to(self, event: PhaseDelivery, deliveries: Sequence[Delivery]) -> list[OutgoingFrame]:
        frames = []
        for each in deliveries:
            is_answer = event.phase == "answers"
            rng = self.draw(event.step, event.round, 1, each.sender, each.map_id, is_answer)
            payload = self.data(rng, each.payload) if is_answer else self.answer(rng)
            if payload:
                frames.append(OutgoingFrame(each.sender, payload, each.connection))
        return frames

    def answer(self, rng: np.random.Generator) -> bytes:
        index, block = packets.Answer(int(rng.integers(4096))), packets.Block(int(rng.integers(64)))
        choices: list[list[packets.Packet]] = [[index], [block, index], [packets.Block(packets.DECLINED)]]
        return packet_codec.encode(choices[rng.integers(3)])

    def data(self, rng: np.random.Generator, answer: bytes) -> bytes:
        if answer == packet_codec.encode([packets.Block(packets.DECLINED)]) or rng.random() < 0.2:
            return b""
        kinds = [
            packets.Save(),
            packets.Delete(5),
            packets.Insert(1, 2, 3, 0, 1),
            packets.Fragment(bytes(63)),
        ]
        return packet_codec.encode([kinds[kind] for kind in rng.integers(0, 4, rng.integers(1, 12))])

    def rests(self, _event: Close) -> list[RobotFrames]:
        return []


class Gossiper(Robot):
    """A robot that broadcasts log entries, and a target now and then."""

    def opens(self, event: Open) -> list[RobotFrames]:
        rng = self.draw(event.step, event.round, 6)
        broadcast = self.target(rng) if event.round == 0 and rng.random() < 0.6 else b""
        kinds = [
            packets.Save(),
            packets.Insert(1, 2, 3, 0, 1),
            packets.Fragment(bytes(63)),
            packets.Update(None, bytes(8)),
            packets.Update(0, b"new"),
            packets.FromFirst(1, 7),
            packets.Held(0, 300),
            packets.Gone(1),
        ]
        news = packet_codec.encode([kinds[kind] for kind in rng.integers(0, len(kinds), rng.integers(0, 9))])
        frames = [OutgoingFrame(EVERYONE, news)] if news else []
        priority = int(rng.integers(0, 256))
        return [RobotFrames(event.step, event.round, "offers", broadcast, frames, priority)]


class ByzantineRobot(Robot):
    """A byzantine robot: it sends arbitrary frames at any time, but ends each phase correctly."""

    def noise(self, rng: np.random.Generator, step: int) -> list[RobotFrames]:
        return [
            RobotFrames(
                step,
                int(rng.integers(0, 3)),
                ("offers", "answers", "data", "unknown")[rng.integers(4)],
                self.frame(rng) if rng.random() < 0.3 else b"",
                self.frames(rng),
            )
            for _ in range(rng.integers(0, 3))
        ]

    def frames(self, rng: np.random.Generator) -> list[OutgoingFrame]:
        return [
            OutgoingFrame(int(rng.integers(-99, self.robots + 3)), self.frame(rng), int(rng.integers(-3, 9)))
            for _ in range(rng.integers(0, 6))
        ]

    def frame(self, rng: np.random.Generator) -> bytes:
        choices: list[Callable[[], bytes]] = [
            lambda: rng.bytes(int(rng.integers(0, 30))),
            lambda: b"",
            lambda: packet_codec.encode([packets.Offer(int(rng.integers(64)), 0)]),
            lambda: 2 * packet_codec.encode([packets.Offer(int(rng.integers(self.robots)), 0)]),
            lambda: packet_codec.encode([packets.Target(1, 2)]),
            lambda: self.answer(rng),
            lambda: Robot.data(self, rng, b""),
        ]
        return choices[rng.integers(len(choices))]()

    def opens(self, event: Open) -> list[RobotFrames]:
        rng = self.draw(event.step, event.round, 2)
        (honest,) = super().opens(event)
        frames = [*self.frames(rng), *honest.frames, *honest.frames]
        broadcast = self.frame(rng) if rng.random() < 0.3 else honest.broadcast
        offers = RobotFrames(event.step, event.round, "offers", broadcast, frames)
        return [offers, *self.noise(rng, event.step)]

    def replies(self, event: PhaseDelivery) -> list[RobotFrames]:
        rng = self.draw(event.step, event.round, 3, event.phase == "offers")
        (honest,) = super().replies(event)
        numbers = rng.permutation([*(each.connection for each in event.deliveries), *range(-2, 9)]).tolist()
        mixed = [
            OutgoingFrame(frame.receiver, frame.payload, number)
            for frame, number in zip(honest.frames, numbers, strict=False)
        ]
        frames = [*self.frames(rng), *mixed, *honest.frames]
        end = RobotFrames(event.step, event.round, honest.phase, b"", frames)
        return [end, end, *self.noise(rng, event.step)]

    def rests(self, event: Close) -> list[RobotFrames]:
        return self.noise(self.draw(event.step, 4), event.step)


class Mute(Robot):
    """A robot that has joined and sends nothing."""

    def opens(self, _event: Open) -> list[RobotFrames]:
        return []
