"""The claims that an approximation makes of cells: its drawing, a byte of bits a cell.

Free area is what its inside object encloses and none of its outside objects encloses or bounds. What claim
counts where several meet, `agent.outline.merge` says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.outline.boxes import NO_BOXES, Boxes, clip, whole
from agent.outline.polygons import Polygons
from agent.outline.raster import draw, fill
from protocol.kernels import kernel

NEAR_WALL, FREE_AREA, OUTSIDE_OCCUPIED, INSIDE_FREE, INSIDE_OCCUPIED = 1, 2, 4, 8, 16
"""The claims of a cell; the stronger has the higher bit. A layer itself does not claim that a wall is near: whose it is
says that."""

_WALL = OUTSIDE_OCCUPIED | INSIDE_OCCUPIED
_COUNT = 12
"""Bits in which a claim is counted."""

COUNTED = np.array(
    [
        [
            sum((bits >> k & 1) << _COUNT * k for k in range(5)) + (near and bits & _WALL > 0)
            for bits in range(32)
        ]
        for near in (False, True)
    ],
    np.int64,
)
"""What is counted of a cell's claims in a layer that is not near, and in one that is."""

Layer = NDArray[np.uint8]


class Tally:
    """What several layers claim together: by what one of them claims otherwise it changes, however many they are.

    Attributes
    ----------
    counts : int64 array, shape (h, w)
        How many make each claim of a cell.
    claims : uint8 array, shape (h, w)
        Which claims any of them makes, as bits.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.counts: NDArray[np.int64] = np.zeros(shape, np.int64)
        self.claims: Layer = np.zeros(shape, np.uint8)

    def turn(self, layer: Layer, near: bool) -> Boxes:
        """Count a layer that was not near as one that is, or the other way round; return boxes around its claims."""
        box = np.empty((1, 4), np.int32)
        return box if _turn(layer, near, self.counts, self.claims, box[0]) else NO_BOXES


NO_TALLY = Tally((0, 0))


@dataclass(frozen=True)
class Drawing:
    """What of an approximation is drawn. By default all of it, as in the thesis.

    Attributes
    ----------
    free_inside_edges : bool
        Draw inside edges that are labelled free. They claim cells free which their robot has not seen.
    unknown_pairs : bool
        Draw outside objects of two vertices and no occupied edge. They are the unseen specks between beams.
    wide_walls : bool
        Take the eight neighbours of a wall's cells for wall where nothing else is claimed of them.
    close_slivers : bool
        Take an unknown cell for free if its neighbours on the left and right or above and below are free, and
        not both by the robot's own sight.
    """

    free_inside_edges: bool = True
    unknown_pairs: bool = True
    wide_walls: bool = False
    close_slivers: bool = False


THESIS = Drawing()
"""All is drawn, as Algorithm 9 says."""


def layer(polygons: Polygons, drawing: Drawing = THESIS) -> Layer:
    """Render an approximation into the claims that it makes, a byte of bits a cell."""
    out = np.zeros(polygons.shape, np.uint8)
    draw_anew(out, polygons, drawing, np.zeros_like(out), whole(polygons.shape))
    return out


def draw_anew(
    out: Layer,
    polygons: Polygons,
    drawing: Drawing,
    scratch: Layer,
    boxes: Boxes,
    tally: Tally = NO_TALLY,
    near: bool = False,
) -> Boxes:
    """Render the claims of an approximation in some boxes, in place of what was claimed there.

    `scratch` has the shape of the layer, and is zero before and after. In a `tally` that has counted the layer, as one
    that is `near` or not, what is claimed now is counted instead. Returns boxes around the claims that are others than
    before.
    """
    changed: Boxes = _render(
        out,
        polygons.x,
        polygons.y,
        polygons.side,
        polygons.occupied,
        polygons.start,
        polygons.inside,
        drawing.free_inside_edges,
        drawing.unknown_pairs,
        scratch,
        boxes,
        near,
        tally.counts,
        tally.claims,
    )
    return changed


_CHUNK = 16
"""So many edges are looked at together: those of a chunk whose bounds a box does not touch are left out."""


@kernel("void(int16[::1], int16[::1], int32[::1], int32[::1], int32[:,::1], int32[:,::1])")
def _measure(
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    start: NDArray[np.int32],
    chunk_of: NDArray[np.int32],
    chunks: Boxes,
    objects: Boxes,
) -> None:
    """Write the boxes in which the edges of each chunk and each object lie, with a cell to spare.

    An object's chunks begin with number ``chunk_of[k]``.
    """
    chunk = 0
    for k in range(len(start) - 1):
        first, end = start[k], start[k + 1]
        chunk_of[k] = chunk
        left, top, right, bottom = 1 << 20, 1 << 20, -1, -1
        for begin in range(first, end, _CHUNK):
            behind = min(begin + _CHUNK, end)
            after = behind if behind < end else first  # where the last edge of the chunk ends
            x0 = x1 = int(x[after])
            y0 = y1 = int(y[after])
            for i in range(begin, behind):
                x0, x1 = min(x0, x[i]), max(x1, x[i])
                y0, y1 = min(y0, y[i]), max(y1, y[i])
            chunks[chunk, 0], chunks[chunk, 1] = x0 - 1, y0 - 1
            chunks[chunk, 2], chunks[chunk, 3] = x1 + 2, y1 + 2
            chunk += 1
            left, top, right, bottom = min(left, x0), min(top, y0), max(right, x1), max(bottom, y1)
        objects[k, 0], objects[k, 1], objects[k, 2], objects[k, 3] = left - 1, top - 1, right + 2, bottom + 2


@kernel("boolean(int32[:,::1], int64, int32[::1], int32[::1])")
def _overlap(objects: Boxes, k: int, box: NDArray[np.int32], part: NDArray[np.int32]) -> bool:
    """Write what a box and that of object `k` have in common; whether that is anything."""
    if (
        objects[k, 0] >= box[2]
        or objects[k, 2] <= box[0]
        or objects[k, 1] >= box[3]
        or objects[k, 3] <= box[1]
    ):
        return False
    part[0], part[1] = max(objects[k, 0], box[0]), max(objects[k, 1], box[1])
    part[2], part[3] = min(objects[k, 2], box[2]), min(objects[k, 3], box[3])
    return True


@kernel("int64(int32[:,::1], int64, int64, int64, int32[::1], int32[::1])")
def _edges_near(
    chunks: Boxes, chunk: int, first: int, end: int, box: NDArray[np.int32], edges: NDArray[np.int32]
) -> int:
    """Collect the edges of the vertices ``first:end`` that may cross a column of a box, in it or above it."""
    count = 0
    for begin in range(first, end, _CHUNK):
        if chunks[chunk, 0] < box[2] and chunks[chunk, 2] > box[0] and chunks[chunk, 1] < box[3]:
            for i in range(begin, min(begin + _CHUNK, end)):
                edges[count] = i
                count += 1
        chunk += 1
    return count


@kernel("uint8(int64)")
def _claimed(count: int) -> int:
    """Which claims have been counted."""
    claims = 0
    for k in range(5):
        claims |= (count >> _COUNT * k & (1 << _COUNT) - 1 != 0) << k
    return claims


@kernel("boolean(uint8[:,::1], uint8[:,::1], boolean, int64[:,::1], uint8[:,::1], int32[::1], int32[::1])")
def _note_change(
    before: Layer,
    layer: Layer,
    near: bool,
    counts: NDArray[np.int64],
    claims: Layer,
    box: NDArray[np.int32],
    changed: NDArray[np.int32],
) -> bool:
    """Count what has changed in a box, and write the box around it; whether anything has."""
    x0, y0 = box[0], box[1]
    height, width = before.shape
    top, bottom, left, right = height, -1, width, -1
    for y in range(height):
        for x in range(width):
            old, new = before[y, x], layer[y0 + y, x0 + x]
            if old == new:
                continue
            top, bottom = min(top, y), y
            left, right = min(left, x), max(right, x)
            if counts.size:
                counts[y0 + y, x0 + x] += COUNTED[int(near), new] - COUNTED[int(near), old]
                claims[y0 + y, x0 + x] = _claimed(counts[y0 + y, x0 + x])
    changed[0], changed[1], changed[2], changed[3] = x0 + left, y0 + top, x0 + right + 1, y0 + bottom + 1
    return bottom >= 0


@kernel("boolean(uint8[:,::1], boolean, int64[:,::1], uint8[:,::1], int32[::1])")
def _turn(layer: Layer, near: bool, counts: NDArray[np.int64], claims: Layer, box: NDArray[np.int32]) -> bool:
    """Count the walls of a layer as near, or no longer, and write the box around them; whether there are any."""
    height, width = layer.shape
    top, bottom, left, right = height, -1, width, -1
    for y in range(height):
        for x in range(width):
            if layer[y, x] & _WALL:
                top, bottom = min(top, y), y
                left, right = min(left, x), max(right, x)
                counts[y, x] += 1 if near else -1
                claims[y, x] = _claimed(counts[y, x])
    box[0], box[1], box[2], box[3] = left, top, right + 1, bottom + 1
    return bottom >= 0


@kernel(
    "int32[:,::1](uint8[:,::1], int16[::1], int16[::1], uint8[::1], uint8[::1], int32[::1], boolean[::1], boolean, "
    "boolean, uint8[:,::1], int32[:,::1], boolean, int64[:,::1], uint8[:,::1])"
)
def _render(
    out: NDArray[np.uint8],
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    side: NDArray[np.uint8],
    occupied: NDArray[np.uint8],
    start: NDArray[np.int32],
    inside: NDArray[np.bool_],
    free_inside_edges: bool,
    unknown_pairs: bool,
    scratch: NDArray[np.uint8],
    boxes: Boxes,
    near: bool,
    counts: NDArray[np.int64],
    claims: Layer,
) -> Boxes:
    bounds = np.empty((len(inside), 4), np.int32)
    chunks = np.empty((len(x) // _CHUNK + len(inside), 4), np.int32)
    chunk_of = np.empty(len(inside), np.int32)
    _measure(x, y, start, chunk_of, chunks, bounds)
    edges = np.empty(len(x), np.int32)
    other = INSIDE_FREE if free_inside_edges else 0
    box, part = np.empty(4, np.int32), np.empty(4, np.int32)
    changed = np.empty((len(boxes), 4), np.int32)
    count = 0
    for number in range(len(boxes)):
        clip(boxes[number], 0, out.shape, box)
        before = out[box[1] : box[3], box[0] : box[2]].copy()
        out[box[1] : box[3], box[0] : box[2]] = 0
        for stage in range(3):
            for k in range(len(inside)):
                first, end = start[k], start[k + 1]
                if inside[k] == (stage == 1) or not _overlap(bounds, k, box, part):
                    continue
                has_wall = occupied[first] or occupied[first + 1]
                if not (unknown_pairs or inside[k] or end - first > 2 or has_wall):
                    continue
                found = edges[: _edges_near(chunks, chunk_of[k], first, end, part, edges)]
                if stage == 0:
                    fill(out, x, y, side, first, end, found, scratch, FREE_AREA, 0, part)
                elif stage == 1:
                    fill(out, x, y, side, first, end, found, scratch, 0, FREE_AREA, part)
                    draw(out, x, y, side, occupied, first, end, found, OUTSIDE_OCCUPIED, 0, FREE_AREA, part)
                else:
                    draw(out, x, y, side, occupied, first, end, found, INSIDE_OCCUPIED, other, 0, part)
        if _note_change(before, out, near, counts, claims, box, changed[count]):
            count += 1
    return changed[:count].copy()
