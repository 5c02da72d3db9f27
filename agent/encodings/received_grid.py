"""What teammates have told, as one grid, and the planning grid: the robot's own grid laid over it."""

from __future__ import annotations

import numpy as np

from agent.encodings.changed_cells import ChangedCells
from protocol.boxes import Boxes, whole_grid
from protocol.grid import UNKNOWN, Grid
from protocol.kernels import kernel
from protocol.scans import Change


class Heard:
    """A grid of what was told, to be written on; the planning grid is put together anew where either has changed.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.

    Attributes
    ----------
    grid : uint8 array, shape (h, w)
        What all have told; who writes on it says where (`told`).
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.grid: Grid = np.zeros(shape, np.uint8)
        self._boxes: list[tuple[int, int, int, int]] = []
        self._own_news = ChangedCells()
        self._planning: Grid | None = None

    def seen(self, own: Grid, change: Change) -> None:
        """Something has been drawn on the robot's own grid."""
        self._own_news.add(own, change)

    def told(self, box: tuple[int, int, int, int]) -> None:
        """Something has been written on `grid` in a box (x0, y0, x1, y1)."""
        self._boxes.append(box)

    def under(self, own: Grid) -> Grid:
        """Return the planning grid; it is written over by the next call."""
        changed = self._own_news.take(own)
        if self._planning is None or changed is None:
            self._planning, changed = np.empty_like(own), whole_grid(own.shape)
        boxes = np.array([*changed.tolist(), *self._boxes], np.int32).reshape(-1, 4)
        lay_over(self.grid, own, boxes, self._planning)
        self._boxes.clear()
        return self._planning


@kernel("void(uint8[:,::1], uint8[:,::1], int32[:,::1], uint8[:,::1])")
def lay_over(below: Grid, above: Grid, boxes: Boxes, both: Grid) -> None:
    """Write what is above where that is known, else what is below, in some boxes."""
    for box in boxes:
        for y in range(box[1], box[3]):
            low, high = below[y, box[0] : box[2]], above[y, box[0] : box[2]]
            out = both[y, box[0] : box[2]]
            for x in range(len(out)):
                out[x] = low[x] if high[x] == UNKNOWN else high[x]
