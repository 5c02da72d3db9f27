"""Edit scripts: what a robot says of its approximation, as changes to what was said before (section 4.2.3).

An approximation is a set of cycles; packets speak of numbered lists. `Held` is an approximation in the
form in which its receivers hold it. `edit_script` finds the packets of fewest bytes that turn the old one
into the new one: objects keep their numbers where that saves most, and the new list of an object begins
where most of the old one stays, so a cyclic shift or another order of the objects costs nothing.

The minimum edit distance needs no table of all pairs (Algorithm 4), for a vertex occurs once in an
approximation. What may stay falls into runs, stretches of equal symbols in both cycles; a run stays as a
whole or goes as a whole, so the search goes over the few runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.polygons import Polygons
from protocol.kernels import kernel
from protocol.packets import Change, Delete, Edit, Emerge, Insert, Remove, Replace, Save

_DELETED, _INSERTED = Delete.size, Insert.size
_KEPT = Delete.size + Insert.size
"""Bytes saved by a vertex that stays, against deleting and inserting it."""
_REPLACED = Delete.size + Insert.size - Replace.size
"""Bytes saved by a replacement, against deleting and inserting."""


@dataclass(frozen=True, eq=False)
class Held:
    """An approximation as packets speak of it.

    Attributes
    ----------
    number : int32 array of shape (objects,), ascending
        The number of each object.
    polygons : Polygons
        The objects in this order; `Insert`, `Replace` and `Delete` count an object's vertices from its start.
    """

    number: NDArray[np.int32]
    polygons: Polygons

    @staticmethod
    def nothing(shape: tuple[int, int]) -> Held:
        """Return what is held before anything has been said."""
        return Held(np.empty(0, np.int32), Polygons.nothing(shape))


def edit_script(held: Held, approximation: Polygons) -> tuple[list[Edit], Held]:
    """Find the packets that turn what is held into an approximation.

    Parameters
    ----------
    held : Held
        A(t - 1), as all that was said before has left it.
    approximation : Polygons
        A(t): at most 4096 objects of at most 4096 vertices, no vertex twice.

    Returns
    -------
    list of packets
        Removed objects, then changed ones, then new ones, each by ascending number; at the end a save
        point. Empty where nothing has changed. In an object first vertices are deleted, the last one
        first; then, from the first to the last, others come to stand at their final index: so it is never
        longer than before or after.
    Held
        What is held after these packets.
    """
    old, new = held.polygons, approximation
    old_symbols, new_symbols = symbols(old), symbols(new)
    twins = _twins(old_symbols, new_symbols)
    successor, shift, kin = _kinship(
        old_symbols, old.start, old.inside, new_symbols, new.start, new.inside, twins
    )
    alignments: dict[int, tuple[int, NDArray[np.int32]]] = {}
    for old_object, new_object, alignment in _successions(old, new, old_symbols, new_symbols, twins, kin):
        successor[new_object] = old_object
        alignments[new_object] = alignment
        shift[new_object] = alignment[0]

    number = np.empty(new.objects, np.int32)
    kept = successor >= 0
    number[kept] = held.number[successor[kept]]
    taken = set(number[kept].tolist())
    free = (n for n in range(new.objects) if n not in taken)
    emerging = np.flatnonzero(~kept).tolist()
    for new_object in emerging:
        number[new_object] = next(free)
    order = np.argsort(number)
    after = Held(number[order], _rearranged(new, order, shift))

    packets: list[Edit] = [Remove(n) for n in held.number.tolist() if n not in taken]
    for new_object in sorted(alignments, key=lambda k: int(number[k])):
        _, source = alignments[new_object]
        k = int(successor[new_object])
        before = old_symbols[old.start[k] : old.start[k + 1]]
        cycle = np.roll(new_symbols[new.start[new_object] : new.start[new_object + 1]], -shift[new_object])
        packets.append(Change(int(number[new_object]), len(cycle), int(new.inside[new_object])))
        packets += _vertex_edits(before, cycle, source)
    for new_object in emerging:
        cycle = new_symbols[new.start[new_object] : new.start[new_object + 1]]
        packets.append(Emerge(int(number[new_object]), len(cycle), int(new.inside[new_object])))
        packets += [Insert(i, *_fields(symbol)) for i, symbol in enumerate(cycle.tolist())]
    if packets:
        packets.append(Save())
    return packets, after


def symbols(polygons: Polygons) -> NDArray[np.int32]:
    """Pack each vertex, x, y, side and occupancy, into one number."""
    packed = polygons.y.astype(np.int32) + 1
    packed = packed << 12 | (polygons.x.astype(np.int32) + 1)
    return packed << 3 | (polygons.side << 1 | polygons.occupied)


def unpacked(
    shape: tuple[int, int], symbols: NDArray[np.int32], start: NDArray[np.int32], inside: NDArray[np.bool_]
) -> Polygons:
    """Return the polygons that symbols stand for."""
    return Polygons(
        shape,
        ((symbols >> 3 & 0xFFF) - 1).astype(np.int16),
        ((symbols >> 15) - 1).astype(np.int16),
        (symbols >> 1 & 3).astype(np.uint8),
        (symbols & 1).astype(np.uint8),
        start,
        inside,
    )


def _fields(symbol: int) -> tuple[int, int, int, int]:
    return (symbol >> 3 & 0xFFF) - 1, (symbol >> 15) - 1, symbol >> 1 & 3, symbol & 1


def _vertex_edits(
    before: NDArray[np.int32], after: NDArray[np.int32], source: NDArray[np.int32]
) -> list[Edit]:
    """Write out one object's edits; ``after[i]`` was ``before[source[i]]`` (-1: it is new)."""
    stays = np.zeros(len(before), np.bool_)
    stays[source[source >= 0]] = True
    edits: list[Edit] = [Delete(i) for i in np.flatnonzero(~stays)[::-1].tolist()]
    is_new = source < 0
    edits += [
        (Insert if is_new[i] else Replace)(i, *_fields(int(after[i])))
        for i in np.flatnonzero(is_new | (before[source] != after)).tolist()
    ]
    return edits


