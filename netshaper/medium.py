"""The medium: it carries frames as far as the budget allows, and logs every frame and its fate.

All bytes on the air count against the budget, a broadcast once; unused budget lapses. A frame of several packets
is cut at a packet boundary where the budget ends. In a round of handshakes the first packet that does not fit closes
the medium for the rest of the step; in other rounds a shorter frame may still use the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from netshaper import capture
from netshaper.airtime import Airtime, cut_into_frames
from netshaper.channel import DAMAGED, LOSS, Channel, Reception, with_checksum
from netshaper.connections import Connections
from netshaper.frame_log import (
    BEGIN,
    COLUMNS,
    COMMENT,
    PACKETS_FROM,
    RECEIVERS_FROM,
    RECEIVERS_TO,
    VERDICT,
    Frame,
    FrameLog,
)
from netshaper.ledger import ANSWER, BROADCAST, CAUSES, DATA, NEWS
from netshaper.ledger_rows import ledger_rows
from netshaper.settings import RadioSettings
from protocol.arrays import Int64Rows, Int64s, ReadOnlyInt32s
from protocol.budget import Budget
from protocol.kernels import kernel
from protocol.messages import Delivery, RadioReport
from protocol.packet_index import index_of

_CARRIED, _BUDGET, _LOST, _LIMIT, _FULL = (
    CAUSES.index(cause) for cause in ("", "budget", "lost", "limit", "full")
)

_MISSED = {LOSS: "lost to", DAMAGED: "damaged at", _FULL: "too much for"}

_NO_LIMIT = 1 << 62


class Account(NamedTuple):
    """All frames of a step, for ledger and capture."""

    step: int
    carried: int
    log: FrameLog

    def report(self, *, captures: bool = True) -> RadioReport:
        """Write the ledger's rows, and the frames for a capture unless there is none."""
        if not len(self.log):
            return RadioReport(self.step, b"", self.carried, b"")
        frames = self.log.columns()
        written = capture.encode(self.step, frames) if captures else b""
        return RadioReport(self.step, ledger_rows(self.step, frames), self.carried, written)


