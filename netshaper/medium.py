"""One step's shared medium: a budget of bytes, a seeded order, what is put on the air (docs/architecture.md, A step).

What is carried counts, regardless of its receivers; a broadcast counts once; unused budget lapses. The first packet
that does not fit closes the medium for the rest of the step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from netshaper import airtime, capture
from netshaper.frame_log import BEGIN, COLUMNS, HEARD_FROM, HEARD_TO, VERDICT, WORDS, FrameLog, Rows
from netshaper.ledger import CAUSES, EVERYONE
from netshaper.ledger_rows import book
from protocol import packet_index
from protocol.kernels import kernel
from protocol.messages import RadioReport
from protocol.packet_index import TABLE, Bytes, Table, fitting_part

OFFER, ANSWER, DATA, BROADCAST, NEWS = range(5)
"""The frames of a connection in their order, and broadcasts, which have none: targets and poses, and news of maps."""

UNLIMITED = airtime.UNLIMITED

NOTHING = -1
"""The size of a frame that was not said."""

_CARRIED, _BUDGET, _LOST = (CAUSES.index(cause) for cause in ("", "budget", "lost"))


@dataclass
class Connections:
    """The connections of one exchange, in the order in which they are played, as columns.

    A connection is one offer, its answer and its data, from one robot to one other about one map. They are numbered
    on from `first`.
    """

    first: int = 0
    senders: list[int] = field(default_factory=list)
    receivers: list[int] = field(default_factory=list)
    maps: list[int] = field(default_factory=list)
    frames: tuple[list[bytes | None], list[bytes | None], list[bytes | None]] = field(
        default_factory=lambda: ([], [], [])
    )
    """Of each the offer, the answer, the data; None where there is none."""
    lost: list[int] = field(default_factory=list)
    """Of each the frame whose receiver was dead when it came; -1: none."""

    def __len__(self) -> int:
        return len(self.senders)

    def add(self, ends: Sequence[tuple[int, int, int]], offers: Sequence[bytes]) -> None:
        """Add connections, as (sender, receiver, map), of which the offers have been said."""
        for sender, receiver, map_id in ends:
            self.senders.append(sender)
            self.receivers.append(receiver)
            self.maps.append(map_id)
        self.frames[OFFER].extend(offers)
        self.frames[ANSWER].extend([None] * len(ends))
        self.frames[DATA].extend([None] * len(ends))
        self.lost.extend([-1] * len(ends))


class Medium:
    """The medium during one step.

    Parameters
    ----------
    step : int
        The step, for the ledger.
    budget : int
        Bytes that the whole team may put on the air in this step; `UNLIMITED` for no limit.
    frame_bytes : int
        Bytes that a frame holds at most, 0 for no limit: what is longer goes on the air as several.
    """

    def __init__(self, step: int, budget: int, frame_bytes: int = 0) -> None:
        self.step = step
        self._frame_bytes = frame_bytes
        self.left = budget
        self.carried = 0
        self.predictiveings = FrameLog()
        """What was said: of this the ledger and the capture are made."""

    def broadcast(self, round_number: int, sender: int, payload: bytes, hearers: Sequence[int]) -> bool:
        """Put a target on the air, whole or not at all; say whether it was carried."""
        size = len(payload)
        if self.left != UNLIMITED:
            if size > self.left:
                self.left = 0  # what is left over is too small for this packet: closed
                self.predictiveings.add(round_number, -1, BROADCAST, sender, EVERYONE, -1, _BUDGET, payload)
                return False
            self.left -= size
        self.carried += size
        self.predictiveings.add(round_number, -1, BROADCAST, sender, EVERYONE, -1, _CARRIED, payload, hearers)
        return size > 0

    def play(self, round_number: int, connections: Connections) -> NDArray[np.int64]:
        """Put connections on the air one by one, frame by frame, as far as there is room.

        A frame that is lost is the last of its connection, and so is one that is not there.

        Returns
        -------
        int64 array, shape (connections, 3)
            Bytes of each offer, answer and data frame that went on the air.
        """
        carried = np.zeros((len(connections), 3), np.int64)
        if not len(connections):
            return carried
        sizes = np.array(
            [[NOTHING if said is None else len(said) for said in frames] for frames in connections.frames],
            np.int64,
        )
        payload = b"".join(
            [said for three in zip(*connections.frames, strict=True) for said in three if said is not None]
        )
        ends = np.array([connections.senders, connections.receivers, connections.maps, connections.lost])
        frames = len(payload) if self._frame_bytes else 0
        rows = np.empty((6 * len(connections) + frames, COLUMNS), np.int64)
        hearers = np.empty(3 * len(connections) + frames, np.int64)
        data = np.frombuffer(payload, np.uint8)
        most = self._frame_bytes or len(payload)
        written, heard, self.left = _play(
            round_number, connections.first, ends, sizes, data, self.left, most, TABLE, carried, rows, hearers
        )
        self.carried += int(carried.sum())
        self.predictiveings.extend(rows[:written], hearers[:heard], payload)
        return carried

    def leave_out(self, round_number: int, sender: int, payload: bytes) -> None:
        """Note a broadcast that has to wait, though there is room."""
        self.predictiveings.add(round_number, -1, BROADCAST, sender, EVERYONE, -1, _BUDGET, payload)

    def tell(self, round_number: int, told: Sequence[tuple[int, bytes, Sequence[int]]]) -> list[int]:
        """Put news on the air, each as (sender, payload, hearers), as far as there is room; return the bytes of each.

        What is left where not all find room is for shorter ones, in the next exchange.
        """
        sizes = airtime.fill([payload for _, payload, _ in told], self.left)
        for (sender, payload, hearers), size in zip(told, sizes, strict=True):
            for frame in airtime.cut_into_frames(payload[:size], UNLIMITED, self._frame_bytes, 0)[0]:
                self.predictiveings.add(
                    round_number, -1, NEWS, sender, EVERYONE, -1, _CARRIED, frame, hearers
                )
            if size < len(payload):
                self.predictiveings.add(round_number, -1, NEWS, sender, EVERYONE, -1, _BUDGET, payload[size:])
            self.carried += size
            if self.left != UNLIMITED:
                self.left -= size
        return sizes

    def refuse(
        self,
        round_number: int,
        frame: int,
        sender: int,
        receiver: int,
        payload: bytes,
        cause: str,
        reason: str,
    ) -> None:
        """Note a frame that was never admitted to the air, and why."""
        self.predictiveings.add(
            round_number, -1, frame, sender, receiver, -1, CAUSES.index(cause), payload, (), reason
        )

    def report(self, *, captures: bool = True) -> RadioReport:
        """Write down what was said: the ledger's rows, and the frames for a capture unless there is none."""
        if not len(self.predictiveings):
            return RadioReport(self.step, b"", self.carried, b"")
        seen = self.predictiveings.columns()
        frames = capture.encode(self.step, seen) if captures else b""
        return RadioReport(self.step, book(self.step, seen), self.carried, frames)


