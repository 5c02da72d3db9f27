"""Edit scripts: packets that turn one approximation into the next (section 4.2.3, Algorithm 5).

An approximation is a set of cycles, but packets edit numbered lists. `NumberedPolygons` is an approximation in the form
in which receivers hold it. Old and new objects are paired greedily, largest saving in bytes first. The list of a new
object starts at the vertex for which the pair needs the fewest bytes. So a cyclic shift, or another order of the
objects, costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from agent.outline.alignment import Cycles, align, align_lists, match_objects, match_vertices
from agent.outline.polygons import Polygons, Symbols
from protocol.arrays import Int32Rows, Int32s, Int64s, Uint8s
from protocol.kernels import kernel
from protocol.packets import LAYOUT_OF, MAX_OBJECTS, Change, Delete, Emerge, Insert, Remove, Replace, Save

_INSERT, _DELETE, _EMERGE, _CHANGE, _REMOVE, _SAVE = (
    kind.size for kind in (Insert, Delete, Emerge, Change, Remove, Save)
)
"""Bytes of packets."""
_INSERT_CODE, _REPLACE_CODE, _DELETE_CODE, _EMERGE_CODE, _CHANGE_CODE, _REMOVE_CODE, _SAVE_CODE = (
    LAYOUT_OF[kind].fixed[1] for kind in (Insert, Replace, Delete, Emerge, Change, Remove, Save)
)
"""Packets as numbers, with all fields 0."""
_INDEX_AT, _X_AT, _Y_AT, _SIDE_AT, _OCCUPIED_AT = LAYOUT_OF[Insert].shifts
_OBJECT_AT, _COUNT_AT, _INSIDE_AT = LAYOUT_OF[Emerge].shifts
(_DELETED_AT,) = LAYOUT_OF[Delete].shifts
(_REMOVED_AT,) = LAYOUT_OF[Remove].shifts
"""Left shifts of fields in packets."""
_RECREATED = _REMOVE + _EMERGE
"""Bytes, besides the vertices, of an object that is removed and created instead of changed."""
_MAX_SAVING = 1 << 30


@dataclass(frozen=True, eq=False)
class NumberedPolygons:
    """An approximation with numbered objects and indexed vertices, as packets refer to them."""

    number: NDArray[np.int32]
    """The number of each object, ascending, shape (objects,)."""
    polygons: Polygons
    """The objects in this order; packets index an object's vertices from its start."""

    @staticmethod
    def empty(shape: tuple[int, int]) -> NumberedPolygons:
        """Return no objects: the state before the first packet."""
        return NumberedPolygons(np.empty(0, np.int32), Polygons.empty(shape))


def edit_packets(
    held: NumberedPolygons, approximation: Polygons, *, scan_order: bool = False, shifts: bool = True
) -> list[bytes]:
    """Encode the packets that turn the held approximation, A(t - 1), into A(t) (Algorithm 5); none if they are equal.

    A(t) has at most 4096 objects of at most 4096 vertices, no vertex twice. The packets are removed objects, then
    changed ones, then new ones, each by ascending number, and a save point. Within an object, vertices are deleted from
    the last to the first, then replaced or inserted from the first to the last at their final index. So it is never
    longer than before and after.

    Objects keep their numbers. With `scan_order`, a `Change` is also sent for each object whose place among the objects
    in scan order differs: the thesis numbers objects anew in each step (Algorithm 3), and sends the packet "if the
    index, the number of vertices, or the type of a contour changes" (section 6.4). It changes nothing for the receiver.

    Without `shifts`, the list of a new object starts at the first vertex of the object, as the arrays of Algorithms 4
    and 5 do. Where this vertex has moved, the vertices between are deleted at one end of the list and inserted at the
    other.
    """
    old, new = held.polygons, approximation
    cycles = (old.symbols, old.start, old.inside), (new.symbols, new.start, new.inside)
    script, ends = _script(*cycles, held.number, scan_order, shifts)
    data = script.tobytes()
    return [data[begin:end] for begin, end in pairwise(ends.tolist())]


@kernel
def _put(out: Uint8s, ends: Int32s, packets: int, packet: int, size: int) -> int:
    """Write a packet behind the first `packets`, most significant byte first; return the number of packets."""
    at = ends[packets]
    for i in range(size):
        out[at + i] = packet >> 8 * (size - 1 - i) & 0xFF
    ends[packets + 1] = at + size
    return packets + 1


@kernel
def _vertex_packet(code: int, index: int, symbol: int) -> int:
    """Return an `Insert` or `Replace` packet as a number, without spare bits set."""
    x, y = symbol >> 3 & 0xFFF, symbol >> 15
    side, occupied = symbol >> 1 & 3, symbol & 1
    return code | index << _INDEX_AT | x << _X_AT | y << _Y_AT | side << _SIDE_AT | occupied << _OCCUPIED_AT


@kernel
def _object_packet(code: int, number: int, count: int, inside: int) -> int:
    """Return an `Emerge` or `Change` packet as a number."""
    return code | number << _OBJECT_AT | count << _COUNT_AT | inside << _INSIDE_AT


@kernel
def _align_pair(
    old: Cycles, new: Cycles, twins: Int32s, old_object: int, new_object: int, shifts: bool
) -> tuple[int, int, Int32s]:
    """Align one old and one new object (`align`, or without `shifts` `align_lists`)."""
    (old_symbols, old_start, _), (new_symbols, new_start, _) = old, new
    first, begin, end = old_start[old_object], new_start[new_object], new_start[new_object + 1]
    own = twins[begin:end] - np.int32(first)
    old_list, new_list = old_symbols[first : old_start[old_object + 1]], new_symbols[begin:end]
    return align(old_list, new_list, own, False) if shifts else align_lists(old_list, new_list, own)


