"""What a robot in the field records of its radio: every frame that it sent, or received from a teammate.

Its directory has the files of a run, as far as one robot knows them:

    radio.pcapng    the packets of each frame, for Wireshark; written in each step
    ledger.parquet  one row per frame and kind of packet; the bytes of packets, without those of sealing
    frames.parquet  one row per frame: when, and its number, by which the directories of several robots can be joined

In capture and ledger, `connection` is the counter of the sealed frame. A frame that this robot sent has no receivers
there: a sender without a relay does not know them. Broadcast and gossip of one frame are two rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from agent.radios.peer_medium import FrameRecord
from deploy.record.columns import Column, schema
from deploy.record.run_directory import CAPTURE, LEDGER, CaptureFile, ledger_table
from netshaper import capture
from netshaper.frame_log import Content, FrameLog
from netshaper.ledger import BROADCAST, CAUSES, EVERYONE, NEWS, ROW
from protocol.errors import ProtocolError
from protocol.packet_index import NO_PACKETS, index_of
from worldsim.atomic_files import write_whole

FRAMES = "frames.parquet"

FRAME_COLUMNS = (
    Column("time_ns", "int64", "when it was sent or arrived, by this robot's clock"),
    Column("step", "int32", "the step of this robot"),
    Column("sender", "int16", "the robot that sent it"),
    Column("session", "int32", "how often the sender had started"),
    Column("counter", "int32", "frames of that session before it"),
    Column("bytes", "int32", "bytes of the sealed frame"),
    Column("received", "bool", "whether this robot received it; else it sent it"),
)
"""One row per frame (``frames.parquet``)."""

_CARRIED = CAUSES.index("")


def frame_log(robot: int, records: Sequence[FrameRecord]) -> FrameLog:
    """Return the frames of a step of one robot as a log, for ledger and capture."""
    log = FrameLog()
    for each in records:
        received = each.sender != robot
        number = f"frame {each.counter} of session {each.session}, {each.size} bytes sealed"
        fate = f"received by r{robot}: {number}" if received else f"sent: {number}"
        for kind, packets in ((BROADCAST, each.broadcast), (NEWS, each.gossip)):
            if packets:
                log.add(
                    0, _content(kind, packets), _CARRIED, each.sender, EVERYONE, connection=each.counter,
                    receivers=(robot,) if received else (), fate=fate,
                )  # fmt: skip
    return log


class LinkRecorder:
    """Writes the directory of one robot; FileExistsError if it has a capture already."""

    def __init__(self, folder: Path, robot: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._robot = robot
        self._capture = CaptureFile(folder / CAPTURE, "xb")
        self._capture.write(capture.head(f"radio of robot {robot} in the field"))
        self._rows: list[bytes] = []
        self._frames: list[tuple[int, int, int, int, int, int, bool]] = []

    def record(self, step: int, records: Sequence[FrameRecord]) -> None:
        """Take the frames of a step; those of equal steps may come in several calls."""
        log = frame_log(self._robot, records)
        if len(log):
            self._capture.write(capture.encode(step, log))
            self._rows.append(log.ledger_rows(step))
        self._frames += [
            (each.time, step, each.sender, each.session, each.counter, each.size, each.sender != self._robot)
            for each in records
        ]

    def close(self) -> None:
        """Write the tables; OSError if a file could not be written."""
        import pyarrow as pa  # noqa: PLC0415
        from pyarrow import parquet  # noqa: PLC0415

        self._capture.close()
        rows = np.frombuffer(b"".join(self._rows), ROW)
        names = [column.name for column in FRAME_COLUMNS]
        frames = [dict(zip(names, frame, strict=True)) for frame in self._frames]
        tables: dict[str, Any] = {
            LEDGER: ledger_table(rows),
            FRAMES: pa.Table.from_pylist(frames, schema=schema(FRAME_COLUMNS)),
        }
        for name, table in tables.items():
            write_whole(self._folder / name, _writer(parquet.write_table, table))
        if self._capture.failure is not None:
            raise self._capture.failure


def _writer(write: Callable[[Any, BinaryIO], object], table: Any) -> Callable[[BinaryIO], object]:
    return lambda file: write(table, file)


def _content(kind: int, packets: bytes) -> Content:
    try:
        return Content(kind, packets, index_of(packets))
    except ProtocolError as error:
        return Content(kind, packets, NO_PACKETS, -1, str(error))
