"""Reader of edit streams: applies a chunk of packets to the objects, and finds the boxes in which they changed.

The state before the chunk is not modified. So a malformed chunk changes nothing, and several receivers can continue
from the same state. A vertex packet changes the drawing only within the box of the vertex and its neighbors.
"""

from __future__ import annotations

from typing import NamedTuple, get_args

import numpy as np

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
    enter,
)
from agent.outline.polygons import Symbols
from protocol.arrays import Int32s, Int64s, ReadOnlyUint8s, Uint8s
from protocol.boxes import MAX_BOXES, NO_BOXES, Boxes, add_box, bounding_box
from protocol.errors import ProtocolError
from protocol.kernels import kernel
from protocol.packet_codec import LAYOUT_BY_BYTE, packet_at
from protocol.packets import (
    ALL_KINDS,
    LAYOUT_OF,
    MAX_VERTICES,
    Change,
    Delete,
    Edit,
    Emerge,
    Insert,
    Remove,
    Replace,
    Save,
)

_EDITS = [ALL_KINDS.index(kind.name) for kind in get_args(Edit)]
_SIZE = np.array([size if kind in _EDITS else 0 for kind, size, *_ in LAYOUT_BY_BYTE], np.int64)
"""For each first byte the bytes of the edit packet; 0: it starts no edit packet."""

_INSERT, _REPLACE, _CHANGE, _SAVE = (int(kind.code, 2) for kind in (Insert, Replace, Change, Save))
"""First bytes of packets."""
_DELETE, _REMOVE = int(Delete.code, 2), int(Remove.code, 2)
"""The four bits with which packets start."""
_INDEX_AT, _X_AT, _Y_AT, _SIDE_AT, _OCCUPIED_AT = LAYOUT_OF[Insert].shifts
_OBJECT_AT, _COUNT_AT, _INSIDE_AT = LAYOUT_OF[Emerge].shifts
(_DELETED_AT,) = LAYOUT_OF[Delete].shifts
(_REMOVED_AT,) = LAYOUT_OF[Remove].shifts
"""Left shifts of fields in packets."""
_VERTEX_SPARE, _OBJECT_SPARE = ((1 << LAYOUT_OF[kind].spare) - 1 for kind in (Insert, Emerge))
"""Masks of the bits that must be zero."""

SMALL = 3
"""An object with at most so many vertices is redrawn as a whole: each vertex can decide whether it is drawn at all."""

_OPEN, _COUNT, _INSIDE, _EDITED, _VERTICES, _GAP, _BOXES, _INSIDES, _USED, _READ, _ERROR, _DETAILS = range(12)
"""Indices into `ReaderState.numbers`: number of the object being edited (-1: none), its announced vertices, and whether
it is inside; whether a packet followed the last save point; current vertices of the object, and index of the gap in
their buffer; number of boxes, of inside objects, and of used symbols in the pool; bytes read of the chunk. If a
packet is rejected, the bytes read end before it; the remaining numbers are the reason, an index into `_REASONS`, and
three details for its text."""

_MALFORMED, _CLOSED, _NO_INDEX, _FULL, _OUTSIDE, _UNFINISHED = range(1, 7)
_MISSING, _PRESENT, _BAD_SIZE, _BAD_INSIDES, _UNCHANGED = range(7, 12)
_REASONS = (
    "",
    "malformed",
    "no object is being edited",
    "index {1} of object {0}: the last one is {2}",
    "object {0} is full with {1} vertices",
    "cell ({0}, {1}) is outside the {width} x {height} grid",
    "object {0} has {1} vertices instead of the announced {2}",
    "there is no object {0}",
    "object {0} already exists",
    f"{{0}} vertices: an object has 2 to {MAX_VERTICES}",
    "{0} inside objects: there must be exactly one",
    "nothing has changed since the last save point",
)


