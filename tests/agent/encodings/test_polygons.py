"""The `polygons` encoding: when edits are logged, how receivers apply them, and each of its options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.encoding_options import THESIS_OPTIONS, PolygonOptions
from agent.encodings.catalog import make_encoding
from agent.encodings.polygons import PolygonEncoding
from agent.outline.approximation import repair
from agent.outline.claims import Drawing
from agent.outline.contour import contours
from agent.outline.merge import TeamMap, approximation_error
from agent.outline.objects import Objects
from agent.outline.polygons import Polygons
from agent.outline.simplify import refine
from agent.planning.small_frontiers import without_small_frontiers
from agent.settings import EncodingSettings, MediumSettings, ReplicationSettings, Settings
from protocol import packet_codec
from protocol.body import Body
from protocol.budget import UNLIMITED, Budget
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.packet_codec import decode, encode
from protocol.packets import Change, Delete, Fragment, Save
from protocol.scans import GridChange, Scan
from tests.agent.encodings.arrival import LATE
from tests.agent.explorations import Cell, exploration, growing_maps
from tests.agent.outline.edit_scripts import canonical

EXACT: dict[str, Any] = {"bandwidth": UNLIMITED}
NO_NEWS = GridChange(0, (0, 0, 0, 0))
DEFAULT_BANDWIDTH, DEFAULT_OPTIONS = Budget(1000), PolygonOptions()
WORLD_SEED, STEPS = 4, 25


def settings_of(
    shape: tuple[int, int],
    robot: int = 0,
    robots: int = 3,
    bandwidth: Budget = DEFAULT_BANDWIDTH,
    options: PolygonOptions = DEFAULT_OPTIONS,
    least: float = 0.0,
) -> Settings:
    return Settings(
        robot=robot, bodies=(Body(20.0, 360.0, 5.0),) * robots, width=shape[1], height=shape[0], beams=360,
        seed=0, strategy="meier", encoding=EncodingSettings("polygons", options),
        replication=ReplicationSettings("backoff"), medium=MediumSettings(bandwidth, 1000.0),
        min_frontier_cells=least,
    )  # fmt: skip


def maker(shape: tuple[int, int], robot: int = 0, **more: Any) -> PolygonEncoding:
    return PolygonEncoding(settings_of(shape, robot, **more))


def record(
    map_encoding: PolygonEncoding, grid: Grid, cell: Cell, *, news: bool = True, delivered: bool = True
) -> list[bytes]:
    height, width = grid.shape
    change = GridChange(1, (0, 0, width, height)) if news else NO_NEWS
    return map_encoding.encode_changes(grid, Scan(*cell, np.empty(0, np.uint16)), change, delivered=delivered)


def house() -> Grid:
    """Rooms, and pillars of one to four cells."""
    grid = np.full((60, 80), FREE, np.uint8)
    grid[0] = grid[-1] = grid[:, 0] = grid[:, -1] = OCCUPIED
    grid[20, :60] = grid[40, 25:] = OCCUPIED
    grid[1:40, 40] = OCCUPIED
    grid[8:12, 40] = grid[20, 10:14] = grid[30:33, 40] = FREE
    rng = np.random.default_rng(WORLD_SEED)
    for y, x in rng.integers((2, 2), (57, 77), (25, 2)).tolist():
        grid[y : y + 1 + x % 2, x : x + 1 + y % 2] = OCCUPIED
    return grid


def walk(steps: int = STEPS) -> list[tuple[Grid, Cell]]:
    return list(exploration(house(), np.random.default_rng(WORLD_SEED), steps, 20.0))


def is_exact(polygons: Polygons, grid: Grid, cell: Cell) -> bool:
    """Whether no edge can be split any further."""
    traced = contours(grid, cell)
    return len(refine(traced, repair(polygons, traced))) == len(polygons.x)


def reported(map_encoding: PolygonEncoding, steps: Sequence[tuple[Grid, Cell]]) -> list[list[bytes]]:
    return [record(map_encoding, grid, cell) for grid, cell in steps]


# --- encoding and decoding -----------------------------------------------------------------------------


@given(growing_maps(), st.sampled_from([UNLIMITED, Budget(50), Budget(2000)]))
def test_receivers_hold_the_authors_approximation_after_every_step(
    steps: list[tuple[Grid, Cell]], bandwidth: Budget
) -> None:
    shape = steps[0][0].shape
    one, other = maker(shape, 0, bandwidth=bandwidth), maker(shape, 1, bandwidth=bandwidth)
    for grid, cell in steps:
        entries = record(one, grid, cell)
        other.apply(0, b"".join(entries), **LATE)
        assert canonical(other.polygons[0]) == canonical(one.polygons[0])


@given(growing_maps(), st.sampled_from([UNLIMITED, Budget(50)]))
def test_where_robots_leave_small_frontiers_the_approximation_has_walls(
    steps: list[tuple[Grid, Cell]], bandwidth: Budget
) -> None:
    shape = steps[0][0].shape
    leaving, exploring = (maker(shape, bandwidth=bandwidth, least=least) for least in (3.0, 0.0))
    closed = [(without_small_frontiers(grid, 3.0), cell) for grid, cell in steps]
    assert reported(leaving, steps) == reported(exploring, closed)


def test_each_log_entry_is_one_packet_and_a_step_ends_with_a_save_point() -> None:
    for entries in reported(maker((60, 80)), walk()):
        sent = [packet_codec.decode(packet) for packet in entries]
        assert [len(packet) for packet in sent] == [1] * len(entries)
        assert [isinstance(packet, Save) for (packet,) in sent] == [False] * (len(sent) - 1) + [True] * bool(
            sent
        )


def test_entries_take_effect_at_the_save_point() -> None:
    one, other = maker((60, 80), 0), maker((60, 80), 1)
    for entries in reported(one, walk(6)):
        before = other.polygons.get(0)
        for packet in entries[:-1]:
            other.apply(0, packet, **LATE)
            assert other.polygons.get(0) is before
        other.apply(0, b"".join(entries[-1:]), **LATE)
    assert canonical(other.polygons[0]) == canonical(one.polygons[0])


def test_with_unlimited_bandwidth_and_alone_the_approximation_is_exact() -> None:
    alone: dict[str, Any] = {"robots": 1}
    for more, delivered in ((EXACT, True), (alone, False)):
        one = maker((60, 80), **more)
        for grid, cell in walk():
            record(one, grid, cell, delivered=delivered)
            assert is_exact(one.polygons[0], grid, cell)


@pytest.mark.parametrize(
    "option",
    [{"medium_use": 0.0}, {"medium_use": 1e18}, {"bytes_per_split": 1e-18}, {"bytes_per_split": -1.0}],
)
def test_an_option_that_would_break_the_splitting_frequency_is_refused(option: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(option))} = .*must be"):
        PolygonOptions(**option)


def test_a_step_without_new_cells_logs_nothing_once_the_approximation_is_exact() -> None:
    one = maker((60, 80), **EXACT)
    grid, cell = walk()[-1]
    assert record(one, grid, cell)
    assert record(one, grid, cell, news=False) == []
    assert record(one, grid, cell) == []


def test_a_step_without_new_cells_refines_at_the_splitting_frequency() -> None:
    one = maker((60, 80), bandwidth=Budget(300))
    grid, cell = walk()[-1]
    sizes = []
    for _ in range(200):
        record(one, grid, cell, news=not sizes)
        sizes.append(len(one.polygons[0].x))
    assert sizes[0] < sizes[5] < sizes[-1]
    assert sizes == sorted(sizes)
    assert is_exact(one.polygons[0], grid, cell)


def test_without_bandwidth_the_approximation_is_still_repaired() -> None:
    one = maker((60, 80), bandwidth=Budget(0), options=PolygonOptions(unknown_pairs=True))
    for grid, cell in walk():
        record(one, grid, cell)
    assert not is_exact(one.polygons[0], grid, cell)
    assert one.polygons[0].objects == contours(grid, cell).objects


def test_more_bandwidth_makes_a_smaller_error() -> None:
    grid = house()
    errors = []
    for bandwidth in (Budget(20), Budget(200), Budget(1000), UNLIMITED):
        one = maker((60, 80), bandwidth=bandwidth)
        for grid, cell in walk():
            record(one, grid, cell)
        errors.append(one.approximation_error(grid))
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 2 * errors[-1]


def test_bytes_per_split_are_measured_unless_given() -> None:
    fixed = PolygonOptions(bytes_per_split=1000.0)
    measured, given_ = (
        maker((60, 80), bandwidth=Budget(600)),
        maker((60, 80), bandwidth=Budget(600), options=fixed),
    )
    for grid, cell in walk():
        record(measured, grid, cell)
        record(given_, grid, cell)
    assert len(given_.polygons[0].x) < len(measured.polygons[0].x)


# --- merging -------------------------------------------------------------------------------------------


def test_the_planning_map_merges_all_approximations_with_the_self_explored_grid() -> None:
    shape = (60, 80)
    receiver = maker(shape, 2)
    team = TeamMap(Drawing(False, False, wide_walls=True, close_slivers=True))
    own, _ = walk(8)[-1]
    assert (receiver.merge(own) == own).all()
    for robot in (0, 1):
        steps = list(exploration(house(), np.random.default_rng(robot), 15, 20.0))
        sender = maker(shape, robot)
        for entries in reported(sender, steps):
            receiver.apply(robot, b"".join(entries), **LATE)
        team.update(robot, Objects.of(sender.polygons[robot]))
        assert (receiver.merge(own, (0, 1)) == team.merged(own)).all()
    assert (receiver.merge(own) == FREE).sum() > (own == FREE).sum()
    assert (receiver.merge(own)[own != UNKNOWN] == own[own != UNKNOWN]).all()


def test_robots_of_one_process_plan_as_if_each_were_alone() -> None:
    common: dict[str, Any] = {}
    alone, together = ([maker((60, 80), robot) for robot in range(3)] for _ in range(2))
    for each in together:
        each.use_shared_cache(common)
    for grid, cell in walk(12):
        for team in (alone, together):
            entries = record(team[0], grid, cell)
            team[1].apply(0, b"".join(entries), **LATE)
            for packet in entries:
                team[2].apply(0, packet, **LATE)
        for one, other in zip(alone, together, strict=True):
            assert one.merge(grid).tolist() == other.merge(grid).tolist()
            assert one.approximation_error(grid) == other.approximation_error(grid)


def test_the_error_includes_changes_that_are_not_logged_yet() -> None:
    one = maker((60, 80))
    (first, cell), *_, (last, _) = walk()
    assert one.approximation_error(first) == (first != UNKNOWN).sum()
    record(one, first, cell)
    drawing = Drawing(free_inside_edges=False, unknown_pairs=False)
    assert one.approximation_error(first) == approximation_error(first, one.polygons[0], drawing)
    assert one.approximation_error(last) > one.approximation_error(first)


# --- malformed data ------------------------------------------------------------------------------------------

MALFORMED = {
    "an object that is not there": [encode([Change(99, 2, 0)])],
    "a vertex of no object": [encode([Delete(0)])],
    "a second save point": [encode([Save()])],
    "a raw scan": [encode([Fragment(b"scan")])],
    "no packet": [6 * b"\xff"],
}


@pytest.mark.parametrize("entries", MALFORMED.values(), ids=MALFORMED)
def test_malformed_data_is_rejected_and_changes_nothing(entries: list[bytes]) -> None:
    one, other = maker((60, 80), 0), maker((60, 80), 1)
    *before, last = reported(one, walk(5))
    for sent in before:
        other.apply(0, b"".join(sent), **LATE)
    held, plan = other.polygons[0], other.merge(house())
    with pytest.raises(ProtocolError):
        other.apply(0, b"".join(entries), **LATE)
    assert other.polygons[0] is held
    assert (other.merge(house()) == plan).all()
    other.apply(0, b"".join(last), **LATE)
    assert canonical(other.polygons[0]) == canonical(one.polygons[0])


# --- options -------------------------------------------------------------------------------------------


def test_a_lazy_robot_logs_once_after_its_last_entries_were_delivered() -> None:
    first, *between, last = walk(6)
    lazy, eager = maker((60, 80)), maker((60, 80), options=PolygonOptions(lazy=False))
    for one in (lazy, eager):
        record(one, *first)
    waited = [record(lazy, *step, delivered=False) for step in between]
    hurried = [record(eager, *step, delivered=False) for step in between]
    assert waited == [[]] * len(between)
    assert all(hurried)
    at_once = record(lazy, *last)
    assert sum(map(len, at_once)) < sum(map(len, sum(hurried, record(eager, *last))))
    assert lazy.polygons[0].objects == contours(*last).objects


def test_edges_that_stand_for_walls_and_for_nothing_known_come_first_if_wished() -> None:
    grid, cell = walk()[-1]
    walls = {}
    for wished in (True, False):
        options = PolygonOptions(mixed_first=wished)
        one, other = (
            maker((60, 80), 0, bandwidth=Budget(200), options=options),
            maker((60, 80), 1, options=options),
        )
        for _ in range(6):
            other.apply(0, b"".join(record(one, grid, cell)), **LATE)
        walls[wished] = ((other.merge(np.zeros_like(grid)) == OCCUPIED) & (grid == OCCUPIED)).sum()
    assert walls[True] > walls[False]


def test_free_inside_edges_are_drawn_if_wished() -> None:
    grid, cell = walk(3)[-1]
    claims = {}
    for wished in (True, False):
        options = PolygonOptions(free_inside_edges=wished)
        one, other = (
            maker((60, 80), 0, bandwidth=Budget(100), options=options),
            maker((60, 80), 1, options=options),
        )
        other.apply(0, b"".join(record(one, grid, cell)), **LATE)
        claims[wished] = other.merge(np.zeros_like(grid)) == FREE
    assert claims[True].sum() > claims[False].sum()


def test_unknown_pairs_are_sent_and_drawn_only_if_enabled() -> None:
    grid = np.full((30, 30), FREE, np.uint8)
    grid[10, 10] = grid[20, 15] = UNKNOWN
    grid[5, 20] = OCCUPIED
    objects, free = {}, {}
    for wished in (True, False):
        options = PolygonOptions(unknown_pairs=wished, bytes_per_split=10.0, close_slivers=False)
        six_splits: dict[str, Any] = {"options": options, "bandwidth": Budget(3 * 2 * 10 * 6)}
        one, other = maker((30, 30), 0, **six_splits), maker((30, 30), 1, **six_splits)
        other.apply(0, b"".join(record(one, grid, (1, 1))), **LATE)
        objects[wished] = other.polygons[0].objects
        free[wished] = other.merge(np.zeros_like(grid))[10, 10]
    assert objects == {True: 4, False: 2}
    assert free == {True: UNKNOWN, False: FREE}


def test_walls_are_wide_if_wished_while_their_robot_is_in_range() -> None:
    grid, cell = walk()[-1]
    nothing = np.zeros_like(grid)
    walls = {}
    for wished in (True, False):
        options = PolygonOptions(wide_walls=wished)
        one, other = maker((60, 80), 0, options=options), maker((60, 80), 1, options=options)
        other.apply(0, b"".join(record(one, grid, cell)), **LATE)
        near, far = (int((other.merge(nothing, peers) == OCCUPIED).sum()) for peers in ((0,), (2,)))
        walls[wished] = near, far
    assert walls[True][0] > walls[True][1] == walls[False][0] == walls[False][1]


def test_slivers_are_closed_if_wished() -> None:
    grid = np.full((20, 20), UNKNOWN, np.uint8)
    left, right = grid.copy(), grid.copy()
    left[1:10, 1:8] = right[1:10, 9:16] = FREE
    free = {}
    for wished in (True, False):
        options = PolygonOptions(close_slivers=wished, wide_walls=False)
        one, other = maker((20, 20), 0, options=options), maker((20, 20), 1, options=options)
        other.apply(0, b"".join(record(one, left, (2, 2))), **LATE)
        free[wished] = other.merge(right)[1:10, 8].tolist()
    assert free == {True: [FREE] * 9, False: [UNKNOWN] * 9}


def test_the_thesis_plain_rules_are_a_set_of_options() -> None:
    assert asdict(THESIS_OPTIONS) == {
        "medium_use": 0.5, "bytes_per_split": 0.0, "lazy": False, "mixed_first": False,
        "value_function": "segment-distance", "free_inside_edges": True, "unknown_pairs": True,
        "wide_walls": False, "wide_seen_walls": True, "close_slivers": False,
        "keep_walls": False, "scan_order": False, "moving_starts": False,
        "splits_per_step": 0.0, "exact_error": False,
    }  # fmt: skip
    shape = (60, 80)
    one, other = (maker(shape, robot, options=THESIS_OPTIONS) for robot in (0, 1))
    for grid, cell in walk():
        other.apply(0, b"".join(record(one, grid, cell, delivered=False)), **LATE)
        assert canonical(other.polygons[0]) == canonical(one.polygons[0])


def test_moving_starts_cost_deletions_and_lead_to_the_same_map() -> None:
    scripts, maps = {}, {}
    for moving in (False, True):
        options = replace(THESIS_OPTIONS, moving_starts=moving)
        one, other = (maker((60, 80), robot, options=options, bandwidth=UNLIMITED) for robot in (0, 1))
        scripts[moving] = b"".join(b"".join(record(one, grid, cell)) for grid, cell in walk())
        other.apply(0, scripts[moving], **LATE)
        assert canonical(other.polygons[0]) == canonical(one.polygons[0])
        maps[moving] = other.merge(np.full((60, 80), UNKNOWN, np.uint8))
    assert (maps[True] == maps[False]).all()
    moved, kept = (
        sum(isinstance(packet, Delete) for packet in decode(scripts[moving])) for moving in (True, False)
    )
    assert moved > kept


@pytest.mark.parametrize(
    "wrong",
    [
        {"medium_use": 0.0},
        {"medium_use": float("nan")},
        {"medium_use": float("inf")},
        {"bytes_per_split": -1.0},
    ],
)
def test_options_without_meaning_are_refused(wrong: dict[str, float]) -> None:
    (name,) = wrong
    with pytest.raises(ValueError, match=f"{name} = .*: must be "):
        PolygonOptions(**wrong)


def test_the_polygon_encoding_is_found_by_its_name() -> None:
    assert isinstance(make_encoding(settings_of((9, 9))), PolygonEncoding)