class Arrival(NamedTuple):
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

    def refuse(self, frame: Frame, cause: str, reason: str = "") -> None:
        """Log a frame that does not go on the air, and why."""
        self._log.add(self._round, frame._replace(map_id=-1), CAUSES.index(cause), (), reason)

    def broadcast(self, frame: Frame, receivers: Sequence[int]) -> bool:
        """Put a pose and target on the air, whole or not at all; return whether they were carried."""
        carried = self.carry(frame, receivers) > 0
        if not carried and self._closes:
            self.airtime.set_left(Budget(0))
        return carried

    def carry(self, frame: Frame, receivers: Sequence[int]) -> int:
        """Put a frame on the air as far as the budget allows; return the bytes of its packets that were carried.

        Data and news are cut at a packet boundary; other frames are sent whole or not at all.
        """
        sender, index = frame.sender, frame.packets
        shared = self.airtime.shared(sender)
        room = shared.least(self.airtime.own(sender))
        limit = self._frame_limit
        stops = cut_into_frames(index, room, limit, self._tail)
        sent = stops[-1] if stops else 0
        if sent < len(index.kinds) and frame.kind not in (DATA, NEWS):
            stops, sent = [], 0
        pieces = self._pieces(frame, stops)
        self._transmit(frame, pieces, receivers)
        if sent < len(index.kinds):
            rest = index.bytes_of(sent, len(index.kinds))
            cause = _BUDGET if room == shared else _LIMIT
            cut = frame._replace(payload=frame.payload[rest], packets=index.part(sent, len(index.kinds)))
            self._log.add(self._round, cut, cause)
        return index.ends[sent - 1] if sent else 0

    def play(self, connections: Connections) -> NDArray[np.int64]:
        """Put connections on the air one by one, frame by frame, as far as the budget allows.

        A frame that is lost is the last of its connection, and so is a missing one.

        Returns
        -------
        int64 array, shape (connections, 3)
            Bytes of each offer, answer and data frame that went on the air.
        """
        carried = np.zeros((len(connections), 3), np.int64)
        if not len(connections):
            return carried
        frames = [frame for three in zip(*connections.frames, strict=True) for frame in three]
        there = [frame for frame in frames if frame is not None]
        sizes = np.array([-1 if frame is None else len(frame.payload) for frame in frames], np.int64)
        counts = np.array([0 if frame is None else len(frame.packets.sizes) for frame in frames], np.int64)
        packets = np.frombuffer(b"".join([frame.packets.sizes for frame in there]), np.int32)
        ends = np.array([connections.senders, connections.receivers, connections.maps, connections.lost])
        parts = len(packets) if not self._frame_limit.unlimited else 0
        rows = np.empty((6 * len(connections) + parts, COLUMNS), np.int64)
        receivers = np.empty(3 * len(connections) + parts, np.int64)
        left, most = self.airtime.shared(0).limit, self._frame_limit.limit
        written, received, rest = _play(
            self._round, connections.first, ends, sizes, counts, packets, _NO_LIMIT if left is None else left,
            _NO_LIMIT if most is None else most, carried, rows, receivers,
        )  # fmt: skip
        if left is not None:
            self.airtime.set_left(Budget(rest))
        self.carried += int(carried.sum())
        payloads, packet_indexes = [frame.payload for frame in there], [frame.packets for frame in there]
        self._log.extend(rows[:written], receivers[:received], payloads, packet_indexes)
        return carried

    def arrivals(self, receives: Callable[[int], bool]) -> tuple[list[Arrival], list[Arrival]]:
        """Remove and return the frames that have arrived by now: broadcasts, and other frames."""
        due = [each for each in self._coming if each.due <= self._step]
        self._coming = [each for each in self._coming if each.due > self._step]
        due = [
            each._replace(receivers=[robot for robot in each.receivers if receives(robot)]) for each in due
        ]
        return [each for each in due if each.is_broadcast], [each for each in due if not each.is_broadcast]

    def _pieces(self, frame: Frame, stops: Sequence[int]) -> list[Frame]:
        """Cut a frame into frames for the air, without checksums."""
        pieces = []
        first = 0
        for stop in stops:
            payload = frame.payload[frame.packets.bytes_of(first, stop)]
            pieces.append(frame._replace(payload=payload, packets=frame.packets.part(first, stop)))
            first = stop
        return pieces

    def _transmit(self, frame: Frame, pieces: Sequence[Frame], receivers: Sequence[int]) -> None:
        """Put the pieces of a frame on the air."""
        if not pieces:
            return
        if self._tail:
            pieces = [self._with_checksum(piece) for piece in pieces]
        payloads = [piece.payload for piece in pieces]
        size = sum(map(len, payloads))
        self.airtime.book(frame.sender, size)
        self.carried += size
        receptions = self._channel.carry(
            self._step, self._round, frame.sender, frame.number, payloads, receivers
        )
        got = {
            receiver: self._accept(receiver, reception)
            for receiver, reception in zip(receivers, receptions, strict=True)
        }
        self._queue(frame, got)
        for number, piece in enumerate(pieces):
            self._log_piece(piece, number, got)

    def _with_checksum(self, piece: Frame) -> Frame:
        payload = with_checksum(piece.payload)
        index = piece.packets.followed_by(index_of(payload[len(piece.payload) :]))
        return piece._replace(payload=payload, packets=index)

    def _accept(self, receiver: int, reception: Reception) -> Reception:
        """Cut a reception at the limit of bytes that the robot can receive per step."""
        for number, payload in enumerate(reception.frames):
            if not self.airtime.receives(receiver, len(payload) + self._tail):
                return Reception(reception.frames[:number], _FULL, reception.delays)
        return reception

    def _queue(self, frame: Frame, got: dict[int, Reception]) -> None:
        """Queue a frame for delivery; receivers with equal receptions share one arrival."""
        alike: dict[int, list[int]] = {}
        for receiver, reception in got.items():
            alike.setdefault(id(reception), []).append(receiver)
        for receivers in alike.values():
            reception = got[receivers[0]]
            payload = b"".join(reception.frames)
            delivery = Delivery(frame.sender, payload)
            for delay in reception.delays if payload else ():
                self._coming.append(Arrival(self._step + delay, receivers, delivery, frame.kind == BROADCAST))

    def _log_piece(self, piece: Frame, number: int, got: dict[int, Reception]) -> None:
        """Log a frame that was on the air, its receivers, and why others missed it."""
        received = [receiver for receiver, reception in got.items() if number < len(reception.frames)]
        missed = {
            receiver: reception.cause for receiver, reception in got.items() if receiver not in received
        }
        verdict = max(missed.values()) if missed and not received else _CARRIED
        notes = [f"{_MISSED[cause]} r{receiver}" for receiver, cause in missed.items()] if received else []
        for receiver in received:
            delay, *again = got[receiver].delays
            if delay:
                notes.append(f"heard by r{receiver} in step {self._step + delay}")
            if again:
                notes.append(f"twice by r{receiver}")
        self._log.add(self._round, piece, verdict, received, "" if verdict else ", ".join(notes))


