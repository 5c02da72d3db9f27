"""A run from scenario to directory: the files, the repetition of the run, and how runs end."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from PIL import Image
from pyarrow import parquet

import murmur
from deploy.record import run_directory
from deploy.record.records import Records
from deploy.record.summary import summarize
from deploy.run import exploration
from deploy.run.execution import HubError
from deploy.run.exit_codes import BROKEN_OFF, EXPLORED, NOT_FINISHED
from deploy.run.in_memory import MemoryRun
from deploy.run.result import Result
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario, load, parse
from protocol.grid import FREE, UNKNOWN
from protocol.packets import ALL_KINDS
from worldsim import generators, maps

CONTRACT = {
    "finished", "steps", "first_robot", "coverage", "map_accuracy", "t50", "t90", "t99", "overlap", "path_length",
    "robots", "seed", "bus", "strategy", "map_encoding", "bandwidth", "range_m", "bytes", "packets",
    "raw_scan_bytes", "over_budget_steps", "undelivered",
    "approximation_error", "approximation_error_net", "explored_at", "known_at", "digest",
    "wall_s", "steps_per_s", "versions",
}  # fmt: skip
"""Keys of a summary that scripts may rely on."""

LEDGER = {
    "step": "int32", "round": "int16", "connection": "int32", "frame": "int16", "sender": "int16",
    "receiver": "int16", "map": "int16", "kind": "string", "packets": "int32", "bytes": "int32",
    "carried": "bool", "cause": "string", "received_by": "int16",
}  # fmt: skip


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A map of 100 x 100 cells, in a file."""
    path = tmp_path_factory.mktemp("map") / "office.yaml"
    maps.save(generators.make("office", width_m=10, height_m=10), path)
    return str(path)


def scenario(floor: str, **settings: Any) -> Scenario:
    return parse({"map": floor, "robots": 3, "bus": "memory", "sensor_range": 3.0} | settings)


