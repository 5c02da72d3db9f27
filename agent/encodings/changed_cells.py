"""Which part of a robot's self-explored grid has changed since a reader last processed it."""

from __future__ import annotations

from protocol.boxes import NO_BOXES, Boxes, union
from protocol.grid import Grid
from protocol.scans import Change


class ChangedCells:
    """Changes of a grid that one reader has not processed yet; the grid is changed in place."""

    def __init__(self) -> None:
        self._seen: Grid | None = None
        self._boxes: Boxes = NO_BOXES

    def add(self, own: Grid, change: Change) -> None:
        """Note a change of the grid."""
        if own is self._seen:
            self._boxes = union(self._boxes, change.boxes)

    def take(self, own: Grid) -> Boxes | None:
        """Return boxes that cover all changes since the last call.

        None: the last call was for another grid, or there was none, so all cells may have changed.
        """
        boxes = self._boxes if own is self._seen else None
        self._seen, self._boxes = own, NO_BOXES
        return boxes
