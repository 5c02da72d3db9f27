"""Reading a piece of an edit stream in one go: packets in, the objects and where they have changed out.

An approximation lies in flat arrays here, its objects by ascending number. What a vertex packet changes lies in
the box of the vertex and its neighbours; so a receiver knows what to draw anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.outline.boxes import MOST, NO_BOXES, Boxes, add_box
from protocol.kernels import kernel
from protocol.packets import MAX_OBJECTS, MAX_VERTICES

REFUSED = -1

SMALL = 3
"""Whether an object of so few vertices is drawn at all may hang on each of them: it changes as a whole."""


class Objects(NamedTuple):
    """Numbered objects, and since a draft may end anywhere, what has been told of one that is still open.

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


NOTHING = Objects(
    np.empty(0, np.int32), np.zeros(1, np.int32), np.empty(0, np.bool_), np.empty(0, np.int32)
)


class Reading(NamedTuple):
    """How far a stream has been read.

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
    count, inside : int
        How many vertices it is to have, and whether it is the inside object.
    edited : int
        Whether anything has come since the last save point.
    """

    objects: Objects = NOTHING
    vertices: NDArray[np.int32] = np.empty(0, np.int32)
    boxes: Boxes = NO_BOXES
    open: int = -1
    count: int = 0
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
    numbers = np.array([before.open, before.count, before.inside, before.edited, 0, 0], np.int64)
    data = np.frombuffer(piece, np.uint8)
    number, start, inside, symbols, vertices, boxes, *at_save, saved_boxes = _read(
        data, *shape, numbers, *before.objects, before.vertices, before.boxes
    )
    opened, count, is_inside, edited, used, saves = numbers.tolist()
    if used == REFUSED:
        return None
    after = Reading(Objects(number, start, inside, symbols), vertices, boxes, opened, count, is_inside, edited)
    return used, after, Saved(Objects(*at_save), saved_boxes) if saves else None


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
    x0 = y0 = np.int64(1 << 20)
    x1 = y1 = np.int64(-1)
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
    nothing = number, start, inside, symbols, vertices, unsaved, number, start, inside, symbols, unsaved
    refused = numbers[4:5]
    refused[0] = REFUSED

    # Whole packets, and where the last save point ends.
    whole, last_save = 0, -1
    while whole < len(data):
        size = _size(data, whole)
        if size == 0 or whole + size > len(data):
            break
        whole += size
        if size == 1:
            last_save = whole

    first = np.full(MAX_OBJECTS, -1, np.int32)
    length = np.empty(MAX_OBJECTS, np.int32)
    is_inside = np.empty(MAX_OBJECTS, np.bool_)
    insides, limit = 0, 0
    for k in range(len(number)):
        n = number[k]
        first[n], length[n], is_inside[n] = start[k], start[k + 1] - start[k], inside[k]
        insides += inside[k]
        limit = n + 1
    pool = np.empty(2 * len(symbols) + 1024, np.int32)
    used = len(symbols)
    pool[:used] = symbols
    current = np.empty(MAX_VERTICES, np.int32)
    told = len(vertices)
    current[:told] = vertices
    boxes = np.empty((MOST, 4), np.int32)
    box_count = len(unsaved)
    boxes[:box_count] = unsaved
    around = np.empty(4, np.int32)
    opened, count, opened_inside, edited = numbers[0], numbers[1], numbers[2], numbers[3]

    s_number, s_start, s_inside, s_symbols, s_boxes = number, start, inside, symbols, unsaved
    at = 0
    while at < whole:
        head = data[at]
        if head >> 5 in (2, 3, 4):
            if opened < 0:
                return nothing
            if head >> 5 == 4:
                word = np.int64(data[at]) << 8 | data[at + 1]
                index = word >> 1 & 0xFFF
                if word & 1 or index >= told:
                    return nothing
                around[0] = around[3] = current[index]
                around[1] = current[(index + told - 1) % told]
                around[2] = current[(index + 1) % told]
                told -= 1
                for i in range(index, told):
                    current[i] = current[i + 1]
                at += 2
            else:
                word = np.int64(0)
                for i in range(6):
                    word = word << 8 | data[at + i]
                index, x, y = word >> 33 & 0xFFF, word >> 21 & 0xFFF, word >> 9 & 0xFFF
                inserted = head >> 5 == 2
                if word & 0x3F or x > width + 1 or y > height + 1:
                    return nothing
                if index > told or (index == told and not inserted) or (inserted and told == MAX_VERTICES):
                    return nothing
                around[:] = np.int32(y << 15 | x << 3 | (word >> 6 & 7))
                if told:
                    around[1] = current[(index + told - 1) % told]
                    around[2] = current[(index if inserted else index + 1) % told]
                if inserted:
                    for i in range(told, index, -1):
                        current[i] = current[i - 1]
                    told += 1
                else:
                    around[3] = current[index]
                current[index] = around[0]
                at += 6
            if first[opened] >= 0:
                box_count = _add_box_of(boxes, box_count, around)
            edited = 1
            continue

        # All other packets close the open object.
        if opened >= 0:
            if told != count:
                return nothing
            known = first[opened] >= 0
            if not known or min(told, length[opened]) <= SMALL or is_inside[opened] != (opened_inside != 0):
                box_count = _add_box_of(boxes, box_count, current[:told])
                if known:
                    old = pool[first[opened] : first[opened] + length[opened]]
                    box_count = _add_box_of(boxes, box_count, old)
            if known:
                insides -= is_inside[opened]
            insides += opened_inside
            if used + told > len(pool):
                larger = np.empty(2 * (used + told), np.int32)
                larger[:used] = pool[:used]
                pool = larger
            first[opened], length[opened], is_inside[opened] = used, told, opened_inside != 0
            limit = max(limit, opened + 1)
            for i in range(told):
                pool[used + i] = current[i]
            used += told
            opened, told = np.int64(-1), 0
        if head >> 4 == 0xA:
            n = (np.int64(data[at]) << 8 | data[at + 1]) & 0xFFF
            if first[n] < 0:
                return nothing
            box_count = _add_box_of(boxes, box_count, pool[first[n] : first[n] + length[n]])
            insides -= is_inside[n]
            first[n] = -1
            edited = 1
            at += 2
        elif head == 0xF0:
            if not edited or insides != 1:
                return nothing
            edited = 0
            at += 1
            if at == last_save:
                s_number, s_start, s_inside, s_symbols = _packed(first, length, is_inside, pool, limit)
                s_boxes = boxes[:box_count].copy()
                box_count = 0
        else:
            word = np.int64(0)
            for i in range(5):
                word = word << 8 | data[at + i]
            opened, count, opened_inside = word >> 24 & 0xFFF, word >> 11 & 0x1FFF, word >> 10 & 1
            known = first[opened] >= 0
            if word & 0x3FF or known != (head >> 4 == 0xE) or count < 2 or count > MAX_VERTICES:
                return nothing
            told = length[opened] if known else 0
            for i in range(told):
                current[i] = pool[first[opened] + i]
            edited = 1
            at += 5

    numbers[0], numbers[1], numbers[2], numbers[3] = opened, count, opened_inside, edited
    numbers[4], numbers[5] = whole, last_save >= 0
    if last_save == whole:
        d_number, d_start, d_inside, d_symbols = s_number, s_start, s_inside, s_symbols
    else:
        d_number, d_start, d_inside, d_symbols = _packed(first, length, is_inside, pool, limit)
    return (
        d_number, d_start, d_inside, d_symbols, current[:told].copy(), boxes[:box_count].copy(),
        s_number, s_start, s_inside, s_symbols, s_boxes,
    )  # fmt: skip
