"""Whole runs in one process, and two robots that walk apart and back over the real radio."""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.radio_events import continue_round, open_round
from agent.replication.base import Replication
from deploy.record.records import Records
from deploy.record.summary import digest
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from netshaper.ledger import CAUSES, DATA, balance
from netshaper.settings import RadioSettings
from protocol import packet_codec, packet_index, packets
from protocol.budget import UNLIMITED, Budget
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.messages import MediumEvent, Open, OutgoingFrame, PhaseDelivery, RobotFrames, RoundReport
from tests.agent.replication.network import make_engine
from tests.netshaper.network import Network
from worldsim import generators
from worldsim.maps import Map

SMALL = {
    "map": "office", "robots": 3, "map_encoding": "scans", "bandwidth": "unlimited", "range": "100%",
    "sensor_range": 4.0, "bus": "memory", "steps": 3000,
}  # fmt: skip


@cache
def small_map(name: str, seed: int = 1) -> Map:
    return generators.make(name, seed=seed, resolution=0.25)


def small_plan(**more: Any) -> Plan:
    scenario = parse(SMALL | more)
    return plans.make(scenario, small_map(scenario.map))


@cache
def small_run(**more: Any) -> tuple[Plan, Records]:
    plan = small_plan(**more)
    return plan, MemoryRun(plan).complete()


def poses(records: Records) -> list[NDArray[np.int32]]:
    """Rows (robot, x mm, y mm, heading) of each step."""
    return [np.frombuffer(report.poses, "<i4").reshape(-1, 4) for report in records.world]


def check_finished(plan: Plan, records: Records) -> None:
    """All reachable cells were seen, the first robot to finish knows them, and no map has a wrong cell."""
    assert records.end is not None
    assert records.end.first >= 0, records.end.reason
    reachable = plan.make_world().reachable
    assert records.world[-1].seen == records.world[-1].reachable == np.count_nonzero(reachable)
    known = records.planning[records.end.first]
    assert (known[reachable] == FREE).all()
    for grid in (*records.own.values(), *records.planning.values()):
        assert (plan.map.cells[grid == FREE] == FREE).all()
        assert (plan.map.cells[grid == OCCUPIED] != FREE).all()
    assert records.protocol_errors.texts == []
    assert records.lost == {}


def check_bodies(plan: Plan, records: Records) -> None:
    """No robot stands in a wall or in another robot's cell, and none exceeds its speed."""
    cell = 1000 * plan.map.resolution
    speed = max(body.speed for body in plan.world.bodies)
    for before, now in zip([None, *poses(records)], poses(records), strict=False):
        cells = [(round(x / cell), round(y / cell)) for _, x, y, _ in now]
        assert all(plan.map.cells[y, x] == FREE for x, y in cells)
        assert len(set(cells)) == len(cells)
        if before is not None:
            places = {int(robot): (x, y) for robot, x, y, _ in before}
            for robot, x, y, _ in now:
                assert math.dist(places[int(robot)], (x, y)) / cell <= speed + math.sqrt(2) + 1e-6


def check_books(plan: Plan, records: Records) -> None:
    """In every step the traffic is within the budget and the ledger balances to the byte."""
    budget = plan.radio.budget
    for sent, carried, cut, received in balance(records.ledger()).values():
        assert sent == carried + cut
        assert budget.fits(carried)
        assert received <= carried
    ledger = records.ledger()
    unicast = (ledger["receiver"] >= 0) & (ledger["carried"] == 1)
    assert (ledger["received_by"][unicast] == 1).all()
    assert not (ledger["cause"] == CAUSES.index("protocol")).any()


RUNS = [
    {"robots": 1},
    {"robots": 2, "map": "leader-rooms", "sensor_range": 1.5},
    {"robots": 4, "bandwidth": 1000},
    {"robots": 3, "bandwidth": 0},
    {"robots": 3, "range": "20%", "bandwidth": 1000, "map": "mixed"},
    {"robots": 3, "range": 0},
    {"robots": 3, "map_encoding": "none"},
    {"robots": 2, "rounds": 1, "bandwidth": 5000},
    {"robots": 3, "dissemination": "thesis", "bandwidth": 1000, "map": "leader-rooms", "sensor_range": 2.0},
    {"robots": 2, "field_of_view": 180.0, "map": "leader-rooms"},
    {"robots": 2, "speed": 0.1, "map": "leader-rooms"},
    {"robots": 4, "interference": 1.5, "map": "leader-rooms"},
]


@pytest.mark.parametrize("more", RUNS, ids=str)
def test_a_team_explores_all_reachable_cells_and_its_first_robot_knows_them(more: dict[str, Any]) -> None:
    plan, records = small_run(**more)
    check_finished(plan, records)
    check_bodies(plan, records)
    check_books(plan, records)


