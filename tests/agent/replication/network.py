"""A network of replication engines: a medium with range, budget, loss, delay and duplication, in one thread.

It stands for the relay and does with frames the plainest thing that a relay may do. Log entries are numbered, so an
entry that is repeated, missing, or in the wrong log is noticed: a robot that receives one rejects its sender.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from agent.replication.base import Replication
from agent.replication.engine import DISSEMINATIONS, make_replication
from agent.replication.gossip_policy import Dependencies
from agent.replication.replica import Consume, Rebuild, Rejected
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol import packet_index
from protocol.body import Body
from protocol.errors import ProtocolError
from protocol.messages import (
    EVERYONE,
    ConnectionReport,
    Delivery,
    OutgoingFrame,
    RoundReport,
    SendReport,
)
from protocol.packet_codec import decode, encode
from protocol.packets import SALTS, Fragment, Held, LogDigest

Reach = Mapping[int, Sequence[int]]
"""The robots in range of each robot; a robot without a key is dead."""

Tamper = Callable[[int, int, int, bytes], bytes]
"""Sender, receiver, the map to which entries in front of any header belong, and a frame of entries."""

VARIANTS = [(dissemination, acks) for dissemination in DISSEMINATIONS for acks in (False, True)]
"""Disseminations, on perfect and on lossy media."""


def make_engine(
    robot: int,
    robots: int,
    consume: Consume,
    dissemination: str = "backoff",
    *,
    requires_acks: bool = False,
    round_trip: int = 0,
    incarnations: int = 1,
    dependencies: Dependencies = lambda _number: (),
    rebuild: Rebuild = lambda _logs: None,
) -> Replication:
    """A replication engine; nothing but its arguments concerns it of a robot's settings."""
    settings = Settings(
        robot=robot, bodies=(Body(1.0, 360.0, 1.0),) * robots, width=1, height=1, beams=4, seed=0,
        strategy="meier", encoding=EncodingSettings("none"),
        replication=ReplicationSettings(dissemination, requires_acks=requires_acks, round_trip=round_trip),
        incarnations=incarnations,
    )  # fmt: skip
    return make_replication(settings, consume, dependencies, rebuild)


def engine(robot: int, robots: int, *, acks: bool = False, lie: bytes = b"") -> Replication:
    """An engine of gossip that can decode everything but `lie`."""

    def consume(peer: int, map_id: object, frame: bytes) -> list[int]:
        if frame == lie:
            raise ProtocolError("entry", 0, "a lie")
        return list(packet_index.ends(frame))

    return make_engine(robot, robots, consume, "gossip", requires_acks=acks)


def closing(*frames: tuple[int, bytes], sent: int | None = None) -> RoundReport:
    """The report of a round: the frames that arrived, with their senders, and the bytes sent of this robot's frame."""
    reports = [] if sent is None else [SendReport(0, sent)]
    return RoundReport(1, 0, [], reports, [Delivery(*each) for each in frames], False)


def entry(robot: int, number: int) -> bytes:
    """Entry `number` of a robot's log: unlike all others, and of one of several lengths."""
    return encode([Fragment(struct.pack(">BI", robot, number) + bytes(number % 4))])


def entries(robot: int, first: int, end: int) -> list[bytes]:
    return [entry(robot, number) for number in range(first, end)]


def fitting(frame: bytes, room: int) -> int:
    """Return how many bytes of a frame of whole packets fit into `room` bytes without cutting a packet."""
    index = packet_index.index_of(frame)
    return index.bytes_of(0, index.count_fitting(room)).stop


def everyone(robots: int) -> Reach:
    return {robot: [other for other in range(robots) if other != robot] for robot in range(robots)}


def line(robots: int) -> Reach:
    return {robot: [r for r in (robot - 1, robot + 1) if 0 <= r < robots] for robot in range(robots)}


def random_reach(rng: np.random.Generator, robots: int, chance: float) -> Reach:
    links = np.triu(rng.random((robots, robots)) < chance, 1)
    links |= links.T
    return {robot: np.flatnonzero(links[robot]).tolist() for robot in range(robots)}


@dataclass
class Transmission:
    """A frame that was on the air: a connection's offer, answer or data, or a frame without connection."""

    sender: int
    receiver: int
    map_id: int
    frames: list[bytes]
    """As sent."""
    carried: list[int] = field(default_factory=list)
    """Bytes on the air of each frame."""


