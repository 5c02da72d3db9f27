"""Common vertices of successive approximations, and the minimum edit distance of objects (section 4.2.3).

The distance needs no table of all pairs (Algorithm 4), because a vertex occurs only once in an approximation. Vertices
that can stay form runs: stretches of equal symbols in both cycles. A run stays or is deleted as a whole, because to
delete a vertex costs more than the replacement that it permits saves. So the search is over the few runs.

A symbol is a vertex with the occupancy of its edge in the lowest bit (`agent.outline.objects.Objects`).
"""

from __future__ import annotations

import numpy as np

from protocol.arrays import Bools, Int32Rows, Int32s
from protocol.kernels import kernel
from protocol.packets import Delete, Insert, Replace

Cycles = tuple[Int32s, Int32s, Bools]
"""Objects: the symbols of all vertices, the start of each object among them, and whether it is the inside one."""

_DELETED, _INSERTED = Delete.size, Insert.size
_KEPT = Delete.size + Insert.size
"""Bytes saved if a vertex stays, instead of a deletion and an insertion."""
_REPLACED = Delete.size + Insert.size - Replace.size
"""Bytes saved by a replacement, instead of a deletion and an insertion."""


@kernel
def match_vertices(old: Int32s, new: Int32s) -> Int32s:
    """Return, for each new symbol, the index of the old symbol of the same vertex (x, y, side), or -1."""
    size = 16
    while size < 2 * len(old):
        size *= 2
    table = np.full(size, -1, np.int32)
    twins = np.empty(len(new), np.int32)
    for i in range(len(old)):
        slot = (old[i] >> 1) * 0x9E3779B1 >> 7 & size - 1
        while table[slot] >= 0:
            slot = slot + 1 & size - 1
        table[slot] = i
    for i in range(len(new)):
        slot = (new[i] >> 1) * 0x9E3779B1 >> 7 & size - 1
        while table[slot] >= 0 and old[table[slot]] >> 1 != new[i] >> 1:
            slot = slot + 1 & size - 1
        twins[i] = table[slot]
    return twins


@kernel
def match_objects(before: Cycles, after: Cycles, twins: Int32s, shifts: bool) -> tuple[Int32s, Int32Rows]:
    """Find the unchanged objects, and the pairs of changed objects that share vertices.

    `twins` is the result of `match_vertices`. With `shifts`, an object whose cycle starts at another vertex counts as
    unchanged, too.

    Returns, for each new object, the equal old one (-1: none); and the pairs (old, new) of other objects with a common
    vertex.
    """
    (old, old_start, old_inside), (new, new_start, new_inside) = before, after
    old_count, new_count = len(old_start) - 1, len(new_start) - 1
    equal = np.full(new_count, -1, np.int32)
    owner = np.empty(len(old), np.int32)
    for k in range(old_count):
        owner[old_start[k] : old_start[k + 1]] = k
    untouched = np.zeros(old_count, np.bool_)
    for k in range(new_count):
        first, length = new_start[k], new_start[k + 1] - new_start[k]
        twin = twins[first]
        if twin < 0:
            continue
        other = owner[twin]
        other_first = old_start[other]
        if old_start[other + 1] - other_first != length or old_inside[other] != new_inside[k]:
            continue
        turn = twin - other_first
        same = shifts or turn == 0
        for i in range(length):
            if old[other_first + (i + turn if i + turn < length else i + turn - length)] != new[first + i]:
                same = False
                break
        if same:
            equal[k] = other
            untouched[other] = True
    pairs = np.empty((len(new), 2), np.int32)
    count = 0
    met_by = np.full(old_count, -1, np.int32)
    for k in range(new_count):
        if equal[k] >= 0:
            continue
        for i in range(new_start[k], new_start[k + 1]):
            if twins[i] >= 0:
                other = owner[twins[i]]
                if not untouched[other] and met_by[other] != k:
                    met_by[other] = k
                    pairs[count, 0] = other
                    pairs[count, 1] = k
                    count += 1
    return equal, pairs[:count].copy()


