"""When the scans of exact lasers are encoded: after a few new cells, or a few steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from agent.mapping.estimator import Int8Grid
from agent.predictive.author import Author
from agent.predictive.history import DecodedUpdate
from agent.predictive.scan_stream import ScanStream
from agent.predictive.scan_updates import REPORTED
from protocol.boxes import Box, bounding_box
from protocol.grid import UNKNOWN, Cell, Grid
from protocol.kernels import kernel
from protocol.range_scans import RangeScan
from protocol.scans import GridChange, Scan

ENOUGH_CELLS = 14
"""New cells that are sent at once; fewer may wait."""

CELLS_PER_BYTE = 3
"""New cells per byte of an update with an urgency of 1. Updates with fewer rank by their waiting time alone."""


@dataclass
class _Pending:
    """Input of the next update: cells from which the robot scanned, and where its grid has changed since the last."""

    poses: list[Cell] = field(default_factory=list)
    boxes: list[Box] = field(default_factory=list)
    steps: int = 0


class ScanAuthor(Author[ScanStream]):
    """Encodes scans; fewer than `ENOUGH_CELLS` new cells wait for `wait_steps` steps.

    With `ranks`, an update is the more urgent, the more new cells it reports per byte.
    """

    def __init__(self, stream: ScanStream, wait_steps: int, *, ranks: bool = False) -> None:
        super().__init__(stream)
        self._wait_steps = wait_steps
        self._ranks = ranks
        self._pending = _Pending()
        self._encoded = _Pending()
        """Input of the last update, to restore `_pending` if the update is retracted."""

    @property
    def has_changes(self) -> bool:
        """Whether the grid has changed since the last update."""
        return bool(self._pending.boxes)

    @property
    def is_full(self) -> bool:
        """Whether the last update ended at its limit, so that later changes do not belong to it."""
        return self.stream.is_narrow and self.has_changes

    def add(self, scan: Scan | RangeScan, change: GridChange) -> None:
        """Add a scan if it has changed the grid."""
        if change.cells:
            self._pending.poses.append((scan.x, scan.y))
            self._pending.boxes.append(change.box)
        if self._pending.boxes:
            self._pending.steps += 1

    def is_due(self, own: Grid, log_odds: Int8Grid, received: Grid) -> bool:
        """Return whether there are enough new cells, or some have waited long enough."""
        pending = self._pending
        new_cells = int(_unreported(received, self.stream.grid, own, bounding_box(pending.boxes)))
        if not new_cells:
            self._pending = _Pending()
        return new_cells >= ENOUGH_CELLS or (new_cells > 0 and pending.steps >= self._wait_steps)

    def encode(self, own: Grid, log_odds: Int8Grid, most: float) -> tuple[bytes, DecodedUpdate] | None:
        """Encode an update of the scans that wait; those beyond `most` bytes remain."""
        pending, self._pending = self._pending, _Pending()
        if not pending.poses:
            self._pending = pending
            return None
        box = bounding_box(pending.boxes)
        encoded = self.stream.encode(own, pending.poses, box, most=most)
        if encoded is None:
            return None
        message, update, scans = encoded
        if self._ranks:
            self.urgency = len(update.places) / len(message) / CELLS_PER_BYTE
        self._encoded = _Pending(pending.poses[:scans], [box], pending.steps)
        if scans < len(pending.poses):
            self._pending = _Pending(pending.poses[scans:], [box], pending.steps)
        return message, update

    def retract(self) -> None:
        """Take back the last update; its scans wait again, before those that have come since."""
        super().retract()
        encoded, pending = self._encoded, self._pending
        self._pending = _Pending(
            encoded.poses + pending.poses, encoded.boxes + pending.boxes, encoded.steps + pending.steps
        )

    def restart(self, stream: ScanStream, withdrawn: Sequence[DecodedUpdate]) -> None:
        """Continue with another stream; the poses of withdrawn updates wait again, and the whole grid may differ."""
        super().restart(stream, withdrawn)
        height, width = stream.grid.shape
        poses = [update.pose for update in withdrawn if update.pose is not None]
        self._pending = _Pending(poses + self._pending.poses, [(0, 0, width, height)], self._pending.steps)


@kernel
def _unreported(received: Grid, logged: Grid, own: Grid, box: Box) -> int:
    """Count the cells of a box whose state in `own` neither this robot's log nor a received log reports."""
    count, (x0, y0, x1, y1) = 0, box
    for y in range(y0, y1):
        for x in range(x0, x1):
            truth = own[y, x]
            if truth == UNKNOWN:
                count += logged[y, x] & REPORTED != 0
            else:
                count += received[y, x] != truth and logged[y, x] != truth | REPORTED
    return count
