"""Drawing of an approximation: the claims that it makes about each cell, as bits of one byte.

The free area is enclosed by the inside object, and neither enclosed nor bounded by an outside object.
`agent.outline.merge` resolves claims that contradict each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.memo_cache import NO_CACHE, MemoCache
from agent.outline.objects import (
    BOTTOM,
    FIRST,
    INSIDE,
    LEFT,
    LENGTH,
    RIGHT,
    TOP,
    Objects,
    Table,
    bounds,
)
from agent.outline.polygons import Symbols, place_of, vertex_cell
from agent.outline.raster import Edges, draw, fill
from protocol.arrays import Int32s, Uint8s
from protocol.boxes import NO_BOXES, Boxes, clip, whole_grid
from protocol.grid import Grid
from protocol.kernels import kernel

NEAR_WALL, FREE_AREA, OUTSIDE_OCCUPIED, INSIDE_FREE, INSIDE_OCCUPIED = 1, 2, 4, 8, 16
"""Bits of the claims about a cell; a stronger claim has a higher bit. Layers do not contain `NEAR_WALL`: `ClaimCounts`
adds it to the walls of robots that are near."""

_WALL = OUTSIDE_OCCUPIED | INSIDE_OCCUPIED

Layer = Grid


class ClaimCounts:
    """Number of layers that make each claim about each cell, updated with the changes of single layers.

    At most 255 layers can be counted.

    Attributes
    ----------
    claims : uint8 array, shape (h, w)
        Claims that any layer makes, as bits.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.claims: Layer = np.zeros(shape, np.uint8)
        self._cells = self.claims.reshape(-1)
        self._counts = np.zeros((self.claims.size, 5), np.uint8)

    def apply(self, difference: ClaimDifference, near: bool) -> None:
        """Apply the changes of a layer; `near`: whether its robot is near."""
        cells, before, after, _ = difference
        _apply(cells, before, after, near, self._counts, self._cells)

    def set_near(self, layer: Layer, near: bool) -> Boxes:
        """Note that the robot of a layer is near now, or not any more; return the boxes of changed claims."""
        box = np.empty((1, 4), np.int32)
        return box if _set_near(layer, near, self._counts, self._cells, box[0]) else NO_BOXES


NO_COUNTS = ClaimCounts((0, 0))


class ClaimDifference(NamedTuple):
    """Changes of a layer: cells with other claims than before.

    `cells`: int32 array, shape (n,), indices into the flattened grid. `before`, `after`: uint8 arrays, shape (n,),
    their claims. `boxes`: boxes that contain these cells.
    """

    cells: NDArray[np.int32]
    before: NDArray[np.uint8]
    after: NDArray[np.uint8]
    boxes: Boxes


THIN, WIDE_UNSEEN, WIDE = range(3)
"""Walls of teammates that are widened: none, those that this robot has not seen itself, all."""


@dataclass(frozen=True)
class Drawing:
    """Parts of an approximation that are drawn, and inferred cells. By default as in the thesis."""

    free_inside_edges: bool = True
    """Draw the free edges of inside objects. They mark cells as free that their robot has not seen."""
    unknown_pairs: bool = True
    """Draw outside objects of two vertices without an occupied edge: unseen cells between beams."""
    wide_walls: bool = False
    """Mark the eight neighbors of a wall's cells as wall, unless another claim exists."""
    close_slivers: bool = False
    """Mark an unknown cell as free if its neighbors on the left and right, or above and below, are free, and this robot
    has not seen both itself."""
    wide_seen_walls: bool = True
    """Widen also walls that this robot has seen itself."""
    keep_walls: bool = False
    """Let occupied edges of outside objects override free edges of inside objects, not the reverse (Algorithm 9)."""

    @property
    def wide(self) -> int:
        """Walls that are widened: `THIN` for none, `WIDE_UNSEEN`, or `WIDE`."""
        if not self.wide_walls:
            return THIN
        return WIDE if self.wide_seen_walls else WIDE_UNSEEN


THESIS = Drawing()
"""Everything is drawn and nothing inferred, as in Algorithm 9."""


def redraw(out: Layer, objects: Objects, drawing: Drawing, boxes: Boxes) -> ClaimDifference:
    """Render an approximation within boxes, replacing the claims there; return the changes."""
    parts = drawing.free_inside_edges, drawing.unknown_pairs
    return ClaimDifference(*_render(out, objects.table, objects.pool, *parts, boxes))


