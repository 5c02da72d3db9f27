"""Transport in memory: it loses, delays, repeats, and separates frames, equally in each run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush

from protocol.keyed_random import keyed_random


@dataclass(frozen=True)
class Faults:
    """Probabilities of loss and duplication, and the longest delay in nanoseconds; for each frame and receiver."""

    loss: float = 0.0
    duplication: float = 0.0
    delay: int = 0


class MemoryAir:
    """The air between the transports of one process.

    `separated(sender, receiver, now)` tells whether a frame does not reach a receiver because they are out of range.
    """

    def __init__(
        self,
        seed: int,
        faults: Faults,
        separated: Callable[[int, int, int], bool] = lambda _sender, _receiver, _now: False,
    ) -> None:
        self.now = 0
        """The time, which the caller sets."""
        self._seed = seed
        self._faults = faults
        self._separated = separated
        self._ends: dict[int, MemoryTransport] = {}
        self._frames = 0

    def join(self, number: int, longest: int) -> MemoryTransport:
        """Return a new end for a robot, in place of its old one if it has one."""
        self._ends[number] = MemoryTransport(self, number, longest)
        return self._ends[number]

    def carry(self, sender: int, frame: bytes) -> None:
        """Bring a frame to all others in range."""
        self._frames += 1
        for receiver, end in sorted(self._ends.items()):
            if receiver == sender or self._separated(sender, receiver, self.now):
                continue
            random = keyed_random(self._seed, "memory air", self._frames, receiver)
            lost, again, first, second = random.random(4).tolist()
            if lost >= self._faults.loss:
                times = [first, second] if again < self._faults.duplication else [first]
                for order, part in enumerate(times):
                    end.arrive(self.now + int(part * self._faults.delay), (self._frames, order), frame)


class MemoryTransport:
    """One robot's end of the air."""

    def __init__(self, air: MemoryAir, number: int, longest: int) -> None:
        self._longest = longest
        self._air = air
        self._number = number
        self._coming: list[tuple[int, tuple[int, int], bytes]] = []

    def send(self, frame: bytes) -> bool:
        """Send a frame; return False if it is too long."""
        if len(frame) > self._longest:
            return False
        self._air.carry(self._number, frame)
        return True

    def receive(self) -> list[bytes]:
        """Return the frames that have arrived by now."""
        frames = []
        while self._coming and self._coming[0][0] <= self._air.now:
            frames.append(heappop(self._coming)[2])
        return frames

    def fileno(self) -> int:
        """Return -1: there is nothing to wait for."""
        return -1

    def close(self) -> None:
        """Do nothing: the air outlives its ends."""

    def arrive(self, time: int, order: tuple[int, int], frame: bytes) -> None:
        """Let a frame arrive at a time."""
        heappush(self._coming, (time, order, frame))
