"""Ledger rows of a step: one row for each logged frame and kind of packet in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from netshaper.frame_log import (
    BEGIN,
    COLUMNS,
    CONNECTION,
    END,
    FRAME,
    MAP,
    PACKETS_FROM,
    PACKETS_TO,
    RECEIVER,
    RECEIVERS_FROM,
    RECEIVERS_TO,
    ROUND,
    SENDER,
    VERDICT,
    Columns,
    Rows,
)
from netshaper.ledger import FIRST_ON_AIR, MALFORMED, ROW
from protocol.kernels import kernel
from protocol.packet_index import FRAME as BYTES
from protocol.packet_index import KINDS, Bytes

_FIELDS = len(ROW.names or ())


def ledger_rows(step: int, frames: Columns) -> bytes:
    """Write the rows of a step's frames (`netshaper.ledger.ROW`), in the order of the log."""
    counts = np.empty((KINDS, 2), np.int64)
    table = _rows(step, frames.rows, frames.kinds, frames.sizes, counts, FIRST_ON_AIR)
    rows = np.empty(len(table), ROW)
    for column, name in enumerate(ROW.names or ()):
        rows[name] = table[:, column]
    return rows.tobytes()


@kernel(f"int64[:,::1](int64, int64[:,::1], {BYTES}, int32[::1], int64[:,::1], int64)")
def _rows(
    step: int, frames: Rows, kind_of: Bytes, size_of: NDArray[np.int32], counts: Rows, on_air: int
) -> Rows:
    # How many kinds there are comes with an array, and which verdicts mean carried: constants of other files would be
    # kept in a stale cache.
    assert frames.shape[1] == COLUMNS
    kinds = len(counts)
    room = 0
    for each in range(len(frames)):
        room += min(kinds, max(1, frames[each, PACKETS_TO] - frames[each, PACKETS_FROM]))
    rows = np.empty((room, _FIELDS), np.int64)
    written = 0
    for each in range(len(frames)):
        frame = frames[each]
        malformed = frame[PACKETS_FROM] < 0
        counts[:] = 0
        if not malformed:
            for packet in range(frame[PACKETS_FROM], frame[PACKETS_TO]):
                counts[kind_of[packet], 0] += 1
                counts[kind_of[packet], 1] += size_of[packet]
        for kind in range(1 if malformed else kinds):
            packets, size = counts[kind, 0], counts[kind, 1]
            if malformed:
                kind, packets, size = MALFORMED, 1, frame[END] - frame[BEGIN]  # noqa: PLW2901
            elif packets == 0:
                continue
            row = rows[written]
            row[0] = step
            row[1] = frame[ROUND]
            row[2] = frame[CONNECTION]
            row[3] = frame[FRAME]
            row[4] = frame[SENDER]
            row[5] = frame[RECEIVER]
            row[6] = frame[MAP]
            row[7] = kind
            row[8] = packets
            row[9] = size
            row[10] = frame[VERDICT] == 0 or frame[VERDICT] >= on_air
            row[11] = frame[VERDICT]
            row[12] = frame[RECEIVERS_TO] - frame[RECEIVERS_FROM]
            written += 1
    return rows[:written]
