"""The medium: it carries frames as far as the budget allows, and logs every frame and its fate.

All bytes on the air count against the budget, a broadcast once; unused budget lapses, unless steps end by the wall
clock (`netshaper.settings.RadioSettings.saving`). A frame of several packets is cut at a packet boundary where the
budget ends. On a perfect radio, the first packet that does not fit closes the medium for the rest of the step. A packet
of news does not: a shorter frame may still use the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
from msgspec.structs import replace

from netshaper import capture
from netshaper.airtime import Airtime, cut_into_frames
from netshaper.channel import DAMAGED, LOSS, RECEIVED, Channel, Reception, with_checksum
from netshaper.frame_log import Connection, Content, Frame, FrameLog
from netshaper.ledger import CAUSES, DATA, NEWS
from netshaper.settings import RadioSettings
from protocol.budget import Budget
from protocol.messages import ConnectionReport, Delivery, RadioReport
from protocol.packet_index import index_of

_CARRIED, _BUDGET, _LIMIT, _FULL = map(CAUSES.index, ("", "budget", "limit", "full"))

_MISSED = {LOSS: "lost to", DAMAGED: "damaged at", _FULL: "too much for"}


class Account(msgspec.Struct, frozen=True, gc=False):
    """All frames of a step, for ledger and capture."""

    step: int
    carried: int
    log: FrameLog

    def report(self, *, captures: bool = True, links: bool = False) -> RadioReport:
        """Write the ledger's rows; the frames if there is a capture; the links if a viewer draws them."""
        if not len(self.log):
            return RadioReport(self.step, b"", self.carried, b"")
        written = capture.encode(self.step, self.log) if captures else b""
        received = self.log.links() if links else b""
        return RadioReport(self.step, self.log.ledger_rows(self.step), self.carried, written, received)


class Arrival(msgspec.Struct, frozen=True, gc=False):
    """A frame that reaches its receivers at the beginning of step `due`; `kind`: as in `netshaper.ledger.FRAMES`."""

    due: int
    receivers: Sequence[int]
    delivery: Delivery
    kind: int


