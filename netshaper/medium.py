"""The medium: it carries frames as far as the budget allows, and logs every frame and its fate.

All bytes on the air count against the budget, a broadcast once; unused budget lapses. A frame of several packets
is cut at a packet boundary where the budget ends. In a round of handshakes the first packet that does not fit closes
the medium for the rest of the step; in other rounds a shorter frame may still use the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
from msgspec.structs import replace

from netshaper import capture
from netshaper.airtime import Airtime, cut_into_frames
from netshaper.channel import DAMAGED, LOSS, Channel, Reception, with_checksum
from netshaper.frame_log import Connection, Content, Frame, FrameLog
from netshaper.ledger import BROADCAST, CAUSES, DATA, NEWS
from netshaper.settings import RadioSettings
from protocol.budget import Budget
from protocol.messages import ConnectionReport, Delivery, RadioReport
from protocol.packet_index import index_of

_CARRIED, _BUDGET, _LOST, _LIMIT, _FULL = map(CAUSES.index, ("", "budget", "lost", "limit", "full"))

_NO_LIMIT = 1 << 62


def _limit(budget: Budget) -> int:
    """Return the bytes of a budget, a number beyond all sizes if it has no limit."""
    return _NO_LIMIT if budget.limit is None else budget.limit


_MISSED = {LOSS: "lost to", DAMAGED: "damaged at", _FULL: "too much for"}


class Account(msgspec.Struct, frozen=True, gc=False):
    """All frames of a step, for ledger and capture."""

    step: int
    carried: int
    log: FrameLog

    def report(self, *, captures: bool = True) -> RadioReport:
        """Write the ledger's rows, and the frames for a capture unless there is none."""
        if not len(self.log):
            return RadioReport(self.step, b"", self.carried, b"")
        written = capture.encode(self.step, self.log) if captures else b""
        return RadioReport(self.step, self.log.ledger_rows(self.step), self.carried, written)


class Arrival(msgspec.Struct, frozen=True, gc=False):
    """A frame that reaches its receivers at the beginning of step `due`."""

    due: int
    receivers: Sequence[int]
    delivery: Delivery
    is_broadcast: bool


class Medium:
    """The medium of a run."""

    def __init__(self, settings: RadioSettings) -> None:
        options = settings.options
        self.airtime = Airtime(
            settings.budget,
            settings.robots,
            reuse=options.reuse,
            send=settings.send or [options.send_bytes] * settings.robots,
            receive=settings.receive or [options.receive_bytes] * settings.robots,
            duty_cycle=options.duty_cycle,
        )
        self.carried = 0
        """Bytes that were on the air in this step."""
        self._channel = Channel(options, settings.seed, settings.robots)
        self._closes = settings.perfect
        self._frame_limit = settings.frame_limit
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

    def refuse(self, sender: int, receiver: int, content: Content, cause: str, reason: str = "") -> None:
        """Log a frame that does not go on the air, and why."""
        self._log.add(self._round, content, CAUSES.index(cause), sender, receiver, reason=reason)

    def broadcast(self, frame: Frame, receivers: Sequence[int]) -> bool:
        """Put a pose and target on the air, whole or not at all; return whether they were carried."""
        carried = self.carry(frame, receivers) > 0
        if not carried and self._closes:
            self.airtime.left = Budget(0)
        return carried

    def carry(self, frame: Frame, receivers: Sequence[int]) -> int:
        """Put a frame on the air as far as the budget allows; return the bytes of its packets that were carried.

        Data and news are cut at a packet boundary; other frames are sent whole or not at all.
        """
        sender, receiver, content = frame.sender, frame.receiver, frame.content
        shared = self.airtime.shared(sender)
        room = shared.least(self.airtime.own(sender))
        pieces, rest = self._cut(content, room)
        if pieces:
            self._transmit(frame, pieces, receivers)
        if rest is None:
            return len(content.payload)
        cause = _BUDGET if room == shared else _LIMIT
        self._log.add(self._round, rest, cause, sender, receiver, content.map_id)
        return len(content.payload) - len(rest.payload)

    def play(self, connections: Sequence[Connection]) -> list[ConnectionReport]:
        """Put connections on the air one by one, frame by frame, as far as the budget allows.

        A frame that is lost is the last of its connection. Return for each connection what went on the air.
        """
        left, most = _limit(self.airtime.left), _limit(self._frame_limit)
        played: list[ConnectionReport] = []
        for connection in connections:
            frames = connection.frames
            sizes = [len(content.payload) for content in frames]
            size = sum(sizes)
            if connection.lost < 0 and size <= left and (size <= most or max(sizes) <= most):
                self._log.add_connection(self._round, connection)
                left -= size
                self.carried += size
            else:
                sizes, left = self._play_in_part(connection, left)
                self.carried += sum(sizes)
            played.append(ConnectionReport(connection.number, *sizes))
        if not self.airtime.left.unlimited:
            self.airtime.left = Budget(left)
        return played

    def _play_in_part(self, connection: Connection, left: int) -> tuple[list[int], int]:
        """Put a connection on the air that is lost or has to be cut, with `left` bytes of the budget.

        Return the bytes of each of its frames that were on the air, and the remaining budget.
        """
        played: list[int] = []
        for kind, content in enumerate(connection.frames):
            sender, receiver = connection.ends(kind)
            ends = sender, receiver, connection.map_id, connection.number
            lost = connection.lost == kind
            pieces, rest = ([], content) if lost else self._cut(content, Budget(left))
            for piece in pieces:
                self._log.add(self._round, piece, _CARRIED, *ends, receivers=(receiver,))
            played.append(sum([len(piece.payload) for piece in pieces]))
            left -= played[-1]
            if rest is not None:
                self._log.add(self._round, rest, _LOST if lost else _BUDGET, *ends)
                left = left if lost else 0  # too small for the next packet: the medium closes
        return played, left

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
        """Put the pieces of a frame on the air."""
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
        for reception in receptions:
            payload = b"".join(reception.frames)
            delivery = Delivery(frame.sender, payload)
            is_broadcast = frame.content.kind == BROADCAST
            for delay in reception.delays if payload else ():
                self._coming.append(Arrival(self._step + delay, reception.receivers, delivery, is_broadcast))
        for number, piece in enumerate(pieces):
            self._log_piece(frame, number, piece, receptions)

    def _accept(self, reception: Reception, receiver: int) -> Reception:
        """Return the part of a reception within the limit of bytes that one of its robots can receive per step."""
        for number, payload in enumerate(reception.frames):
            if not self.airtime.receives(receiver, len(payload) + self._tail):
                return Reception([receiver], reception.frames[:number], _FULL, reception.delays)
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
            delay, *again = reception.delays
            for robot in reception.receivers if delay or again else ():
                late += [f"heard by r{robot} in step {self._step + delay}"] if delay else []
                late += [f"twice by r{robot}"] if again else []
        verdict, reason = _CARRIED, ""
        if received:
            reason = ", ".join([f"{_MISSED[cause]} r{robot}" for cause, robot in missed] + late)
        elif missed:
            verdict = max(missed)[0]
        ends = frame.sender, frame.receiver, frame.content.map_id
        self._log.add(self._round, piece, verdict, *ends, receivers=received, reason=reason)
