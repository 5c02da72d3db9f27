"""Faults of a scenario: kills, restarts, stops and radio failures, the same on both buses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.run.exit_codes import EXPLORED
from deploy.run.exploration import explore
from deploy.run.result import Result
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import parse
from protocol.grid import FREE
from worldsim import maps
from worldsim.maps import Map


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Three rooms in a row, with doors."""
    truth = np.full((26, 62), 2, np.uint8)
    for room in range(3):
        truth[1:-1, 1 + 20 * room : 20 + 20 * room] = FREE
    truth[12:14, 20] = truth[12:14, 40] = FREE
    path = tmp_path_factory.mktemp("floor") / "floor.yaml"
    maps.save(Map("floor", truth, 0.25), path)
    return str(path)


def run(floor: str, *faults: tuple[Any, ...], out: Path | None = None, **settings: Any) -> Result:
    tables = [dict(zip(("step", "robot", "kind", "steps"), fault, strict=False)) for fault in faults]
    given = {"map": floor, "robots": 3, "sensor_range": 2.5, "bus": "memory", "steps": 120, "fault": tables}
    return explore(parse(given | settings), out=out, keep=out is not None)


def report_steps(result: Result, robot: int) -> list[int]:
    """Return the steps in which a robot reported its status."""
    return [report.step for report in result.records.statuses[robot]]


EVERYTHING = (
    (5, 1, "kill"), (9, 2, "stop", 6), (12, 1, "restart"), (14, 0, "mute", 5), (16, 2, "deaf", 5), (20, 0, "restart"),
)  # fmt: skip


@pytest.mark.parametrize("map_encoding", ["polygons", "scans", "predictive"])
@pytest.mark.parametrize("dissemination", ["backoff", "gossip"])
def test_a_run_with_all_kinds_of_faults_ends_explored_and_repeats(
    floor: str, map_encoding: str, dissemination: str
) -> None:
    runs = [
        run(
            floor,
            *EVERYTHING,
            map_encoding=map_encoding,
            dissemination=dissemination,
            bandwidth=20000,
            steps=400,
        )
        for _ in range(2)
    ]
    assert runs[0].exit_code == EXPLORED
    assert runs[0].summary["coverage"] > 0.97
    assert not runs[0].records.protocol_errors.texts
    assert runs[0].summary["digest"] == runs[1].summary["digest"]


def test_processes_with_all_kinds_of_faults_give_the_digest_of_memory(floor: str, tmp_path: Path) -> None:
    memory = run(floor, *EVERYTHING, map_encoding="predictive", dissemination="gossip")
    zenoh = run(
        floor,
        *EVERYTHING,
        map_encoding="predictive",
        dissemination="gossip",
        bus="zenoh",
        out=tmp_path / "run",
    )
    assert zenoh.summary["digest"] == memory.summary["digest"]
    assert (zenoh.exit_code, zenoh.deaths, zenoh.records.lost) == (memory.exit_code, {}, {})
    assert {path.name for path in (tmp_path / "run" / "journals").iterdir()} == {
        "r0.journal", "r1.journal", "r2.journal",
    }  # fmt: skip


def test_killed_robot_sends_no_status_and_no_map(floor: str) -> None:
    result = run(floor, (10, 1, "kill"))
    assert max(report_steps(result, 1)) == 9
    assert sorted(result.records.own) == [0, 2]
    assert result.exit_code == EXPLORED
    assert result.records.killed == {1}


@pytest.mark.parametrize("dissemination", ["backoff", "thesis", "gossip"])
@pytest.mark.parametrize("map_encoding", ["polygons", "scans", "predictive", "zstd-maps"])
def test_restarted_robot_recovers_from_teammates_what_it_had_sent(
    floor: str, map_encoding: str, dissemination: str
) -> None:
    settings = {"map_encoding": map_encoding, "dissemination": dissemination, "bandwidth": "unlimited"}
    before = run(floor, steps=20, **settings).records
    after = run(floor, (20, 1, "restart"), steps=30, **settings).records
    sent = (before.planning[0] == FREE) & (before.own[1] == FREE) & (before.own[0] != FREE)
    assert sent.sum() > 50
    assert ((after.planning[1] == FREE) & sent).sum() >= 0.97 * sent.sum()
    assert ((after.own[1] == FREE) & sent).sum() < sent.sum()


