"""One step's shared medium: a budget of bytes, a seeded order, what is put on the air (docs/architecture.md, A step).

What is carried counts, whoever hears it; a broadcast counts once; unused budget lapses. The first packet
that finds no room closes the medium for the rest of the step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from netshaper import airtime, capture, ledger
from netshaper.ledger import CAUSES, EVERYONE, Sighting
from protocol import packets
from protocol.messages import RadioReport

OFFER, ANSWER, DATA, BROADCAST, NEWS = range(5)
"""The frames of a connection in their order, and broadcasts, which have none: targets and poses, and news of maps."""

UNLIMITED = airtime.UNLIMITED

_CARRIED, _BUDGET, _LOST = (CAUSES.index(cause) for cause in ("", "budget", "lost"))


@dataclass
class Connection:
    """One offer, its answer and its data, from one robot to one other about one map."""

    number: int
    sender: int
    receiver: int
    map: int
    frames: list[bytes | None] = field(default_factory=lambda: [None, None, None])
    carried: list[int] = field(default_factory=lambda: [0, 0, 0])
    """Bytes of each frame that went on the air."""
    lost: int | None = None
    """The frame whose receiver was dead when it came."""


class Medium:
    """The air during one step.

    Parameters
    ----------
    step : int
        The step, for the ledger.
    budget : int
        Bytes that the whole team may put on the air in this step; `UNLIMITED` for no limit.
    """

    def __init__(self, step: int, budget: int) -> None:
        self.step = step
        self.left = budget
        self.carried = 0
        self.sightings: list[Sighting] = []
        """What was said: of this the ledger and the capture are made."""

    def broadcast(self, exchange: int, sender: int, payload: bytes, hearers: Sequence[int]) -> bool:
        """Put a target on the air, whole or not at all; say whether it was carried."""
        size = self._admit(payload)
        heard = sum(1 << hearer for hearer in hearers)
        self._see(exchange, -1, BROADCAST, sender, EVERYONE, -1, payload, size, heard)
        return size > 0

    def leave_out(self, exchange: int, sender: int, payload: bytes) -> None:
        """Note a broadcast that has to wait, though there is room."""
        self._see(exchange, -1, BROADCAST, sender, EVERYONE, -1, payload, 0, 0)

    def tell(self, exchange: int, told: Sequence[tuple[int, bytes, Sequence[int]]]) -> list[int]:
        """Put news on the air, each as (sender, payload, hearers), as far as there is room; return the bytes of each.

        What is left where not all find room is for shorter ones, in the next exchange.
        """
        sizes = airtime.fill([payload for _, payload, _ in told], self.left)
        for (sender, payload, hearers), size in zip(told, sizes, strict=True):
            heard = sum(1 << hearer for hearer in hearers)
            self._see(exchange, -1, NEWS, sender, EVERYONE, -1, payload, size, heard)
            self.carried += size
            if self.left != UNLIMITED:
                self.left -= size
        return sizes

    def connect(self, exchange: int, connection: Connection) -> None:
        """Put the frames of a connection on the air, as far as there is room; one that is lost is the last."""
        number, about = connection.number, connection.map
        for frame, payload in enumerate(connection.frames):
            if payload is None:
                break
            sender, receiver = connection.sender, connection.receiver
            if frame == ANSWER:
                sender, receiver = receiver, sender
            if frame == connection.lost:
                self.sightings.append(
                    Sighting(exchange, number, frame, sender, receiver, about, _LOST, 0, payload)
                )
                break
            size = connection.carried[frame] = self._admit(payload, whole=frame != DATA)
            self._see(exchange, number, frame, sender, receiver, about, payload, size, 1 << receiver)

    def refuse(
        self, exchange: int, frame: int, sender: int, receiver: int, payload: bytes, cause: str, reason: str
    ) -> None:
        """Note a frame that was never admitted to the air, and why."""
        verdict = CAUSES.index(cause)
        self.sightings.append(
            Sighting(exchange, -1, frame, sender, receiver, -1, verdict, 0, payload, reason)
        )

    def report(self) -> RadioReport:
        """Write down what was said: the ledger's rows, and the frames for the capture."""
        rows = ledger.book(self.step, self.sightings)
        return RadioReport(self.step, rows, self.carried, capture.encode(self.step, self.sightings))

    def _admit(self, payload: bytes, *, whole: bool = True) -> int:
        """Spend the budget on as much of a frame as fits, at a packet boundary; return the bytes."""
        size = len(payload)
        if self.left != UNLIMITED:
            if size > self.left:
                size = 0 if whole else packets.fitting(payload, self.left)
                self.left = size  # what is left over is too small for the next packet: closed
            self.left -= size
        self.carried += size
        return size

    def _see(
        self, exchange: int, number: int, frame: int, sender: int, receiver: int, about: int,
        payload: bytes, size: int, hearers: int,
    ) -> None:  # fmt: skip
        """Note a frame of which `size` bytes were carried."""
        if size:
            self.sightings.append(
                Sighting(exchange, number, frame, sender, receiver, about, _CARRIED, hearers, payload[:size])
            )
        if size < len(payload):
            self.sightings.append(
                Sighting(exchange, number, frame, sender, receiver, about, _BUDGET, 0, payload[size:])
            )
