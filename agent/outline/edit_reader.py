"""Reading a piece of an edit stream in one go: packets in, the objects and where they have changed out.

An approximation lies in flat arrays here, its objects by ascending number. What a vertex packet changes lies in
the box of the vertex and its neighbours; so a receiver knows what to draw anew.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.outline.boxes import MOST, NO_BOXES, Boxes, add_box
from protocol.kernels import kernel
from protocol.packets import MAX_OBJECTS, MAX_VERTICES

REFUSED = -1

SMALL = 3
"""Whether an object of so few vertices is drawn at all may hang on each of them: it changes as a whole."""


class Objects(NamedTuple):
    """Numbered objects in flat arrays.

    Attributes
    ----------
    number : int32 array, shape (n,), ascending
    start : int32 array, shape (n + 1,)
        Object k has the vertices ``symbols[start[k]:start[k + 1]]``.
    inside : bool array, shape (n,)
    symbols : int32 array
        See `agent.outline.edits.symbols`.
    """

    number: NDArray[np.int32]
    start: NDArray[np.int32]
    inside: NDArray[np.bool_]
    symbols: NDArray[np.int32]


NOTHING = Objects(np.empty(0, np.int32), np.zeros(1, np.int32), np.empty(0, np.bool_), np.empty(0, np.int32))


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
    open : int
        Number of the open object, -1 if there is none.
    announced, inside : int
        How many vertices it is to have, and whether it is the inside object.
    edited : int
        Whether anything has come since the last save point.
    """

    objects: Objects = NOTHING
    vertices: NDArray[np.int32] = np.empty(0, np.int32)
    boxes: Boxes = NO_BOXES
    open: int = -1
    announced: int = 0
    inside: int = 0
    edited: int = 0


class Saved(NamedTuple):
    """What stood at the last save point of a piece, and where that differs from the save point before the piece."""

    objects: Objects
    boxes: Boxes


def read(shape: tuple[int, int], before: Reading, piece: bytes) -> tuple[int, Reading, Saved | None] | None:
    """Read the whole packets at the beginning of a piece of a stream, up to one that is none of a map's.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the grid; no vertex may lie beyond the rim of one cell around it.
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
    numbers = np.array([before.open, before.announced, before.inside, before.edited, 0, 0], np.int64)
    data = np.frombuffer(piece, np.uint8)
    arrays: tuple[Any, ...] = *before.objects, before.vertices, before.boxes
    number, start, inside, symbols, vertices, boxes, *at_save = _read(data, *shape, numbers, *arrays)
    saved: Any = at_save
    opened, count, is_inside, edited, used, saves = numbers.tolist()
    if used == REFUSED:
        return None
    after = Reading(
        Objects(number, start, inside, symbols), vertices, boxes, opened, count, is_inside, edited
    )
    return used, after, Saved(Objects(*saved[:4]), saved[4]) if saves else None


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


@kernel(
    "Tuple((int32[::1], int32[::1], boolean[::1], int32[::1]))"
    "(int32[::1], int32[::1], boolean[::1], int32[::1], int64)"
)
def _packed(
    first: NDArray[np.int32],
    length: NDArray[np.int32],
    inside: NDArray[np.bool_],
    pool: NDArray[np.int32],
    numbers: int,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_], NDArray[np.int32]]:
    """Put the objects behind each other by their numbers, which are below `numbers`."""
    objects, vertices = 0, 0
    for n in range(numbers):
        if first[n] >= 0:
            objects += 1
            vertices += length[n]
    number, start = np.empty(objects, np.int32), np.zeros(objects + 1, np.int32)
    is_inside, symbols = np.empty(objects, np.bool_), np.empty(vertices, np.int32)
    k, end = 0, 0
    for n in range(numbers):
        if first[n] < 0:
            continue
        number[k], is_inside[k] = n, inside[n]
        for i in range(length[n]):
            symbols[end + i] = pool[first[n] + i]
        end += length[n]
        k += 1
        start[k] = end
    return number, start, is_inside, symbols


_OPEN, _COUNT, _INSIDE, _EDITED, _TOLD, _GAP, _BOXES, _INSIDES, _LIMIT, _USED = range(10)
"""Where the numbers of a reading are: first as in `Reading`; then how many vertices of the open object have been told,
where the gap among them is, how many boxes, inside objects, numbers in use and symbols in the pool there are."""

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


@kernel(
    "boolean(uint8[::1], int64, int64, int64, int64, int64[::1], int32[::1], int32[::1], boolean[::1], int32[::1],"
    " int32[::1], int32[:,::1])"
)
def _apply(
    data: NDArray[np.uint8],
    begin: int,
    end: int,
    height: int,
    width: int,
    n: NDArray[np.int64],
    first: NDArray[np.int32],
    length: NDArray[np.int32],
    inside: NDArray[np.bool_],
    pool: NDArray[np.int32],
    vertices: NDArray[np.int32],
    boxes: Boxes,
) -> bool:
    """Apply the packets from `begin` to `end`; whether all make sense.

    Of each number, `first` says where its vertices are in the pool (-1: there is no such object), `length` how
    many, `inside` whether it is an inside object. `vertices` are those of the open object, with a gap.
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
            if first[n[_OPEN]] >= 0:
                n[_BOXES] = _add_box_of(boxes, n[_BOXES], around)
            n[_EDITED] = 1
            continue

        # All other packets close the open object.
        if n[_OPEN] >= 0:
            number, told = n[_OPEN], n[_TOLD]
            if told != n[_COUNT]:
                return False
            _move_gap(vertices, n, told)
            known = first[number] >= 0
            if not known or min(told, length[number]) <= SMALL or inside[number] != (n[_INSIDE] != 0):
                n[_BOXES] = _add_box_of(boxes, n[_BOXES], vertices[:told])
                if known:
                    old = pool[first[number] : first[number] + length[number]]
                    n[_BOXES] = _add_box_of(boxes, n[_BOXES], old)
            if known:
                n[_INSIDES] -= inside[number]
            n[_INSIDES] += n[_INSIDE]
            first[number], length[number], inside[number] = n[_USED], told, n[_INSIDE] != 0
            for i in range(told):
                pool[n[_USED] + i] = vertices[i]
            n[_USED] += told
            n[_LIMIT] = max(n[_LIMIT], number + 1)
            n[_OPEN], n[_TOLD], n[_GAP] = -1, 0, 0
        if head >> 4 == 0xA:
            number = (np.int64(data[at]) << 8 | data[at + 1]) & 0xFFF
            if first[number] < 0:
                return False
            gone = pool[first[number] : first[number] + length[number]]
            n[_BOXES] = _add_box_of(boxes, n[_BOXES], gone)
            n[_INSIDES] -= inside[number]
            first[number] = -1
            n[_EDITED] = 1
            at += 2
        elif head == 0xF0:
            if not n[_EDITED] or n[_INSIDES] != 1:
                return False
            n[_EDITED] = 0
            at += 1
        else:
            number, count, is_inside = _header(data, at)
            known = first[number] >= 0
            if data[at + 4] or data[at + 3] & 3 or known != (head >> 4 == 0xE):
                return False
            if count < 2 or count > MAX_VERTICES:
                return False
            n[_OPEN], n[_COUNT], n[_INSIDE] = number, count, is_inside
            n[_TOLD] = n[_GAP] = length[number] if known else 0
            for i in range(n[_TOLD]):
                vertices[i] = pool[first[number] + i]
            n[_EDITED] = 1
            at += 5
    return True


