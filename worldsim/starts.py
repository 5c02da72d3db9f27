"""Start cells of the robots: around one cell, at a minimum distance, with an optional random offset."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from protocol.grid import FREE, Cell, Grid, Mask
from protocol.keyed_random import keyed_random
from worldsim.regions import largest_part, nearest_cell, part_with


def start_cells(
    truth: Grid,
    robots: int,
    seed: int,
    spacing: int,
    first: Cell | None = None,
    given: Sequence[Cell] = (),
    *,
    wide: int = 1,
) -> list[Cell]:
    """Choose the start cells: the free cells nearest to one seeded cell, or to `first`, `spacing` cells apart.

    `given` are the start cells of the first robots; the others keep their distance from them. Robots explore no
    openings narrower than `wide` cells, so the seeded cell is not in a part of the map that only such openings leave.

    Raises ValueError if no cell is free, `first` is not free, or too few free cells are that far apart.
    """
    chosen = list(given[:robots])
    if len(chosen) == robots:
        return chosen
    if not (truth == FREE).any():
        raise ValueError("no cell is free for robots of that radius")
    if first is None:
        largest = largest_part(truth == FREE)
        ys, xs = np.nonzero(largest)
        pick = int(keyed_random(seed, "start").integers(len(xs)))
        first = _wide_cell(largest, (int(xs[pick]), int(ys[pick])), wide)
    check_free(truth, first)
    reached = np.zeros(truth.shape, np.bool_)
    reached[first[1], first[0]] = True
    queue = deque([first])
    height, width = truth.shape
    while queue and len(chosen) < robots:
        x, y = queue.popleft()
        if all(max(abs(x - cx), abs(y - cy)) >= spacing for cx, cy in chosen):
            chosen.append((x, y))
        for nx, ny in ((x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1)):
            if 0 <= nx < width and 0 <= ny < height and truth[ny, nx] == FREE and not reached[ny, nx]:
                reached[ny, nx] = True
                queue.append((nx, ny))
    if len(chosen) < robots:
        raise ValueError(
            f"{robots} robots do not fit: {len(chosen)} free cells lie {spacing} cells apart around {first}; name "
            "fewer robots, or a smaller start_spacing or radius"
        )
    return chosen


def _wide_cell(cells: Mask, cell: Cell, width: int) -> Cell:
    """Return the cell nearest to `cell` in the largest part that a square of `width` cells covers if it moves.

    That is `cell` itself if this part contains it, or if no such square fits.
    """
    from scipy import ndimage  # noqa: PLC0415  slow to import, and few commands need it

    if width <= 1:
        return cell
    square = np.ones((width, width), np.bool_)
    largest = largest_part(ndimage.binary_erosion(cells, square))
    if ndimage.binary_dilation(largest, square)[cell[1], cell[0]]:
        return cell
    return nearest_cell(largest, cell) or cell


def jittered(
    truth: Grid, cell: Cell, most: float, seed: int, robot: int, others: Sequence[Cell], spacing: int
) -> Cell:
    """Draw a free cell connected to `cell`, at most `most` cells away, at least `spacing` cells from `others`.

    Raises ValueError if `cell` is not free, or no cell near it is far enough from the others.
    """
    check_free(truth, cell)
    ys, xs = np.nonzero(part_with(truth == FREE, cell))
    near = (xs - cell[0]) ** 2 + (ys - cell[1]) ** 2 <= most * most
    for x, y in others:
        near &= np.maximum(np.abs(xs - x), np.abs(ys - y)) >= spacing
    around = np.flatnonzero(near)
    if not len(around):
        raise ValueError(
            f"robot {robot} does not fit: no cell near {cell} is {spacing} cells from the others'"
        )
    pick = around[int(keyed_random(seed, "jitter", robot).integers(len(around)))]
    return int(xs[pick]), int(ys[pick])


def check_free(truth: Grid, cell: Cell) -> None:
    """Raise ValueError if a robot's center may not be in a cell."""
    height, width = truth.shape
    x, y = cell
    if not (0 <= x < width and 0 <= y < height) or truth[y, x] != FREE:
        raise ValueError(f"cell {cell} is not free: robots cannot start there")