class ReaderState(NamedTuple):
    """State of a stream after any packet, also in the middle of an object."""

    objects: Objects
    """All complete objects."""
    vertices: Symbols
    """Current vertices of the object being edited, as symbols."""
    boxes: Boxes
    """Boxes of changes since the last save point, shape (n, 4)."""
    numbers: Int64s
    """Numbers by the constants above, shape (14,)."""

    @staticmethod
    def empty(shape: tuple[int, int]) -> ReaderState:
        """Return the state before the first packet, for a grid of `shape` (height, width)."""
        numbers = np.zeros(_DETAILS + 3, np.int64)
        numbers[_OPEN] = -1
        return ReaderState(Objects.empty(shape), np.empty(0, np.int32), NO_BOXES, numbers)


class SavePoint(NamedTuple):
    """The objects at the last save point of a chunk, and their changes since the last save point before the chunk."""

    objects: Objects
    boxes: Boxes
    box: tuple[int, int, int, int] | None
    """The bounding box of the changes, if there are any."""
    saves: int
    """Number of save points in the chunk."""
    end: int
    """Offset in the chunk behind the last save point."""


def read(before: ReaderState, chunk: bytes) -> tuple[int, ReaderState, SavePoint | None]:
    """Apply the whole packets at the start of a chunk; `before` is not modified.

    Returns the bytes of these packets, behind which at most an incomplete one follows; the state after them; and the
    last save point, if there is one. ProtocolError: a packet is malformed, does not fit those before it, or is no edit.
    """
    objects, shape = before.objects, before.objects.shape
    state = objects.table, objects.pool, before.vertices, before.boxes, before.numbers
    state, saves, end, saved_table, saved_boxes = _read(np.frombuffer(chunk, np.uint8), shape, state)
    table, pool, vertices, boxes, numbers = state
    used = int(numbers[_READ])
    packet = packet_at(chunk, used)
    if numbers[_ERROR]:
        assert packet is not None
        details = numbers[_DETAILS:].tolist()
        reason = _REASONS[numbers[_ERROR]].format(*details, height=shape[0], width=shape[1])
        raise ProtocolError(packet.name, used, reason)
    if packet is not None:
        raise ProtocolError(packet.name, used, "edit streams have no packets of this kind")
    saved = None
    if saves:
        box = bounding_box(saved_boxes.tolist()) if len(saved_boxes) else None
        saved = SavePoint(Objects(shape, saved_table, pool), saved_boxes, box, saves, end)
    return used, ReaderState(Objects(shape, table, pool), vertices, boxes, numbers), saved


@kernel
def _reject(n: Int64s, at: int, reason: int, one: int, two: int, three: int) -> bool:
    """Note the reason and the details why the packet at an offset is rejected; return False."""
    n[_READ], n[_ERROR] = at, reason
    n[_DETAILS], n[_DETAILS + 1], n[_DETAILS + 2] = one, two, three
    return False


_CAPACITY = MAX_VERTICES + 1

_State = tuple[Table, Symbols, Symbols, Boxes, Int64s]
"""The parts of a `ReaderState`; of the objects, table and pool."""


@kernel
def _place(n: Int64s, index: int) -> int:
    """Return the place of a vertex in the gap buffer; vertices behind the gap are at the end."""
    return index if index < n[_GAP] else _CAPACITY - n[_VERTICES] + index


@kernel
def _move_gap(vertices: Int32s, n: Int64s, to: int) -> None:
    """Move the gap before the vertex of an index; for successive edits that is a short move."""
    behind = _CAPACITY - n[_VERTICES]
    for i in range(n[_GAP] - 1, to - 1, -1):
        vertices[behind + i] = vertices[i]
    for i in range(n[_GAP], to):
        vertices[i] = vertices[behind + i]
    n[_GAP] = to


@kernel
def _number(data: Uint8s, at: int, size: int) -> int:
    """Return `size` bytes as one number, most significant byte first."""
    number = 0
    for i in range(at, at + size):
        number = number << 8 | int(data[i])
    return number


@kernel
def _header(data: Uint8s, at: int) -> tuple[int, int, int]:
    """Return the object, count and inside flag of an `Emerge` or `Change`."""
    packet = _number(data, at, 5)
    return packet >> _OBJECT_AT & 0xFFF, packet >> _COUNT_AT & 0x1FFF, packet >> _INSIDE_AT & 1