@kernel(
    f"UniTuple(int64, 3)(int64, int64, int64[:,::1], int64[:,::1], {packet_index.FRAME}, int64, int64, int64[:,::1], "
    "int64[:,::1], int64[:,::1], int64[::1])"
)
def _play(
    round_number: int,
    first: int,
    ends: Rows,
    sizes: Rows,
    payload: Bytes,
    left: int,
    most: int,
    table: Table,
    carried: Rows,
    rows: Rows,
    hearers: Rows,
) -> tuple[int, int, int]:
    """Play connections in their order; return the rows and hearers written, and what is left of the budget.

    `ends`: shape (4, connections), senders, receivers, maps and lost frames; `sizes`: shape (3, connections), bytes of
    each frame. The frames stand behind each other in `payload`, connection by connection. `most`: bytes that one on
    the air holds.
    """
    written = heard = begin = 0
    for each in range(ends.shape[1]):
        # What comes behind a frame that is not there was not said either; what comes behind a lost one was.
        playing = True
        for frame in range(3):
            size = sizes[frame, each]
            if size < 0:
                playing = False
            if not playing:
                begin += max(0, size)
                continue
            sender, receiver = ends[0, each], ends[1, each]
            if frame == ANSWER:
                sender, receiver = receiver, sender
            admitted = size
            lost = ends[3, each] == frame
            if lost:
                admitted = 0
                playing = False
            elif left >= 0:
                if size > left:
                    admitted = 0
                    if frame == DATA and left > 0:
                        admitted = fitting_part(payload, begin, begin + size, left, table)
                    left = 0  # what is left over is too small for the next packet: closed
                else:
                    left -= size
            carried[each, frame] = admitted
            start = begin
            while start < begin + size:
                on_air = start < begin + admitted
                end = begin + admitted if on_air else begin + size
                if on_air and end - start > most:
                    part = fitting_part(payload, start, end, most, table)
                    end = start + part if part else end
                row = rows[written]
                row[0] = round_number
                row[1] = first + each
                row[2] = frame
                row[3] = sender
                row[4] = receiver
                row[5] = ends[2, each]
                verdict = _CARRIED if on_air else _LOST if lost else _BUDGET
                row[VERDICT] = row[WORDS] = verdict
                row[HEARD_FROM] = heard
                if on_air:
                    hearers[heard] = receiver
                    heard += 1
                row[HEARD_TO] = heard
                row[BEGIN] = start
                row[BEGIN + 1] = end
                written += 1
                start = end
            begin += size
    return written, heard, left
