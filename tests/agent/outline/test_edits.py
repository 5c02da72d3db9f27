"""Edit scripts: they lead from one approximation to the next, at the fewest bytes."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from agent.outline.approximation import approximation, repair
from agent.outline.contour import contours
from agent.outline.edits import NumberedPolygons, edit_packets
from agent.outline.polygons import Polygons
from agent.outline.simplify import refine
from protocol.grid import FREE, UNKNOWN, Grid
from protocol.packet_codec import encode
from protocol.packets import Change, Delete, Edit, Emerge, Insert, Remove, Replace, Save
from tests.agent.explorations import Cell, exploration, growing_maps, real_map
from tests.agent.outline.edit_scripts import Cycle, Symbol, canonical, edit_script, lists, packed

quick = settings(deadline=None)

SHAPE = (8, 8)


def polygons(cycles: list[Cycle], inside: list[bool] | None = None) -> Polygons:
    """Put polygons together from (x, y, side, occupied); the first is the inside one by default."""
    start = np.cumsum([0, *map(len, cycles)]).astype(np.int32)
    flags = np.arange(len(cycles)) == 0 if inside is None else np.array(inside, np.bool_)
    return Polygons(SHAPE, packed([symbol for cycle in cycles for symbol in cycle]), start, flags)


def size(packets: list[Edit]) -> int:
    return sum(packet.size for packet in packets)


def fewest_bytes(old: Cycle, new: Cycle, *, shifts: bool = True) -> int:
    """Minimum edit distance in bytes, by the full table (Algorithm 4), over all turns of the new cycle."""
    best = Delete.size * len(old) + Insert.size * len(new)
    for turn in range(len(new) if shifts else 1):
        turned = new[turn:] + new[:turn]
        row = [Insert.size * j for j in range(len(turned) + 1)]
        for i, symbol in enumerate(old, 1):
            last, row = row, [Delete.size * i]
            for j, other in enumerate(turned, 1):
                row.append(
                    min(
                        last[j] + Delete.size,
                        row[j - 1] + Insert.size,
                        last[j - 1] + (0 if symbol == other else Replace.size),
                    )
                )
        best = min(best, row[-1])
    return best


@st.composite
def cycles(draw: st.DrawFn, pool: list[tuple[int, int, int]], min_size: int = 2) -> Cycle:
    """Some vertices of a pool, each once, in any order or in the pool's."""
    chosen = draw(st.lists(st.sampled_from(range(len(pool))), min_size=min_size, max_size=9, unique=True))
    if draw(st.booleans()):
        chosen.sort()
    seldom_occupied = st.integers(0, 3).map(lambda n: int(n == 0))
    return [(*pool[i], draw(seldom_occupied)) for i in chosen]


POOL = [(x, y, side) for y in range(2) for x in range(2) for side in range(4)]


@st.composite
def approximations(draw: st.DrawFn) -> Polygons:
    """Up to three polygons without a common vertex, of vertices of a small world."""
    owner = draw(st.lists(st.integers(0, 2), min_size=len(POOL), max_size=len(POOL)))
    pools = [[vertex for vertex, o in zip(POOL, owner, strict=True) if o == k] for k in range(3)]
    return polygons([draw(cycles(pool)) for pool in pools if len(pool) >= 2])


@quick
@given(st.lists(approximations(), min_size=1, max_size=5))
def test_the_script_turns_one_approximation_into_the_next(steps: list[Polygons]) -> None:
    held = NumberedPolygons.empty(SHAPE)
    for step in steps:
        _, after = edit_script(held, step)
        assert canonical(after.polygons) == canonical(step)
        assert (np.diff(after.number) > 0).all()
        held = after


@quick
@given(cycles(POOL), cycles(POOL), st.booleans())
def test_no_shorter_script_leads_from_one_object_to_another(old: Cycle, new: Cycle, turned: bool) -> None:
    assume({symbol[:3] for symbol in old} & {symbol[:3] for symbol in new})
    held = NumberedPolygons(np.zeros(1, np.int32), polygons([old]))
    packets, _ = edit_script(held, polygons([new], [not turned]))
    if fewest_bytes(old, new) == 0 and not turned:
        assert packets == []
    else:
        anew = Remove.size + Emerge.size + Insert.size * len(new)
        assert size(packets) == min(Change.size + fewest_bytes(old, new), anew) + Save.size


@quick
@given(cycles(POOL), cycles(POOL))
def test_no_shorter_script_leads_to_a_list_whose_start_is_given(old: Cycle, new: Cycle) -> None:
    assume({symbol[:3] for symbol in old} & {symbol[:3] for symbol in new})
    held = NumberedPolygons(np.zeros(1, np.int32), polygons([old]))
    packets, after = edit_script(held, polygons([new]), shifts=False)
    fewest = fewest_bytes(old, new, shifts=False)
    anew = Remove.size + Emerge.size + Insert.size * len(new)
    assert size(packets) == (min(Change.size + fewest, anew) + Save.size if fewest else 0)
    assert [cycle for _, cycle in lists(after).values()] == [new]


def test_a_start_that_moves_costs_deletions_and_insertions() -> None:
    ring: Cycle = [(*vertex, 0) for vertex in POOL[:6]]
    held = NumberedPolygons(np.zeros(1, np.int32), polygons([ring]))
    turned = polygons([ring[2:] + ring[:2]])
    assert edit_packets(held, turned) == []
    packets, _ = edit_script(held, turned, shifts=False)
    assert [type(packet) for packet in packets] == [Change, *[Delete] * 2, *[Insert] * 2, Save]


