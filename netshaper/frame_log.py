"""Log of a step's frames as flat columns: the ledger's rows and the capture are made of it."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from netshaper.ledger import CAUSES, EVERYONE
from protocol.errors import ProtocolError
from protocol.packet_index import NO_PACKETS, PacketIndex, index_of

(
    ROUND, CONNECTION, FRAME, SENDER, RECEIVER, MAP, VERDICT, COMMENT, RECEIVERS_FROM, RECEIVERS_TO, BEGIN, END,
    PACKETS_FROM, PACKETS_TO,
) = range(14)  # fmt: skip
COLUMNS = 14
"""Columns of a row, one row per frame or part of a frame with one verdict. The first seven are those of `LoggedFrame`;
the others say where in `Columns.texts`, `receivers`, `payload`, `kinds` and `sizes` the rest of it is."""

MALFORMED = -1
"""In `PACKETS_FROM`: the bytes are no packets."""

TEXT_OF_CAUSE = (
    "delivered", "cut by budget", "out of range", "refused", "a partner died", "the sender is mute",
    "beyond the sender's own limit", "lost on the air", "damaged on the air", "beyond the hearer's own limit",
)  # fmt: skip
"""What became of a frame to one robot, as text, by the number of its verdict."""

Rows = NDArray[np.int64]


class Frame(NamedTuple):
    """A frame that a robot sends.

    `kind`: as in `netshaper.ledger.FRAMES`. `packets`: their index, `NO_PACKETS` if the bytes are none. `map_id`: -1 if
    it is of no map. `number`: its position among the frames that the sender submitted, its broadcast included.
    """

    kind: int
    sender: int
    receiver: int
    payload: bytes
    packets: PacketIndex
    map_id: int = -1
    number: int = 0


class LoggedFrame(NamedTuple):
    """One frame, or the part of it with one verdict, as a test or a reader of captures sees it.

    `frame` counts in `netshaper.ledger.FRAMES`, `verdict` in `CAUSES`; `receivers` is a mask, bit r for robot r;
    `reason`: why it was refused, or what else became of it.
    """

    round: int
    connection: int
    frame: int
    sender: int
    receiver: int
    map: int
    verdict: int
    receivers: int
    payload: bytes
    reason: str = ""


class Columns(NamedTuple):
    """A step's frames as arrays.

    `rows`: int64, shape (frames, `COLUMNS`). `receivers`: int64, robots. `payload`: uint8, all bytes. `kinds`,
    `sizes`: uint8 and int32, one number per packet. `texts`: uint8, all comments, of which text n runs from
    ``text_at[n]`` to ``text_at[n + 1]``.
    """

    rows: Rows
    receivers: Rows
    payload: NDArray[np.uint8]
    kinds: NDArray[np.uint8]
    sizes: NDArray[np.int32]
    texts: NDArray[np.uint8]
    text_at: Rows


class FrameLog:
    """Frames in the order in which the relay decided on them."""

    def __init__(self) -> None:
        self._rows = array("q")
        self._receivers = array("q")
        self._payloads: list[bytes] = []
        self._kinds: list[bytes] = []
        self._sizes = array("i")
        self._bytes = 0
        self._texts = list(TEXT_OF_CAUSE)
        self._number_of = {text: number for number, text in enumerate(self._texts)}

    def __len__(self) -> int:
        return len(self._rows) // COLUMNS

    def add(
        self, round_number: int, frame: Frame, verdict: int, receivers: Sequence[int] = (), reason: str = ""
    ) -> None:
        """Log a frame, or a part of one, that has one verdict as a whole and belongs to no connection."""
        self._add(round_number, -1, frame, verdict, receivers, reason)

    def _add(
        self,
        round_number: int,
        connection: int,
        frame: Frame,
        verdict: int,
        receivers: Sequence[int],
        reason: str,
    ) -> None:
        kind, sender, receiver, payload, index, map_id, _ = frame
        text = comment(verdict, receiver, tuple(receivers), reason)
        number = self._number_of.setdefault(text, len(self._texts))
        if number == len(self._texts):
            self._texts.append(text)
        begin, first_packet, first_receiver = self._bytes, len(self._sizes), len(self._receivers)
        self._bytes += len(payload)
        self._payloads.append(payload)
        self._kinds.append(index.kinds)
        self._sizes.extend(index.sizes)
        self._receivers.extend(receivers)
        if payload and not index.kinds:
            first_packet = MALFORMED
        self._rows.extend(
            (
                round_number, connection, kind, sender, receiver, map_id, verdict, number, first_receiver,
                len(self._receivers), begin, self._bytes, first_packet, len(self._sizes),
            )
        )  # fmt: skip

    def extend(
        self, rows: Rows, receivers: Rows, payloads: Sequence[bytes], packets: Sequence[PacketIndex]
    ) -> None:
        """Log many frames at once; the positions in `rows` count from the beginning of these arguments."""
        rows[:, [RECEIVERS_FROM, RECEIVERS_TO]] += len(self._receivers)
        rows[:, [BEGIN, END]] += self._bytes
        rows[:, [PACKETS_FROM, PACKETS_TO]] += len(self._sizes)
        self._rows.frombytes(rows.tobytes())
        self._receivers.frombytes(receivers.tobytes())
        self._payloads.extend(payloads)
        self._bytes += sum(map(len, payloads))
        for index in packets:
            self._kinds.append(index.kinds)
            self._sizes.extend(index.sizes)

    @classmethod
    def of(cls, frames: Iterable[LoggedFrame]) -> FrameLog:
        """Log the same frames."""
        log = cls()
        for each in frames:
            frame = Frame(
                each.frame, each.sender, each.receiver, each.payload, index_or_none(each.payload), each.map
            )
            receivers = receivers_of(each.receivers)
            log._add(each.round, each.connection, frame, each.verdict, receivers, each.reason)
        return log

    def columns(self) -> Columns:
        """Return all of it as arrays."""
        texts = [text.encode() for text in self._texts]
        text_at = np.zeros(len(texts) + 1, np.int64)
        np.cumsum([len(text) for text in texts], out=text_at[1:])
        return Columns(
            np.array(self._rows, np.int64).reshape(-1, COLUMNS),
            np.array(self._receivers, np.int64),
            np.frombuffer(b"".join(self._payloads), np.uint8),
            np.frombuffer(b"".join(self._kinds), np.uint8),
            np.array(self._sizes, np.int32),
            np.frombuffer(b"".join(texts), np.uint8),
            text_at,
        )


def index_or_none(payload: bytes) -> PacketIndex:
    """Return the packets of a frame, `NO_PACKETS` if the bytes are none."""
    try:
        return index_of(payload)
    except ProtocolError:
        return NO_PACKETS


def receivers_of(mask: int) -> list[int]:
    """Return the robots of a mask."""
    return [robot for robot in range(mask.bit_length()) if mask >> robot & 1]


@lru_cache(maxsize=1 << 12)
def comment(verdict: int, receiver: int, receivers: tuple[int, ...], reason: str) -> str:
    """Say what became of a frame: a packet's comment in the capture."""
    text = TEXT_OF_CAUSE[verdict]
    if verdict:
        return f"{text}: {reason}" if reason else text
    if receiver == EVERYONE:
        names = ", ".join(f"r{robot}" for robot in receivers)
        text = f"delivered to {names}" if names else "on the air, but nobody was in range"
    return f"{text}; {reason}" if reason else text


assert len(TEXT_OF_CAUSE) == len(CAUSES)
