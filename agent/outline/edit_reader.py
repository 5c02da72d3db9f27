"""Reading a piece of an edit stream in one go: packets in, the objects and where they have changed out.

What has been read is left as it is, so that a piece that turns out to make no sense changes nothing, and several may
read on from the same place. What a vertex packet changes lies in the box of the vertex and its neighbours; so a
receiver knows what to draw anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    enter,
)
from protocol.boxes import MAX_BOXES, NO_BOXES, Boxes, add_box, bounding_box
from protocol.kernels import kernel
from protocol.packets import MAX_VERTICES

REFUSED = -1

SMALL = 3
"""Whether an object of so few vertices is drawn at all may hang on each of them: it changes as a whole."""


_OPEN, _COUNT, _INSIDE, _EDITED, _TOLD, _GAP, _BOXES, _INSIDES, _USED, _HEARD = range(10)
"""Where the numbers of a reading are: which object is open (-1: none), how many vertices it is to have and whether it
is inside; whether anything has come since the last save point; how many vertices of the open object have been told,
where the gap among them is, how many boxes, inside objects and symbols in the pool there are; and bytes read."""


class Reading(NamedTuple):
    """How far a stream has been read; it may end anywhere, also while an object is being told.

    Attributes
    ----------
    objects : Objects
        As far as they are complete.
    vertices : int32 array
        Those of the open object so far, as symbols.
    boxes : int32 array, shape (n, 4)
        Where something has changed since the last save point.
    numbers : int64 array, shape (10,)
        See above.
    """

    objects: Objects
    vertices: Symbols
    boxes: Boxes
    numbers: NDArray[np.int64]

    @staticmethod
    def nothing(shape: tuple[int, int]) -> Reading:
        """Return the beginning of a stream that speaks of a grid of so many rows and columns."""
        numbers = np.zeros(10, np.int64)
        numbers[_OPEN] = -1
        return Reading(Objects.nothing(shape), np.empty(0, np.int32), NO_BOXES, numbers)

    @property
    def header(self) -> tuple[int, int, bool, bool]:
        """The open object (-1: none), how many vertices it is to have, and whether inside; whether all is saved."""
        number, count, inside, edited = self.numbers[: _EDITED + 1].tolist()
        return number, count, bool(inside), not edited


class Saved(NamedTuple):
    """What stood at the last save point of a piece, and where that differs from the save point before the piece."""

    objects: Objects
    boxes: Boxes
    box: tuple[int, int, int, int] | None
    """The box (x0, y0, x1, y1) around them, if there are any."""
    saves: int
    """How many save points are in the piece."""
    end: int
    """Where in the piece the last of them ends."""


def read(before: Reading, piece: bytes) -> tuple[int, Reading, Saved | None] | None:
    """Read the whole packets at the beginning of a piece of a stream, up to one that is none of a map's.

    Parameters
    ----------
    before : Reading
        What came before; it is left as it is.

    Returns
    -------
    used : int
        Bytes of the packets read; a packet that is not complete, or does not belong here, is behind them.
    after : Reading
    saved : Saved, optional
        If there was a save point.
        None instead of all if the piece makes no sense (`agent.outline.draft` says why).
    """
    objects, vertices, boxes, numbers = before
    shape, data = objects.shape, np.frombuffer(piece, np.uint8)
    table, pool, vertices, boxes, numbers, saves, end, saved_table, saved_boxes = _read(
        data, *shape, numbers, objects.table, objects.pool, vertices, boxes
    )
    used = int(numbers[_HEARD])
    if used == REFUSED:
        return None
    saved = None
    if saves:
        box = bounding_box(saved_boxes.tolist()) if len(saved_boxes) else None
        saved = Saved(Objects(shape, saved_table, pool), saved_boxes, box, saves, end)
    return used, Reading(Objects(shape, table, pool), vertices, boxes, numbers), saved


@kernel("int64(uint8[::1], int64)")
def _size(data: NDArray[np.uint8], at: int) -> int:
    """Bytes of the packet that begins at `at`; 0 if it has no business in a map's stream."""
    first = data[at]
    if first >> 5 in (2, 3):
        return 6
    if first >> 5 == 4 or first >> 4 == 0xA:
        return 2
    if first >> 4 in (0xD, 0xE):
        return 5
    return 1 if first == 0xF0 else 0


@kernel("int64(int32[:,::1], int64, int32[::1])")
def _add_box_of(boxes: Boxes, count: int, symbols: NDArray[np.int32]) -> int:
    """Add the box of some vertices, and a cell around them."""
    x0 = y0 = 1 << 20
    x1 = y1 = -1
    for symbol in symbols:
        x, y = (symbol >> 3 & 0xFFF) - 1, (symbol >> 15) - 1
        x0, x1 = min(x0, x), max(x1, x)
        y0, y1 = min(y0, y), max(y1, y)
    return add_box(boxes, count, x0 - 1, y0 - 1, x1 + 2, y1 + 2)


_ROOM = MAX_VERTICES + 1


