"""Traffic of a watched run: the messages on each TCP connection, and the frames of its capture."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

from deploy.record import run_directory
from netshaper import capture
from netshaper.capture import Captured
from netshaper.ledger import EVERYONE, FRAMES
from netshaper.pcapng import Reader
from protocol import keys
from protocol.message_codec import unpack
from protocol.messages import RobotFrames
from protocol.numbering import HEAD
from tests.capture.sniffer import Segment, Strangers, Stream, segments
from tests.capture.zenoh_wire import Session

UP, DOWN = 0, 1
PHASES = tuple(FRAMES.index(name) for name in ("broadcast", "offer", "answer", "data"))
"""The kinds of frames in the order of the phases of a round."""


def frames_of(message: RobotFrames) -> list[tuple[str, bytes]]:
    """All frames of a message in order, each with its receiver."""
    broadcast = [("all", message.broadcast)] if message.broadcast else []
    named = [
        ("all" if frame.receiver < 0 else f"r{frame.receiver}", frame.payload) for frame in message.frames
    ]
    return broadcast + named


@dataclass
class Connection:
    """One TCP connection to the hub: the messages in each direction, in order."""

    port: int
    name: str = ""
    """The process that holds its other end."""
    streams: tuple[Stream, Stream] = field(default_factory=lambda: (Stream(), Stream()))
    session: Session = field(default_factory=Session)
    puts: tuple[list[tuple[str, bytes]], list[tuple[str, bytes]]] = field(default_factory=lambda: ([], []))
    """(key without ``murmur/<run>/``, payload), up to the hub and down from it."""
    declared: tuple[list[tuple[str, str]], list[tuple[str, str]]] = field(default_factory=lambda: ([], []))
    """All other declarations: (kind, key)."""

    def take(self, way: int, segment: Segment) -> None:
        for message in self.session.feed(way, self.streams[way].take(segment)):
            key = message.key.split("/", 2)[2]
            if message.kind == "put":
                self.puts[way].append((key, message.payload))
            else:
                self.declared[way].append((message.kind, key))

    def radio(self, way: int) -> list[tuple[str, bytes]]:
        """The frames of messages under radio keys: (robot at the other end, payload)."""
        messages = [
            unpack(payload[HEAD.size :]) for key, payload in self.puts[way] if key.startswith("radio/")
        ]
        if way == UP:
            return [frame for message in messages for frame in frames_of(message)]
        return [
            (f"r{each.sender}", each.payload)
            for update in messages
            for event in update.events
            for each in getattr(event, "deliveries", ())
        ]

    def submitted(self) -> dict[tuple[int, int, str], RobotFrames]:
        """All frames that a robot sent to the relay, by step, round and phase."""
        messages = (
            unpack(payload[HEAD.size :]) for key, payload in self.puts[UP] if key.startswith("radio/")
        )
        return {(each.step, each.round, each.phase): each for each in messages}

    @property
    def bytes(self) -> int:
        return sum(stream.bytes for stream in self.streams)


class Traffic:
    """A watched run, read back from the directory that ``watched_swarm.py`` left."""

    def __init__(self, folder: Path) -> None:
        table: dict[str, Any] = json.loads((folder / "table.json").read_text())
        self.alone: bool = table["alone"]
        self.dropped: int = table["dropped"]
        self.processes: dict[str, Any] = table["processes"]
        self.run = folder / "run"
        self.strangers = Strangers()
        names = {local: name for name, held in self.processes.items() for local, _ in held["tcp"]}
        self.hub = next(
            remote for name, held in self.processes.items() if name != "relay" for _, remote in held["tcp"]
        )
        self.connections: dict[int, Connection] = {}
        for segment in segments(_packets(folder / "packets.bin"), self.strangers):
            if self.hub not in (segment.source, segment.target):
                self.strangers.add(f"TCP between ports {segment.source} and {segment.target}")
                continue
            way = UP if segment.target == self.hub else DOWN
            port = segment.source if way == UP else segment.target
            known = self.connections.setdefault(port, Connection(port, names.get(port, "")))
            known.take(way, segment)
        # A client that the hub did not accept at once tries again: connections without messages do not count.
        for port, known in list(self.connections.items()):
            if not (known.name or any(known.puts) or any(known.declared)):
                del self.connections[port]

    def of(self, name: str) -> Connection:
        """The one connection of a process."""
        (found,) = (connection for connection in self.connections.values() if connection.name == name)
        return found

    @property
    def robots(self) -> list[int]:
        return sorted(keys.number(name) for name in self.processes if keys.is_robot(name))

    def overhead(self) -> Counter[str]:
        """Bytes on all connections: payload of each plane, and overhead of the bus."""
        bytes_of: Counter[str] = Counter()
        for connection in self.connections.values():
            bytes_of["bus"] += connection.bytes
            for key, payload in (*connection.puts[UP], *connection.puts[DOWN]):
                bytes_of[key.split("/")[0]] += len(payload)
                bytes_of["bus"] -= len(payload)
        return bytes_of


@dataclass(frozen=True)
class CapturedFrame:
    """A frame of the capture, joined from its parts.

    `known` are its captured bytes: at least all that were carried.
    """

    step: int
    round: int
    frame: int
    sender: int
    receiver: int
    size: int
    carried: int
    known: bytes
    receivers: tuple[int, ...]

    def is_payload(self, payload: bytes) -> bool:
        """Whether these are the bytes of this frame."""
        return len(payload) == self.size and payload.startswith(self.known)


def frames(run: Path) -> list[CapturedFrame]:
    """All frames of a capture, in its order."""
    with (run / run_directory.CAPTURE).open("rb") as file:
        captured = list(capture.read(Reader(file)))
    return [_together(list(parts)) for _, parts in groupby(captured, _identity(captured))]


def _identity(captured: list[Captured]) -> Any:
    """A key that is equal for successive parts of one frame; each part without a connection is a frame of its own."""
    number = {id(item): at for at, item in enumerate(captured)}

    def key(item: Captured) -> tuple[int, ...]:
        own = number[id(item)] if item.connection < 0 else -1
        return item.step, item.round, item.connection, item.frame, own

    return key


def _together(parts: list[Captured]) -> CapturedFrame:
    first = parts[0]
    received = {robot for part in parts for robot in part.receivers}
    return CapturedFrame(
        first.step,
        first.round,
        first.frame,
        first.sender,
        first.receiver,
        sum(part.size for part in parts),
        sum(part.size for part in parts if part.verdict == "carried"),
        b"".join(part.payload for part in parts),
        tuple(sorted(received)),
    )


def in_phases(sent: list[CapturedFrame]) -> Iterator[tuple[int, list[CapturedFrame]]]:
    """Yield the frames phase by phase, as they are sent and relayed: (kind of frame, frames of that phase)."""
    for _, round_number in in_rounds(sent):
        for phase in PHASES:
            yield phase, [frame for frame in round_number if frame.frame == phase]


def in_rounds(sent: list[CapturedFrame]) -> Iterator[tuple[tuple[int, int], list[CapturedFrame]]]:
    """Yield the frames round by round: ((step, round), frames)."""
    for name, round_number in groupby(sent, lambda frame: (frame.step, frame.round)):
        yield name, list(round_number)


def relayed_to(sent: list[CapturedFrame], robot: int) -> list[tuple[str, bytes]]:
    """Frames that the relay must have delivered to a robot, in order, as (sender, payload).

    Offers and answers are delivered before the connections are processed, including those that are cut then; of data
    and broadcasts a robot gets the part that was carried.
    """
    result = []
    for phase, these in in_phases(sent):
        for frame in these:
            name = f"r{frame.sender}"
            if FRAMES[phase] in ("offer", "answer") and frame.receiver == robot:
                result.append((name, frame.known))
            elif robot in frame.receivers and frame.carried and frame.receiver in (robot, EVERYONE):
                result.append((name, frame.known[: frame.carried]))
    return result


def _packets(file: Path) -> Iterator[bytes]:
    data = file.read_bytes()
    at = 0
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        yield data[at + 4 : at + 4 + size]
        at += 4 + size
