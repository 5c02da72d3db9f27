from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import make
from deploy.scenario.recording import Recording, load_recording
from deploy.scenario.scenario import load, parse
from protocol.grid import FREE, OCCUPIED
from tests.worldsim.recorded.made_logs import (
    HEIGHT,
    WIDTH,
    carmen_text,
    distances,
    drive,
    flaser,
    sick_angles,
    write_carmen,
)
from worldsim.maps import to_cell, to_world


def recorded(
    *files: Path, robots: int = 1, recording: dict[str, Any] | None = None, **settings: Any
) -> Recording:
    table = {"files": [str(file) for file in files]} | (recording or {})
    return load_recording(parse({"recording": table, "robots": robots} | settings))


def steps(recording: Recording) -> list[list[int]]:
    return [each.steps.tolist() for each in recording.stretches]


def test_walls_of_the_map_are_where_the_lasers_saw_them(tmp_path: Path) -> None:
    world = recorded(write_carmen(tmp_path / "room.log", scans=40)).map
    rows, columns = np.nonzero(world.cells == OCCUPIED)
    points = np.array([to_world(world, x, y) for x, y in zip(columns, rows, strict=True)])
    to_wall = np.minimum(
        np.minimum(abs(points[:, 0]), abs(points[:, 0] - WIDTH)),
        np.minimum(abs(points[:, 1]), abs(points[:, 1] - HEIGHT)),
    )
    assert len(points) > 200
    assert to_wall.max() < 0.1
    for x, y in ((2.0, 2.0), (6.0, 4.0)):
        column, row = (round(value) for value in to_cell(world, x, y))
        assert world.cells[row, column] == FREE
    assert (world.name, world.resolution) == ("room", 0.1)
    # the map ends two cells behind the walls
    assert abs(world.width - WIDTH / 0.1 - 4) <= 2
    assert abs(world.height - HEIGHT / 0.1 - 4) <= 2


def test_a_robot_is_where_its_scan_was_taken(tmp_path: Path) -> None:
    recording = recorded(write_carmen(tmp_path / "room.log", scans=9), robots=3)
    for number, (column, row) in enumerate(recording.starts):
        x, y, _ = drive(9)[3 * number]
        there = to_cell(recording.map, x, y)
        assert abs(there[0] - column) <= 0.51
        assert abs(there[1] - row) <= 0.51


@pytest.mark.parametrize(
    ("scans", "robots", "lengths"), [(9, 3, [3, 3, 3]), (10, 4, [2, 3, 2, 3]), (3, 3, [1, 1, 1])]
)
def test_a_log_is_cut_into_equal_stretches(
    tmp_path: Path, scans: int, robots: int, lengths: list[int]
) -> None:
    recording = recorded(write_carmen(tmp_path / "room.log", scans=scans), robots=robots)
    assert steps(recording) == [list(range(1, length + 1)) for length in lengths]
    ranges = np.concatenate([each.ranges for each in recording.stretches])
    assert (ranges == recording.logs[0].ranges).all()


def test_at_the_recorded_pace_a_robot_takes_one_scan_in_each_second_with_scans(tmp_path: Path) -> None:
    stamps = [10.0, 10.5, 11.0, 13.2, 13.1, 20.0, 21.0, 21.9]
    lines = [
        flaser(pose, distances(pose, sick_angles(8)), at) for pose, at in zip(drive(8), stamps, strict=True)
    ]
    (tmp_path / "a.log").write_text("".join(lines))
    paced = {"pace": "recorded"}
    assert steps(recorded(tmp_path / "a.log", recording=paced)) == [[1, 2, 4, 11, 12]]
    assert steps(recorded(tmp_path / "a.log", recording=paced, robots=2)) == [[1, 2, 4], [1, 7, 8, 9]]
    first = recorded(tmp_path / "a.log", recording=paced)
    assert (first.stretches[0].ranges[1] == first.logs[0].ranges[2]).all()


def test_several_logs_have_one_robot_each(tmp_path: Path) -> None:
    files = [write_carmen(tmp_path / f"{name}.log", scans=scans) for name, scans in (("a", 2), ("b", 5))]
    recording = recorded(*files, robots=2)
    assert steps(recording) == [[1, 2], [1, 2, 3, 4, 5]]
    assert recording.map.name == "a-and-1-more"
    assert parse({"recording": {"files": [str(file) for file in files]}}).robots == 2


def test_ranges_beyond_the_sensor_range_show_free_cells_up_to_it(tmp_path: Path) -> None:
    near = recorded(write_carmen(tmp_path / "a.log", scans=3), sensor_range=0.9).map
    assert not (near.cells == OCCUPIED).any()
    assert (near.cells == FREE).any()


def test_coarse_cells_make_a_small_map(tmp_path: Path) -> None:
    world = recorded(write_carmen(tmp_path / "a.log"), recording={"resolution": 0.5}).map
    assert world.resolution == 0.5
    assert world.width == 16 + 1 + 5  # the walls, and both margins