@kernel
def _pair(old: Cycles, new: Cycles, twins: Int32s, related: Int32Rows, shifts: bool) -> Int32s:
    """Pair the new objects with old ones whose number they take over, the largest saving first.

    Returns for each new object the old one, or -1. Of the parts of a split object, all but one emerge; of merged
    objects, all but one are removed.
    """
    successor = np.full(len(new[1]) - 1, -1, np.int32)
    is_gone = np.zeros(len(old[1]) - 1, np.bool_)
    key = np.empty(len(related), np.int64)  # orders by saving, then old object, then new object
    candidates = 0
    for pair in range(len(related)):
        old_object, new_object = related[pair]
        cost, _, _ = _align_pair(old, new, twins, old_object, new_object, shifts)
        length = new[1][new_object + 1] - new[1][new_object]
        saving = _RECREATED + _INSERT * length - _CHANGE - cost
        if saving > 0:
            key[candidates] = (_MAX_SAVING - saving) << 24 | old_object << 12 | new_object
            candidates += 1
    for each in np.sort(key[:candidates]):
        old_object, new_object = each >> 12 & 0xFFF, each & 0xFFF
        if not is_gone[old_object] and successor[new_object] < 0:
            is_gone[old_object] = True
            successor[new_object] = old_object
    return successor


@kernel
def _ranks(vertices: Symbols, start: Int32s) -> Int64s:
    """Return the place of each object in scan order: row by row, by the first of its vertices."""
    first = np.empty(len(start) - 1, np.int32)
    for k in range(len(first)):
        first[k] = vertices[start[k] : start[k + 1]].min()
    ranks = np.empty(len(first), np.int64)
    ranks[np.argsort(first)] = np.arange(len(first))
    return ranks


@kernel
def _script(
    old: Cycles, new: Cycles, old_number: Int32s, scan_order: bool, shifts: bool
) -> tuple[Uint8s, Int32s]:
    """Return the script, and the ends of its packets (from 0)."""
    (old_symbols, old_start, _), (new_symbols, new_start, new_inside) = old, new
    old_objects, new_objects = len(old_start) - 1, len(new_start) - 1
    twins = match_vertices(old_symbols, new_symbols)
    equal, related = match_objects(old, new, twins, shifts)
    successor = _pair(old, new, twins, related, shifts)

    # Objects without a predecessor get the lowest unused numbers, below.
    number = np.full(new_objects, -1, np.int32)
    is_taken = np.zeros(MAX_OBJECTS, np.bool_)
    for k in range(new_objects):
        former = equal[k] if equal[k] >= 0 else successor[k]
        if former >= 0:
            number[k] = old_number[former]
            is_taken[number[k]] = True
    most = _SAVE + _REMOVE * old_objects + _EMERGE * new_objects
    most += _DELETE * len(old_symbols) + _INSERT * len(new_symbols)
    most += _CHANGE * new_objects if scan_order else 0
    out = np.empty(most, np.uint8)
    ends = np.zeros(2 + old_objects + 2 * new_objects + len(old_symbols) + len(new_symbols), np.int32)
    packets = 0
    for n in old_number:
        if not is_taken[n]:
            packets = _put(out, ends, packets, _REMOVE_CODE | n << _REMOVED_AT, _REMOVE)
    is_moved = np.zeros(new_objects, np.bool_)
    if scan_order:
        before_ranks, ranks = _ranks(old_symbols, old_start), _ranks(new_symbols, new_start)
        for k in range(new_objects):
            is_moved[k] = equal[k] >= 0 and before_ranks[equal[k]] != ranks[k]
    for k in np.argsort(number):
        if is_moved[k]:
            length = new_start[k + 1] - new_start[k]
            packet = _object_packet(_CHANGE_CODE, number[k], length, new_inside[k])
            packets = _put(out, ends, packets, packet, _CHANGE)
        if successor[k] < 0:
            continue
        former = successor[k]
        _, begin, source = _align_pair(old, new, twins, former, k, shifts)
        before = old_symbols[old_start[former] : old_start[former + 1]]
        after = new_symbols[new_start[k] : new_start[k + 1]]
        packet = _object_packet(_CHANGE_CODE, number[k], len(after), new_inside[k])
        packets = _put(out, ends, packets, packet, _CHANGE)
        stays = np.zeros(len(before), np.bool_)
        for i in source:
            if i >= 0:
                stays[i] = True
        for i in range(len(before) - 1, -1, -1):
            if not stays[i]:
                packets = _put(out, ends, packets, _DELETE_CODE | i << _DELETED_AT, _DELETE)
        for i in range(len(after)):
            symbol = after[i + begin if i + begin < len(after) else i + begin - len(after)]
            if source[i] < 0 or before[source[i]] != symbol:
                packet = _vertex_packet(_INSERT_CODE if source[i] < 0 else _REPLACE_CODE, i, symbol)
                packets = _put(out, ends, packets, packet, _INSERT)
    lowest = 0
    for k in range(new_objects):
        if number[k] >= 0:
            continue
        while is_taken[lowest]:
            lowest += 1
        number[k] = lowest
        lowest += 1
        cycle = new_symbols[new_start[k] : new_start[k + 1]]
        packet = _object_packet(_EMERGE_CODE, number[k], len(cycle), new_inside[k])
        packets = _put(out, ends, packets, packet, _EMERGE)
        for i in range(len(cycle)):
            packets = _put(out, ends, packets, _vertex_packet(_INSERT_CODE, i, cycle[i]), _INSERT)
    if packets:
        packets = _put(out, ends, packets, _SAVE_CODE, _SAVE)
    return out[: ends[packets]].copy(), ends[: packets + 1].copy()
