"""Ledger: a row for every frame that a robot sent and every kind of packet in it, whether or not it was carried."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocol.packets import ALL_KINDS

CAUSES = ("", "budget", "range", "protocol", "lost", "mute", "limit", "loss", "damaged", "full")
"""Causes why a frame was not carried: the budget was spent, the receiver out of range, the frame malformed, a partner
dead, the sender's radio mute, its own limit reached. From `FIRST_ON_AIR` on, the frame was on the air, but no robot
received it: it was lost, damaged, or beyond the receiver's limit."""

FIRST_ON_AIR = CAUSES.index("loss")


def on_air(cause: int) -> bool:
    """Return whether a frame with this cause was on the air, though perhaps not received."""
    return cause == 0 or cause >= FIRST_ON_AIR


FRAMES = ("offer", "answer", "data", "broadcast", "news")
"""The kinds of frames: those of a connection in their order, poses and targets for all, and maps for all."""
OFFER, ANSWER, DATA, BROADCAST, NEWS = range(5)

EVERYONE = -1
"""The receiver of a broadcast."""

ROW = np.dtype([
    ("step", "<i4"), ("round", "<i2"), ("connection", "<i4"), ("frame", "<i2"), ("sender", "<i2"), ("receiver", "<i2"),
    ("map", "<i2"), ("kind", "<i2"), ("packets", "<i4"), ("bytes", "<i4"), ("carried", "<i2"), ("cause", "<i2"),
    ("received_by", "<i2"),
])  # fmt: skip
"""One row. `kind` counts in `ALL_KINDS`, `cause` in `CAUSES`; -1 stands for broadcast, or for no map."""

LINK = np.dtype([("sender", "<i2"), ("receiver", "<i2"), ("bytes", "<i4")])
"""The bytes that one robot received from another in a step; a broadcast counts once for each robot that received it."""

KIND_NUMBER = {kind: number for number, kind in enumerate(ALL_KINDS)}
MALFORMED = -1
"""The kind of bytes that do not decode as packets."""


def sort_rows(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Sort rows by all their fields, first to last: the order in which the digest reads them."""
    return rows[np.lexsort([rows[name] for name in reversed(ROW.names or ())])]


def balance(rows: NDArray[np.void]) -> dict[int, tuple[int, ...]]:
    """Return for each step the bytes (sent, carried, cut, received by unicast receivers).

    The medium conserves bytes: sent = carried + cut, and each unicast byte that is carried is received once.
    """
    steps, place = np.unique(rows["step"], return_inverse=True)
    size, carried = rows["bytes"].astype(np.int64), rows["carried"] == 1
    received = size * rows["received_by"] * (carried & (rows["receiver"] != EVERYONE))
    columns = size, size * carried, size * ~carried, received
    sums = [np.bincount(place, column, len(steps)).astype(int).tolist() for column in columns]
    return dict(zip(steps.tolist(), zip(*sums, strict=True), strict=True))
