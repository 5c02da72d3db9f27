"""Log of a step's frames as flat columns: the ledger's rows and the capture are made of it."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from functools import lru_cache
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from netshaper.ledger import ANSWER, CAUSES, EVERYONE, FIRST_ON_AIR, ROW
from protocol.packet_index import KINDS, PacketIndex

ROUND, CONNECTION, FRAME, SENDER, RECEIVER, MAP, VERDICT, COMMENT, RECEIVERS, BYTES, PACKETS = range(11)
COLUMNS = 11
"""Columns of a row, one row per frame or part of a frame with one verdict: `FRAME` counts in `netshaper.ledger.FRAMES`,
`VERDICT` in `CAUSES`, and `COMMENT` in `Columns.texts`. The last three are numbers of robots, bytes and packets."""

MALFORMED = -1
"""In `PACKETS`: the bytes do not decode as packets."""

TEXT_OF_CAUSE = (
    "delivered", "cut by budget", "out of range", "refused", "a partner died", "the sender is mute",
    "beyond the sender's own limit", "lost on the air", "damaged on the air", "beyond the hearer's own limit",
)  # fmt: skip
"""Comment text of each verdict, for a frame to one robot."""

_KINDS_OF_ROWS = KINDS + 1
"""Malformed bytes (-1), then the kinds of packets."""

Rows = NDArray[np.int64]


class Content(NamedTuple):
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


class Frame(NamedTuple):
    """A frame that a robot sends; `number` counts the frames that it submitted, its broadcast included."""

    sender: int
    receiver: int
    content: Content
    number: int = 0


class Columns(NamedTuple):
    """A step's frames as arrays.

    `rows`: int64, shape (frames, `COLUMNS`). The others hold the items of all frames in order. `receivers`: int64,
    robots. `payload`: uint8. `kinds`, `sizes`: uint8 and int32, one number per packet. `texts`: uint8, all comments, of
    which text n runs from ``text_at[n]`` to ``text_at[n + 1]``.
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
        self._contents: list[Content] = []
        self._texts = {text: number for number, text in enumerate(TEXT_OF_CAUSE)}

    def __len__(self) -> int:
        return len(self._contents)

    def add(
        self,
        round_number: int,
        sender: int,
        receiver: int,
        content: Content,
        verdict: int,
        receivers: Sequence[int] = (),
        map_id: int = -1,
        reason: str = "",
    ) -> None:
        """Log a frame without a connection, or a part of one, with one verdict.

        `receivers`: robots that received it. `reason`: why it was refused, or a note on its delivery.
        """
        kind, payload, packets = content[:3]
        text = verdict
        if reason or receiver == EVERYONE:
            text = self._texts.setdefault(
                comment(verdict, receiver, tuple(receivers), reason), len(self._texts)
            )
        count = len(packets.kinds) or (MALFORMED if payload else 0)
        row = (round_number, -1, kind, sender, receiver, map_id, verdict, text)
        self._rows.extend((*row, len(receivers), len(payload), count))
        self._receivers.extend(receivers)
        self._contents.append(content)

    def add_connections(
        self,
        round_number: int,
        connections: Sequence[tuple[int, int, int, int]],
        owners: Sequence[int],
        contents: Sequence[Content],
        verdicts: Sequence[int],
    ) -> None:
        """Log frames of connections, or parts of them; `owners` has the index of the connection of each.

        `connections`: number, sender, receiver and map of each. Frames without a cause arrive.
        """
        number, sender, receiver, map_id = np.array(connections, np.int64)[list(owners)].T
        kind, verdict = np.array([content.kind for content in contents]), np.array(verdicts)
        answers, received = kind == ANSWER, verdict == 0
        sender, receiver = np.where(answers, receiver, sender), np.where(answers, sender, receiver)
        sizes = [len(content.payload) for content in contents]
        packets = [len(content.packets.kinds) for content in contents]
        rows = np.empty((len(contents), COLUMNS), np.int64)
        for column, values in enumerate(
            (round_number, number, kind, sender, receiver, map_id, verdict, verdict, received, sizes, packets)
        ):
            rows[:, column] = values
        self._rows.frombytes(rows.tobytes())
        self._receivers.frombytes(receiver[received].tobytes())
        self._contents += contents

    def columns(self) -> Columns:
        """Return the log as arrays."""
        texts = [text.encode() for text in self._texts]
        return Columns(
            np.array(self._rows, np.int64).reshape(-1, COLUMNS),
            np.array(self._receivers, np.int64),
            np.frombuffer(b"".join([content.payload for content in self._contents]), np.uint8),
            np.frombuffer(b"".join([content.packets.kinds for content in self._contents]), np.uint8),
            np.frombuffer(b"".join([content.packets.sizes for content in self._contents]), np.int32),
            np.frombuffer(b"".join(texts), np.uint8),
            np.array([*accumulate(map(len, texts), initial=0)], np.int64),
        )


def ledger_rows(step: int, columns: Columns) -> bytes:
    """Write the ledger's rows of a step (`netshaper.ledger.ROW`), one for each frame and kind of packet in it."""
    frames = columns.rows
    malformed = np.flatnonzero(frames[:, PACKETS] == MALFORMED)
    frame = np.repeat(np.arange(len(frames)), np.maximum(frames[:, PACKETS], 0))
    slot = _KINDS_OF_ROWS * frame + columns.kinds + 1
    packets = np.bincount(slot, minlength=_KINDS_OF_ROWS * len(frames))
    sizes = np.bincount(slot, columns.sizes, _KINDS_OF_ROWS * len(frames))
    packets[_KINDS_OF_ROWS * malformed] = 1
    sizes[_KINDS_OF_ROWS * malformed] = frames[malformed, BYTES]
    slots = np.flatnonzero(packets)
    frames = frames[slots // _KINDS_OF_ROWS]
    rows = np.empty(len(slots), ROW)
    for name, column in zip(
        ("round", "connection", "frame", "sender", "receiver", "map", "cause"), frames.T, strict=False
    ):
        rows[name] = column
    rows["step"], rows["kind"] = step, slots % _KINDS_OF_ROWS - 1
    rows["packets"], rows["bytes"] = packets[slots], sizes[slots]
    rows["carried"] = (rows["cause"] == 0) | (rows["cause"] >= FIRST_ON_AIR)
    rows["received_by"] = frames[:, RECEIVERS]
    return rows.tobytes()


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
