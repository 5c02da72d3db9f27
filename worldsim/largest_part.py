"""The largest connected part of some cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def largest_part(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the largest 4-connected part of cells, shape (h, w); of equal ones the first, row by row."""
    from scipy import ndimage  # noqa: PLC0415  slow to import, and few commands need it

    labels, _ = ndimage.label(cells)
    sizes = np.bincount(labels[cells], minlength=1)
    largest: NDArray[np.bool_] = (labels == sizes.argmax()) & cells
    return largest
