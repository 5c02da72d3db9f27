"""A robot that lies about its own map is contradicted, reported, and no longer believed; honest robots never are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.encodings.predictive import PredictiveEncoding
from agent.encodings.votes import MANY, Votes
from agent.process import AgentNode
from deploy.chaos.false_maps import LIES, with_false_map
from deploy.record.records import Records
from deploy.record.summary import summarize
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from protocol.boxes import whole_grid
from protocol.grid import FREE, OCCUPIED, UNKNOWN
from tests.system.team import small_plan

LYING = 1


def wrong_cells(plan: Plan, records: Records) -> int:
    """Wrong cells in the honest robots' maps where honest robots have been."""
    truth = np.where(plan.map.cells == FREE, FREE, OCCUPIED)
    honest = records.planning.keys() - {LYING}
    seen = np.logical_or.reduce([records.own[robot] != UNKNOWN for robot in honest])
    maps = [records.planning[robot] for robot in honest]
    return sum(np.count_nonzero(seen & (each != UNKNOWN) & (each != truth)) for each in maps)


def explored(plan: Plan) -> tuple[dict[str, Any], Records, list[AgentNode]]:
    """The summary and the records of a run, and the robots at its end."""
    run = MemoryRun(plan)
    records = run.complete()
    return summarize(plan, records, 1.0), records, run.agents


@pytest.mark.parametrize(
    ("lie", "map_encoding", "bandwidth"),
    [*((lie, "predictive", 50) for lie in LIES), ("walls", "scans", 20000), ("inverted", "cells", 2000)],
)
def test_a_lying_robot_is_reported_and_deceives_no_honest_one(
    lie: str, map_encoding: str, bandwidth: int
) -> None:
    plan = small_plan(robots=4, map_encoding=map_encoding, bandwidth=bandwidth, steps=1000, seed=3)
    summary, records, agents = explored(with_false_map(plan, LYING, lie))
    assert summary["finished"]
    assert summary["coverage"] > 0.97
    assert wrong_cells(plan, records) <= 20
    for agent in agents:
        assert agent.robot is not None
        assert agent.robot.disbelieved == (set() if agent.robot.settings.robot == LYING else {LYING})
    reports = [error for error in records.protocol_errors.texts if "false map" in error]
    assert {error.partition(":")[0] for error in reports} == {"r0", "r2", "r3"}
    assert all(f"from r{LYING}: this robot sees" in error for error in reports)


@pytest.mark.parametrize("map_encoding", ["predictive", "scans", "cells", "polygons"])
def test_honest_robots_are_believed_although_they_restart_and_frames_are_lost(map_encoding: str) -> None:
    restarts = [{"step": step, "robot": 2, "kind": "restart"} for step in (10, 20)]
    radio = {"loss": 0.2, "delay": 1}
    plan = small_plan(
        robots=3, map_encoding=map_encoding, bandwidth=2000, steps=60, seed=4, fault=restarts, radio=radio
    )
    _, records, agents = explored(plan)
    assert not records.protocol_errors.texts
    assert not any(agent.robot.disbelieved for agent in agents if agent.robot is not None)


def votes(robots: int = 4) -> Votes:
    return Votes(small_plan(robots=robots).robot_settings[0])


def reports(state: int, cells: int = MANY) -> tuple[Any, Any]:
    """The same report of the first cells of a map."""
    return np.arange(cells, dtype=np.int32), np.full(cells, state, np.uint8)


def test_a_cell_that_two_others_report_otherwise_does_not_count() -> None:
    counted = votes()
    counted.count(1, *reports(OCCUPIED))
    counted.count(2, *reports(FREE))
    assert counted.received[0, 0] == OCCUPIED, "one against one"
    counted.count(2, *reports(FREE))
    assert counted.received[0, 0] == OCCUPIED, "all maps of a robot are one voter"
    counted.count(3, *reports(FREE))
    assert counted.received[0, 0] == FREE
    counted.count(3, *reports(UNKNOWN))
    assert counted.received[0, 0] == OCCUPIED, "robot 3 has withdrawn its report"


def test_the_map_of_all_reports_has_every_wall_but_those_of_doubted_robots() -> None:
    counted = votes()
    counted.count(1, *reports(OCCUPIED, 1))
    counted.count(2, *reports(FREE, MANY))
    counted.count(3, *reports(FREE, MANY))
    expected = np.zeros_like(counted.received)
    expected[0, :MANY] = FREE
    assert (counted.received == expected).all()
    expected[0, 0] = OCCUPIED
    assert (counted.reported() == expected).all()
    counted.count(1, *reports(OCCUPIED, MANY))
    assert counted.judge(np.zeros_like(expected))
    expected[0, 0] = FREE
    assert (counted.reported() == expected).all()