@pytest.fixture(scope="module")
def run(floor: str, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """A finished run, in a directory."""
    return exploration.explore(scenario(floor), out=tmp_path_factory.mktemp("out") / "run")


@pytest.fixture(scope="module")
def out(run: Result) -> Path:
    assert run.directory is not None
    return run.directory


# --- the directory -------------------------------------------------------------------------------------


def test_a_run_leaves_the_files_of_the_contract_and_nothing_else(out: Path) -> None:
    planning = {f"planning-r{robot}.{suffix}" for robot in range(3) for suffix in ("yaml", "png")}
    assert {path.name for path in out.iterdir()} == planning | {
        "scenario.toml", "summary.json", "steps.parquet", "ledger.parquet", "map_changes.parquet", "radio.pcapng",
        "maps.png", "map.yaml", "map.png", "team.yaml", "team.png",
    }  # fmt: skip


def test_overlap_is_the_share_that_several_robots_have_seen(floor: str) -> None:
    alone = exploration.explore(scenario(floor, robots=1, steps=5), keep=False)
    assert alone.summary["overlap"] == 0
    result = exploration.explore(scenario(floor, steps=5), keep=False)
    seen = sum((grid == FREE).astype(int) for grid in result.records.own.values())
    assert result.summary["overlap"] == pytest.approx((seen > 1).sum() / (seen > 0).sum())
    assert result.summary["overlap"] > 0


def test_the_summary_has_every_name_of_the_contract(run: Result, out: Path) -> None:
    summary = json.loads((out / "summary.json").read_text())
    assert summary == run.summary
    assert set(summary) >= CONTRACT
    assert summary["finished"]
    assert summary["steps"] == run.records.step
    assert summary["coverage"] == summary["map_accuracy"] == 1
    assert summary["t50"] <= summary["t90"] <= summary["t99"] <= summary["steps"]
    assert summary["over_budget_steps"] == 0
    assert len(summary["path_length"]) == summary["robots"] == 3
    assert len(summary["digest"]) == 64
    assert {"murmur-robots", "numpy", "eclipse-zenoh"} <= set(summary["versions"])


def test_known_at_is_the_first_step_with_a_planning_grid_of_nearly_all_cells(floor: str) -> None:
    plan = plans.make(scenario(floor))
    run, reachable = MemoryRun(plan), plan.make_world().reachable
    known: dict[int, float] = {}
    for step in run.steps():
        if not step:
            continue
        grids = [agent.robot.planning for agent in run.agents if agent.robot is not None]
        known[step] = max((grid[reachable] != UNKNOWN).mean() for grid in grids)
    first = next(step for step, share in known.items() if share >= 0.999)
    summary = summarize(plan, run.records, 1.0)
    assert summary["known_at"] == first <= summary["steps"]


def test_known_at_is_null_until_a_robot_knows_the_full_map(floor: str) -> None:
    result = exploration.explore(scenario(floor, steps=5), keep=False)
    assert not result.summary["finished"] and result.summary["known_at"] is None


def test_the_ledger_has_the_columns_of_the_contract_and_adds_up_to_the_summary(
    run: Result, out: Path
) -> None:
    table = parquet.read_table(out / "ledger.parquet")
    assert {field.name: str(field.type) for field in table.schema} == LEDGER
    rows = table.to_pylist()
    assert len(rows) == len(run.records.ledger())
    carried: dict[str, int] = {}
    for row in rows:
        assert row["kind"] in ALL_KINDS
        assert row["carried"] == (row["cause"] == "")
        if row["carried"]:
            carried[row["kind"]] = carried.get(row["kind"], 0) + row["bytes"]
    assert carried | {"total": sum(carried.values())} == run.summary["bytes"]


def test_steps_have_one_row_per_robot_in_meters_of_the_map_frame(run: Result, out: Path) -> None:
    steps = parquet.read_table(out / "steps.parquet").to_pydict()
    robots, last = run.summary["robots"], run.summary["steps"]
    assert len(steps["step"]) == robots * last
    assert sorted(set(zip(steps["step"], steps["robot"], strict=True))) == [
        (step, robot) for step in range(1, last + 1) for robot in range(robots)
    ]
    truth = maps.load(out / "map.yaml")
    for x, y in zip(steps["x"], steps["y"], strict=True):
        column, row = maps.to_cell(truth, x, y)
        assert truth.cells[round(row), round(column)] == 1, "a robot stands on free floor"
    assert steps["team_seen"] == sorted(steps["team_seen"])
    assert steps["team_seen"][-1] == 1
    ways = [
        max(way for way, r in zip(steps["driven"], steps["robot"], strict=True) if r == robot)
        for robot in range(3)
    ]
    assert ways == run.summary["path_length"]


def test_written_maps_equal_the_maps_of_the_robots(run: Result, out: Path) -> None:
    for robot, grid in run.records.planning.items():
        assert (maps.load(out / f"planning-r{robot}.yaml").cells == grid).all()
    team = np.maximum.reduce(list(run.records.own.values()))
    assert (maps.load(out / "team.yaml").cells == team).all()
    with Image.open(out / "maps.png") as picture:
        assert min(picture.size) > 300


def test_the_scenario_is_written_with_every_setting_and_its_own_map(floor: str, out: Path) -> None:
    written = run_directory.read_scenario(out)
    assert written == scenario(floor, map=str(out / "map.yaml"))
    assert (plans.load_map(written).cells == maps.load(floor).cells).all()
    text = (out / "scenario.toml").read_text()
    for name in set(Scenario.model_fields) - {
        "start",
        "robot",
        "radio",
        "laser",
        "pose",
        "people",
        "recording",
        "starts",
        "fault",
        "map_options",
        "options",
        "polygons",
        "predictive",
    }:
        assert f"\n{name} = " in text


def test_a_run_of_a_generated_map_brings_the_map_along(tmp_path: Path) -> None:
    result = exploration.explore(
        parse({"map": "leader-trap", "robots": 1, "steps": 2, "bus": "memory"}), out=tmp_path / "a"
    )
    assert result.directory is not None
    assert (maps.load(tmp_path / "a" / "map.yaml").cells == generators.make("leader-trap").cells).all()


def test_runs_that_begin_at_once_take_directories_of_their_own(
    floor: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = plans.make(scenario(floor))
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: run_directory.create(None, plan), range(16)))
    assert len(set(made)) == 16
    assert min(made, key=lambda path: len(path.name)) == Path("runs/office-predictive-3robots-seed0")
    assert {path.parent for path in made} == {Path("runs")}