@kernel("UniTuple(int64, 3)(uint8[::1])")
def _survey(data: NDArray[np.uint8]) -> tuple[int, int, int]:
    """Bytes of whole packets up to one that does not belong here, where the last save point ends (-1: nowhere), and
    how many vertices the objects have in all that are told."""
    whole, last_save, vertices = 0, -1, 0
    while whole < len(data):
        size = _size(data, whole)
        if size == 0 or whole + size > len(data):
            break
        if size == 5:
            vertices += _header(data, whole)[1]
        whole += size
        if size == 1:
            last_save = whole
    return whole, last_save, vertices


@kernel(
    "Tuple((int32[::1], int32[::1], boolean[::1], int32[::1], int32[::1], int32[:,::1],"
    " int32[::1], int32[::1], boolean[::1], int32[::1], int32[:,::1]))"
    "(Array(uint8, 1, 'C', readonly=True), int64, int64, int64[::1],"
    " int32[::1], int32[::1], boolean[::1], int32[::1], int32[::1], int32[:,::1])"
)
def _read(
    piece: NDArray[np.uint8],
    height: int,
    width: int,
    numbers: NDArray[np.int64],
    number: NDArray[np.int32],
    start: NDArray[np.int32],
    inside: NDArray[np.bool_],
    symbols: NDArray[np.int32],
    vertices: NDArray[np.int32],
    unsaved: Boxes,
) -> tuple[
    NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_], NDArray[np.int32], NDArray[np.int32], Boxes,
    NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_], NDArray[np.int32], Boxes,
]:  # fmt: skip
    """Read on; `numbers` has what `Reading` has, and takes the bytes used and whether there was a save point.

    Nothing else that is given is changed. The first arrays returned are the reading's, the last ones what was
    saved.
    """
    data = piece.copy()
    whole, last_save, announced = _survey(data)
    first = np.full(MAX_OBJECTS, -1, np.int32)
    length = np.empty(MAX_OBJECTS, np.int32)
    is_inside = np.empty(MAX_OBJECTS, np.bool_)
    n = np.zeros(10, np.int64)
    n[:4] = numbers[:4]
    for k in range(len(number)):
        first[number[k]], length[number[k]] = start[k], start[k + 1] - start[k]
        is_inside[number[k]] = inside[k]
        n[_INSIDES] += inside[k]
        n[_LIMIT] = number[k] + 1
    pool = np.empty(len(symbols) + announced + MAX_VERTICES, np.int32)
    pool[: len(symbols)] = symbols
    n[_USED] = len(symbols)
    told = np.empty(_ROOM, np.int32)
    told[: len(vertices)] = vertices
    n[_TOLD] = n[_GAP] = len(vertices)
    boxes = np.empty((MOST, 4), np.int32)
    boxes[: len(unsaved)] = unsaved
    n[_BOXES] = len(unsaved)

    saves = max(last_save, 0)
    makes_sense = _apply(data, 0, saves, height, width, n, first, length, is_inside, pool, told, boxes)
    s_number, s_start, s_inside, s_symbols = _packed(first, length, is_inside, pool, n[_LIMIT])
    s_boxes = boxes[: n[_BOXES]].copy()
    d_number, d_start, d_inside, d_symbols = s_number, s_start, s_inside, s_symbols
    if last_save >= 0:
        n[_BOXES] = 0
    if makes_sense and saves < whole:
        makes_sense = _apply(
            data, saves, whole, height, width, n, first, length, is_inside, pool, told, boxes
        )
        d_number, d_start, d_inside, d_symbols = _packed(first, length, is_inside, pool, n[_LIMIT])
    _move_gap(told, n, n[_TOLD])
    numbers[:4] = n[:4]
    numbers[4], numbers[5] = whole if makes_sense else REFUSED, last_save >= 0
    return (
        d_number, d_start, d_inside, d_symbols, told[: n[_TOLD]].copy(), boxes[: n[_BOXES]].copy(),
        s_number, s_start, s_inside, s_symbols, s_boxes,
    )  # fmt: skip