def _successions(
    old: Polygons,
    new: Polygons,
    old_symbols: NDArray[np.int32],
    new_symbols: NDArray[np.int32],
    twins: NDArray[np.int32],
    kin: NDArray[np.int32],
) -> list[tuple[int, int, tuple[int, NDArray[np.int32]]]]:
    """Choose who takes over whose number among objects that share vertices, the largest saving first.

    Returns old object, new object and their alignment (`_align`). Where an object has split, the others
    emerge; where objects have joined, the others are removed.
    """
    offers = []
    for old_object, new_object in kin.tolist():
        cycle, former = new_symbols[_part(new, new_object)], old_symbols[_part(old, old_object)]
        first = int(old.start[old_object])
        cost, begin, source = _align(former, cycle, twins[_part(new, new_object)] - first)
        apart = Remove.size + Emerge.size + Insert.size * len(cycle)
        saving = apart - Change.size - cost
        if saving > 0:
            offers.append((-saving, old_object, new_object, (begin, source)))
    offers.sort(key=lambda offer: offer[:3])
    gone: set[int] = set()
    settled: set[int] = set()
    chosen = []
    for _, old_object, new_object, alignment in offers:
        if old_object not in gone and new_object not in settled:
            gone.add(old_object)
            settled.add(new_object)
            chosen.append((old_object, new_object, alignment))
    return chosen


def _part(polygons: Polygons, k: int) -> slice:
    return slice(int(polygons.start[k]), int(polygons.start[k + 1]))


def _rearranged(polygons: Polygons, order: NDArray[np.int64], shift: NDArray[np.int32]) -> Polygons:
    """Put the objects into `order`, each beginning `shift` vertices later."""
    vertex, start = _gather(polygons.start, order, shift)
    return Polygons(
        polygons.shape,
        polygons.x[vertex],
        polygons.y[vertex],
        polygons.side[vertex],
        polygons.occupied[vertex],
        start,
        polygons.inside[order],
    )


@kernel("Tuple((int32[::1], int32[::1]))(int32[::1], int64[::1], int32[::1])")
def _gather(
    start: NDArray[np.int32], order: NDArray[np.int64], shift: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    vertex = np.empty(start[-1], np.int32)
    begins = np.zeros(len(start), np.int32)
    count = 0
    for i, k in enumerate(order):
        length = start[k + 1] - start[k]
        for j in range(length):
            vertex[count] = start[k] + (j + shift[k]) % length
            count += 1
        begins[i + 1] = count
    return vertex, begins


@kernel("int32[::1](int32[::1], int32[::1])")
def _twins(old: NDArray[np.int32], new: NDArray[np.int32]) -> NDArray[np.int32]:
    """For each new symbol, the position of the old one of the same vertex (x, y, side), or -1."""
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


@kernel(
    "Tuple((int32[::1], int32[::1], int32[:,::1]))"
    "(int32[::1], int32[::1], boolean[::1], int32[::1], int32[::1], boolean[::1], int32[::1])"
)
def _kinship(
    old: NDArray[np.int32],
    old_start: NDArray[np.int32],
    old_inside: NDArray[np.bool_],
    new: NDArray[np.int32],
    new_start: NDArray[np.int32],
    new_inside: NDArray[np.bool_],
    twins: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Find the objects that are as they were, and which of the others share vertices.

    Returns, for each new object, the old one that equals it (-1: none) and where in its cycle the old list
    begins; and the pairs (old, new) of other objects with a common vertex.
    """
    old_count, new_count = len(old_start) - 1, len(new_start) - 1
    equal = np.full(new_count, -1, np.int32)
    shift = np.zeros(new_count, np.int32)
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
        same = True
        for i in range(length):
            if old[other_first + (i + turn) % length] != new[first + i]:
                same = False
                break
        if same:
            equal[k] = other
            shift[k] = (length - turn) % length
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
    return equal, shift, pairs[:count].copy()


@kernel("Tuple((int64, int64, int32[::1]))(int32[::1], int32[::1], int32[::1])")
def _align(
    old: NDArray[np.int32], new: NDArray[np.int32], twins: NDArray[np.int32]
) -> tuple[int, int, NDArray[np.int32]]:
    """Align a cycle with a list at the fewest bytes of vertex packets.

    ``twins[i]``, where it is a position in `old`, is the only one that may equal ``new[i]``.

    Returns the bytes, where in `new` the list is to begin, and from there on for each vertex the one of
    `old` that stays or is replaced (-1: it is inserted).
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
        if i > 0 and place[i - 1] >= 0 and place[i] == (place[i - 1] + 1) % n:
            length[runs - 1] += 1
        else:
            at[runs], to[runs], length[runs] = i, place[i], 1
            runs += 1

    # The best chain of runs for each run that may stay first. In a gap of a old and b new vertices between
    # runs that stay, min(a, b) are replaced; the gap before the first and after the last one is one gap.
    best = _REPLACED * min(m, n)
    best_first = -1
    best_chain = np.empty(0, np.int64)
    gain = np.empty(runs, np.int64)
    before = np.empty(runs, np.int64)
    rest = matches
    for first in range(runs):
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

    # Write the chain out; what is new before the first run replaces as much of the old there as it can.
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
