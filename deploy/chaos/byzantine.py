"""Hostile and damaged frames: byzantine robots, and bits that flip on the way to a robot although the checksum holds.

The control logic of a byzantine robot is that of any other robot, and it holds valid credentials. Its radio sometimes
sends a different frame: random bytes, flipped bits, a truncated or repeated frame, a well-formed packet with false
content, or entries that it attributes to another robot. All are drawn from the robot's number and its count of frames,
so that they are the same on both buses. Other robots send very long messages.

Byzantine robots with false maps of their own: `deploy.chaos.false_maps`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from protocol import keys as names
from protocol import packet_codec, packets, rights
from protocol.bus import Bus, Message
from protocol.keyed_random import keyed_random
from protocol.keys import Keys
from protocol.message_codec import pack, unpack
from protocol.messages import RelayUpdate, RoundReport

REPLACED = 0.25
"""Probability that a frame is replaced."""

FLIPPED = 0.02
"""Probability that a bit of a received frame flips, in robots whose radios receive damaged frames."""

HEAVY_BYTES = (4 << 20, 16 << 20)
"""Lengths of long messages; below the limit of the hub, so that they arrive."""
HEAVY_AFTER = 6
"""Received messages after which a robot sends long messages, once per start."""


@dataclass(frozen=True)
class HostileRadios:
    """A wrapper for the buses of participants, drawn from `seed`.

    Robots in `byzantine` get a `ByzantineBus`, those in `flipped` a `FlippingBus`, those in `heavy` a `HeavyBus`.
    """

    seed: int
    byzantine: tuple[int, ...] = ()
    flipped: tuple[int, ...] = ()
    heavy: tuple[int, ...] = ()

    def __call__(self, name: str, bus: Bus) -> Bus:
        """Wrap the bus of the participant `name`, if its radio is hostile or damages frames."""
        if name in map(names.robot, self.flipped):
            bus = FlippingBus(bus, self.seed, names.number(name))
        if name in map(names.robot, self.heavy):
            bus = HeavyBus(bus, name)
        byzantine = name in map(names.robot, self.byzantine)
        return ByzantineBus(bus, self.seed, names.number(name)) if byzantine else bus


class FlippingBus:
    """An end of the bus that flips a bit of some log entries which its robot receives."""

    def __init__(self, bus: Bus, seed: int, robot: int) -> None:
        self.put, self.close = bus.put, bus.close
        self._bus = bus
        self._seed = seed
        self._robot = robot
        self._count = 0

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Receive a message, possibly with damaged frames."""
        message = self._bus.receive(timeout_s)
        if message is None or names.parts(message.key)[0] != "radio":
            return message
        update = unpack(message.payload)
        if not isinstance(update, RelayUpdate):
            return message
        events = [
            replace(
                event,
                deliveries=[replace(each, payload=self._damaged(each.payload)) for each in event.deliveries],
            )
            if isinstance(event, RoundReport)
            else event
            for event in update.events
        ]
        return message._replace(payload=pack(RelayUpdate(events)))

    def _damaged(self, frame: bytes) -> bytes:
        """The frame, or the frame with another value of one bit."""
        self._count += 1
        draw = keyed_random(self._seed, "flip", self._robot, self._count)
        if draw.random() >= FLIPPED:
            return frame
        return _flipped(draw, frame, 1)


class HeavyBus:
    """An end of the bus that sends long messages without meaning to all participants that its robot may send to."""

    def __init__(self, bus: Bus, name: str) -> None:
        self.put, self.close = bus.put, bus.close
        self._bus = bus
        self._name = name
        self._received = 0

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Receive a message; after some of them, send the long ones."""
        message = self._bus.receive(timeout_s)
        self._received += message is not None
        if message is not None and self._received == HEAVY_AFTER:
            for key in rights.may_put(Keys(message.key.split("/")[1]), self._name):
                for size in HEAVY_BYTES if "*" not in key else ():
                    self.put(key, bytes(size))
        return message


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
        self._last = frame
        return sent

    def _replacement(self, draw: np.random.Generator, frame: bytes) -> bytes:
        match int(draw.integers(7)):
            case 0:
                return bytes(draw.bytes(int(draw.integers(1, 80))))
            case 1:
                return _flipped(draw, frame, int(draw.integers(1, 4)))
            case 2:
                return frame[: int(draw.integers(len(frame) + 1))]
            case 3:
                return 2 * frame[:30]
            case 4:
                return self._last
            case 5:
                return packet_codec.encode([_packet(draw) for _ in range(int(draw.integers(1, 4)))])
            case _:
                begin = packets.FromEarly(int(draw.integers(6)), int(draw.integers(packets.EARLY)))
                update = packets.Update(int(draw.integers(packets.UPDATE_NUMBERS)), bytes(draw.bytes(20)))
                return packet_codec.encode([begin]) + packet_codec.encode([update])


def _flipped(draw: np.random.Generator, frame: bytes, bits: int) -> bytes:
    flipped = bytearray(frame)
    for _ in range(bits):
        flipped[int(draw.integers(len(flipped)))] ^= 1 << int(draw.integers(8))
    return bytes(flipped)


def _packet(draw: np.random.Generator) -> packets.Packet:
    """A well-formed packet with random content."""
    number, index = int(draw.integers(64)), int(draw.integers(4096))
    small = int(draw.integers(6))
    types: list[packets.Packet] = [
        packets.Offer(small, number), packets.Answer(index), packets.Block(number), packets.Block(packets.DECLINED),
        packets.From(small, index), packets.Held(small, index), packets.Near(small), packets.Gone(small),
        packets.Pose(index % 2048, small, small % 2), packets.Save(), packets.Remove(index),
        packets.Target(index % 2048, number),
    ]  # fmt: skip
    return types[int(draw.integers(len(types)))]
