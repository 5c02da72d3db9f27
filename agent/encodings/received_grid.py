"""Encodings whose received maps share one grid; the planning grid is updated only where a grid has changed."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from agent.encodings.base import MapEncoding
from agent.encodings.votes import Votes
from agent.settings import Settings
from protocol.boxes import NO_BOXES, Box, Boxes, union, whole_grid
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.kernels import kernel
from protocol.scans import GridChange


class ChangedCells:
    """Where a grid has changed, in place, since a reader last processed it."""

    def __init__(self) -> None:
        self._seen: Grid | None = None
        self._boxes: Boxes = NO_BOXES

    def add(self, own: Grid, change: GridChange) -> None:
        """Note a change of the grid."""
        if own is self._seen and change.cells:
            self._boxes = union(self._boxes, change.boxes)

    def take(self, own: Grid) -> Boxes | None:
        """Return boxes that cover all changes since the last call.

        None: the last call was for another grid, or there was none, so all cells may have changed.
        """
        boxes = self._boxes if own is self._seen else None
        self._seen, self._boxes = own, NO_BOXES
        return boxes


class GridEncoding(MapEncoding):
    """An encoding that writes all received cells to one grid, and overlays it with the self-explored grid."""

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self.votes = Votes(settings)
        """The reports from which `received` follows."""
        self.received = self.votes.received
        """The received state of each cell, shape (h, w). A subclass that counts votes reports where it changes."""
        self.own_changes = ChangedCells()
        """Changes of the self-explored grid, which a subclass reports."""
        self._boxes: list[Box] = []
        self._planning: Grid | None = None

    @property
    def doubted(self) -> Mapping[int, str]:
        """Why each doubted robot is doubted (`agent.encodings.votes`), by its number."""
        return self.votes.doubted

    def received_changed(self, box: Box) -> None:
        """Note that received cells were written in a box (x0, y0, x1, y1)."""
        self._boxes.append(box)

    def forget_received(self) -> None:
        """Forget everything decoded from the logs of others."""
        self.votes.reset()
        self.received_changed((0, 0, self.received.shape[1], self.received.shape[0]))

    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Return the planning grid: the self-explored grid where it is known, else the received one.

        With noisy lasers, it is what all robots report, this one among them (`agent.encodings.votes`).
        """
        changed = self.own_changes.take(own)
        if self._planning is None or changed is None:
            self._planning, changed = np.empty_like(own), whole_grid(own.shape)
        boxes = np.array([*changed.tolist(), *self._boxes], np.int32).reshape(-1, 4)
        self._boxes.clear()
        if self.settings.laser is not None:
            self.votes.unite(own, boxes, self._planning)
            return self._planning
        contradicted = overlay(self.received, own, boxes, self._planning)
        if (contradicted or self.votes.contested) and self.votes.judge(own):
            overlay(self.received, own, whole_grid(own.shape), self._planning)
        return self._planning

    def shared_map(self, own: Grid, planning: Grid) -> Grid:
        """Return all reports that count; cells without any are those of the self-explored grid.

        A cell is a wall if any robot reports one, although the planning grid follows two others that report it free.
        """
        shared = self.votes.reported()
        return np.where(shared == UNKNOWN, own, shared)


@kernel
def overlay(below: Grid, above: Grid, boxes: Boxes, both: Grid) -> int:
    """Write to `both`, inside the boxes, the cells of `above` that are known, else those of `below`.

    Returns the number of cells that are free in one and occupied in the other, where boxes overlap more than once.
    """
    contradicted = 0
    for box in boxes:
        for y in range(box[1], box[3]):
            low, high = below[y, box[0] : box[2]], above[y, box[0] : box[2]]
            out = both[y, box[0] : box[2]]
            for x in range(len(out)):
                out[x] = low[x] if high[x] == UNKNOWN else high[x]
                contradicted += low[x] ^ high[x] == FREE ^ OCCUPIED
    return contradicted