def test_restart_costs_no_byte_before_it_occurs(floor: str) -> None:
    def carried(*faults: tuple[Any, ...], dissemination: str, map_encoding: str) -> list[tuple[int, int]]:
        ledger = run(floor, *faults, steps=20, dissemination=dissemination, map_encoding=map_encoding).ledger
        return ledger.filter(ledger["step"] < 20).select("step", "bytes").rows()

    for dissemination in ("backoff", "gossip"):
        for map_encoding in ("polygons", "predictive"):
            plain = carried(dissemination=dissemination, map_encoding=map_encoding)
            assert (
                carried((20, 1, "restart"), dissemination=dissemination, map_encoding=map_encoding) == plain
            )


def test_stopped_robot_continues_at_the_same_place(floor: str) -> None:
    result = run(floor, (10, 1, "stop", 5))
    assert not {10, 11, 12, 13, 14} & set(report_steps(result, 1))
    assert {9, 15} <= set(report_steps(result, 1))
    places = result.steps.filter(result.steps["robot"] == 1).rows_by_key("step", named=True)
    assert len({(row["x"], row["y"]) for step in range(9, 15) for row in places[step]}) == 1


def test_ledger_marks_frames_of_a_mute_robot_and_a_deaf_robot_receives_none(floor: str) -> None:
    ledger = run(floor, (5, 1, "mute", 10), (20, 2, "deaf", 10), steps=40).ledger
    mute = ledger.filter((ledger["sender"] == 1) & ledger["step"].is_between(5, 14))
    assert len(mute)
    assert not mute["carried"].any()
    assert set(mute["cause"]) == {"mute"}
    deaf = ledger.filter((ledger["receiver"] == 2) & ledger["step"].is_between(20, 29))
    assert not deaf["carried"].any()
    others = ledger.filter(~ledger["step"].is_between(5, 29))
    assert others.filter(others["sender"] == 1)["carried"].any()


@pytest.mark.parametrize("dissemination", ["backoff", "gossip"])
def test_robot_receives_missed_updates_after_it_was_deaf(floor: str, dissemination: str) -> None:
    records = run(
        floor,
        (5, 2, "deaf", 20),
        map_encoding="predictive",
        dissemination=dissemination,
        bandwidth=20000,
        steps=40,
    ).records
    others = (records.own[0] == FREE) | (records.own[1] == FREE)
    assert (records.planning[2] == FREE)[others].mean() > 0.97
    assert (records.own[2] == FREE)[others].mean() < 0.9


def test_one_restarted_robot_finishes_after_all_were_killed(floor: str) -> None:
    result = run(floor, (10, 0, "kill"), (10, 1, "kill"), (10, 2, "kill"), (15, 2, "restart"), steps=600)
    assert result.exit_code == EXPLORED
    assert result.summary["first_robot"] == 2


INVALID = [
    ([(5, 3, "kill")], r"fault at step 5: kill of robot 3: the last robot is 2"),
    ([(5, 1, "kill"), (9, 1, "stop")], r"fault at step 9: stop of robot 1: it is gone by then \(kill\)"),
    ([(5, 1, "death"), (9, 1, "restart")], r"it is gone by then \(death\)"),
    ([(5, 1, "kill"), (5, 1, "restart")], r"it has kill in the same step"),
    ([(5, 1, "mute"), (5, 1, "mute")], r"it has mute in the same step"),
    ([(5, 1, "kill", 4)], r"steps = 4, but only stop, mute, deaf are temporary"),
    ([(5, 1, "explode")], r"fault.0.kind = 'explode'"),
    ([(step, 1, "restart") for step in range(1, 100)], r"3 robots can start 85 times each, not 100 times"),
]


@pytest.mark.parametrize(("faults", "message"), INVALID)
def test_invalid_faults_are_rejected(floor: str, faults: list[tuple[Any, ...]], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        run(floor, *faults)