class DrawnClaims:
    """The claims of an approximation that changes step by step; robots of this process share intermediate results."""

    def __init__(self, shape: tuple[int, int], drawing: Drawing, cache: MemoCache = NO_CACHE) -> None:
        self.layer: Layer = np.zeros(shape, np.uint8)
        self._cells = self.layer.reshape(-1)
        self._drawing = drawing
        self._cache = cache
        self._objects: Objects | None = None

    def update(self, objects: Objects, changed: Boxes | None = None) -> ClaimDifference:
        """Redraw the approximation, which differs from the last one only in the boxes `changed` (None: anywhere)."""
        drawing = self._drawing
        boxes = whole_grid(objects.shape) if changed is None or self._objects is None else changed
        change = self._objects, objects, drawing.free_inside_edges, drawing.unknown_pairs
        difference = self._cache.get(change, lambda: redraw(self.layer, objects, drawing, boxes))
        _write(self._cells, difference.cells, difference.after)
        self._objects = objects
        return difference


_CHUNK = 16
"""Edges per chunk; all edges of a chunk whose bounding box does not touch the box to be drawn are skipped."""


@kernel
def _measure(vertices: Symbols, chunks: Boxes) -> None:
    """Write the bounding boxes of the edges of each chunk of an object, with a margin of one cell."""
    for begin in range(0, len(vertices), _CHUNK):
        end = begin + _CHUNK
        x0, y0, x1, y1 = bounds(vertices[begin:end])
        x, y = vertex_cell(vertices[end if end < len(vertices) else 0])  # end of the last edge
        box = chunks[begin // _CHUNK]
        box[0], box[1], box[2], box[3] = min(x0, x - 1), min(y0, y - 1), max(x1, x + 2), max(y1, y + 2)


@kernel
def _overlap(row: Int32s, box: Int32s, part: Int32s) -> bool:
    """Write the intersection of a box and the box of an object; return whether it is not empty."""
    part[0], part[1] = max(row[LEFT], box[0]), max(row[TOP], box[1])
    part[2], part[3] = min(row[RIGHT], box[2]), min(row[BOTTOM], box[3])
    return bool(part[0] < part[2] and part[1] < part[3])


@kernel
def _edges_near(vertices: Symbols, chunks: Boxes, box: Int32s, edges: Edges) -> int:
    """Collect the edges that may cross a column of a box, within it or above it; return their number."""
    count = 0
    for begin in range(0, len(vertices), _CHUNK):
        chunk = begin // _CHUNK
        if chunks[chunk, 0] >= box[2] or chunks[chunk, 2] <= box[0] or chunks[chunk, 1] >= box[3]:
            continue
        x, y = place_of(vertices[begin])
        for i in range(begin, min(begin + _CHUNK, len(vertices))):
            end_x, end_y = place_of(vertices[i + 1 if i + 1 < len(vertices) else 0])
            edge = edges[count]
            edge[0], edge[1], edge[2], edge[3], edge[4] = x, y, end_x, end_y, vertices[i] & 1
            x, y = end_x, end_y
            count += 1
    return count


@kernel
def _write(layer: Uint8s, cells: Int32s, claims: Uint8s) -> None:
    """Write the claims of cells to a flattened layer."""
    for each in range(len(cells)):
        layer[cells[each]] = claims[each]


@kernel
def _change(counts: Layer, claims: Uint8s, cell: int, before: int, after: int) -> None:
    """Update the counts of a cell about which a layer makes other claims than before."""
    changed = before ^ after
    for k in range(5):
        if changed >> k & 1:
            counts[cell, k] += 1 if after >> k & 1 else -1
            claims[cell] = claims[cell] & ~(1 << k) | (counts[cell, k] > 0) << k


@kernel
def _apply(cells: Int32s, before: Uint8s, after: Uint8s, near: bool, counts: Layer, claims: Uint8s) -> None:
    """Update the counts of all changed cells of a layer."""
    for each in range(len(cells)):
        was, now = before[each], after[each]
        if near:
            was |= (was & _WALL > 0) * NEAR_WALL
            now |= (now & _WALL > 0) * NEAR_WALL
        _change(counts, claims, cells[each], was, now)


@kernel
def _note_change(
    before: Layer,
    layer: Layer,
    box: Int32s,
    cells: Int32s,
    was: Uint8s,
    now: Uint8s,
    count: int,
    changed: Int32s,
) -> int:
    """Append the cells of a box whose claims have changed, and write their bounding box; return the new number."""
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
            cells[count], was[count], now[count] = (y0 + y) * layer.shape[1] + x0 + x, old, new
            count += 1
    changed[0], changed[1], changed[2], changed[3] = x0 + left, y0 + top, x0 + right + 1, y0 + bottom + 1
    return count


@kernel
def _set_near(layer: Layer, near: bool, counts: Layer, claims: Uint8s, box: Int32s) -> bool:
    """Add or remove the claim `NEAR_WALL` of all walls of a layer, and write their box; return whether it has walls."""
    height, width = layer.shape
    top, bottom, left, right = height, -1, width, -1
    for y in range(height):
        for x in range(width):
            if layer[y, x] & _WALL:
                top, bottom = min(top, y), y
                left, right = min(left, x), max(right, x)
                _change(counts, claims, y * width + x, 0 if near else NEAR_WALL, NEAR_WALL if near else 0)
    box[0], box[1], box[2], box[3] = left, top, right + 1, bottom + 1
    return bottom >= 0


@kernel
def _render(
    out: Layer, table: Table, pool: Symbols, free_inside_edges: bool, unknown_pairs: bool, boxes: Boxes
) -> tuple[Int32s, Uint8s, Uint8s, Boxes]:
    """Render objects within boxes; return the columns of the `ClaimDifference`."""
    longest, all_chunks = 0, 0
    for row in table:
        if row[FIRST] >= 0:
            longest = max(longest, row[LENGTH])
            all_chunks += row[LENGTH] // _CHUNK + 1
    edges = np.empty((longest, 5), np.int32)
    chunks = np.empty((all_chunks, 4), np.int32)
    measured = 0
    chunk_of = np.full(len(table), -1, np.int32)  # index of an object's first chunk; -1: not measured
    touched = np.empty(len(table), np.int32)
    other = INSIDE_FREE if free_inside_edges else 0
    box, part = np.empty(4, np.int32), np.empty(4, np.int32)
    capacity = 0
    for number in range(len(boxes)):
        clip(boxes[number], 0, out.shape, box)
        capacity += (box[2] - box[0]) * (box[3] - box[1])
    cells, was, now = np.empty(capacity, np.int32), np.empty(capacity, np.uint8), np.empty(capacity, np.uint8)
    changed = np.empty((len(boxes), 4), np.int32)
    found, count = 0, 0
    for number in range(len(boxes)):
        clip(boxes[number], 0, out.shape, box)
        before = out[box[1] : box[3], box[0] : box[2]].copy()
        out[box[1] : box[3], box[0] : box[2]] = 0
        hits = 0
        for k in range(len(table)):
            first, length = table[k, FIRST], table[k, LENGTH]
            if first < 0 or not _overlap(table[k], box, part):
                continue
            has_wall = (pool[first] | pool[first + 1]) & 1
            if not (unknown_pairs or table[k, INSIDE] or length > 2 or has_wall):
                continue
            if chunk_of[k] < 0:
                _measure(pool[first : first + length], chunks[measured:])
                chunk_of[k] = measured
                measured += length // _CHUNK + 1
            touched[hits] = k
            hits += 1
        for outside in range(2):
            for k in touched[:hits]:
                if (table[k, INSIDE] == 0) != outside:
                    continue
                _overlap(table[k], box, part)
                vertices = pool[table[k, FIRST] : table[k, FIRST] + table[k, LENGTH]]
                near = edges[: _edges_near(vertices, chunks[chunk_of[k] :], part, edges)]
                if outside:
                    fill(out, near, 0, FREE_AREA, part)
                    draw(out, near, OUTSIDE_OCCUPIED, 0, FREE_AREA, part)
                else:
                    fill(out, near, FREE_AREA, 0, part)
                    draw(out, near, INSIDE_OCCUPIED, other, 0, part)
        more = _note_change(before, out, box, cells, was, now, found, changed[count])
        if more > found:
            found, count = more, count + 1
    return cells[:found].copy(), was[:found].copy(), now[:found].copy(), changed[:count].copy()
