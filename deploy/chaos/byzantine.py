"""Liars: robots whose radios say what is hostile, though they have every right to speak.

A liar's own mind is that of any robot. What its radio says is now and then something else: noise, bits turned over, a
frame cut off or said twice, a well-formed packet that does not belong there or that is not true. All of it is drawn by
the liar's number and the count of its frames, so that it lies the same on both buses.

What it does not do is to counterfeit what it has seen, in words that are well formed: nobody could tell that from the
truth but by going there. Against that there is access control, not the exchange.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from protocol import keys as names
from protocol import packet_index, packets
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.keyed_random import keyed_random
from protocol.messages import pack, unpack
from protocol.packets import Answer, Block, Decline, From, Gone, Held, Near, Offer, Pose, Remove, Save, Target

LIES = 0.25
"""Probability that a frame is another one."""

NO_UNITS = {Offer.name, Target.name, Pose.name}
"""Kinds of packets that are no part of any log."""


@dataclass(frozen=True)
class Lies:
    """What is laid around the buses of participants: that of a liar lies."""

    seed: int
    byzantine: tuple[int, ...]

    def __call__(self, name: str, bus: Bus) -> Bus:
        """The end of the bus of `name`, or one that lies."""
        lies = name in map(names.robot, self.byzantine)
        return LyingBus(bus, self.seed, names.number(name)) if lies else bus


class LyingBus:
    """An end of the bus whose owner's radio says what is hostile now and then."""

    def __init__(self, bus: Bus, seed: int, robot: int) -> None:
        self._bus = bus
        self._seed = seed
        self._robot = robot
        self._count = 0
        self._last = b"\xf0"

    def put(self, key: str, payload: bytes) -> None:
        """Send a payload, or what a liar makes of it."""
        if names.parts(key)[0] == "radio":
            said = unpack(payload)
            broadcast = self._spoken(said.broadcast) if said.broadcast else b""
            frames = [replace(frame, payload=self._spoken(frame.payload)) for frame in said.frames]
            payload = pack(replace(said, broadcast=broadcast, frames=frames))
        self._bus.put(key, payload)

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Return the next message, as it is."""
        return self._bus.receive(timeout_s)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()

    def _spoken(self, true: bytes) -> bytes:
        """A frame, or what a liar makes of it."""
        self._count += 1
        draw = keyed_random(self._seed, "lie", self._robot, self._count)
        said = self._lie(draw, true) if draw.random() < LIES else true
        if said != true and not true.startswith(said) and _tells_of_maps(said):
            said = bytes(draw.bytes(20))
        self._last = true
        return said

    def _lie(self, draw: np.random.Generator, payload: bytes) -> bytes:
        kind = int(draw.integers(6))
        if kind == 0:
            return bytes(draw.bytes(int(draw.integers(1, 80))))
        if kind == 1:
            turned = bytearray(payload)
            for _ in range(int(draw.integers(1, 4))):
                turned[int(draw.integers(len(turned)))] ^= 1 << int(draw.integers(8))
            return bytes(turned)
        if kind == 2:
            return payload[: int(draw.integers(len(payload) + 1))]
        if kind == 3:
            return payload + payload
        if kind == 4:
            return self._last
        return packets.encode([_packet(draw) for _ in range(int(draw.integers(1, 4)))])


def _tells_of_maps(payload: bytes) -> bool:
    """Whether a frame is well formed, and has units of logs in it."""
    try:
        return any(packets.name(piece) not in NO_UNITS for piece in packet_index.split(payload))
    except ProtocolError:
        return False


def _packet(draw: np.random.Generator) -> packets.Packet:
    """A well-formed packet of no truth."""
    number, index = int(draw.integers(64)), int(draw.integers(4096))
    few = int(draw.integers(6))
    all_kinds: list[packets.Packet] = [
        Offer(few, number), Answer(index), Block(number), Decline(), From(few, index), Held(few, index), Near(few),
        Gone(few), Pose(index % 2048, few, few % 2), Save(), Remove(index), Target(index % 2048, number),
    ]  # fmt: skip
    return all_kinds[int(draw.integers(len(all_kinds)))]