@pytest.mark.parametrize("cells", [MANY - 1, MANY])
def test_a_robot_that_two_others_contradict_often_is_doubted(cells: int) -> None:
    counted = votes()
    nothing_seen = np.zeros_like(counted.received)
    counted.count(1, *reports(OCCUPIED, 2 * MANY))
    counted.count(2, *reports(FREE, cells))
    assert not counted.judge(nothing_seen), "one against one"
    counted.count(3, *(each[-cells:] for each in reports(FREE, 2 * MANY)))
    assert counted.judge(nothing_seen) == (cells == MANY)
    assert set(counted.doubted) == ({1} if cells == MANY else set())
    assert (counted.received[0, 0] == FREE) == (cells == MANY)
    assert counted.received[0, MANY] == (FREE if cells == MANY else OCCUPIED)
    counted.reset()
    assert not counted.doubted
    assert not counted.received.any()


def test_this_robots_own_sight_is_enough_to_doubt_two_robots_that_agree() -> None:
    counted = votes(5)
    for byzantine in (1, 2):
        counted.count(byzantine, *reports(FREE))
    for honest in (3, 4):
        counted.count(honest, *reports(OCCUPIED))
    own = np.zeros_like(counted.received)
    assert not counted.judge(own), "two against two"
    own[0, :MANY] = OCCUPIED
    assert counted.judge(own)
    assert set(counted.doubted) == {1, 2}
    assert counted.received[0, 0] == OCCUPIED


def most_likely(states: list[int]) -> int:
    """The state of a cell by one state per robot, in plain words: the slow reference of `Votes.unite`."""
    walls, free = states.count(OCCUPIED), states.count(FREE)
    if walls and not (walls == 1 and free >= 2):
        return OCCUPIED
    return FREE if free else UNKNOWN


@given(st.lists(st.lists(st.sampled_from([UNKNOWN, FREE, OCCUPIED]), min_size=5, max_size=5), min_size=1))
def test_with_noisy_lasers_a_robots_own_grid_is_one_vote(cells: list[list[int]]) -> None:
    """Per cell: what each of four robots has reported, then what robot 0 sees itself."""
    counted = votes(4)
    states = np.array(cells, np.uint8)
    for robot in range(4):
        counted.count(robot, np.arange(len(cells), dtype=np.int32), states[:, robot].copy())
    own, united = np.zeros_like(counted.received), np.full_like(counted.received, 9)
    own.flat[: len(cells)] = states[:, 4]
    counted.unite(own, whole_grid(own.shape), united)
    expected = [most_likely([seen or reported, *others]) for reported, *others, seen in cells]
    assert united.flat[: len(cells)].tolist() == expected
    assert (united.flat[len(cells) :] == UNKNOWN).all()


@pytest.mark.parametrize("laser", ["ideal", "utm-30lx"])
def test_two_other_robots_overrule_a_wall_that_this_robot_sees_if_its_laser_is_noisy(laser: str) -> None:
    settings = small_plan(robots=4, map_encoding="predictive", laser={"preset": laser}).robot_settings[0]
    encoding = PredictiveEncoding(settings)
    own = np.zeros_like(encoding.received)
    own[0, :MANY] = OCCUPIED
    assert (encoding.merge(own)[0, :MANY] == OCCUPIED).all()
    for robot in (1, 2):
        encoding.votes.count(robot, *reports(FREE, MANY // 2))
    encoding.received_changed((0, 0, MANY, 1))
    merged = encoding.merge(own)[0]
    assert (merged[: MANY // 2] == (OCCUPIED if laser == "ideal" else FREE)).all()
    assert (merged[MANY // 2 : MANY] == OCCUPIED).all()


@pytest.mark.long
@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("bandwidth", [50, 1000])
@pytest.mark.parametrize("seed", range(10))
def test_four_robots_in_an_office_finish_although_one_lies(lie: str, bandwidth: int, seed: int) -> None:
    scenario = parse({
        "map": "office", "map_seed": seed, "robots": 4, "bandwidth": bandwidth, "seed": seed, "bus": "memory",
        "steps": 3000,
    })  # fmt: skip
    plan = with_false_map(plans.make(scenario), LYING, lie)
    summary, records, _ = explored(plan)
    assert summary["finished"]
    assert summary["coverage"] > 0.97
    assert wrong_cells(plan, records) <= 100