def test_robots_with_different_sensors_and_speeds_explore_together() -> None:
    plan = small_plan()
    scenario = parse(
        SMALL | {"robot": [{"robot": 1, "speed": 1.0, "sensor_range": 1.0}, {"robot": 2, "speed": 0.2}]}
    )
    plan = plans.make(scenario, plan.map)
    records = MemoryRun(plan).complete()
    check_finished(plan, records)
    check_bodies(plan, records)
    slow, fast = records.world[-1].driven[2], records.world[-1].driven[1]
    assert slow <= 200 * records.step + 1
    assert fast > slow


def test_three_robots_are_faster_than_one() -> None:
    assert small_run(robots=3)[1].step < 0.75 * small_run(robots=1)[1].step


def test_with_a_budget_of_a_kilobyte_no_step_carries_more() -> None:
    _, records = small_run(robots=4, bandwidth=1000)
    carried = [carried for _, carried, _, _ in balance(records.ledger()).values()]
    assert max(carried) <= 1000
    assert max(carried) > 900


def test_without_a_budget_nothing_is_cut() -> None:
    _, records = small_run(robots=3)
    assert records.ledger()["carried"].all()


def test_without_reach_or_bandwidth_nothing_arrives() -> None:
    for more in (
        {"robots": 3, "range": 0},
        {"robots": 3, "bandwidth": 0},
        {"robots": 3, "map_encoding": "none"},
    ):
        _, records = small_run(**more)
        ledger = records.ledger()
        assert not ((ledger["carried"] == 1) & (ledger["frame"] == DATA)).any()
        for robot in range(3):
            assert (records.planning[robot] == records.own[robot]).all()
    assert not (small_run(robots=3, range=0)[1].ledger()["received_by"] > 0).any()


def test_two_runs_of_one_scenario_differ_only_in_computing_time() -> None:
    more = {"robots": 4, "bandwidth": 1000}
    _, first = small_run(**more)
    second = MemoryRun(small_plan(**more)).complete()
    assert first.rows == second.rows
    assert first.world == second.world
    assert first.end == second.end
    for one, other in zip(first.statuses, second.statuses, strict=True):
        assert [replace(report, work_us=0) for report in one] == [
            replace(report, work_us=0) for report in other
        ]
    assert digest(first) == digest(second)
    assert digest(small_run(robots=2, map="leader-rooms", sensor_range=1.5, seed=1)[1]) != digest(
        small_run(robots=2, map="leader-rooms", sensor_range=1.5)[1]
    )


def test_watching_a_run_does_not_change_it() -> None:
    steps: list[int] = []
    more = {"robots": 2, "map": "leader-rooms", "sensor_range": 1.5}
    watched = MemoryRun(small_plan(**more)).complete(lambda records: steps.append(records.step))
    assert digest(watched) == digest(small_run(**more)[1])
    assert steps == list(range(1, watched.step + 1))


def test_the_others_explore_the_rest_after_a_robot_breaks_down() -> None:
    deaths = [{"robot": robot, "step": step, "kind": "death"} for robot, step in ((0, 5), (2, 1))]
    plan = plans.make(parse(SMALL | {"fault": deaths}), small_map("leader-rooms"))
    records = MemoryRun(plan).complete()
    check_bodies(plan, records)
    check_books(plan, records)
    assert records.end is not None
    assert records.end.first == 1
    assert records.world[-1].seen == records.world[-1].reachable
    alive = [[int(robot) for robot in rows[:, 0]] for rows in poses(records)]
    assert alive == 4 * [[0, 1]] + (records.step - 4) * [[1]]
    assert set(records.own) == {0, 1, 2}
    assert records.lost == {}


def test_a_run_ends_when_all_robots_have_broken_down() -> None:
    plan = plans.make(
        parse(SMALL | {"robots": 1, "fault": [{"robot": 0, "step": 5, "kind": "death"}]}), small_map("office")
    )
    records = MemoryRun(plan).complete()
    assert records.end is not None
    assert (records.end.reason, records.end.first) == ("all robots are lost", -1)


