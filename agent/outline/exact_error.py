"""Error of an exact approximation: the part of Eq. 6.1 that is not due to coarseness.

Algorithm 9 cannot determine some cells (`agent.outline.merge`). Free edges of inside objects alone cover 1 to 3 % of
the cells, which hides the effect of the splitting frequency. Without this part, Eq. 6.1 is 0 for an exact
approximation.
"""

from __future__ import annotations

import numpy as np

from agent.outline.approximation import approximation
from agent.outline.claims import Drawing
from agent.outline.contour import Tracer
from agent.outline.merge import approximation_error
from protocol.boxes import NO_BOXES, Boxes, union
from protocol.grid import Grid
from protocol.scans import Change, Scan


class ExactError:
    """The error of the exact approximation of a grid that changes step by step.

    Parameters
    ----------
    drawing : Drawing
        Parts of approximations that are drawn; without wide walls and closed slivers.
    """

    def __init__(self, drawing: Drawing) -> None:
        self._drawing = drawing
        self._tracer: Tracer | None = None
        self._at = (0, 0)
        self._changed: Boxes = NO_BOXES
        self._count = 0

    def note(self, scan: Scan, change: Change) -> None:
        """Note that a scan was drawn on the grid."""
        self._at = scan.x, scan.y
        if change.cells:
            self._changed = union(self._changed, change.boxes)

    def count(self, own: Grid) -> int:
        """Return the number of cells in which the grid and the drawing of all its contour points differ."""
        if self._tracer is not None and not len(self._changed):
            return self._count
        changed = None if self._tracer is None else self._changed
        self._tracer = self._tracer or Tracer((own.shape[0], own.shape[1]))
        exact = self._tracer.contours(own, self._at, changed)
        every = np.arange(len(exact.x), dtype=np.int32)
        complete = approximation(exact, every, unknown_pairs=self._drawing.unknown_pairs)
        self._count, self._changed = approximation_error(own, complete, self._drawing), NO_BOXES
        return self._count
