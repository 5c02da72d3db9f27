"""Ledger rows of a step: one row for each logged frame and kind of packet in it."""

from __future__ import annotations

import numpy as np

from netshaper import frame_log as log
from netshaper.ledger import FIRST_ON_AIR, ROW
from protocol.packet_index import KINDS

_SLOTS = KINDS + 1
"""Kinds of rows: malformed bytes (-1), then those of packets."""


def ledger_rows(step: int, columns: log.Columns) -> bytes:
    """Write the rows of a step's frames (`netshaper.ledger.ROW`), in the order of the log."""
    frames = columns.rows
    first, stop = frames[:, log.PACKETS_FROM], frames[:, log.PACKETS_TO]
    malformed = np.flatnonzero(first == log.MALFORMED)
    count = np.where(first == log.MALFORMED, 0, stop - first)
    frame = np.repeat(np.arange(len(frames)), count)
    packet = np.arange(len(frame)) - np.repeat(np.cumsum(count) - count - first, count)
    slot = _SLOTS * frame + columns.kinds[packet] + 1
    packets = np.bincount(slot, minlength=_SLOTS * len(frames))
    sizes = np.bincount(slot, columns.sizes[packet], _SLOTS * len(frames))
    packets[_SLOTS * malformed] = 1
    sizes[_SLOTS * malformed] = (frames[:, log.END] - frames[:, log.BEGIN])[malformed]
    slots = np.flatnonzero(packets)
    frames = frames[slots // _SLOTS]
    rows = np.empty(len(slots), ROW)
    for name, column in zip(
        ("round", "connection", "frame", "sender", "receiver", "map"), frames.T, strict=False
    ):
        rows[name] = column
    rows["step"], rows["kind"] = step, slots % _SLOTS - 1
    rows["packets"], rows["bytes"] = packets[slots], sizes[slots]
    verdict = frames[:, log.VERDICT]
    rows["cause"], rows["carried"] = verdict, (verdict == 0) | (verdict >= FIRST_ON_AIR)
    rows["received_by"] = frames[:, log.RECEIVERS_TO] - frames[:, log.RECEIVERS_FROM]
    return rows.tobytes()
