"""Whole runs with people in the building, and with lasers that do not scan in every step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from deploy.run.exploration import explore
from deploy.run.result import Result
from deploy.scenario import plan as plans
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import load, parse
from tests.system.team import corridor

SMALL: dict[str, Any] = {
    "map": "office", "map_options": {"width_m": 12.0, "height_m": 10.0}, "robots": 3, "seed": 5, "steps": 600,
    "bandwidth": "unlimited", "sensor_range": 4.0, "bus": "memory", "people": {"number": 4},
    "laser": {"preset": "rplidar-a1"}, "pose": {"preset": "graph-slam"},
}  # fmt: skip


def run(**settings: Any) -> Result:
    return explore(parse(SMALL | settings), keep=False)


def walks(result: Result) -> list[bytes]:
    return [report.people for report in result.records.world]


@pytest.mark.parametrize("strategy", ["repairmen", "meier", "burgard", "leaders"])
def test_a_team_explores_a_building_with_people(strategy: str) -> None:
    result = run(strategy=strategy)
    assert result.summary["finished"]
    assert result.summary["coverage"] >= 0.98
    assert result.summary["claimed_worst_wall_f1"] >= 0.93
    assert result.summary["refuted_maps"] == []
    assert len(set(walks(result))) > 10


@pytest.mark.parametrize(("seed", "people"), [(2, 6), (23, 12)])
def test_people_who_close_a_doorway_for_a_while_do_not_end_a_run(seed: int, people: int) -> None:
    """In these runs, people stand in the only doorway, or before it, until all robots have nothing left to explore."""
    crowded: dict[str, Any] = {
        "map_seed": seed, "map_options": {"width_m": 14.0, "height_m": 12.0}, "seed": seed, "bandwidth": 200,
        "radius": 0.2, "pose": {"preset": "particle-filter"}, "people": {"number": people},
    }  # fmt: skip
    result = run(**crowded)
    assert result.summary["finished"]
    assert result.summary["coverage"] >= 0.98
    looked = [status.step for each in result.records.statuses for status in each if "again" in status.status]
    assert min(looked) < result.summary["t90"]


def test_a_team_that_must_return_drives_home_among_people() -> None:
    summary = run(strategy="meier", options={"mission": "return"}).summary
    assert summary["finished"]


def test_people_walk_alike_on_both_buses() -> None:
    memory, zenoh = (run(bus=bus, steps=40) for bus in ("memory", "zenoh"))
    assert walks(memory) == walks(zenoh)
    assert np.frombuffer(walks(memory)[0], "<i4").shape == (2 * 4,)
    assert memory.summary["digest"] == zenoh.summary["digest"]


def test_the_digest_of_a_run_covers_its_people() -> None:
    alike, other = ({"number": 4, "speed": speed} for speed in (1.34, 1.0))
    first, second = (run(steps=1, people=people) for people in (alike, other))
    assert walks(first) != walks(second)
    assert first.summary["digest"] != second.summary["digest"]


def test_the_true_map_of_a_run_has_no_people() -> None:
    empty, full = (run(steps=5, people={"number": number}) for number in (0, 20))
    assert [report.reachable for report in full.records.world] == [
        report.reachable for report in empty.records.world
    ]


@pytest.mark.parametrize("rate", [0.5, 0.2])
def test_a_team_with_slow_lasers_explores_everything(rate: float) -> None:
    summary = run(laser={"preset": "rplidar-a1", "rate": rate}).summary
    assert summary["finished"]
    assert summary["coverage"] >= 0.98


def test_exact_lasers_may_scan_in_some_steps_only() -> None:
    summary = run(laser={"rate": 0.5}, pose={}, people={}).summary
    assert summary["finished"]
    assert summary["coverage"] == 1
    assert summary["refuted_maps"] == []


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"people.number": 3}, r"people.number = 3: .*choose a laser.preset with errors: sick-lms, utm-30lx"),
        ({"people.number": 101, "laser.preset": "sick-lms"}, "people.*number = 101: must be 0 to 100"),
        ({"people.number": 2.5, "laser.preset": "sick-lms"}, "number = 2.5: must be a whole number"),
        ({"people.sped": 1.0}, r"people.sped: unknown setting; .*did you mean speed"),
        ({"laser.rate": 2.0}, "rate = 2: must be 0.01 to 1 scans per step"),
        ({"laser.rate": 0.5, "scanner_turn": 90.0}, "laser.rate = 0.5: a turning scanner"),
        ({"map_encoding": "slam-toolbox"}, "map_encoding = 'slam-toolbox': .*choose a laser.preset"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        load(None, settings)


def test_people_who_do_not_fit_are_refused() -> None:
    settings = {key: value for key, value in SMALL.items() if not key.startswith("map")}
    with pytest.raises(ScenarioError, match=r"people.number on map corridor: 100 people do not fit"):
        plans.make(parse(settings | {"people": {"number": 100}}), corridor(40))
