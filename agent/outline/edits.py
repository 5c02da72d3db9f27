"""Edit scripts: what a robot says of its approximation, as changes to what was said before (section 4.2.3).

An approximation is a set of cycles; packets speak of numbered lists. `Held` is an approximation in the
form in which its receivers hold it. `edit_script` finds packets that turn the old one into the new one
(Algorithm 5): of each pair of objects the fewest bytes, with the new list beginning where most of the old one
stays; pairs are chosen by what they save, the largest saving first. So a cyclic shift or another order of the
objects costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.outline.alignment import align, find_twins, kinship
from agent.outline.polygons import Polygons
from protocol.kernels import kernel
from protocol.packets import Change, Delete, Edit, Emerge, Insert, Remove, Replace, Save


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
    twins = find_twins(old_symbols, new_symbols)
    successor, shift, kin = kinship(
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
    packed: NDArray[np.int32] = _pack(polygons.x, polygons.y, polygons.side, polygons.occupied)
    return packed


def unpacked(
    shape: tuple[int, int], symbols: NDArray[np.int32], start: NDArray[np.int32], inside: NDArray[np.bool_]
) -> Polygons:
    """Return the polygons that symbols stand for."""
    return Polygons(shape, *_unpack(symbols), start, inside)


@kernel("Tuple((int16[::1], int16[::1], uint8[::1], uint8[::1]))(int32[::1])")
def _unpack(
    symbols: NDArray[np.int32],
) -> tuple[NDArray[np.int16], NDArray[np.int16], NDArray[np.uint8], NDArray[np.uint8]]:
    n = len(symbols)
    x, y = np.empty(n, np.int16), np.empty(n, np.int16)
    side, occupied = np.empty(n, np.uint8), np.empty(n, np.uint8)
    for i in range(n):
        symbol = symbols[i]
        x[i] = (symbol >> 3 & 0xFFF) - 1
        y[i] = (symbol >> 15) - 1
        side[i] = symbol >> 1 & 3
        occupied[i] = symbol & 1
    return x, y, side, occupied


@kernel("int32[::1](int16[::1], int16[::1], uint8[::1], uint8[::1])")
def _pack(
    x: NDArray[np.int16], y: NDArray[np.int16], side: NDArray[np.uint8], occupied: NDArray[np.uint8]
) -> NDArray[np.int32]:
    symbols = np.empty(len(x), np.int32)
    for i in range(len(x)):
        symbols[i] = (np.int32(y[i]) + 1 << 12 | np.int32(x[i]) + 1) << 3 | side[i] << 1 | occupied[i]
    return symbols


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

    Returns old object, new object and their alignment (`align`). Where an object has split, the others
    emerge; where objects have joined, the others are removed.
    """
    offers = []
    for old_object, new_object in kin.tolist():
        cycle, former = new_symbols[_part(new, new_object)], old_symbols[_part(old, old_object)]
        first = int(old.start[old_object])
        cost, begin, source = align(former, cycle, twins[_part(new, new_object)] - first)
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