@kernel
def _add_box_around(boxes: Boxes, count: int, table: Table, number: int) -> int:
    """Add the box of an object; return the number of boxes."""
    row = table[number]
    return add_box(boxes, count, row[LEFT], row[TOP], row[RIGHT], row[BOTTOM])


@kernel
def _apply(data: Uint8s, begin: int, end: int, shape: tuple[int, int], state: _State) -> bool:
    """Apply the packets from `begin` to `end`; return False if one is rejected.

    Of the state, which is modified, the vertices are the gap buffer of the object being edited.
    """
    table, pool, vertices, boxes, n = state
    around = np.empty(4, np.int32)
    at = begin
    while at < end:
        head = data[at]
        if head >> 4 == _DELETE or head in (_INSERT, _REPLACE):
            length = n[_VERTICES]
            if n[_OPEN] < 0:
                return _reject(n, at, _CLOSED, 0, 0, 0)
            if head >> 4 == _DELETE:
                index = _number(data, at, 2) >> _DELETED_AT & 0xFFF
                if index >= length:
                    return _reject(n, at, _NO_INDEX, n[_OPEN], index, length - 1)
                around[0] = around[3] = vertices[_place(n, index)]
                around[1] = vertices[_place(n, (index + length - 1) % length)]
                around[2] = vertices[_place(n, (index + 1) % length)]
                _move_gap(vertices, n, index)
                n[_VERTICES] -= 1
                at += 2
            else:
                packet = _number(data, at, 6)
                index, x, y = packet >> _INDEX_AT & 0xFFF, packet >> _X_AT & 0xFFF, packet >> _Y_AT & 0xFFF
                side, occupied = packet >> _SIDE_AT & 3, packet >> _OCCUPIED_AT & 1
                is_new = head == _INSERT
                if packet & _VERTEX_SPARE:
                    return _reject(n, at, _MALFORMED, 0, 0, 0)
                if is_new and length == MAX_VERTICES:
                    return _reject(n, at, _FULL, n[_OPEN], length, 0)
                if index >= length + is_new:
                    return _reject(n, at, _NO_INDEX, n[_OPEN], index, length + is_new - 1)
                if x > shape[1] + 1 or y > shape[0] + 1:
                    return _reject(n, at, _OUTSIDE, x - 1, y - 1, 0)
                around[:] = np.int32(y << 15 | x << 3 | side << 1 | occupied)
                if length:
                    around[1] = vertices[_place(n, (index + length - 1) % length)]
                    around[2] = vertices[_place(n, (index if is_new else index + 1) % length)]
                if is_new:
                    _move_gap(vertices, n, index)
                    n[_GAP] += 1
                    n[_VERTICES] += 1
                else:
                    around[3] = vertices[_place(n, index)]
                vertices[_place(n, index)] = around[0]
                at += 6
            if table[n[_OPEN], FIRST] >= 0:
                n[_BOXES] = add_box(boxes, n[_BOXES], *bounds(around))
            n[_EDITED] = 1
            continue

        # All other packets finish the object being edited.
        if n[_OPEN] >= 0:
            number, length = n[_OPEN], n[_VERTICES]
            if length != n[_COUNT]:
                return _reject(n, at, _UNFINISHED, number, length, n[_COUNT])
            _move_gap(vertices, n, length)
            known, was_inside = table[number, FIRST] >= 0, table[number, INSIDE]
            as_a_whole = not known or min(length, table[number, LENGTH]) <= SMALL or was_inside != n[_INSIDE]
            if known:
                n[_INSIDES] -= was_inside
                if as_a_whole:
                    n[_BOXES] = _add_box_around(boxes, n[_BOXES], table, number)
            pool[n[_USED] : n[_USED] + length] = vertices[:length]
            enter(table, number, pool, n[_USED], length, n[_INSIDE] != 0)
            n[_INSIDES] += n[_INSIDE]
            n[_USED] += length
            if as_a_whole:
                n[_BOXES] = _add_box_around(boxes, n[_BOXES], table, number)
            n[_OPEN], n[_VERTICES], n[_GAP] = -1, 0, 0
        if head >> 4 == _REMOVE:
            number = _number(data, at, 2) >> _REMOVED_AT & 0xFFF
            if number >= len(table) or table[number, FIRST] < 0:
                return _reject(n, at, _MISSING, number, 0, 0)
            n[_BOXES] = _add_box_around(boxes, n[_BOXES], table, number)
            n[_INSIDES] -= table[number, INSIDE]
            table[number, FIRST] = -1
            n[_EDITED] = 1
            at += 2
        elif head == _SAVE:
            if not n[_EDITED]:
                return _reject(n, at, _UNCHANGED, 0, 0, 0)
            if n[_INSIDES] != 1:
                return _reject(n, at, _BAD_INSIDES, n[_INSIDES], 0, 0)
            n[_EDITED] = 0
            at += 1
        else:
            number, count, is_inside = _header(data, at)
            known = table[number, FIRST] >= 0
            if _number(data, at, 5) & _OBJECT_SPARE:
                return _reject(n, at, _MALFORMED, 0, 0, 0)
            if known != (head == _CHANGE):
                return _reject(n, at, _PRESENT if known else _MISSING, number, 0, 0)
            if count < 2 or count > MAX_VERTICES:
                return _reject(n, at, _BAD_SIZE, count, 0, 0)
            n[_OPEN], n[_COUNT], n[_INSIDE] = number, count, is_inside
            n[_VERTICES] = n[_GAP] = table[number, LENGTH] if known else 0
            for i in range(n[_VERTICES]):
                vertices[i] = pool[table[number, FIRST] + i]
            n[_EDITED] = 1
            at += 5
    return True