@quick
@given(approximations(), st.data())
def test_turning_and_reordering_the_polygons_costs_nothing(step: Polygons, data: st.DataObject) -> None:
    _, held = edit_script(NumberedPolygons.empty(SHAPE), step)
    order = data.draw(st.permutations(range(step.objects)))
    rows = [lists(held)[k] for k in order]
    turns = [data.draw(st.integers(0, len(cycle) - 1)) for _, cycle in rows]
    turned = [cycle[turn:] + cycle[:turn] for (_, cycle), turn in zip(rows, turns, strict=True)]
    packets, after = edit_script(held, polygons(turned, [inside for inside, _ in rows]))
    assert packets == []
    assert lists(after) == lists(held)


@pytest.mark.parametrize("length", [2, 4, 6])
def test_no_shorter_script_leads_to_any_order_of_the_same_vertices(length: int) -> None:
    old: Cycle = [(*vertex, 0) for vertex in POOL[:length]]
    held = NumberedPolygons(np.zeros(1, np.int32), polygons([old]))
    for order in permutations(old):
        packets, _ = edit_script(held, polygons([list(order)]))
        fewest = fewest_bytes(old, list(order))
        assert size(packets) == (Change.size + fewest + Save.size if fewest else 0)


def test_a_vertex_between_deleted_and_inserted_ones_is_replaced_too() -> None:
    def vertex(i: int) -> Symbol:
        return i % 8, i // 8, 0, 0

    between, anchor = vertex(0), [vertex(i) for i in range(1, 20)]
    old = [*anchor, *(vertex(i) for i in range(20, 28)), between]
    new = [*anchor, between, *(vertex(i) for i in range(30, 38))]
    packets, _ = edit_script(NumberedPolygons(np.zeros(1, np.int32), polygons([old])), polygons([new]))
    assert size(packets) == Change.size + fewest_bytes(old, new) + Save.size
    assert not [packet for packet in packets if isinstance(packet, Insert | Delete)]


def test_the_part_of_a_split_object_with_the_largest_saving_keeps_the_number() -> None:
    row = [(x, 0, 0, 0) for x in range(8)]
    column = [(0, y, 1, 0) for y in range(1, 4)]
    whole = NumberedPolygons(np.array([7], np.int32), polygons([row + column]))
    packets, parted = edit_script(whole, polygons([column, row]))
    assert [type(packet) for packet in packets] == [Change, *[Delete] * 3, Emerge, *[Insert] * 3, Save]
    assert {n: cycle for n, (_, cycle) in lists(parted).items()} == {0: column, 7: row}
    packets, _ = edit_script(parted, whole.polygons)
    assert [type(packet) for packet in packets] == [Remove, Change, *[Insert] * 3, Save]


def test_a_new_object_takes_the_lowest_free_number() -> None:
    squares = [[(x, y, 0, 0), (x, y, 1, 0)] for y in range(3) for x in range(2)]
    _, held = edit_script(NumberedPolygons.empty(SHAPE), polygons(squares[:4]))
    assert held.number.tolist() == [0, 1, 2, 3]
    packets, after = edit_script(held, polygons([squares[0], squares[3], *squares[4:]]))
    assert [p for p in packets if isinstance(p, Remove)] == [Remove(1), Remove(2)]
    assert [p.object for p in packets if isinstance(p, Emerge)] == [1, 2]
    assert after.number.tolist() == [0, 1, 2, 3]


def test_in_scan_order_a_new_object_changes_the_index_of_all_behind_it() -> None:
    squares = [[(x, y, 0, 0), (x, y, 1, 0)] for y in range(3) for x in range(2)]
    _, held = edit_script(NumberedPolygons.empty(SHAPE), polygons([squares[0], *squares[2:]]))
    kept, same = edit_script(held, polygons(squares))
    packets, after = edit_script(held, polygons(squares), scan_order=True)
    assert not [packet for packet in kept if isinstance(packet, Change)]
    assert [packet for packet in packets if isinstance(packet, Change)] == [
        Change(number, 2, False) for number in range(1, 5)
    ]
    assert [packet for packet in packets if not isinstance(packet, Change)] == kept
    assert canonical(after.polygons) == canonical(same.polygons)


def assert_scripts_lead_through(steps: list[tuple[Grid, Cell]], splits: int | None) -> None:
    held = NumberedPolygons.empty(steps[0][0].shape)
    for grid, robot in steps:
        exact = contours(grid, robot)
        coarse = approximation(exact, refine(exact, repair(held.polygons, exact), splits))
        packets, after = edit_script(held, coarse)
        assert canonical(after.polygons) == canonical(coarse)
        assert canonical(edit_script(held, coarse, scan_order=True)[1].polygons) == canonical(coarse)
        assert canonical(edit_script(held, coarse, shifts=False)[1].polygons) == canonical(coarse)
        assert edit_packets(held, coarse) == [encode([packet]) for packet in packets]
        held = after


@quick
@given(growing_maps(), st.sampled_from([0, 1, 3, None]))
def test_scripts_follow_growing_maps(steps: list[tuple[Grid, Cell]], splits: int | None) -> None:
    assert_scripts_lead_through(steps, splits)


@pytest.mark.parametrize(("name", "splits"), [("intel", 2), ("aces", None)])
def test_scripts_follow_real_explorations(name: str, splits: int | None) -> None:
    steps = exploration(real_map(name), np.random.default_rng(4), 80, 40.0)
    assert_scripts_lead_through(list(steps), splits)


def test_objects_at_the_limits_of_the_packets_are_edited() -> None:
    grid = np.full((21, 2048), FREE, np.uint8)
    grid[:6, ::2] = grid[-6:, ::2] = UNKNOWN
    assert_scripts_lead_through([(np.full_like(grid, FREE), (0, 10)), (grid, (0, 10))], None)
