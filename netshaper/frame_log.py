"""Log of the frames of a step, from which the ledger's rows and the capture are made."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from functools import lru_cache

import msgspec
import numpy as np

from netshaper.ledger import CAUSES, EVERYONE, FIRST_ON_AIR, LINK, MALFORMED, ROW
from protocol.arrays import Int64Rows, ReadOnlyInt32s, ReadOnlyUint8s
from protocol.kernels import kernel
from protocol.packet_index import PacketIndex
from protocol.packets import ALL_KINDS

ROUND, CONNECTION, FRAME, SENDER, RECEIVER, MAP, VERDICT, COMMENT, RECEIVERS, BYTES, PACKETS = range(11)
COLUMNS = 11
"""Columns of a row, one row per frame or part of a frame with one verdict: `FRAME` counts in `netshaper.ledger.FRAMES`,
`VERDICT` in `CAUSES`, and `COMMENT` in `FrameLog.texts`. The last three are numbers of robots, bytes and packets
(`MALFORMED` if the bytes do not decode as packets)."""

TEXT_OF_CAUSE = (
    "delivered", "cut by budget", "out of range", "refused", "a partner died", "the sender is mute",
    "beyond the sender's own limit", "lost on the air", "damaged on the air", "beyond the hearer's own limit",
)  # fmt: skip
"""Comment text of each verdict, for a frame to one robot."""


class Content(msgspec.Struct, frozen=True, gc=False):
    """The bytes of a frame, as the relay has read them (`netshaper.admission`).

    `kind`: as in `netshaper.ledger.FRAMES`. `packets`: their index, `NO_PACKETS` if malformed. `map_id`: -1 if it
    belongs to no map. `problem`: error text, empty if the frame is valid.
    """

    kind: int
    payload: bytes
    packets: PacketIndex
    map_id: int = -1
    problem: str = ""

    def part(self, first: int, last: int) -> Content:
        """Return packets `first` to `last` - 1."""
        payload = self.payload[self.packets.bytes_of(first, last)]
        return Content(self.kind, payload, self.packets.part(first, last), self.map_id)


class Frame(msgspec.Struct, frozen=True, gc=False):
    """A frame that a robot sends.

    `map_id`, `connection`: -1 for none. `position`: among the frames that it submitted. `number`: the same, its
    broadcast included.
    """

    sender: int
    receiver: int
    content: Content
    map_id: int = -1
    connection: int = -1
    position: int = -1
    number: int = 0


class Connection(msgspec.Struct, eq=False, gc=False):
    """A connection of a round of handshakes: an offer, its answer and its data.

    `number`: counted in a step, in the order in which connections go on the air. `frames`: those sent so far. `lost`:
    whether the receiver of the last one cannot receive it.
    """

    number: int
    frames: list[Frame]
    lost: bool = False

    @property
    def offer(self) -> Frame:
        """Its first frame."""
        return self.frames[0]

    def accepts(self, kind: int, sender: int, receiver: int) -> bool:
        """Return whether a frame of a kind is its next one, and goes back to the sender of the last one."""
        last = self.frames[-1]
        return (sender, receiver, kind) == (last.receiver, last.sender, len(self.frames)) and not self.lost


class FrameLog:
    """Frames in the order in which the relay decided on them."""

    def __init__(self) -> None:
        self._rows: list[int] = []
        self.receivers: list[int] = []
        """Robots that received a frame, for all frames in order."""
        self.contents: list[Content] = []
        """The bytes of each frame."""
        self.texts = {text: number for number, text in enumerate(TEXT_OF_CAUSE)}
        """All comments in order, with their numbers."""

    def __len__(self) -> int:
        return len(self.contents)

    def add(
        self,
        round_number: int,
        frame: Frame,
        content: Content,
        verdict: int,
        *,
        receivers: Sequence[int] = (),
        reason: str = "",
        fate: str = "",
    ) -> None:
        """Log the content of a frame, or a part of it, with one verdict.

        `receivers`: robots that received it. `reason`: why it was refused, or a note on its delivery. `fate`: comment
        in the capture instead of the one that follows from the others.
        """
        payload, text = content.payload, verdict
        if fate or reason or frame.receiver == EVERYONE:
            words = fate or comment(verdict, frame.receiver, tuple(receivers), reason)
            text = self.texts.setdefault(words, len(self.texts))
        count = len(content.packets.kinds) or (MALFORMED if payload else 0)
        self._rows += (
            round_number, frame.connection, content.kind, frame.sender, frame.receiver, frame.map_id, verdict, text,
            len(receivers), len(payload), count,
        )  # fmt: skip
        self.receivers += receivers
        self.contents.append(content)

    def rows(self) -> Int64Rows:
        """Return a row per frame, shape (frames, `COLUMNS`); packing is four times as fast as `numpy.array`."""
        packed = struct.pack(f"={len(self._rows)}q", *self._rows)
        return np.frombuffer(bytearray(packed), np.int64).reshape(-1, COLUMNS)

    def rows_as_lists(self) -> Iterator[tuple[int, ...]]:
        """Yield the `COLUMNS` numbers of each frame."""
        return zip(*[iter(self._rows)] * COLUMNS, strict=True)

    def ledger_rows(self, step: int) -> bytes:
        """Write the ledger's rows of a step (`netshaper.ledger.ROW`), one for each frame and kind of packet in it."""
        log = self.rows()
        kinds = np.frombuffer(b"".join([content.packets.kinds for content in self.contents]), np.uint8)
        sizes = np.frombuffer(b"".join([content.packets.sizes for content in self.contents]), np.int32)
        counted = _count(log, kinds, sizes, len(ALL_KINDS))
        frames = log[counted[:, 0]]
        rows = np.empty(len(counted), ROW)
        names = ("round", "connection", "frame", "sender", "receiver", "map", "cause")
        for name, column in zip(names, frames.T, strict=False):
            rows[name] = column
        rows["step"], rows["received_by"] = step, frames[:, RECEIVERS]
        rows["kind"], rows["packets"], rows["bytes"] = counted[:, 1:].T
        rows["carried"] = (rows["cause"] == 0) | (rows["cause"] >= FIRST_ON_AIR)
        return rows.tobytes()

    def links(self) -> bytes:
        """Write the bytes that robots received from each other (`netshaper.ledger.LINK`), by sender and receiver."""
        log = self.rows()
        counts = log[:, RECEIVERS]
        pairs = np.column_stack((np.repeat(log[:, SENDER], counts), self.receivers)).astype(np.int64)
        unique, which = np.unique(pairs, axis=0, return_inverse=True)
        links = np.zeros(len(unique), LINK)
        links["sender"], links["receiver"] = unique.T
        np.add.at(links["bytes"], which.reshape(-1), np.repeat(log[:, BYTES], counts))
        return links.tobytes()


