"""What was said in a step, frame behind frame, as flat columns: of these the ledger and the capture are made."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from netshaper.ledger import CAUSES, EVERYONE

ROUND, CONNECTION, FRAME, SENDER, RECEIVER, MAP, VERDICT, WORDS, HEARD_FROM, HEARD_TO, BEGIN, END = range(12)
COLUMNS = 12
"""Of each frame, or of the part of it that was carried or not, a row of these: where in `Columns.hearers`, `texts` and
`payload` the rest of it stands, and numbers as in `LoggedFrame`."""

WORDS_OF_CAUSE = (
    "delivered", "cut by budget", "out of range", "refused", "a partner died", "the sender is mute",
    "beyond the sender's own limit", "lost on the air", "damaged on the air", "beyond the hearer's own limit",
)  # fmt: skip
"""What became of a frame to one robot, in words, by the number of its verdict."""

Rows = NDArray[np.int64]


class LoggedFrame(NamedTuple):
    """One frame, or the part of it that was carried or not.

    `frame` counts in `netshaper.capture.FRAMES`, `verdict` in `CAUSES`; `hearers` is a mask, bit r for robot r;
    `reason`: why it was refused, or what else became of it.
    """

    round: int
    connection: int
    frame: int
    sender: int
    receiver: int
    map: int
    verdict: int
    hearers: int
    payload: bytes
    reason: str = ""


class Columns(NamedTuple):
    """A step's frames as arrays.

    `rows`: int64, shape (frames, `COLUMNS`). `hearers`: int64, robots. `payload`: uint8, all bytes that were said.
    `texts`: uint8, all words, of which text n runs from ``text_at[n]`` to ``text_at[n + 1]``.
    """

    rows: Rows
    hearers: Rows
    payload: NDArray[np.uint8]
    texts: NDArray[np.uint8]
    text_at: Rows


class FrameLog:
    """Frames in the order in which they were seen."""

    def __init__(self) -> None:
        self._rows = array("q")
        self._hearers = array("q")
        self._payloads: list[bytes] = []
        self._size = 0
        self._texts = list(WORDS_OF_CAUSE)
        self._number_of = {text: number for number, text in enumerate(self._texts)}

    def __len__(self) -> int:
        return len(self._rows) // COLUMNS

    def add(
        self,
        round_number: int,
        connection: int,
        frame: int,
        sender: int,
        receiver: int,
        map_id: int,
        verdict: int,
        payload: bytes,
        hearers: Sequence[int] = (),
        reason: str = "",
    ) -> None:
        """Note one frame, of one verdict as a whole; `receiver` is `EVERYONE` for a broadcast."""
        words = in_words(verdict, receiver, tuple(hearers), reason)
        number = self._number_of.setdefault(words, len(self._texts))
        if number == len(self._texts):
            self._texts.append(words)
        begin, heard_from = self._size, len(self._hearers)
        self._size += len(payload)
        self._payloads.append(payload)
        self._hearers.extend(hearers)
        self._rows.extend(
            (
                round_number, connection, frame, sender, receiver, map_id, verdict, number, heard_from,
                heard_from + len(hearers), begin, self._size,
            )
        )  # fmt: skip

    def extend(self, rows: Rows, hearers: Rows, payload: bytes) -> None:
        """Note many frames at one go: rows whose columns of places count from the beginning of these."""
        rows[:, [HEARD_FROM, HEARD_TO]] += len(self._hearers)
        rows[:, [BEGIN, END]] += self._size
        self._rows.frombytes(rows.tobytes())
        self._hearers.frombytes(hearers.tobytes())
        self._payloads.append(payload)
        self._size += len(payload)

    @classmethod
    def of(cls, seen: Iterable[LoggedFrame]) -> FrameLog:
        """The same frames as columns."""
        predictiveings = cls()
        for each in seen:
            predictiveings.add(*each[:7], each.payload, hearers_of(each.hearers), each.reason)
        return predictiveings

    def columns(self) -> Columns:
        """All of it as arrays."""
        texts = [text.encode() for text in self._texts]
        text_at = np.zeros(len(texts) + 1, np.int64)
        np.cumsum([len(text) for text in texts], out=text_at[1:])
        return Columns(
            np.array(self._rows, np.int64).reshape(-1, COLUMNS),
            np.array(self._hearers, np.int64),
            np.frombuffer(b"".join(self._payloads), np.uint8),
            np.frombuffer(b"".join(texts), np.uint8),
            text_at,
        )


def hearers_of(mask: int) -> list[int]:
    """The robots of a mask."""
    return [robot for robot in range(mask.bit_length()) if mask >> robot & 1]


@lru_cache(maxsize=1 << 12)
def in_words(verdict: int, receiver: int, hearers: tuple[int, ...], reason: str) -> str:
    """Say what became of a frame: a packet's comment in the capture."""
    if verdict:
        words = WORDS_OF_CAUSE[verdict]
        return f"{words}: {reason}" if reason else words
    names = [f"r{robot}" for robot in hearers]
    words = WORDS_OF_CAUSE[verdict]
    if receiver == EVERYONE:
        words = f"delivered to {', '.join(names)}" if names else "on the air, but nobody was in range"
    return f"{words}; {reason}" if reason else words


assert len(WORDS_OF_CAUSE) == len(CAUSES)
