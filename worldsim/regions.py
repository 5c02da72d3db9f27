"""Regions of a grid, as masks of shape (h, w): connected parts, wide parts, and the nearest cell.

Parts are 4-connected, since robots do not cut corners.
"""

from __future__ import annotations

import numpy as np

from protocol.grid import Cell, Mask


def part_with(cells: Mask, cell: Cell) -> Mask:
    """Return the connected part of some cells that contains `cell`; no cell if none does."""
    from scipy import ndimage  # noqa: PLC0415  slow to import, and few commands need it

    labels, _ = ndimage.label(cells)
    found: Mask = (labels == labels[cell[1], cell[0]]) & cells
    return found


def largest_part(cells: Mask) -> Mask:
    """Return the largest connected part of some cells; of equal ones the first, row by row."""
    from scipy import ndimage  # noqa: PLC0415

    labels, _ = ndimage.label(cells)
    sizes = np.bincount(labels[cells], minlength=1)
    largest: Mask = (labels == sizes.argmax()) & cells
    return largest


def wide_part(cells: Mask, start: Cell, width: int) -> Mask:
    """Return the cells that a square of `width` cells covers if it moves within some cells.

    It begins as near as possible to `start`. All cells are returned if no such square fits.
    """
    from scipy import ndimage  # noqa: PLC0415

    square = np.ones((width, width), np.bool_)
    places: Mask = ndimage.binary_erosion(cells, square)
    first = nearest_cell(places, start)
    if first is None:
        return cells
    covered: Mask = ndimage.binary_dilation(part_with(places, first), square)
    return covered


def nearest_cell(cells: Mask, near: Cell) -> Cell | None:
    """Return the one of some cells that is nearest to `near`, of equal ones the first, row by row; None without any."""
    rows, columns = np.nonzero(cells)
    if not len(rows):
        return None
    nearest = np.argmin((columns - near[0]) ** 2 + (rows - near[1]) ** 2)
    return int(columns[nearest]), int(rows[nearest])
