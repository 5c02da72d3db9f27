"""Whole runs with every strategy: they finish, differ from each other, and are the same on both buses."""

from __future__ import annotations

import hashlib
from functools import cache
from typing import Any

import pytest

from deploy.run.exit_codes import EXPLORED, NOT_FINISHED
from deploy.run.in_memory import MemoryRun
from deploy.run.result import Result
from deploy.scenario import plan
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import parse
from murmur import explore
from tests.agent.encodings.names import EXACT
from worldsim import generators
from worldsim.base import EXPLORED as EXPLORED_ALL
from worldsim.base import STALLED

NAMES = [
    "burgard", "burgard-optimal", "classical", "continuous-replan", "greedy", "hungarian", "hungarian-depot",
    "iterative", "leaders", "meier", "mtsp", "mtsp-depot", "nearest", "potential-field", "repairmen",
    "scan-replan", "sheng-bid", "stop-scan-replan",
]  # fmt: skip

STALLS = "potential-field"


@cache
def run(
    strategy: str, bus: str = "memory", map_encoding: str = "polygons", mission: str | None = None
) -> Result:
    """Three robots with turning scanners in rooms off a hall."""
    scenario: dict[str, Any] = {
        "map": "leader-trap", "robots": 3, "strategy": strategy, "bus": bus, "map_encoding": map_encoding,
        "bandwidth": "unlimited", "sensor_range": 2.5, "speed": 0.5, "scanner_turn": 120, "seed": 1, "steps": 900,
        "options": {} if mission is None else {"mission": mission},
    }  # fmt: skip
    return explore(parse(scenario), keep=False)


@pytest.mark.parametrize("name", NAMES)
def test_every_strategy_explores_all_reachable_cells_or_reports_a_stall(name: str) -> None:
    result = run(name)
    assert not result.records.protocol_errors.texts
    if name == STALLS:
        assert result.exit_code == NOT_FINISHED
        assert result.summary["reason"] == STALLED
        assert result.summary["coverage"] < 0.9
    else:
        assert result.exit_code == EXPLORED, result.summary["reason"]
        assert result.summary["coverage"] >= 0.99


def ways_of(result: Result) -> str:
    return hashlib.sha256(b"".join(report.poses for report in result.records.world)).hexdigest()


def test_no_two_strategies_drive_the_same_paths() -> None:
    ways = {name: ways_of(run(name)) for name in NAMES}
    # The depot strategies differ from those that they build on by more than the way home.
    ways |= {f"{name}, return": ways_of(run(name, mission="return")) for name in ("hungarian", "mtsp")}
    assert len(set(ways.values())) == len(ways), ways


def test_when_the_leader_breaks_down_another_leads_and_the_team_finishes() -> None:
    ends = {}
    for dynamic in (True, False):
        scenario: dict[str, Any] = {
            "map": "leader-trap", "robots": 3, "strategy": "leaders", "bus": "memory", "map_encoding": "scans",
            "bandwidth": "unlimited", "sensor_range": 2.5, "speed": 1.0, "seed": 0, "steps": 500,
            "fault": [{"robot": 0, "step": 5, "kind": "death"}], "options": {"dynamic": dynamic},
        }  # fmt: skip
        records = MemoryRun(plan.make(parse(scenario))).complete()
        assert records.end is not None
        ends[dynamic] = records.end.reason, records.explored > 0.99
    assert ends == {True: (EXPLORED_ALL, True), False: (STALLED, False)}


@pytest.mark.parametrize("name", ["burgard", "greedy", "hungarian-depot", "leaders", "meier", "repairmen"])
def test_a_strategy_gives_the_same_digest_on_both_buses(name: str) -> None:
    """One strategy of each kind; the long test below runs all of them."""
    assert run(name, "zenoh").summary["digest"] == run(name).summary["digest"]


