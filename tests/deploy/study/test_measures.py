"""Measures of whole runs: agreement of the robots' maps, and traffic until one of them knows the full map."""

from __future__ import annotations

from typing import Any

import pytest

from deploy.scenario import plan as plans
from deploy.scenario.scenario import parse
from deploy.study.measures import METRICS, agreement, offline


@pytest.fixture(scope="module")
def shared() -> dict[str, Any]:
    return measured(map_encoding="scans")


def measured(**settings: Any) -> dict[str, Any]:
    floor = {
        "map": "office",
        "map_options": {"width_m": 10, "height_m": 10},
        "sensor_range": 3.0,
        "robots": 2,
    }
    return agreement(plans.make(parse({"bus": "memory", "bandwidth": "unlimited"} | floor | settings)))


def test_planning_grids_of_robots_that_share_scans_agree_and_own_ones_do_not(shared: dict[str, Any]) -> None:
    assert set(METRICS["agreement"]) <= set(shared)
    assert shared["agreement.least"] <= shared["agreement.planning"] <= 1
    assert shared["agreement.least"] > 0.95
    assert shared["agreement.own"] < 0.7


def test_planning_grids_of_robots_out_of_range_agree_as_little_as_own_ones() -> None:
    apart = measured(map_encoding="scans", range="0")
    assert apart["agreement.planning"] == pytest.approx(apart["agreement.own"])


def test_bytes_until_the_map_is_known_are_part_of_all_bytes(shared: dict[str, Any]) -> None:
    assert 0 < shared["known.bytes"] <= shared["bytes.total"]
    assert (
        shared["known.raw_scan_bytes"] == 2 * shared["known.scan_values"] == 2 * shared["known_at"] * 362 * 2
    )


def test_the_offline_measure_adds_the_same_steps_of_a_team_that_knows_the_map_to_every_strategy() -> None:
    small = {
        "bus": "memory", "map": "office", "map_options": {"width_m": 10, "height_m": 10}, "robots": 2,
        "bandwidth": "unlimited", "map_encoding": "scans",
    }  # fmt: skip
    first, other = (
        offline(plans.make(parse(small | {"strategy": name}))) for name in ("repairmen", "nearest")
    )
    assert set(METRICS["offline"]) <= set(first)
    assert first["offline.steps"] == other["offline.steps"]
    assert 1 < first["offline.steps"] <= first["steps"]
    assert offline(plans.make(parse(small | {"seed": 5})))["offline.steps"] != first["offline.steps"]