@kernel("int64(int64[::1], int64)")
def _place(n: NDArray[np.int64], index: int) -> int:
    """Where the vertex of an index is kept: those behind the gap are at the end."""
    return index if index < n[_GAP] else _ROOM - n[_TOLD] + index


@kernel("void(int32[::1], int64[::1], int64)")
def _move_gap(vertices: NDArray[np.int32], n: NDArray[np.int64], to: int) -> None:
    """Move the gap before the vertex of an index: edits that are near each other move little."""
    behind = _ROOM - n[_TOLD]
    for i in range(n[_GAP] - 1, to - 1, -1):
        vertices[behind + i] = vertices[i]
    for i in range(n[_GAP], to):
        vertices[i] = vertices[behind + i]
    n[_GAP] = to


@kernel("UniTuple(int64, 3)(uint8[::1], int64)")
def _header(data: NDArray[np.uint8], at: int) -> tuple[int, int, int]:
    """Number, count of vertices and inside flag of an `Emerge` or `Change`."""
    word = 0
    for i in range(5):
        word = word << 8 | int(data[at + i])
    return word >> 24 & 0xFFF, word >> 11 & 0x1FFF, word >> 10 & 1


@kernel("int64(int32[:,::1], int64, int32[:,::1], int64)")
def _add_box_around(boxes: Boxes, count: int, table: Table, number: int) -> int:
    """Add the box of an object."""
    row = table[number]
    return add_box(boxes, count, row[LEFT], row[TOP], row[RIGHT], row[BOTTOM])


@kernel(
    "boolean(uint8[::1], int64, int64, int64, int64, int64[::1], int32[:,::1], int32[::1], int32[::1], int32[:,::1])"
)
def _apply(
    data: NDArray[np.uint8],
    begin: int,
    end: int,
    height: int,
    width: int,
    n: NDArray[np.int64],
    table: Table,
    pool: Symbols,
    vertices: Symbols,
    boxes: Boxes,
) -> bool:
    """Apply the packets from `begin` to `end`; whether all make sense.

    `vertices` are those of the open object, with a gap.
    """
    around = np.empty(4, np.int32)
    at = begin
    while at < end:
        head = data[at]
        if head >> 5 in (2, 3, 4):
            told = n[_TOLD]
            if n[_OPEN] < 0:
                return False
            if head >> 5 == 4:
                word = np.int64(data[at]) << 8 | data[at + 1]
                index = word >> 1 & 0xFFF
                if word & 1 or index >= told:
                    return False
                around[0] = around[3] = vertices[_place(n, index)]
                around[1] = vertices[_place(n, (index + told - 1) % told)]
                around[2] = vertices[_place(n, (index + 1) % told)]
                _move_gap(vertices, n, index)
                n[_TOLD] -= 1
                at += 2
            else:
                word = np.int64(0)
                for i in range(6):
                    word = word << 8 | data[at + i]
                index, x, y = word >> 33 & 0xFFF, word >> 21 & 0xFFF, word >> 9 & 0xFFF
                is_new = head >> 5 == 2
                if word & 0x3F or x > width + 1 or y > height + 1:
                    return False
                if index > told or (index == told and not is_new) or (is_new and told == MAX_VERTICES):
                    return False
                around[:] = np.int32(y << 15 | x << 3 | (word >> 6 & 7))
                if told:
                    around[1] = vertices[_place(n, (index + told - 1) % told)]
                    around[2] = vertices[_place(n, (index if is_new else index + 1) % told)]
                if is_new:
                    _move_gap(vertices, n, index)
                    n[_GAP] += 1
                    n[_TOLD] += 1
                else:
                    around[3] = vertices[_place(n, index)]
                vertices[_place(n, index)] = around[0]
                at += 6
            if table[n[_OPEN], FIRST] >= 0:
                n[_BOXES] = _add_box_of(boxes, n[_BOXES], around)
            n[_EDITED] = 1
            continue

        # All other packets close the open object.
        if n[_OPEN] >= 0:
            number, told = n[_OPEN], n[_TOLD]
            if told != n[_COUNT]:
                return False
            _move_gap(vertices, n, told)
            known, was_inside = table[number, FIRST] >= 0, table[number, INSIDE]
            as_a_whole = not known or min(told, table[number, LENGTH]) <= SMALL or was_inside != n[_INSIDE]
            if known:
                n[_INSIDES] -= was_inside
                if as_a_whole:
                    n[_BOXES] = _add_box_around(boxes, n[_BOXES], table, number)
            pool[n[_USED] : n[_USED] + told] = vertices[:told]
            enter(table, number, pool, n[_USED], told, n[_INSIDE] != 0)
            n[_INSIDES] += n[_INSIDE]
            n[_USED] += told
            if as_a_whole:
                n[_BOXES] = _add_box_around(boxes, n[_BOXES], table, number)
            n[_OPEN], n[_TOLD], n[_GAP] = -1, 0, 0
        if head >> 4 == 0xA:
            number = (np.int64(data[at]) << 8 | data[at + 1]) & 0xFFF
            if number >= len(table) or table[number, FIRST] < 0:
                return False
            n[_BOXES] = _add_box_around(boxes, n[_BOXES], table, number)
            n[_INSIDES] -= table[number, INSIDE]
            table[number, FIRST] = -1
            n[_EDITED] = 1
            at += 2
        elif head == 0xF0:
            if not n[_EDITED] or n[_INSIDES] != 1:
                return False
            n[_EDITED] = 0
            at += 1
        else:
            number, count, is_inside = _header(data, at)
            known = table[number, FIRST] >= 0
            if data[at + 4] or data[at + 3] & 3 or known != (head >> 4 == 0xE):
                return False
            if count < 2 or count > MAX_VERTICES:
                return False
            n[_OPEN], n[_COUNT], n[_INSIDE] = number, count, is_inside
            n[_TOLD] = n[_GAP] = table[number, LENGTH] if known else 0
            for i in range(n[_TOLD]):
                vertices[i] = pool[table[number, FIRST] + i]
            n[_EDITED] = 1
            at += 5
    return True