@kernel
def _play(
    round_number: int,
    first: int,
    ends: Int64Rows,
    sizes: Int64s,
    counts: Int64s,
    packets: ReadOnlyInt32s,
    left: int,
    most: int,
    carried: Int64Rows,
    rows: Int64Rows,
    receivers: Int64s,
) -> tuple[int, int, int]:
    """Play connections in their order; return the rows and receivers written, and the remaining budget.

    `ends`: shape (4, connections), senders, receivers, maps and lost frames. `sizes`, `counts`: bytes and packets of
    each frame, connection by connection, three each; a missing frame has the size -1. `packets`: bytes of each packet.
    `most`: maximum bytes of one frame on the air.
    """
    written = received = begin = packet = 0
    for each in range(ends.shape[1]):
        # Frames after a missing one were not sent; frames after a lost one were.
        playing = True
        for kind in range(3):
            size, count = sizes[3 * each + kind], counts[3 * each + kind]
            if size < 0:
                playing = False
            if not playing:
                begin += max(0, size)
                packet += count
                continue
            sender, receiver = ends[0, each], ends[1, each]
            if kind == ANSWER:
                sender, receiver = receiver, sender
            admitted, stop = size, packet + count
            lost = ends[3, each] == kind
            if lost:
                admitted, stop = 0, packet
                playing = False
            elif size > left:
                admitted, stop = 0, packet
                while kind == DATA and stop < packet + count and admitted + packets[stop] <= left:
                    admitted += packets[stop]
                    stop += 1
                left = 0  # the remaining budget is too small for the next packet: the medium closes
            else:
                left -= size
            carried[each, kind] = admitted
            start, at = begin, packet
            while start < begin + size:
                on_air = start < begin + admitted
                end, last = (begin + admitted, stop) if on_air else (begin + size, packet + count)
                if on_air and end - start > most:
                    end, last = start + packets[at], at + 1
                    while end + packets[last] - start <= most:
                        end += packets[last]
                        last += 1
                row = rows[written]
                row[0] = round_number
                row[1] = first + each
                row[2] = kind
                row[3] = sender
                row[4] = receiver
                row[5] = ends[2, each]
                verdict = _CARRIED if on_air else _LOST if lost else _BUDGET
                row[VERDICT] = row[COMMENT] = verdict
                row[RECEIVERS_FROM] = received
                if on_air:
                    receivers[received] = receiver
                    received += 1
                row[RECEIVERS_TO] = received
                row[BEGIN] = start
                row[BEGIN + 1] = end
                row[PACKETS_FROM] = at
                row[PACKETS_FROM + 1] = last
                written += 1
                start, at = end, last
            begin += size
            packet += count
    return written, received, left
