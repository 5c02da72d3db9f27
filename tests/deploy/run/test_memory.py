"""The memory of a run: estimated before it starts; runs that cannot fit are refused with what would fit."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from deploy.run import memory
from deploy.scenario import plan as plans
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from deploy.study.experiment import read
from deploy.study.runs import cases

GB = 1e9


def plan(robots: int, side_m: float, resolution: float = 0.1, bus: str = "zenoh", **settings: object) -> Plan:
    options = {"width_m": side_m, "height_m": side_m, "resolution": resolution}
    return plans.make(parse({"map_options": options, "robots": robots, "bus": bus} | settings))


@pytest.fixture
def small_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "memory_limits", lambda: [("this machine has", 4 * GB, "total")])


@pytest.mark.usefixtures("small_machine")
def test_error_names_what_is_needed_what_there_is_and_sizes_that_fit() -> None:
    with pytest.raises(ScenarioError) as error:
        memory.check(plan(64, 60.0))
    words = re.fullmatch(
        r"robots = 64 on 600 x 600 cells: bus = 'zenoh' needs about ([0-9.]+) GB, and this machine has 4 GB; "
        r"use ([0-9]+) robots or cells of ([0-9.]+) m or bus = 'memory'",
        str(error.value),
    )
    assert words is not None, str(error.value)
    assert float(words[1]) > 4
    memory.check(plan(int(words[2]), 60.0))
    memory.check(plan(64, 60.0, float(words[3])))
    memory.check(plan(64, 60.0, bus="memory"))
    with pytest.raises(ScenarioError):
        memory.check(plan(int(words[2]) + 1, 60.0))


@pytest.mark.usefixtures("small_machine")
def test_only_robots_on_this_host_count() -> None:
    memory.check(plan(64, 60.0), elsewhere=56)


@pytest.mark.usefixtures("small_machine")
def test_some_encodings_need_a_grid_per_teammate() -> None:
    with pytest.raises(ScenarioError, match="robots = 44 on 800 x 800 cells"):
        memory.check(plan(44, 80.0))
    with pytest.raises(ScenarioError, match="robots = 44 on 800 x 800 cells"):
        memory.check(plan(44, 80.0, map_encoding="polygons"))
    memory.check(plan(44, 80.0, map_encoding="scans"))


@pytest.mark.usefixtures("small_machine")
def test_sweep_is_refused_before_its_first_run(tmp_path: Path) -> None:
    file = tmp_path / "large.toml"
    file.write_text("seeds = 1\n[base]\nrobots = 64\nmap_options = {width_m = 150.0, height_m = 150.0}\n")
    with pytest.raises(ScenarioError, match="robots = 64 on 1500 x 1500 cells: bus = 'memory' needs about"):
        cases(read(file))


def test_default_run_fits_here() -> None:
    memory.check(plans.make(parse({})))


@pytest.mark.parametrize(
    ("groups", "files", "limit"),
    [
        ("0::/a/b\n", {"memory.max": "max", "a/memory.max": "2000", "a/b/memory.max": "max"}, 2000),
        ("0::/a/b\n", {"a/memory.max": "2000", "a/b/memory.max": "1000"}, 1000),
        (
            "4:memory:/c\n0::/\n",
            {"memory/memory.limit_in_bytes": "9", "memory/c/memory.limit_in_bytes": "7"},
            7,
        ),
        ("4:memory:/hidden\n", {"memory/memory.limit_in_bytes": "9"}, 9),
        ("0::/\n", {}, math.inf),
    ],
)
def test_smallest_limit_of_all_control_groups_counts(
    tmp_path: Path, groups: str, files: dict[str, str], limit: float
) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"{text}\n")
    (tmp_path / "groups").write_text(groups)
    assert memory.control_group_bytes(tmp_path, tmp_path / "groups") == limit
    assert memory.control_group_bytes(tmp_path, tmp_path / "missing") == math.inf