def test_the_whole_team_finds_all_free_cells_of_the_map(tmp_path: Path) -> None:
    recording = recorded(write_carmen(tmp_path / "a.log"), robots=3)
    found = np.unique(np.concatenate([cells for each in recording.stretches for cells in each.found]))
    assert found.tolist() == np.flatnonzero(recording.map.cells == FREE).tolist()
    for each in recording.stretches:
        own = np.concatenate(list(each.found))
        assert len(own) == len(np.unique(own))


def test_receivers_accept_as_fast_a_robot_as_the_log_has(tmp_path: Path) -> None:
    plan = make(
        parse({"recording": {"files": [str(write_carmen(tmp_path / "a.log", scans=4))]}, "robots": 2})
    )
    assert plan.robot_settings[0].body.speed == pytest.approx(20, abs=0.5)  # 2 m between scans


@pytest.mark.parametrize(
    ("settings", "error"),
    [
        ({"robots": 5}, "4 scans for 5 robots; each robot needs one scan at least: set --robots to 4 at most"),
        ({"recording": {"every": 3}, "robots": 3}, "2 scans for 3 robots; .* to 2 at most, or --every to less"),
        ({"recording": {"every": 0}}, "every = 0: must be 1 to"),
        ({"recording": {"pace": "fast"}}, "pace = 'fast': must be scan or recorded"),
        ({"recording": {"resolution": 0.0}}, "resolution = 0: must be 0.01 to 10 m per cell"),
        ({"recording": {"topic": "/scan"}}, "topic = '/scan': only bags have topics"),
        ({"recording": {"speed": 1}}, "recording.speed: unknown setting; there are: files"),
        ({"strategy": "meier"}, "strategy = 'meier': robots that replay a log do not plan; omit it"),
        ({"speed": 1.0}, "speed = 1.0: has no meaning for robots that replay a log"),
        ({"laser": {"preset": "utm-30lx"}}, "laser = .*: has no meaning for robots that replay a log|field_of_view"),
        ({"robot": [{"robot": 0, "radius": 0.3}]}, r"\[\[robot\]\] 0: has no meaning for robots that replay a log"),
    ],
)  # fmt: skip
def test_an_error_names_the_setting_and_the_reason(
    tmp_path: Path, settings: dict[str, Any], error: str
) -> None:
    file = write_carmen(tmp_path / "a.log", scans=4)
    with pytest.raises(ScenarioError, match=error):
        recorded(file, **settings)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (carmen_text(scans=3, period_s=None), "its scans have no times: leave out --pace recorded"),
        (carmen_text(scans=3, period_s=0.0), "all scans have the same time"),
        (carmen_text(scans=3, period_s=-6.0), "the time jumps back by more than 5 s at scan 2"),
    ],
)
def test_the_recorded_pace_needs_times(tmp_path: Path, text: str, error: str) -> None:
    (tmp_path / "a.log").write_text(text)
    recorded(tmp_path / "a.log")
    with pytest.raises(ScenarioError, match=f"a.log: {error}"):
        recorded(tmp_path / "a.log", recording={"pace": "recorded"})


def test_logs_of_one_team_have_the_same_laser(tmp_path: Path) -> None:
    files = [write_carmen(tmp_path / f"{beams}.log", beams=beams) for beams in (180, 181)]
    with pytest.raises(
        ScenarioError, match=r"181.log: 181 beams from -90.0 to 90.0 degrees, but .*180 beams from -90.0"
    ):
        recorded(*files, robots=2)


def test_the_number_of_robots_is_that_of_the_logs(tmp_path: Path) -> None:
    files = [write_carmen(tmp_path / f"{name}.log") for name in "ab"]
    with pytest.raises(ScenarioError, match="robots = 3: each of 2 logs has one robot"):
        recorded(*files, robots=3)


def test_an_area_too_large_for_a_map_is_refused(tmp_path: Path) -> None:
    far = flaser((0, 0, 0), [1.0, 1.0]) + flaser((300, 0, 0), [1.0, 1.0])
    (tmp_path / "a.log").write_text(far)
    with pytest.raises(ScenarioError, match=r"more than 2048 cells of 0.1 m: use larger cells"):
        recorded(tmp_path / "a.log")
    assert recorded(tmp_path / "a.log", recording={"resolution": 0.5}).map.width > 600


def test_the_strategy_of_recorded_runs_needs_a_recording() -> None:
    with pytest.raises(ScenarioError, match=r"strategy = 'playback': replays logs: set recording.files"):
        parse({"strategy": "playback"})


def test_the_path_of_a_log_is_relative_to_the_scenario_file(tmp_path: Path) -> None:
    write_carmen(tmp_path / "a.log")
    (tmp_path / "s.toml").write_text('[recording]\nfiles = ["a.log"]\n')
    scenario = load(tmp_path / "s.toml", {})
    assert scenario.recording.files == (str(tmp_path / "a.log"),)
    assert (scenario.strategy, scenario.sensor_range) == ("playback", 10.0)
