"""Where a robot's own grid has changed since somebody last looked at it."""

from __future__ import annotations

from protocol.boxes import NO_BOXES, Boxes, union
from protocol.grid import Grid
from protocol.scans import Change


class ChangedCells:
    """One onlooker's news of a grid that is changed in place."""

    def __init__(self) -> None:
        self._seen: Grid | None = None
        self._boxes: Boxes = NO_BOXES

    def add(self, own: Grid, change: Change) -> None:
        """Something has been drawn on the grid."""
        if own is self._seen:
            self._boxes = union(self._boxes, change.boxes)

    def take(self, own: Grid) -> Boxes | None:
        """Return boxes that cover all changes, and begin anew; None if another grid was seen the last time, or none."""
        boxes = self._boxes if own is self._seen else None
        self._seen, self._boxes = own, NO_BOXES
        return boxes
