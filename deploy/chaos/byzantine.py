"""Byzantine robots: their radios send hostile frames, although they hold valid credentials.

The control logic of a byzantine robot is that of any other robot. Its radio sometimes sends a different frame: random
bytes, flipped bits, a truncated or repeated frame, or a well-formed packet with false content. All are drawn from the
robot's number and its count of frames, so that they are the same on both buses.

Byzantine robots with false maps of their own: `deploy.chaos.false_maps`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from protocol import keys as names
from protocol import packet_index, packets
from protocol.bus import Bus
from protocol.errors import ProtocolError
from protocol.keyed_random import keyed_random
from protocol.messages import pack, unpack
from protocol.packets import Answer, Block, Decline, From, Gone, Held, Near, Offer, Pose, Remove, Save, Target

REPLACED = 0.25
"""Probability that a frame is replaced."""

NOT_LOGGED = {Offer.name, Target.name, Pose.name}
"""Packet types that are not part of a log."""


@dataclass(frozen=True)
class ByzantineRadios:
    """A wrapper for the buses of participants: the robots in `robots` get a `ByzantineBus`, drawn from `seed`."""

    seed: int
    robots: tuple[int, ...]

    def __call__(self, name: str, bus: Bus) -> Bus:
        """Wrap the bus of the participant `name`, if it is a byzantine robot."""
        byzantine = name in map(names.robot, self.robots)
        return ByzantineBus(bus, self.seed, names.number(name)) if byzantine else bus


class ByzantineBus:
    """An end of the bus that sometimes replaces the frames of its robot's radio."""

    def __init__(self, bus: Bus, seed: int, robot: int) -> None:
        self.receive, self.close = bus.receive, bus.close
        self._bus = bus
        self._seed = seed
        self._robot = robot
        self._count = 0
        self._last = b"\xf0"

    def put(self, key: str, payload: bytes) -> None:
        """Send a message, possibly with other frames."""
        if names.parts(key)[0] == "radio":
            message = unpack(payload)
            broadcast = self._transmitted(message.broadcast) if message.broadcast else b""
            frames = [replace(each, payload=self._transmitted(each.payload)) for each in message.frames]
            payload = pack(replace(message, broadcast=broadcast, frames=frames))
        self._bus.put(key, payload)

    def _transmitted(self, frame: bytes) -> bytes:
        """The frame, or its replacement."""
        self._count += 1
        draw = keyed_random(self._seed, "lie", self._robot, self._count)
        sent = self._replacement(draw, frame) if draw.random() < REPLACED else frame
        if sent != frame and not frame.startswith(sent) and _has_log_entries(sent):
            sent = bytes(draw.bytes(20))
        self._last = frame
        return sent

    def _replacement(self, draw: np.random.Generator, frame: bytes) -> bytes:
        kind = int(draw.integers(6))
        if kind == 0:
            return bytes(draw.bytes(int(draw.integers(1, 80))))
        if kind == 1:
            flipped = bytearray(frame)
            for _ in range(int(draw.integers(1, 4))):
                flipped[int(draw.integers(len(flipped)))] ^= 1 << int(draw.integers(8))
            return bytes(flipped)
        if kind == 2:
            return frame[: int(draw.integers(len(frame) + 1))]
        if kind == 5:
            return packets.encode([_packet(draw) for _ in range(int(draw.integers(1, 4)))])
        return frame + frame if kind == 3 else self._last


def _has_log_entries(frame: bytes) -> bool:
    """Whether a frame is well formed and contains log entries."""
    try:
        return any(packets.name(piece) not in NOT_LOGGED for piece in packet_index.split(frame))
    except ProtocolError:
        return False


def _packet(draw: np.random.Generator) -> packets.Packet:
    """A well-formed packet with random content."""
    number, index = int(draw.integers(64)), int(draw.integers(4096))
    small = int(draw.integers(6))
    types: list[packets.Packet] = [
        Offer(small, number), Answer(index), Block(number), Decline(), From(small, index), Held(small, index),
        Near(small), Gone(small), Pose(index % 2048, small, small % 2), Save(), Remove(index),
        Target(index % 2048, number),
    ]  # fmt: skip
    return types[int(draw.integers(len(types)))]
