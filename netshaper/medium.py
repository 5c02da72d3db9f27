"""One step's shared medium: a budget of bytes, a seeded order, and what is put on the air (docs/architecture.md, A step).

What is carried counts, whoever hears it; a broadcast counts once; unused budget lapses. The first packet
that finds no room closes the medium for the rest of the step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from netshaper.capture import Sighting
from netshaper.ledger import BROADCAST, CAUSES, KIND_NUMBER, MALFORMED
from protocol import packets
from protocol.errors import ProtocolError

OFFER, ANSWER, DATA, TARGET = range(4)
"""The frames of a connection in their order, and the broadcast that has no connection."""

UNLIMITED = -1

Row = tuple[int, int, int, int, int, int, int, int, int, int, int, int, int]

_tally = lru_cache(maxsize=256)(packets.tally)


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
        self.rows: list[Row] = []
        self.sightings: list[Sighting] = []
        """The frames that the rows speak of, for the capture."""

    def broadcast(self, exchange: int, sender: int, payload: bytes, hearers: Sequence[int]) -> bool:
        """Put a target on the air, whole or not at all; say whether it was carried."""
        size = self._admit(payload)
        self._book(exchange, -1, TARGET, sender, BROADCAST, -1, payload, size, hearers)
        return size > 0

    def connect(self, exchange: int, connection: Connection) -> None:
        """Put the frames of a connection on the air, as far as there is room; one that is lost is the last."""
        for frame, payload in enumerate(connection.frames):
            if payload is None:
                break
            sender, receiver = connection.sender, connection.receiver
            if frame == ANSWER:
                sender, receiver = receiver, sender
            if frame == connection.lost:
                self._write(
                    exchange, connection.number, frame, sender, receiver, connection.map, payload, "lost", []
                )
                break
            size = self._admit(payload, whole=frame != DATA)
            connection.carried[frame] = size
            self._book(
                exchange, connection.number, frame, sender, receiver, connection.map, payload, size,
                [receiver],
            )  # fmt: skip

    def refuse(
        self, exchange: int, frame: int, sender: int, receiver: int, payload: bytes, cause: str, reason: str
    ) -> None:
        """Book a frame that was never admitted to the air, and why."""
        self._write(exchange, -1, frame, sender, receiver, -1, payload, cause, [], reason)

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

    def _book(
        self, exchange: int, number: int, frame: int, sender: int, receiver: int, about: int,
        payload: bytes, size: int, hearers: Sequence[int],
    ) -> None:  # fmt: skip
        if size:
            self._write(exchange, number, frame, sender, receiver, about, payload[:size], "", hearers)
        if size < len(payload):
            self._write(exchange, number, frame, sender, receiver, about, payload[size:], "budget", [])

    def _write(
        self, exchange: int, number: int, frame: int, sender: int, receiver: int, about: int,
        payload: bytes, cause: str, hearers: Sequence[int], reason: str = "",
    ) -> None:  # fmt: skip
        """Book bytes that were carried, if there is no cause why not."""
        verdict = CAUSES.index(cause)
        heard = sum(1 << hearer for hearer in hearers)
        self.sightings.append(
            Sighting(exchange, number, frame, sender, receiver, about, verdict, heard, payload, reason)
        )
        try:
            counts = [(KIND_NUMBER[kind], *count) for kind, count in _tally(payload).items()]
        except ProtocolError:
            counts = [(MALFORMED, 1, len(payload))]
        for kind, number_of_packets, size in counts:
            self.rows.append(
                (self.step, exchange, number, frame, sender, receiver, about, kind, number_of_packets, size,
                 int(not cause), verdict, len(hearers))
            )  # fmt: skip