def test_an_empty_directory_is_taken(floor: str, tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    assert exploration.explore(scenario(floor, steps=1), out=tmp_path / "here").directory == tmp_path / "here"


# --- whole files or none -------------------------------------------------------------------------------


def test_reader_sees_complete_files_while_a_run_is_written(floor: str, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    worker = threading.Thread(target=exploration.explore, args=[scenario(floor)], kwargs={"out": folder})
    worker.start()
    reads = 0
    while worker.is_alive():
        for path in folder.glob("[!.]*") if folder.exists() else ():
            if path.suffix == ".json":
                assert "digest" in json.loads(path.read_text())
            elif path.suffix == ".toml":
                assert run_directory.read_scenario(folder).robots == 3
            elif path.suffix == ".parquet":
                assert parquet.read_table(path).num_rows
            elif path.suffix == ".png":
                Image.open(path).verify()
            reads += 1
        time.sleep(0.002)
    worker.join()
    assert reads > 20


FULL_DISK = """
import resource, sys
from pathlib import Path
from murmur import Scenario, explore
scenario = Scenario(map=sys.argv[1], robots=2, range="0", bus="memory", steps=30)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
explore(scenario, out=Path(sys.argv[2]))
"""


def test_a_file_that_does_not_fit_the_disk_is_not_there_at_all(floor: str, tmp_path: Path) -> None:
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[1] == resource.RLIM_INFINITY
    folder = tmp_path / "run"
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, floor, str(folder), "12000"],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "File too large" in done.stderr
    assert json.loads((folder / "summary.json").read_text())["steps"] == 30
    assert not (folder / "maps.png").exists()
    assert not list(folder.glob(".*"))


# --- again ---------------------------------------------------------------------------------------------


def test_a_directory_alone_repeats_the_run_wherever_it_is(run: Result, out: Path, tmp_path: Path) -> None:
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for name in ("scenario.toml", "map.yaml", "map.png"):
        (moved / name).write_bytes((out / name).read_bytes())
    again = exploration.explore(run_directory.read_scenario(moved), keep=False)
    assert again.summary["digest"] == run.summary["digest"]
    for name in CONTRACT - {"wall_s", "steps_per_s"}:
        assert again.summary[name] == run.summary[name], name


def test_a_run_of_processes_is_repeated_in_one_process(floor: str, tmp_path: Path) -> None:
    result = exploration.explore(scenario(floor, bus="zenoh", steps=15), out=tmp_path / "run")
    assert run_directory.read_scenario(tmp_path / "run").bus == "zenoh"
    again = exploration.explore(load(tmp_path / "run" / "scenario.toml", {"bus": "memory"}), keep=False)
    assert again.summary["digest"] == result.summary["digest"]


# --- the call from Python ------------------------------------------------------------------------------


def test_python_callers_get_all_that_the_command_gets(
    floor: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    seen: list[tuple[Plan, int]] = []

    def watch(plan: Plan, records: Records) -> None:
        seen.append((plan, records.step))

    result = murmur.explore(
        murmur.Scenario(map=floor, robots=2, bus="memory", steps=12), keep=False, watch=watch
    )
    assert isinstance(result, murmur.Result)
    assert result.directory is None
    assert not list(tmp_path.iterdir())
    assert [step for _, step in seen] == list(range(1, 13))
    assert {id(plan) for plan, _ in seen} == {id(seen[0][0])}
    assert result.records.planning[0].shape == (100, 100)
    assert result.deaths == {}


# --- how runs end --------------------------------------------------------------------------------------


def test_explored_run_ends_with_0_and_names_the_first_robot(run: Result) -> None:
    assert run.exit_code == EXPLORED == 0
    assert run.summary["reason"] == "explored"
    assert run.summary["first_robot"] in range(3)


def test_a_run_that_is_out_of_steps_ends_with_1(floor: str) -> None:
    result = exploration.explore(scenario(floor, steps=3), keep=False)
    assert result.exit_code == NOT_FINISHED == 1
    assert result.summary["reason"] == "out of steps"
    assert result.summary["first_robot"] is None
    assert result.summary["steps"] == 3
    assert 0 < result.summary["coverage"] < 1


@pytest.mark.parametrize("bus", ["memory", "zenoh"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_a_run_after_its_step_with_everything_written(
    floor: str, tmp_path: Path, bus: str, number: int
) -> None:
    handler = signal.getsignal(number)
    notes: list[str] = []

    def watch(_: Plan, records: Records) -> None:
        if records.step >= 5:
            os.kill(os.getpid(), number)

    result = exploration.explore(
        scenario(floor, bus=bus), out=tmp_path / "run", watch=watch, notify=notes.append, pace=20
    )
    assert result.exit_code == NOT_FINISHED
    assert result.summary["reason"] == "interrupted"
    assert 5 <= result.summary["steps"] < 40
    assert notes == ["ending after this step; writing the run directory"]
    assert {"summary.json", "steps.parquet", "ledger.parquet", "maps.png", "team.yaml"} <= {
        path.name for path in (tmp_path / "run").iterdir()
    }
    assert signal.getsignal(number) == handler


@pytest.mark.parametrize("exists", [False, True])
def test_a_run_whose_port_another_program_takes_ends_at_once_and_leaves_no_files(
    floor: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exists: bool
) -> None:
    out = tmp_path / "run"
    if exists:
        out.mkdir()
    with socket.create_server(("127.0.0.1", 0)) as other:
        monkeypatch.setattr("deploy.run.rendezvous.free_port", lambda: other.getsockname()[1])
        with pytest.raises(
            HubError, match=r"the hub cannot listen at tcp/127\.0\.0\.1:\d+: Address already in"
        ):
            exploration.explore(map=floor, robots=2, out=out)
    assert [*tmp_path.rglob("*")] == ([out] if exists else [])


@pytest.mark.parametrize("bus", ["memory", "zenoh"])
def test_a_run_that_leaves_nothing_dies_of_an_interrupt(floor: str, bus: str) -> None:
    with pytest.raises(KeyboardInterrupt):
        exploration.explore(
            scenario(floor, bus=bus), keep=False, watch=lambda *_: os.kill(os.getpid(), signal.SIGINT)
        )


@pytest.mark.parametrize("bus", ["memory", "zenoh"])
def test_scheduled_death_is_not_reported_as_a_crash(floor: str, bus: str) -> None:
    result = exploration.explore(
        scenario(floor, bus=bus, fault=[{"robot": 0, "step": 5, "kind": "death"}]), keep=False
    )
    assert result.exit_code == EXPLORED
    assert result.summary["first_robot"] in (1, 2)
    assert result.summary["lost"] == {}
    assert result.deaths == {}
    poses = [
        np.frombuffer(report.poses, "<i4").reshape(-1, 4)[:, 0].tolist() for report in result.records.world
    ]
    assert poses[3] == [0, 1, 2]
    assert poses[4] == [1, 2]


@pytest.mark.parametrize("bus", ["memory", "zenoh"])
def test_run_ends_when_all_robots_have_died(floor: str, bus: str) -> None:
    deaths = [{"robot": robot, "step": 4 + robot, "kind": "death"} for robot in range(3)]
    result = exploration.explore(scenario(floor, bus=bus, fault=deaths), keep=False)
    assert result.exit_code == NOT_FINISHED
    assert result.summary["reason"] == "all robots are lost"


def children() -> Iterator[psutil.Process]:
    for process in psutil.Process().children(recursive=True):
        try:
            if process.cmdline()[:1] == ["murmur r1"]:
                yield process
        except psutil.NoSuchProcess:
            continue


def test_unexpected_death_ends_with_3_and_is_named(floor: str, tmp_path: Path) -> None:
    killed: list[int] = []

    def watch(_: Plan, records: Records) -> None:
        for process in children() if records.step > 2 and not killed else ():
            killed.append(process.pid)
            process.kill()

    result = exploration.explore(scenario(floor, bus="zenoh"), out=tmp_path / "run", watch=watch, pace=15)
    assert killed
    assert result.exit_code == BROKEN_OFF == 3
    assert result.summary["lost"] == {"1": "its process ended"}
    assert "SIGKILL" in result.deaths["r1"]
    assert result.summary["finished"], "the other robots continue"
    assert (tmp_path / "run" / "ledger.parquet").exists()