@kernel("UniTuple(int64, 5)(uint8[::1])")
def _survey(data: NDArray[np.uint8]) -> tuple[int, int, int, int, int]:
    """Bytes of whole packets up to one that does not belong here, how many save points there are and where the last one
    ends (-1: nowhere), how many vertices the objects have in all that are told, and the highest of their numbers (-1:
    there are none)."""
    whole, saves, last_save, vertices, highest = 0, 0, -1, 0, -1
    while whole < len(data):
        size = _size(data, whole)
        if size == 0 or whole + size > len(data):
            break
        if size == 5:
            number, count, _ = _header(data, whole)
            vertices += count
            highest = max(highest, number)
        whole += size
        if size == 1:
            saves += 1
            last_save = whole
    return whole, saves, last_save, vertices, highest


@kernel("Tuple((int32[::1], int64))(int32[:,::1], int32[::1], int64)")
def _with_room(table: Table, pool: Symbols, more: int) -> tuple[Symbols, int]:
    """A pool of the objects of a table alone, which has room for more; and how much of it is used."""
    used = 0
    for row in table:
        if row[FIRST] >= 0:
            used += row[LENGTH]
    fresh = np.empty(2 * (used + more) + 1, np.int32)
    used = 0
    for row in table:
        if row[FIRST] >= 0:
            fresh[used : used + row[LENGTH]] = pool[row[FIRST] : row[FIRST] + row[LENGTH]]
            row[FIRST] = used
            used += row[LENGTH]
    return fresh, used


@kernel(
    "Tuple((int32[:,::1], int32[::1], int32[::1], int32[:,::1], int64[::1], int64, int64, int32[:,::1], int32[:,::1]))"
    "(Array(uint8, 1, 'C', readonly=True), int64, int64, int64[::1], int32[:,::1], int32[::1], int32[::1],"
    " int32[:,::1])"
)
def _read(
    piece: NDArray[np.uint8],
    height: int,
    width: int,
    numbers: NDArray[np.int64],
    old_table: Table,
    pool: Symbols,
    vertices: Symbols,
    unsaved: Boxes,
) -> tuple[Table, Symbols, Symbols, Boxes, NDArray[np.int64], int, int, Table, Boxes]:
    """Read on: the parts of the reading, how many save points there were, where the last one ends, and what was saved.

    Nothing that is given is changed but what the pool has beyond the symbols in use, and its last number: how many
    symbols whoever has read on farthest has written to it.
    """
    data = piece.copy()
    whole, saves, last_save, announced, highest = _survey(data)
    n = numbers.copy()
    table = np.full((max(len(old_table), highest + 1), old_table.shape[1]), -1, np.int32)
    table[: len(old_table)] = old_table
    announced += n[_COUNT]
    # Who else has read on from here has written to the pool.
    if n[_USED] + announced >= len(pool) or pool[-1] != n[_USED]:
        pool, n[_USED] = _with_room(table, pool, announced)
    told = np.empty(_ROOM, np.int32)
    told[: len(vertices)] = vertices
    n[_GAP] = n[_TOLD]
    boxes = np.empty((MAX_BOXES, 4), np.int32)
    boxes[: len(unsaved)] = unsaved

    saved = max(last_save, 0)
    makes_sense = _apply(data, 0, saved, height, width, n, table, pool, told, boxes)
    saved_table, saved_boxes = table, boxes[: n[_BOXES]].copy()
    if last_save >= 0:
        n[_BOXES] = 0
    if makes_sense and saved < whole:
        saved_table = table.copy()
        makes_sense = _apply(data, saved, whole, height, width, n, table, pool, told, boxes)
    _move_gap(told, n, n[_TOLD])
    if makes_sense:
        pool[-1] = n[_USED]
    n[_HEARD] = whole if makes_sense else REFUSED
    return (
        table,
        pool,
        told[: n[_TOLD]].copy(),
        boxes[: n[_BOXES]].copy(),
        n,
        saves,
        last_save,
        saved_table,
        saved_boxes,
    )