@kernel
def _count(frames: Int64Rows, kinds: ReadOnlyUint8s, sizes: ReadOnlyInt32s, most: int) -> Int64Rows:
    """Count the packets of each frame: rows of frame, kind, packets and bytes."""
    rows = np.empty((len(frames) + len(kinds), 4), np.int64)
    counts = np.zeros((most, 2), np.int64)
    written = packet = 0
    for frame in range(len(frames)):
        if frames[frame, PACKETS] == MALFORMED:
            rows[written] = frame, MALFORMED, 1, frames[frame, BYTES]
            written += 1
        for at in range(packet, packet + frames[frame, PACKETS]):
            counts[kinds[at], 0] += 1
            counts[kinds[at], 1] += sizes[at]
        packet += max(0, frames[frame, PACKETS])
        for kind in range(most):
            if counts[kind, 0]:
                rows[written] = frame, kind, counts[kind, 0], counts[kind, 1]
                written += 1
        counts[:] = 0
    return rows[:written]


@lru_cache(maxsize=1 << 12)
def comment(verdict: int, receiver: int, receivers: tuple[int, ...], reason: str) -> str:
    """Return the comment of a frame in the capture: its fate, receivers and reason."""
    text = TEXT_OF_CAUSE[verdict]
    if verdict:
        return f"{text}: {reason}" if reason else text
    if receiver == EVERYONE:
        names = ", ".join(f"r{robot}" for robot in receivers)
        text = f"delivered to {names}" if names else "on the air, but nobody was in range"
    return f"{text}; {reason}" if reason else text


assert len(TEXT_OF_CAUSE) == len(CAUSES)