class Network:
    """Engines of one team, and the medium between them."""

    def __init__(
        self,
        robots: int,
        dissemination: str = "backoff",
        seed: int = 0,
        *,
        acks: bool = False,
        loss: float = 0.0,
        delay: int = 0,
        duplication: float = 0.0,
        digests: bool = False,
    ) -> None:
        self.engines = [
            make_engine(
                robot,
                robots,
                partial(self._consume, robot),
                dissemination,
                requires_acks=acks,
                rebuild=partial(self._rebuild, robot),
            )
            for robot in range(robots)
        ]
        self.loss, self.delay, self.duplication = loss, delay, duplication
        self.tamper: Tamper = lambda _sender, _receiver, _map_id, payload: payload
        """Returns what a robot receives in place of entries that another one sends."""
        self.decoded = [[b""] * robots for _ in range(robots)]
        """What each robot has decoded of each other's log."""
        self.rejected: list[tuple[int, Rejected]] = []
        """The rejections of peers' entries, with the robots that rejected them."""
        self.announced = 0
        """Bytes of announcements so far, which are on the air besides those in `carried`."""
        self._salts = np.random.default_rng([seed, 1]) if digests else None
        self.understands: Callable[[int, int, list[bytes]], bool] = self.are_next
        """Whether a robot can decode the next entries of a map."""
        self.appended = [0] * robots
        self.rng = np.random.default_rng(seed)
        self.carried = 0
        """Bytes on the air so far."""
        self.last: list[Transmission] = []
        """What was on the air in the last round."""
        self._handshakes = dissemination != "gossip" and not acks
        self._now = 0
        self._coming: list[tuple[int, int, Delivery]] = []

    def append(self, robot: int, count: int) -> None:
        """Let a robot append so many entries to its log."""
        first = self.appended[robot]
        self.appended[robot] += count
        self.engines[robot].own_log.append(entries(robot, first, first + count))

    def written(self, robot: int) -> list[bytes]:
        """All entries that a robot ever appended."""
        return entries(robot, 0, self.appended[robot])

    def held(self, robot: int, of: int) -> list[bytes]:
        """The entries that a robot holds of another's log."""
        return packet_index.split(self.engines[robot].logs[of].read(0))

    def length(self, robot: int, of: int) -> int:
        """How many entries a robot holds of another's log."""
        return len(self.engines[robot].logs[of])

    def complete(self, robots: Sequence[int] | None = None) -> bool:
        """Whether these robots, or all, hold all entries that any robot appended."""
        return all(
            self.held(robot, of) == self.written(of)
            for robot in (robots if robots is not None else range(len(self.engines)))
            for of in range(len(self.engines))
        )

    def check(self) -> None:
        """Assert that logs hold what was appended, and that no robot expects a peer to hold more than it does."""
        for robot, engine in enumerate(self.engines):
            for of in range(len(self.engines)):
                assert self.held(robot, of) == self.written(of)[: self.length(robot, of)]
                for peer in range(len(self.engines)):
                    if peer != robot:
                        assert engine.peers.acked[peer, of] <= self.length(peer, of)

    def settle(self, reach: Reach, budget: int | None = None, rounds: int = 2, most: int = 400) -> int:
        """Return the steps until all logs are complete."""
        for step in range(most):
            if self.complete():
                return step
            self.step(reach, budget, rounds)
        raise AssertionError(f"logs differ after {most} steps")

    def step(self, reach: Reach, budget: int | None = None, rounds: int = 2) -> list[list[Transmission]]:
        """Play a step of at most so many rounds; return what was on the air in each."""
        self._now += 1
        played = []
        for number in range(rounds):
            before = self.carried
            played.append(self.round(number, reach, budget))
            if budget is not None:
                budget = 0 if self._closed else budget - (self.carried - before)
            if budget == 0 and self._handshakes:
                break
        return played

    def round(self, number: int, reach: Reach, budget: int | None = None) -> list[Transmission]:
        """Play a round; return what was on the air."""
        announced = self._announcements(reach) if number == 0 else {}
        sent = {
            robot: self.engines[robot].open_round(number, list(peers), budget)
            for robot, peers in sorted(reach.items())
        }
        for robot, frames in sent.items():
            assert all(frame.receiver == EVERYONE or frame.receiver in reach[robot] for frame in frames)
        for robot, payload in announced.items():
            self._deliver(robot, payload, reach[robot])
        self._closed = False
        self.last = (
            self._connections(sent, reach, budget) if self._handshakes else self._frames(sent, reach, budget)
        )
        for robot in announced:
            self.engines[robot].announced()
        self.carried += sum(sum(each.carried) for each in self.last)
        return self.last

    def _announcements(self, reach: Reach) -> dict[int, bytes]:
        """What robots broadcast about logs in this step."""
        payloads = {}
        for robot, engine in enumerate(self.engines):
            if self._salts is not None:
                engine.salt = int(self._salts.integers(SALTS))
            if reach.get(robot):
                payloads[robot] = engine.announcements()
        return {robot: payload for robot, payload in payloads.items() if payload}

    def _deliver(self, robot: int, payload: bytes, peers: Sequence[int]) -> None:
        """Deliver a broadcast; robots receive it between the opening and the closing of a round."""
        self.announced += len(payload)
        for peer in peers:
            if self.loss and self.rng.random() < self.loss:
                continue
            for packet in decode(payload):
                assert isinstance(packet, LogDigest | Held)
                self._note(peer, self.engines[peer].receive_announcement(robot, packet))

    def _note(self, robot: int, rejected: list[Rejected]) -> None:
        self.rejected += [(robot, each) for each in rejected]

    # --- handshakes

    def _connections(
        self, sent: dict[int, list[OutgoingFrame]], reach: Reach, budget: int | None
    ) -> list[Transmission]:
        offers = [
            Transmission(robot, each.receiver, packet_map(each.payload), [each.payload])
            for robot, frames in sent.items()
            for each in frames
        ]
        offers = [offers[at] for at in self.rng.permutation(len(offers))]
        for robot in sorted(reach):
            arrived = [
                Delivery(each.sender, each.frames[0], number)
                for number, each in enumerate(offers)
                if each.receiver == robot
            ]
            if reach[robot] and arrived:
                for frame in self.engines[robot].answer(arrived):
                    assert offers[frame.connection].sender == frame.receiver
                    offers[frame.connection].frames.append(frame.payload)
        for robot in sorted(reach):
            arrived = [
                Delivery(each.receiver, each.frames[1], number, each.map_id)
                for number, each in enumerate(offers)
                if each.sender == robot and len(each.frames) > 1
            ]
            if arrived:
                for frame in self.engines[robot].send_data(arrived):
                    assert offers[frame.connection].receiver == frame.receiver
                    offers[frame.connection].frames.append(frame.payload)
        self._carry_connections(offers, budget)
        for robot in sorted(reach):
            self._report_connections(robot, offers)
        return offers

    def _carry_connections(self, played: list[Transmission], left: int | None) -> None:
        for each in played:
            each.carried = [0, 0, 0]
            for at, frame in enumerate(each.frames):
                size = len(frame)
                if left is not None and size > left:
                    size = fitting(frame, left) if at == 2 else 0
                    self._closed = True
                    left = size
                each.carried[at] = size
                left = None if left is None else left - size
                if size < len(frame):
                    break

    def _report_connections(self, robot: int, played: list[Transmission]) -> None:
        reports = [
            ConnectionReport(number, *each.carried)
            for number, each in enumerate(played)
            if robot in (each.sender, each.receiver)
        ]
        data = [
            Delivery(
                each.sender,
                self.tamper(each.sender, robot, each.map_id, each.frames[2][: each.carried[2]]),
                number,
            )
            for number, each in enumerate(played)
            if each.receiver == robot and each.carried[2]
        ]
        report = RoundReport(self._now, 0, reports, [], data, False)
        self._note(robot, self.engines[robot].close_round(report))

    # --- frames without connections

    def _frames(
        self, sent: dict[int, list[OutgoingFrame]], reach: Reach, left: int | None
    ) -> list[Transmission]:
        frames = [
            Transmission(robot, each.receiver, -1, [each.payload])
            for robot, these in sent.items()
            for each in these
        ]
        for at in self.rng.permutation(len(frames)):
            frame = frames[at].frames[0]
            size = len(frame) if left is None else fitting(frame, left)
            left = None if left is None else left - size
            frames[at].carried = [size]
            to = reach[frames[at].sender] if frames[at].receiver == EVERYONE else [frames[at].receiver]
            for receiver in to:
                sender = frames[at].sender
                self._transmit(
                    receiver, Delivery(sender, self.tamper(sender, receiver, sender, frame[:size]))
                )
        now = [each for each in self._coming if each[0] <= self._now]
        self._coming = [each for each in self._coming if each[0] > self._now]
        for robot in sorted(reach):
            own = [each for each in frames if each.sender == robot]
            sizes = [SendReport(number, each.carried[0]) for number, each in enumerate(own)]
            arrived = [delivery for _, receiver, delivery in now if receiver == robot]
            report = RoundReport(self._now, 0, [], sizes, arrived, False)
            self._note(robot, self.engines[robot].close_round(report))
        return frames

    def _transmit(self, receiver: int, delivery: Delivery) -> None:
        for _ in range(1 + int(self.rng.random() < self.duplication)):
            if delivery.payload and self.rng.random() >= self.loss:
                due = self._now + int(self.rng.integers(0, self.delay + 1))
                self._coming.append((due, receiver, delivery))

    # --- decoding

    def _consume(self, robot: int, peer: int, map_id: int, frame: bytes) -> Sequence[int]:
        if not self.understands(robot, map_id, packet_index.split(frame)):
            raise ProtocolError("entry", 0, f"robot {robot} cannot decode what robot {peer} sends")
        ends = packet_index.ends(frame)
        self.decoded[robot][map_id] += frame
        return ends

    def _rebuild(self, robot: int, logs: Sequence[bytes]) -> None:
        self.decoded[robot] = list(logs)

    def are_next(self, robot: int, map_id: int, received: list[bytes]) -> bool:
        """Whether entries are the next ones of a map that another robot writes."""
        first = self.length(robot, map_id)
        return map_id != robot and received == self.written(map_id)[first : first + len(received)]


def packet_map(offer: bytes) -> int:
    """The map number of an offer."""
    from protocol.packet_codec import decode
    from protocol.packets import Offer

    (packet,) = decode(offer)
    assert isinstance(packet, Offer)
    return packet.map
