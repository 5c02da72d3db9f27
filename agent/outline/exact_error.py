"""What is wrong with an approximation even if it is exact: the part of Eq. 6.1 that is not due to coarseness.

Free edges of inside objects alone claim 1 to 3 % of the cells, which hides what a splitting frequency does;
`agent.outline.merge` says which cells Algorithm 9 cannot know. Less this, Eq. 6.1 is 0 for an exact approximation.
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
        What is drawn of approximations; without guesses.
    """

    def __init__(self, drawing: Drawing) -> None:
        self._drawing = drawing
        self._tracer: Tracer | None = None
        self._at = (0, 0)
        self._news: Boxes = NO_BOXES
        self._count = 0

    def note(self, scan: Scan, change: Change) -> None:
        """A scan has been drawn on the grid."""
        self._at = scan.x, scan.y
        if change.cells:
            self._news = union(self._news, change.boxes)

    def count(self, own: Grid) -> int:
        """Cells in which the grid and the drawing of all its contour points differ."""
        if self._tracer is not None and not len(self._news):
            return self._count
        changed = None if self._tracer is None else self._news
        self._tracer = self._tracer or Tracer((own.shape[0], own.shape[1]))
        exact = self._tracer.contours(own, self._at, changed)
        every = np.arange(len(exact.x), dtype=np.int32)
        told = approximation(exact, every, unknown_pairs=self._drawing.unknown_pairs)
        self._count, self._news = approximation_error(own, told, self._drawing), NO_BOXES
        return self._count
