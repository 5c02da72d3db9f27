"""Records of robots in the field become a run: tables, maps over time, pictures, and figures without a true map."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
import pytest

import murmur
from deploy.after.archive import Archive, read
from deploy.after.field_summary import NEEDS_TRUTH
from deploy.after.merge import merge
from deploy.after.report import write_report
from deploy.record.columns import FIELD, SUMMARY
from deploy.record.field_records import END, MAPS, SETUP, STEP_LINES, read_field_record
from deploy.run.exit_codes import NOT_FINISHED
from deploy.run.result import Result
from deploy.scenario.errors import ScenarioError
from protocol.grid import FREE, UNKNOWN, Grid
from protocol.nanoseconds import SECOND
from tests.agent.radios.memory_air import Faults, MemoryAir
from tests.deploy.after.recorded_team import CORNER, RATE, RecordedTeam
from tests.deploy.commands.office_floor import murmur as command
from tests.system.team import small_plan
from worldsim.maps import to_world

RESTART, STEPS = 12, 24
"""Robot 1 is killed and starts again after the first one; then all robots end, but for robot 2, which is killed."""
AHEAD = {0: 0, 1: 70 * SECOND, 2: -40 * SECOND}


@dataclass
class Mission:
    """The directories of three robots, where they were, and their maps."""

    folder: Path
    places: dict[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    """Position in cells by step and robot."""
    planning: dict[int, Grid] = field(default_factory=dict)
    free_at_restart: int = 0
    """Free cells on the map of robot 1 when it was killed."""

    @property
    def folders(self) -> list[Path]:
        return [self.folder / f"r{number}" for number in range(3)]


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Mission:
    made = Mission(tmp_path_factory.mktemp("field"))
    noisy = {"laser": {"preset": "rplidar-a1"}, "robot": [{"robot": 2, "sensor_range": 2.0, "speed": 0.4}]}
    plan = small_plan(
        side_m=10.0, map_encoding="predictive", dissemination="gossip", robots=3, seed=1, **noisy
    )
    team = RecordedTeam(plan, MemoryAir(3, Faults(delay=SECOND // 20)), made.folder, AHEAD)
    while team.step < STEPS:
        if team.step == RESTART:
            made.free_at_restart = int((team.members[1].robot.own == FREE).sum())
            team.restart(1)
        team.play()
        for number, (x, y) in team.world.cells.items():
            offset = team.world.offsets[number]
            made.places[team.step, number] = x + offset[0] / 1000, y + offset[1] / 1000
    team.end(0)
    team.end(1, "stopped by SIGINT", is_complete=False)
    made.planning = {number: member.robot.planning for number, member in team.members.items()}
    team.close()
    return made


@pytest.fixture(scope="module")
def merged(mission: Mission) -> Result:
    return merge(mission.folders, mission.folder / "team")


@pytest.fixture(scope="module")
def archive(merged: Result) -> Archive:
    assert merged.directory is not None
    return read(merged.directory)


def test_each_step_has_the_pose_and_the_state_of_every_robot(mission: Mission, archive: Archive) -> None:
    world, steps = archive.plan.map, archive.steps
    assert (world.resolution, world.origin) == (0.1, (*CORNER, 0.0))
    off = []
    for step, robot, x, y in zip(*(steps[name] for name in ("step", "robot", "x", "y")), strict=True):
        near = [
            np.hypot(*np.subtract(to_world(world, *mission.places[at, robot]), (x, y)))
            for at in (step - 1, step, step + 1)
            if (at, robot) in mission.places
        ]
        off.append(min(near))
    assert max(off) < 0.06, "poses are those that the robots believed in, at most a step off"
    assert archive.last_step == STEPS
    assert [len(archive.of_robot(robot)["step"]) >= STEPS - 1 for robot in range(3)] == [True] * 3
    assert set(archive.of_robot(2)["work_us"].tolist()) == {1002}
    assert np.all(np.diff(archive.of_robot(0)["driven"]) >= 0)
    assert archive.of_robot(0)["driven"][-1] > 3
    assert "driving to the target" in set(archive.of_robot(0)["status"])


def test_maps_over_time_end_with_those_of_the_robots(mission: Mission, archive: Archive) -> None:
    for robot in (0, 1):
        shown = archive.maps.planning(robot, archive.last_step)
        assert shown is not None
        np.testing.assert_array_equal(shown, mission.planning[robot])
    last = archive.maps.planning(2, archive.last_step)
    assert last is not None
    assert 0 < np.count_nonzero(last != UNKNOWN) <= np.count_nonzero(mission.planning[2] != UNKNOWN)
    assert len(archive.maps.steps(2)) >= STEPS // 5 - 1
    before, after = archive.maps.own(1, RESTART - 1), archive.maps.own(1, RESTART + 5)
    assert before is not None
    assert after is not None
    assert np.count_nonzero(before == FREE) > 0.6 * mission.free_at_restart
    assert np.count_nonzero(after == FREE) != np.count_nonzero(before == FREE), (
        "a restarted robot begins anew"
    )
    assert np.count_nonzero(archive.plan.map.cells == FREE) > mission.free_at_restart


def test_figures_that_need_a_true_map_are_null_and_agreement_is_not(merged: Result, archive: Archive) -> None:
    summary = archive.summary
    assert {summary[key] for key in NEEDS_TRUTH} == {None}
    assert set(summary) == set(", ".join([*SUMMARY, *FIELD]).split(", "))
    assert summary["claimed_mean_wall_f1"] is None
    assert (summary["finished"], summary["first_robot"], merged.exit_code) == (False, 0, NOT_FINISHED)
    assert summary["reason"] == "robot 1: stopped by SIGINT; robot 2: no end was recorded"
    assert summary["lost"] == {"2": "its record breaks off"}
    assert [robot for _, robot in summary["returned"]] == [1]
    assert 0.7 < summary["worst_walls_within_tolerance"] <= summary["walls_within_tolerance"] <= 1
    assert summary["walls_within_tolerance"] > 0.85
    assert 0.3 < summary["worst_team_map_held"] <= summary["team_map_held"] <= 1
    assert summary["robot_maps"]["2"]["walls_within_tolerance"] is None, "a killed robot left no shared map"
    assert summary["missed_steps_by_robot"] == [0, 0, 0]
    assert summary["bandwidth"] == 3 * RATE
    assert [entry.robot for entry in archive.plan.scenario.robot] == [2]
    assert archive.plan.world.bodies[2].range_cells == pytest.approx(20)


def test_report_pictures_and_films_are_made(archive: Archive) -> None:
    page = write_report(archive.directory).read_text(encoding="utf-8")
    assert "free cells of the team&#39;s map that a robot has" in page
    assert "steps that took robots too long" in page
    assert "accuracy of the planning map" not in page
    assert "seen by the team" not in page
    shown = command("capture", str(archive.directory), "--robot", "2")
    assert shown.exit_code == 0, shown.stderr
    assert (archive.directory / "maps.png").stat().st_size > 10_000


def test_the_joined_run_is_a_result_in_python(mission: Mission, tmp_path: Path) -> None:
    result = murmur.merge(mission.folders[:2], tmp_path / "two")
    assert set(result.maps) == {"team", 0, 1}
    assert set(result.steps["robot"]) == {0, 1}
    assert result.summary["lost"] == {"2": "its record is missing"}
    assert "robots on the field" in repr(result)
    assert result.plot().axes


def test_a_robot_that_ends_early_keeps_the_distance_that_it_drove(mission: Mission, tmp_path: Path) -> None:
    copy = tmp_path / "r0"
    shutil.copytree(mission.folder / "r0" / "start-1", copy)
    lines = (copy / STEP_LINES).read_text(encoding="utf-8").splitlines(keepends=True)
    (copy / STEP_LINES).write_text("".join(lines[: STEPS // 2]), encoding="utf-8")
    result = merge([copy, mission.folder / "r1"], tmp_path / "team")
    own = result.steps.filter(result.steps["robot"] == 0)
    assert own["step"].max() < result.summary["steps"]
    assert result.summary["path_length"][0] == own["driven"].max() > 1


def test_robots_that_were_all_killed_have_a_run_without_figures_of_walls(
    mission: Mission, tmp_path: Path
) -> None:
    summary = merge([mission.folder / "r2"], tmp_path / "team").summary
    assert summary["lost"] == {
        "0": "its record is missing", "1": "its record is missing", "2": "its record breaks off"
    }  # fmt: skip
    figures = summary["robot_maps"]["2"]
    assert figures.pop("team_map_held") == summary["team_map_held"] > 0.9
    assert set(figures.values()) == {None}
    assert summary["claimed_mean_wall_f1"] is None


def test_a_record_cannot_be_run_again(archive: Archive) -> None:
    for name in ("replay", "explore"):
        path = archive.directory if name == "replay" else archive.directory / "scenario.toml"
        result = command(name, str(path))
        assert result.exit_code == 2
    with pytest.raises(ScenarioError, match="record of robots in the field"):
        murmur.explore(clock="field")


def test_a_recording_for_the_dashboard_is_written_on_request(mission: Mission, tmp_path: Path) -> None:
    result = command("merge", *map(str, mission.folders), "--out", str(tmp_path / "team"), "--view")
    assert result.exit_code == 0, result.stderr
    assert "3 robots, 24 steps of 1 s" in result.stdout
    assert "robot 2: its record breaks off" in result.stdout
    assert (tmp_path / "team" / "run.rrd").stat().st_size > 10_000


def test_damaged_records_and_other_teams_are_refused(mission: Mission, tmp_path: Path) -> None:
    copy = tmp_path / "r0"
    shutil.copytree(mission.folder / "r0" / "start-1", copy)
    lines = (copy / STEP_LINES).read_text(encoding="utf-8").splitlines(keepends=True)
    cases = {
        STEP_LINES: [
            (lines[1].encode(), "the first line must be time_ns"),
            ("".join([*lines[:2], "1,2\n"]).encode(), "line 3: has 2 values; must have 12"),
            ("".join([*lines[:2], lines[1]]).encode(), "line 3: is not of a step after"),
            (f'{lines[0]}"{"1" * 200_000}\n'.encode(), "line 2: field larger than field limit"),
            (f"{lines[0]}1,1,5,,0,-1,-1,0,0,0,0,ok\n".encode(), "line 2: has only a part of a pose"),
        ],
        MAPS: [(b"\x05\0\0\0hello", "byte 4")],
        SETUP: [(b"{}", "setup.json"), (b"no", "setup.json")],
        END: [(b'{"reason": 3}', "end.json")],
        "maps.npz": [(b"PK", "not the maps of a robot")],
    }
    for name, damaged in cases.items():
        whole = (copy / name).read_bytes()
        for data, problem in damaged:
            (copy / name).write_bytes(data)
            with pytest.raises(ValueError, match=problem):
                merge([copy], tmp_path / "team")
        (copy / name).write_bytes(whole)
    setup = json.loads((copy / SETUP).read_text(encoding="utf-8"))
    fewer = setup["settings"] | {"bodies": setup["settings"]["bodies"][:2]}
    (copy / SETUP).write_text(json.dumps(setup | {"settings": fewer}), encoding="utf-8")
    with pytest.raises(ValueError, match=r"r0: robots = 2, but 3 in .*start-1: not one team"):
        merge([mission.folder / "r1", copy], tmp_path / "team")
    (copy / SETUP).write_text(json.dumps(setup | {"x": 1.0}), encoding="utf-8")
    with pytest.raises(ValueError, match="its grid lies elsewhere"):
        merge([mission.folder / "r1", copy], tmp_path / "team")
    with pytest.raises(ValueError, match="start 1 of robot 1 is given twice"):
        merge([mission.folder / "r1", mission.folder / "r1" / "start-1"], tmp_path / "team")
    assert not (tmp_path / "team").exists()


def test_a_record_is_read_up_to_its_last_whole_step(mission: Mission, tmp_path: Path) -> None:
    copy = tmp_path / "r2"
    shutil.copytree(mission.folder / "r2" / "start-1", copy)
    whole = read_field_record(copy)
    assert (whole.maps, whole.ending) == (None, None)
    for name, cut in ((STEP_LINES, 5), (MAPS, 7)):
        (copy / name).write_bytes((copy / name).read_bytes()[:-cut])
    part = read_field_record(copy)
    assert part.steps == whole.steps[:-1]
    assert [msgspec.to_builtins(each) for each in part.changes] == [
        msgspec.to_builtins(each) for each in whole.changes[:-1]
    ]
