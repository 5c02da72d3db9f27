"""The largest connected part of some cells."""

from __future__ import annotations

import numpy as np

from protocol.grid import Mask


def largest_part(cells: Mask) -> Mask:
    """Return the largest 4-connected part of cells, shape (h, w); of equal ones the first, row by row."""
    from scipy import ndimage  # noqa: PLC0415  slow to import, and few commands need it

    labels, _ = ndimage.label(cells)
    sizes = np.bincount(labels[cells], minlength=1)
    largest: Mask = (labels == sizes.argmax()) & cells
    return largest