@kernel
def _scan(data: Uint8s) -> tuple[int, int, int, int, int]:
    """Scan the packets before applying them.

    Returns the bytes of whole edit packets; the number of save points and the end of the last one (-1: none); the sum
    of all announced vertices, and the highest number of an object (-1: none).
    """
    whole, saves, last_save, vertices, highest = 0, 0, -1, 0, -1
    while whole < len(data):
        size = _SIZE[data[whole]]
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


@kernel
def _new_pool(table: Table, pool: Symbols, more: int) -> tuple[Symbols, int]:
    """Copy the objects of a table to a new pool with capacity for `more` symbols; return it and its used length."""
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


@kernel
def _read(
    chunk: ReadOnlyUint8s, shape: tuple[int, int], before: _State
) -> tuple[_State, int, int, Table, Boxes]:
    """Apply a chunk.

    Returns the new state, the number of save points, the end of the last one, and the table and boxes at that point.
    The state before is not modified, except the unused part of the pool. The last element of the pool is the length
    that any receiver has used of it.
    """
    old_table, pool, vertices, unsaved, numbers = before
    data = chunk.copy()
    whole, saves, last_save, announced, highest = _scan(data)
    n = numbers.copy()
    table = np.full((max(len(old_table), highest + 1), old_table.shape[1]), -1, np.int32)
    table[: len(old_table)] = old_table
    announced += n[_COUNT]
    # Another receiver that continued from this state has written to the pool: copy it.
    if n[_USED] + announced >= len(pool) or pool[-1] != n[_USED]:
        pool, n[_USED] = _new_pool(table, pool, announced)
    edited = np.empty(_CAPACITY, np.int32)
    edited[: len(vertices)] = vertices
    n[_GAP] = n[_VERTICES]
    boxes = np.empty((MAX_BOXES, 4), np.int32)
    boxes[: len(unsaved)] = unsaved

    saved = max(last_save, 0)
    is_valid = _apply(data, 0, saved, shape, (table, pool, edited, boxes, n))
    saved_table, saved_boxes = table, boxes[: n[_BOXES]].copy()
    if last_save >= 0:
        n[_BOXES] = 0
    if is_valid and saved < whole:
        saved_table = table.copy()
        is_valid = _apply(data, saved, whole, shape, (table, pool, edited, boxes, n))
    _move_gap(edited, n, n[_VERTICES])
    if is_valid:
        pool[-1], n[_READ] = n[_USED], whole
    state = table, pool, edited[: n[_VERTICES]].copy(), boxes[: n[_BOXES]].copy(), n
    return state, saves, last_save, saved_table, saved_boxes
