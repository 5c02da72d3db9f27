"""Edit scripts applied to plain lists of vertices: the reference for what receivers hold."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import numpy as np

from agent.outline.claims import THESIS, Drawing, DrawnClaims, Layer
from agent.outline.edits import NumberedPolygons, edit_packets
from agent.outline.objects import Objects
from agent.outline.polygons import Polygons, Symbols
from protocol.packet_codec import decode
from protocol.packets import Change, Delete, Edit, Emerge, Insert, Remove, Replace, Save

Symbol = tuple[int, int, int, int]
Cycle = list[Symbol]


def edit_script(
    held: NumberedPolygons, approximation: Polygons, *, scan_order: bool = False, shifts: bool = True
) -> tuple[list[Edit], NumberedPolygons]:
    """The packets that turn what is held into an approximation, and what is held after them."""
    script = b"".join(edit_packets(held, approximation, scan_order=scan_order, shifts=shifts))
    packets = cast("list[Edit]", decode(script))
    objects = applied(lists(held), packets)
    rows = [symbol for _, cycle in objects.values() for symbol in cycle]
    start = np.cumsum([0, *(len(cycle) for _, cycle in objects.values())]).astype(np.int32)
    inside = np.array([inside for inside, _ in objects.values()], np.bool_)
    polygons = Polygons(held.polygons.shape, packed(rows), start, inside)
    return packets, NumberedPolygons(np.array([*objects], np.int32), polygons)


def packed(rows: Sequence[Symbol]) -> Symbols:
    """Vertices as numbers, as `Polygons` has them."""
    x, y, side, occupied = np.array(rows, np.int32).reshape(-1, 4).T
    return np.ascontiguousarray(y + 1 << 15 | x + 1 << 3 | side << 1 | occupied)


def lists(held: NumberedPolygons) -> dict[int, tuple[bool, Cycle]]:
    """Objects by number: whether it is the inside one, and its vertices."""
    p = held.polygons
    rows = list(zip(p.x.tolist(), p.y.tolist(), p.side.tolist(), p.occupied.tolist(), strict=True))
    parts = pairwise(p.start.tolist())
    return {
        number: (bool(inside), rows[first:end])
        for number, inside, (first, end) in zip(held.number.tolist(), p.inside, parts, strict=True)
    }


def applied(objects: dict[int, tuple[bool, Cycle]], packets: list[Edit]) -> dict[int, tuple[bool, Cycle]]:
    """Apply packets to plain lists, as docs and docstrings describe it."""
    objects = dict(objects)
    current: Cycle = []
    announced = longest = 0
    for packet in packets:
        match packet:
            case Emerge(number, count, inside) | Change(number, count, inside):
                assert len(current) == announced
                assert (number in objects) == isinstance(packet, Change)
                current = list(objects[number][1]) if number in objects else []
                announced, longest = count, max(count, len(current))
                objects[number] = bool(inside), current
            case Remove(number):
                del objects[number]
            case Insert(index, x, y, side, occupied):
                assert index <= len(current)
                current.insert(index, (x, y, side, occupied))
            case Replace(index, x, y, side, occupied):
                current[index] = x, y, side, occupied
            case Delete(index):
                del current[index]
        assert len(current) <= longest
    assert len(current) == announced
    assert (packets == []) or (packets[-1] == Save() and packets.count(Save()) == 1)
    return dict(sorted(objects.items()))


def canonical(polygons: Polygons) -> list[tuple[bool, Cycle]]:
    """The objects, sorted, each from its smallest vertex on: independent of their order and of where they start."""
    cycles = []
    for inside, cycle in lists(
        NumberedPolygons(np.arange(polygons.objects, dtype=np.int32), polygons)
    ).values():
        first = cycle.index(min(cycle)) if cycle else 0
        cycles.append((inside, cycle[first:] + cycle[:first]))
    return sorted(cycles)


def layer(polygons: Polygons, drawing: Drawing = THESIS) -> Layer:
    """The claims of an approximation, shape (h, w)."""
    drawn = DrawnClaims(polygons.shape, drawing)
    drawn.update(Objects.of(polygons))
    return drawn.layer
