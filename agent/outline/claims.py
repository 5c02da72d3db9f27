"""The claims that an approximation makes of cells: its drawing, a byte of bits a cell.

Free area is what its inside object encloses and none of its outside objects encloses or bounds. What claim
counts where several meet, `agent.outline.merge` says.
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
    Symbols,
    Table,
)
from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons
from agent.outline.raster import Edges, draw, fill
from protocol.boxes import NO_BOXES, Boxes, clip, whole_grid
from protocol.kernels import kernel

NEAR_WALL, FREE_AREA, OUTSIDE_OCCUPIED, INSIDE_FREE, INSIDE_OCCUPIED = 1, 2, 4, 8, 16
"""The claims of a cell; the stronger has the higher bit. A layer itself does not claim that a wall is near: whose it is
says that."""

_WALL = OUTSIDE_OCCUPIED | INSIDE_OCCUPIED

Layer = NDArray[np.uint8]


class Tally:
    """What several layers claim together: by what one of them claims otherwise it changes, however many they are.

    These are 255 at most. Each claim is counted by itself: the one that changes most costs no look at the others.

    Attributes
    ----------
    claims : uint8 array, shape (h, w)
        Which claims any of them makes, as bits.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.claims: Layer = np.zeros(shape, np.uint8)
        self._cells = self.claims.reshape(-1)
        self._counts = np.zeros((5, self.claims.size), np.uint8)

    def count(self, news: Difference, near: bool) -> None:
        """Count what a layer, which is near or not, claims now instead of what it did."""
        _count(news.cells, news.before, news.after, near, self._counts, self._cells)

    def turn(self, layer: Layer, near: bool) -> Boxes:
        """Count a layer that was not near as one that is, or the other way round; return boxes around its claims."""
        box = np.empty((1, 4), np.int32)
        return box if _turn(layer, near, self._counts, self._cells, box[0]) else NO_BOXES


NO_TALLY = Tally((0, 0))


class Difference(NamedTuple):
    """What claims of a layer are others than before.

    `cells`: int32 array, shape (n,), where, counted row by row. `before`, `after`: uint8 arrays, shape (n,), the claims
    there. `boxes`: boxes around these cells.
    """

    cells: NDArray[np.int32]
    before: NDArray[np.uint8]
    after: NDArray[np.uint8]
    boxes: Boxes