@st.composite
def floors(draw: st.DrawFn) -> Map:
    """Random floors of all kinds, with their free cells in one or in many parts."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    height, width = rng.integers(3, 26, 2)
    walls = draw(st.sampled_from((0.0, 0.15, 0.35)))
    cells: Grid = rng.choice(
        np.array([UNKNOWN, FREE, OCCUPIED], np.uint8),
        (height, width),
        p=[walls / 3, 1 - walls, 2 * walls / 3],
    )
    cells[height // 2 - 1 : height // 2 + 2, width // 2 - 1 : width // 2 + 2] = FREE
    return Map("floor", cells, 0.5)


@settings(max_examples=max(10, settings().max_examples // 10))
@given(
    floors(),
    st.integers(1, 4),
    st.sampled_from(("unlimited", 0, 200, 3000)),
    st.sampled_from(("0", "25%", "100%")),
    st.sampled_from((1.0, 2.5, 20.0)),
    st.integers(0, 1000),
)
def test_any_floor_is_explored_by_any_team(
    floor: Map, robots: int, bandwidth: Any, reach: str, sensor_range: float, seed: int
) -> None:
    scenario = parse(SMALL | {
        "robots": robots, "bandwidth": bandwidth, "range": reach, "sensor_range": sensor_range, "seed": seed,
        "start": [floor.width / 4, floor.height / 4], "start_spacing": 0.5, "steps": 4000,
    })  # fmt: skip
    reachable = int(np.count_nonzero(floor.cells == FREE))
    if reachable < 9 + robots:
        return
    plan = plans.make(scenario, floor)
    records = MemoryRun(plan).complete()
    check_finished(plan, records)
    check_bodies(plan, records)
    check_books(plan, records)


def test_a_team_with_more_robots_than_map_ids_runs_without_sharing_maps() -> None:
    records = MemoryRun(small_plan(robots=66, steps=3, map_encoding="none")).complete()
    assert records.step == 3
    assert not records.lost


# Two replication engines and the real radio, without robots' bodies.


class Pair:
    """Replication engines of two robots that append an entry each per step, wherever they are."""

    def __init__(self, range_cells: float, budget: Budget) -> None:
        self.engines = [
            make_engine(robot, 2, lambda *received: packet_index.ends(received[-1])) for robot in range(2)
        ]
        members = {robot: partial(self.respond, engine) for robot, engine in enumerate(self.engines)}
        self.network = Network(RadioSettings(2, 0, range_cells, budget), members)
        self.logged = [0, 0]

    @staticmethod
    def respond(engine: Replication, event: MediumEvent) -> list[RobotFrames]:
        if isinstance(event, Open):
            return [open_round(engine, event)]
        if isinstance(event, PhaseDelivery):
            return [continue_round(engine, event, pytest.fail)]
        if isinstance(event, RoundReport):
            assert not engine.close_round(event)
        return []

    def step(self, number: int, cells: dict[int, tuple[int, int]]) -> NDArray[np.void]:
        """Play one step; return its ledger."""
        for robot, engine in enumerate(self.engines):
            engine.own_log.append([self.entry(robot, self.logged[robot])])
            self.logged[robot] += 1
        return self.network.step(number, cells).rows

    def entry(self, robot: int, number: int) -> bytes:
        return packet_codec.encode([packets.Fragment(bytes([robot, number % 256, number // 256]))])

    def holds(self, robot: int, map_id: int) -> int:
        """The length of a robot's copy of a log; checks its entries."""
        log = self.engines[robot].logs[map_id]
        assert log.read(0) == b"".join(self.entry(map_id, n) for n in range(len(log)))
        return len(log)


@pytest.mark.parametrize("budget", [UNLIMITED, Budget(40)])
def test_two_robots_that_walk_apart_and_back_receive_entries_only_in_range(budget: Budget) -> None:
    pair = Pair(10.0, budget)
    distances = [*range(21), *range(20, 0, -1), *20 * [1]]
    together = 0
    for number, distance in enumerate(distances, 1):
        before = pair.holds(0, 1), pair.holds(1, 0)
        rows = pair.step(number, {0: (0, 0), 1: (distance, 0)})
        now = pair.holds(0, 1), pair.holds(1, 0)
        assert not pair.network.radio.protocol_errors
        if distance > 10:
            assert now == before
            assert len(rows) == 0
        else:
            together += 1
            assert now > before
        if budget != UNLIMITED:
            assert budget.fits(int(rows["bytes"][rows["carried"] == 1].sum()))
        elif distance <= 10:
            assert now == (number, number)
    # Entries that were logged out of range have arrived, each once.
    assert together == 41
    assert (pair.holds(0, 1), pair.holds(1, 0)) == (len(distances), len(distances))


def test_a_frame_to_a_robot_out_of_range_is_not_delivered() -> None:
    def insistent(event: MediumEvent) -> list[RobotFrames]:
        if not isinstance(event, Open):
            return []
        offer = OutgoingFrame(1, packet_codec.encode([packets.Offer(0, 0)]))
        return [RobotFrames(event.step, event.round, "offers", frames=[offer])]

    def silent(event: MediumEvent) -> list[RobotFrames]:
        return [RobotFrames(event.step, event.round, "offers")] if isinstance(event, Open) else []

    network = Network(RadioSettings(2, 0, 10.0, UNLIMITED, 1), {0: insistent, 1: silent})
    step = network.step(1, {0: (0, 0), 1: (11, 0)})
    assert [event.peers for _, event in step.opened] == [[], []]
    assert step.delivered == []
    assert [CAUSES[row["cause"]] for row in step.rows] == ["range"]
