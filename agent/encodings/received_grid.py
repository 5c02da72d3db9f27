"""One grid of all that teammates reported, and the planning grid made of it and the self-explored grid."""

from __future__ import annotations

import numpy as np

from agent.encodings.changed_cells import ChangedCells
from protocol.boxes import Box, Boxes, whole_grid
from protocol.grid import UNKNOWN, Grid
from protocol.kernels import kernel
from protocol.scans import Change


class ReceivedGrid:
    """The grid of received cells; the planning grid is updated where this grid or the self-explored grid changed.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.

    Attributes
    ----------
    grid : uint8 array, shape (h, w)
        The received state of each cell. A caller that writes to it reports where (`changed`).
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.grid: Grid = np.zeros(shape, np.uint8)
        self._boxes: list[Box] = []
        self._own_changes = ChangedCells()
        self._planning: Grid | None = None

    def own_changed(self, own: Grid, change: Change) -> None:
        """Note a change of the self-explored grid."""
        self._own_changes.add(own, change)

    def changed(self, box: Box) -> None:
        """Note that the caller has written to `grid` in a box (x0, y0, x1, y1)."""
        self._boxes.append(box)

    def overlaid(self, own: Grid) -> Grid:
        """Return the planning grid: `own` where it is known, else `grid`. The next call overwrites it."""
        changed = self._own_changes.take(own)
        if self._planning is None or changed is None:
            self._planning, changed = np.empty_like(own), whole_grid(own.shape)
        boxes = np.array([*changed.tolist(), *self._boxes], np.int32).reshape(-1, 4)
        overlay(self.grid, own, boxes, self._planning)
        self._boxes.clear()
        return self._planning


@kernel
def overlay(below: Grid, above: Grid, boxes: Boxes, both: Grid) -> None:
    """Write to `both`, inside the boxes, the cells of `above` that are known, else those of `below`."""
    for box in boxes:
        for y in range(box[1], box[3]):
            low, high = below[y, box[0] : box[2]], above[y, box[0] : box[2]]
            out = both[y, box[0] : box[2]]
            for x in range(len(out)):
                out[x] = low[x] if high[x] == UNKNOWN else high[x]