@kernel
def align(old: Int32s, new: Int32s, twins: Int32s, first_stays: bool) -> tuple[int, int, Int32s]:
    """Align a new cycle with an old list such that the vertex packets have the fewest bytes.

    Only the symbol at index ``twins[i]`` of `old`, if that is a valid index, can equal ``new[i]``. With `first_stays`,
    the first symbols are equal, and the new list starts with it.

    Returns the bytes; the index in `new` at which the new list starts; and for each vertex from there on the index of
    the old vertex that stays or is replaced (-1: it is inserted).
    """
    m, n = len(old), len(new)
    place = np.full(m, -1, np.int64)
    for i in range(n):
        if 0 <= twins[i] < m and old[twins[i]] == new[i]:
            place[twins[i]] = i

    # Runs: old[at : at + length] equals new[to : to + length] (cyclically).
    at = np.empty(m, np.int64)
    to = np.empty(m, np.int64)
    length = np.empty(m, np.int64)
    runs = 0
    matches = 0
    for i in range(m):
        if place[i] < 0:
            continue
        matches += 1
        if i > 0 and place[i - 1] >= 0 and place[i] == (place[i - 1] + 1 if place[i - 1] + 1 < n else 0):
            length[runs - 1] += 1
        else:
            at[runs], to[runs], length[runs] = i, place[i], 1
            runs += 1

    # For each run, find the best chain of runs that stay and start with it. In a gap of a old and b new vertices
    # between runs that stay, min(a, b) are replaced; the gaps before the first and after the last run are one gap.
    best = -1 if first_stays else _REPLACED * min(m, n)
    best_first = -1
    best_chain = np.empty(0, np.int64)
    gain = np.empty(runs, np.int64)
    before = np.empty(runs, np.int64)
    rest = matches
    for first in range(1 if first_stays else runs):
        if _KEPT * rest + _REPLACED * (min(m, n) - rest) <= best:
            break
        rest -= length[first]
        last, total = -1, best
        for j in range(first, runs):
            j_to = (to[j] - to[first]) % n
            before[j] = -1
            gain[j] = _KEPT * length[first] if j == first else -1
            for i in range(first, j):
                i_end = (to[i] - to[first]) % n + length[i]
                if gain[i] >= 0 and i_end <= j_to:
                    replaced = min(at[j] - at[i] - length[i], j_to - i_end)
                    value = gain[i] + _KEPT * length[j] + _REPLACED * replaced
                    if value > gain[j]:
                        gain[j], before[j] = value, i
            if gain[j] >= 0:
                gap = min(at[first] + m - at[j] - length[j], n - j_to - length[j])
                if gain[j] + _REPLACED * gap > total:
                    last, total = j, gain[j] + _REPLACED * gap
        if last >= 0:
            best, best_first = total, first
            count = 1
            j = last
            while j != first:
                j = before[j]
                count += 1
            best_chain = np.empty(count, np.int64)
            j = last
            for c in range(count - 1, -1, -1):
                best_chain[c] = j
                j = before[j]

    # Assign a source to each vertex; new vertices before the first run replace as many old ones there as possible.
    source = np.full(n, -1, np.int32)
    begin = 0
    if best_first >= 0:
        last = best_chain[-1]
        between = n - (to[last] - to[best_first]) % n - length[last]
        begin = (to[best_first] - min(at[best_first], between)) % n
    i, j = 0, 0
    for c in range(len(best_chain) + 1):
        run = best_chain[c] if c < len(best_chain) else -1
        run_at = at[run] if run >= 0 else m
        run_to = (to[run] - begin) % n if run >= 0 else n
        for k in range(min(run_at - i, run_to - j)):
            source[j + k] = i + k
        if run >= 0:
            for k in range(length[run]):
                source[run_to + k] = run_at + k
            i, j = run_at + length[run], run_to + length[run]
    return _DELETED * m + _INSERTED * n - best, begin, source


@kernel
def align_lists(old: Int32s, new: Int32s, twins: Int32s) -> tuple[int, int, Int32s]:
    """Align two lists as `align` does, but let the new list start at index 0 of `new`.

    For this, both lists get a common first symbol that must stay.
    """
    m, n = len(old), len(new)
    marked_old, marked_new = np.full(m + 1, -1, np.int32), np.full(n + 1, -1, np.int32)
    marked_twins = np.zeros(n + 1, np.int32)
    marked_old[1:] = old
    marked_new[1:] = new
    marked_twins[1:] = twins + np.int32(1)
    size, _, source = align(marked_old, marked_new, marked_twins, True)
    return size, 0, np.maximum(source[1:] - np.int32(1), np.int32(-1))