@pytest.mark.parametrize("map_encoding", ["scans", "predictive"])
def test_a_sub_team_strategy_gives_equal_digests_on_both_buses_with_every_map_encoding(
    map_encoding: str,
) -> None:
    memory = run("burgard", map_encoding=map_encoding)
    assert memory.summary["coverage"] >= 0.99
    assert run("burgard", "zenoh", map_encoding).summary["digest"] == memory.summary["digest"]


@pytest.mark.long
@pytest.mark.parametrize("map_encoding", EXACT)
@pytest.mark.parametrize("name", NAMES)
def test_every_strategy_gives_equal_digests_on_both_buses_with_every_map_encoding(
    name: str, map_encoding: str
) -> None:
    digests = {run(name, bus, map_encoding).summary["digest"] for bus in ("memory", "zenoh")}
    assert len(digests) == 1


def test_the_ledger_contains_poses_and_targets() -> None:
    kinds = run("hungarian").summary["bytes"]
    assert kinds["pose"] > kinds["targ"] > 0
    assert "targ" not in run("nearest").summary["bytes"]
    assert "pose" not in run("meier").summary["bytes"]


def test_robots_that_return_end_at_their_starts() -> None:
    import numpy as np

    world = run("mtsp-depot").records.world
    first, last = (
        np.frombuffer(report.poses, "<i4").reshape(-1, 4)[:, :3] for report in (world[0], world[-1])
    )
    assert np.array_equal(first, last)


@pytest.mark.parametrize("name", ["hungarian", "classical"])
def test_a_disc_with_a_narrow_field_of_view_detects_walls_beside_its_path(name: str) -> None:
    # With a field of view of 90 degrees, the robot drives into corners that it has not seen.
    office = generators.make("office-obstacles", seed=3, resolution=0.15, width_m=12.0, height_m=10.0)
    scenario: dict[str, Any] = {
        "map": "office-obstacles", "robots": 1, "strategy": name, "bus": "memory", "map_encoding": "none",
        "field_of_view": 90.0, "radius": 0.15, "sensor_range": 3.0, "speed": 0.3, "seed": 3, "steps": 2000,
    }  # fmt: skip
    records = MemoryRun(plan.make(parse(scenario), office)).complete()
    assert records.end is not None
    assert records.end.reason == EXPLORED_ALL
    assert records.explored > 0.99


@pytest.mark.parametrize(("sensor_range", "sees"), [(0.42, False), (0.43, True)])
def test_a_disc_must_see_all_walls_that_its_next_step_touches(sensor_range: float, sees: bool) -> None:
    # Cells of 0.15 m: a diagonal step touches the cell two to the right and two down, 0.424 m away.
    office = generators.make("office-obstacles", seed=1, resolution=0.15, width_m=12.0, height_m=10.0)
    scenario = {"map": "office-obstacles", "robots": 1, "radius": 0.15, "speed": 0.15, "map_encoding": "none"}
    disc = parse(scenario | {"bus": "memory", "sensor_range": sensor_range, "steps": 10000, "seed": 1})
    if sees:
        assert MemoryRun(plan.make(disc, office)).complete().explored > 0.99
        return
    with pytest.raises(ScenarioError, match=r"sensor_range = 0.42 m of robot 0 is less than 0.424 m: a disc"):
        plan.make(disc, office)
    plan.make(disc.model_copy(update={"radius": 0.0}), office)


def test_robots_in_a_doorway_do_not_block_each_other_forever() -> None:
    # Four of the five meet in the first doorway, two going in and two coming out.
    office = generators.make("office-plain", seed=1, resolution=0.25)
    scenario: dict[str, Any] = {
        "map": "office-plain", "robots": 5, "strategy": "stop-scan-replan", "bus": "memory", "map_encoding": "scans",
        "bandwidth": "unlimited", "sensor_range": 5.0, "speed": 0.25, "scanner_turn": 18, "seed": 1, "steps": 600,
    }  # fmt: skip
    records = MemoryRun(plan.make(parse(scenario), office)).complete()
    assert records.end is not None
    assert records.end.reason == EXPLORED_ALL
