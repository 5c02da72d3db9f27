"""The books of a step: the ledger's rows, a frame and kind of packet each, written in one pass over its bytes."""

from __future__ import annotations

import numpy as np

from netshaper.frame_log import (
    BEGIN,
    COLUMNS,
    CONNECTION,
    END,
    FRAME,
    HEARD_FROM,
    HEARD_TO,
    MAP,
    RECEIVER,
    ROUND,
    SENDER,
    VERDICT,
    Columns,
    Rows,
)
from netshaper.ledger import FIRST_ON_AIR, MALFORMED, ROW
from protocol import packet_index
from protocol.kernels import kernel
from protocol.packet_index import KINDS, TABLE, Bytes, Table, count_part

_FIELDS = len(ROW.names or ())


def book(step: int, seen: Columns) -> bytes:
    """Write the rows of a step's frames (`netshaper.ledger.ROW`), in the order in which they were seen."""
    counts = np.empty((KINDS, 2), np.int64)
    table = _book(step, seen.rows, seen.payload, TABLE, counts, FIRST_ON_AIR)
    rows = np.empty(len(table), ROW)
    for column, name in enumerate(ROW.names or ()):
        rows[name] = table[:, column]
    return rows.tobytes()


@kernel(f"int64[:,::1](int64, int64[:,::1], {packet_index.FRAME}, int64[:,::1], int64[:,::1], int64)")
def _book(step: int, seen: Rows, payload: Bytes, table: Table, counts: Rows, on_air: int) -> Rows:
    # How many kinds there are comes with an array, and which verdicts mean carried: constants of other files would be
    # kept in a stale cache.
    assert seen.shape[1] == COLUMNS
    kinds = len(counts)
    room = 0
    for each in range(len(seen)):
        room += min(kinds, max(1, seen[each, END] - seen[each, BEGIN]))
    rows = np.empty((room, _FIELDS), np.int64)
    written = 0
    for each in range(len(seen)):
        begin, end = seen[each, BEGIN], seen[each, END]
        whole = count_part(payload, begin, end, table, counts) == 0
        for kind in range(kinds if whole else 1):
            packets, size = counts[kind, 0], counts[kind, 1]
            if not whole:
                kind, packets, size = MALFORMED, 1, end - begin  # noqa: PLW2901
            elif packets == 0:
                continue
            row = rows[written]
            row[0] = step
            row[1] = seen[each, ROUND]
            row[2] = seen[each, CONNECTION]
            row[3] = seen[each, FRAME]
            row[4] = seen[each, SENDER]
            row[5] = seen[each, RECEIVER]
            row[6] = seen[each, MAP]
            row[7] = kind
            row[8] = packets
            row[9] = size
            row[10] = seen[each, VERDICT] == 0 or seen[each, VERDICT] >= on_air
            row[11] = seen[each, VERDICT]
            row[12] = seen[each, HEARD_TO] - seen[each, HEARD_FROM]
            written += 1
    return rows[:written]