class Medium:
    """The medium of a run."""

    def __init__(self, settings: RadioSettings) -> None:
        self.airtime = Airtime(settings)
        self.carried = 0
        """Bytes that were on the air in this step."""
        self._channel = Channel(settings.options, settings.seed, settings.robots)
        self._perfect = settings.perfect
        self._frame_limit = settings.frame_limit
        self._receives_whole = settings.perfect and settings.frame_limit.unlimited
        """Whether all receivers receive a frame within the budget at once and uncut."""
        self._tail = settings.checksum_bytes
        self._step = 0
        self._round = 0
        self._log = FrameLog()
        self._coming: list[Arrival] = []

    def begin_step(self, step: int, neighbors: dict[int, list[int]]) -> None:
        """Open the medium for a step, with the robots in range of each."""
        self._step, self._round, self.carried = step, 0, 0
        self.airtime.next_step(neighbors)
        self._channel.next_step(step)

    def next_round(self) -> None:
        """Begin the next round of a step."""
        self._round += 1

    def close(self) -> Account:
        """Close the medium, and return the account of the step."""
        account, self._log = Account(self._step, self.carried, self._log), FrameLog()
        return account

    def refuse(self, frame: Frame, cause: str, reason: str = "") -> None:
        """Log a frame that does not go on the air, and why."""
        self._log.add(self._round, frame, frame.content, CAUSES.index(cause), reason=reason)

    def carry(self, frame: Frame, receivers: Sequence[int]) -> int:
        """Put a frame on the air as far as the budget allows; return the bytes of its packets that were carried.

        Data and news are cut at a packet boundary; other frames are sent whole or not at all.
        """
        content, size = frame.content, len(frame.content.payload)
        if self._receives_whole and self.airtime.left.fits(size):
            self.airtime.book(frame.sender, size)
            self.carried += size
            self._log.add(self._round, frame, content, _CARRIED, receivers=receivers)
            if frame.connection < 0 or content.kind == DATA:
                self._deliver(frame, Reception(receivers, [content.payload], RECEIVED))
            return size
        shared = self.airtime.shared(frame.sender)
        room = shared.least(self.airtime.own(frame.sender))
        pieces, rest = self._cut(content, room)
        if pieces:
            self._transmit(frame, pieces, receivers)
        if rest is None:
            return size
        self._log.add(self._round, frame, rest, _BUDGET if room == shared else _LIMIT)
        if self._perfect and content.kind != NEWS:
            self.airtime.left = Budget(0)
        return size - len(rest.payload)

    def play(self, connection: Connection) -> ConnectionReport:
        """Put a connection on the air frame by frame, except for a lost one; return the carried bytes."""
        frames = connection.frames[:-1] if connection.lost else connection.frames
        sent = [self.carry(frame, [frame.receiver]) for frame in frames]
        if connection.lost:
            self.refuse(connection.frames[-1], "lost")
        return ConnectionReport(connection.number, *sent)

    def arrivals(self) -> list[Arrival]:
        """Remove and return the frames that have arrived by now."""
        due = [each for each in self._coming if each.due <= self._step]
        self._coming = [each for each in self._coming if each.due > self._step]
        return due

    def _cut(self, content: Content, room: Budget) -> tuple[list[Content], Content | None]:
        """Cut a frame into frames for the air, without checksums; also return the rest that does not fit, if any."""
        if room.spent:
            return [], content
        size = len(content.payload) + self._tail
        if room.fits(size) and self._frame_limit.fits(size):
            return [content], None
        stops = cut_into_frames(content.packets, room, self._frame_limit, self._tail)
        count = len(content.packets.kinds)
        if content.kind not in (DATA, NEWS) and stops[-1:] != [count]:
            stops = []
        *starts, sent = 0, *stops
        rest = content.part(sent, count) if sent < count else None
        return [content.part(first, stop) for first, stop in zip(starts, stops, strict=True)], rest

    def _transmit(self, frame: Frame, pieces: Sequence[Content], receivers: Sequence[int]) -> None:
        if self._tail:
            payloads = [with_checksum(piece.payload) for piece in pieces]
            pieces = [replace(frame.content, payload=each, packets=index_of(each)) for each in payloads]
        payloads = [piece.payload for piece in pieces]
        size = sum(map(len, payloads))
        self.airtime.book(frame.sender, size)
        self.carried += size
        receptions = self._channel.carry(
            self._step, self._round, frame.sender, frame.number, payloads, receivers
        )
        if self.airtime.limits_reception:
            receptions = [self._accept(each, robot) for each in receptions for robot in each.receivers]
        for number, piece in enumerate(pieces):
            self._log_piece(frame, number, piece, receptions)
        if frame.connection < 0 or frame.content.kind == DATA:
            for reception in receptions:
                self._deliver(frame, reception)

    def _deliver(self, frame: Frame, reception: Reception) -> None:
        """Let the received part of a frame arrive; offers and answers arrive in their phases instead."""
        if payload := b"".join(reception.frames):
            delivery = Delivery(frame.sender, payload, frame.connection)
            arrival = Arrival(self._step + reception.delay, reception.receivers, delivery, frame.content.kind)
            self._coming += reception.copies * [arrival]

    def _accept(self, reception: Reception, receiver: int) -> Reception:
        """Return the part of a reception within the limit of bytes that one of its robots can receive per step."""
        for number, payload in enumerate(reception.frames):
            if not self.airtime.receives(receiver, len(payload) + self._tail):
                return replace(reception, receivers=[receiver], frames=reception.frames[:number], cause=_FULL)
        return replace(reception, receivers=[receiver])

    def _log_piece(self, frame: Frame, number: int, piece: Content, receptions: Sequence[Reception]) -> None:
        """Log piece `number` of a frame, its receivers, and why others missed it."""
        received: list[int] = []
        missed: list[tuple[int, int]] = []
        late: list[str] = []
        for reception in receptions:
            if number >= len(reception.frames):
                missed += [(reception.cause, robot) for robot in reception.receivers]
                continue
            received += reception.receivers
            if reception.delay:
                due = self._step + reception.delay
                late += [f"received by r{robot} in step {due}" for robot in reception.receivers]
            if reception.copies > 1:
                late += [f"twice by r{robot}" for robot in reception.receivers]
        verdict, reason = _CARRIED, ""
        if missed and not received:
            verdict = max(missed)[0]
        elif missed or late:
            reason = ", ".join([f"{_MISSED[cause]} r{robot}" for cause, robot in missed] + late)
        self._log.add(self._round, frame, piece, verdict, receivers=received, reason=reason)