THIN, WIDE_UNSEEN, WIDE = range(3)
"""Walls of teammates that are taken to be wider than they are drawn: none, those one has not seen, all."""


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
        not both by the robot's own predictive.
    wide_seen_walls : bool
        Let walls be wide that the robot has seen itself as well.
    """

    free_inside_edges: bool = True
    unknown_pairs: bool = True
    wide_walls: bool = False
    close_slivers: bool = False
    wide_seen_walls: bool = True

    @property
    def wide(self) -> int:
        """Which walls are wide: `THIN` for none, `WIDE_UNSEEN`, or `WIDE`."""
        if not self.wide_walls:
            return THIN
        return WIDE if self.wide_seen_walls else WIDE_UNSEEN


THESIS = Drawing()
"""All is drawn, as Algorithm 9 says."""


def layer(polygons: Polygons, drawing: Drawing = THESIS) -> Layer:
    """Render an approximation into the claims that it makes, a byte of bits a cell."""
    out = np.zeros(polygons.shape, np.uint8)
    draw_anew(out, Objects.of(polygons), drawing, whole_grid(polygons.shape))
    return out


def draw_anew(out: Layer, objects: Objects, drawing: Drawing, boxes: Boxes) -> Difference:
    """Render the claims of an approximation in some boxes, in place of what was claimed there."""
    wished = drawing.free_inside_edges, drawing.unknown_pairs
    return Difference(*_render(out, objects.table, objects.pool, *wished, boxes))


class Drawn:
    """The layer of an approximation that changes little by little.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    drawing : Drawing
        What is drawn.
    cache : MemoCache
        Cache of intermediate results, shared by the robots of this process.
    """

    def __init__(self, shape: tuple[int, int], drawing: Drawing, cache: MemoCache = NO_CACHE) -> None:
        self.layer: Layer = np.zeros(shape, np.uint8)
        self._cells = self.layer.reshape(-1)
        self._drawing = drawing
        self._cache = cache
        self._objects: Objects | None = None

    def follow(self, objects: Objects, changed: Boxes | None = None) -> Difference:
        """Draw what has taken the place of what was drawn last; it differs in the boxes at most (None: anywhere)."""
        drawing = self._drawing
        boxes = whole_grid(objects.shape) if changed is None or self._objects is None else changed
        change = self._objects, objects, drawing.free_inside_edges, drawing.unknown_pairs
        news = self._cache.get(change, lambda: draw_anew(self.layer, objects, drawing, boxes))
        self._cells[news.cells] = news.after
        self._objects = objects
        return news


_CHUNK = 16
"""So many edges are looked at together: those of a chunk whose bounds a box does not touch are left out."""


@kernel("UniTuple(int64, 2)(int32)")
def _place(symbol: int) -> tuple[int, int]:
    """Where a vertex stands, in quarters of a cell."""
    side = symbol >> 1 & 3
    return ((symbol >> 3 & 0xFFF) - 1) * 4 + SIDE_X[side], ((symbol >> 15) - 1) * 4 + SIDE_Y[side]


@kernel("void(int32[::1], int32[:,::1])")
def _measure(vertices: Symbols, chunks: Boxes) -> None:
    """Write the boxes in which the edges of each chunk of an object lie, with a cell to spare."""
    for begin in range(0, len(vertices), _CHUNK):
        end = begin + _CHUNK
        after = vertices[end if end < len(vertices) else 0]  # where the last edge ends
        x0 = x1 = after >> 3 & 0xFFF
        y0 = y1 = after >> 15
        for symbol in vertices[begin:end]:
            x, y = symbol >> 3 & 0xFFF, symbol >> 15
            x0, x1 = min(x0, x), max(x1, x)
            y0, y1 = min(y0, y), max(y1, y)
        box = chunks[begin // _CHUNK]
        box[0], box[1], box[2], box[3] = x0 - 2, y0 - 2, x1 + 1, y1 + 1


@kernel("boolean(int32[::1], int32[::1], int32[::1])")
def _overlap(row: NDArray[np.int32], box: NDArray[np.int32], part: NDArray[np.int32]) -> bool:
    """Write what a box and that of an object of a table have in common; whether that is anything."""
    part[0], part[1] = max(row[LEFT], box[0]), max(row[TOP], box[1])
    part[2], part[3] = min(row[RIGHT], box[2]), min(row[BOTTOM], box[3])
    return bool(part[0] < part[2] and part[1] < part[3])


@kernel("int64(int32[::1], int32[:,::1], int32[::1], int32[:,::1])")
def _edges_near(vertices: Symbols, chunks: Boxes, box: NDArray[np.int32], edges: Edges) -> int:
    """Collect the edges that may cross a column of a box, in it or above it; how many these are."""
    count = 0
    for begin in range(0, len(vertices), _CHUNK):
        chunk = begin // _CHUNK
        if chunks[chunk, 0] >= box[2] or chunks[chunk, 2] <= box[0] or chunks[chunk, 1] >= box[3]:
            continue
        x, y = _place(vertices[begin])
        for i in range(begin, min(begin + _CHUNK, len(vertices))):
            end_x, end_y = _place(vertices[i + 1 if i + 1 < len(vertices) else 0])
            edge = edges[count]
            edge[0], edge[1], edge[2], edge[3], edge[4] = x, y, end_x, end_y, vertices[i] & 1
            x, y = end_x, end_y
            count += 1
    return count


@kernel("void(uint8[:,::1], uint8[::1], int64, int64, int64)")
def _change(counts: Layer, claims: NDArray[np.uint8], cell: int, before: int, after: int) -> None:
    """Count of a cell that a layer claims something else of it than before."""
    changed = before ^ after
    for k in range(5):
        if changed >> k & 1:
            counts[k, cell] += 1 if after >> k & 1 else -1
            claims[cell] = claims[cell] & ~(1 << k) | (counts[k, cell] > 0) << k


@kernel("void(int32[::1], uint8[::1], uint8[::1], boolean, uint8[:,::1], uint8[::1])")
def _count(
    cells: NDArray[np.int32],
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    near: bool,
    counts: Layer,
    claims: NDArray[np.uint8],
) -> None:
    for each in range(len(cells)):
        was, now = before[each], after[each]
        if near:
            was |= (was & _WALL > 0) * NEAR_WALL
            now |= (now & _WALL > 0) * NEAR_WALL
        _change(counts, claims, cells[each], was, now)


@kernel(
    "int64(uint8[:,::1], uint8[:,::1], int32[::1], int32[::1], uint8[::1], uint8[::1], int64, int32[::1])"
)
def _note_change(
    before: Layer,
    layer: Layer,
    box: NDArray[np.int32],
    cells: NDArray[np.int32],
    was: NDArray[np.uint8],
    now: NDArray[np.uint8],
    count: int,
    changed: NDArray[np.int32],
) -> int:
    """Note which cells have changed in a box, behind the first `count`, and a box around them; how many there are."""
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


@kernel("boolean(uint8[:,::1], boolean, uint8[:,::1], uint8[::1], int32[::1])")
def _turn(layer: Layer, near: bool, counts: Layer, claims: NDArray[np.uint8], box: NDArray[np.int32]) -> bool:
    """Count the walls of a layer as near, or no longer, and write the box around them; whether there are any."""
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


@kernel(
    "Tuple((int32[::1], uint8[::1], uint8[::1], int32[:,::1]))"
    "(uint8[:,::1], int32[:,::1], int32[::1], boolean, boolean, int32[:,::1])"
)
def _render(
    out: Layer,
    table: Table,
    pool: Symbols,
    free_inside_edges: bool,
    unknown_pairs: bool,
    boxes: Boxes,
) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.uint8], Boxes]:
    longest, all_chunks = 0, 0
    for row in table:
        if row[FIRST] >= 0:
            longest = max(longest, row[LENGTH])
            all_chunks += row[LENGTH] // _CHUNK + 1
    edges = np.empty((longest, 5), np.int32)
    chunks = np.empty((all_chunks, 4), np.int32)
    measured = 0
    chunk_of = np.full(len(table), -1, np.int32)  # where the chunks of an object begin, once measured
    touched = np.empty(len(table), np.int32)
    other = INSIDE_FREE if free_inside_edges else 0
    box, part = np.empty(4, np.int32), np.empty(4, np.int32)
    room = 0
    for number in range(len(boxes)):
        clip(boxes[number], 0, out.shape, box)
        room += (box[2] - box[0]) * (box[3] - box[1])
    cells, was, now = np.empty(room, np.int32), np.empty(room, np.uint8), np.empty(room, np.uint8)
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
