from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import make
from deploy.scenario.recording import Recording, load_recording
from deploy.scenario.scenario import load, parse
from protocol.grid import FREE, OCCUPIED
from protocol.range_scans import TURN
from tests.worldsim.recorded.made_logs import (
    HEIGHT,
    WIDTH,
    Bag,
    carmen_text,
    distances,
    drive,
    flaser,
    robotlaser,
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


def test_robots_of_one_team_may_have_different_lasers(tmp_path: Path) -> None:
    one = write_carmen(tmp_path / "one.log", beams=180)
    angles = np.radians(np.arange(-120.0, 121.0, 2.0))
    lines = [robotlaser(pose, distances(pose, angles), angles[0], math.radians(2), 30.0) for pose in drive(9)]
    (tmp_path / "other.log").write_text("".join(lines))
    files = {"files": [str(one), str(tmp_path / "other.log")], "listeners": 1}
    plan = make(parse({"recording": files, "robots": 3}))
    lasers = [body.laser for body in plan.world.bodies]
    assert [(each.beams, round(each.span * 360 / TURN)) for each in lasers if each] == [
        (180, 179),
        (121, 240),
        (180, 179),
    ]
    assert plan.recording is not None
    assert [each.ranges.shape[1] for each in plan.recording.stretches] == [180, 121, 180]
    # the map of both has the room's size: all walls are in the right place
    assert abs(plan.map.width - WIDTH / 0.1 - 4) <= 2


def test_a_bag_of_a_team_has_a_robot_for_each_topic(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="rosbags is in the extra mcap")
    with Bag(tmp_path / "team", "mcap") as bag:
        for robot in ("left", "right"):
            for second in range(3 if robot == "left" else 5):
                bag.scan(second, [1.0, 2.0], topic=f"/{robot}/scan", frame=f"{robot}/laser")
                bag.transform(second, "map", f"{robot}/laser", (second, 0.0, 0.0))
    table = {"files": [str(tmp_path / "team")], "topic": "/left/scan,/right/scan"}
    scenario = parse({"recording": table})
    assert scenario.robots == 2
    assert steps(load_recording(scenario)) == [[1, 2, 3], [1, 2, 3, 4, 5]]
    with pytest.raises(ScenarioError, match="robots = 3: each of 2 logs has one robot"):
        parse({"recording": table, "robots": 3})
    with pytest.raises(ScenarioError, match="has 2 topics for 3 logs; give one bag, or one per topic"):
        parse({"recording": table | {"files": ["a", "b", "c"]}})


def test_a_log_that_is_longer_than_a_run_is_refused_unless_the_steps_are_given(tmp_path: Path) -> None:
    scan = [1.0, 2.0]
    lines = [flaser((0, 0, 0), scan, at) for at in (0, 1, 2, 50_000, 50_001)]
    (tmp_path / "gap.log").write_text("".join(lines))
    (tmp_path / "long.log").write_text(flaser((0, 0, 0), scan) * 30_000)
    assert steps(recorded(tmp_path / "gap.log")) == [[1, 2, 3, 4, 5]]
    paced = {"pace": "recorded"}
    with pytest.raises(
        ScenarioError, match=r"last scan is 50001 s after .* .longest gap: 49998 s.*--pace recorded"
    ):
        recorded(tmp_path / "gap.log", recording=paced)
    assert steps(recorded(tmp_path / "gap.log", recording=paced, steps=10)) == [[1, 2, 3, 50_001, 50_002]]
    with pytest.raises(
        ScenarioError, match=r"has 15000 scans, .* 10000 steps: replay fewer scans .--every 2."
    ):
        recorded(tmp_path / "long.log", robots=2)


def test_a_pose_that_jumps_is_noted(tmp_path: Path) -> None:
    def jumps(name: str) -> list[str]:
        return [note for note in recorded(tmp_path / f"{name}.log").notes if "the pose jumps" in note]

    places = [0.0, 0.4, 0.8, 3.4, 3.8, 4.2]
    for name, stamps in (
        ("timed", [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        ("slow", range(6)),
        ("untimed", [None] * 6),
    ):
        lines = [flaser((x, 0, 0), [1.0, 2.0], at) for x, at in zip(places, stamps, strict=True)]
        (tmp_path / f"{name}.log").write_text("".join(lines))
    (note,) = jumps("timed")
    assert note.startswith(
        "timed: the pose jumps by 2.6 m within 0.2 s, before scan 4; if odometry was reset there"
    )
    assert jumps("slow") == jumps("untimed") == []
    lines[2] = flaser((500.0, 0, 0), [1.0, 2.0])
    (tmp_path / "far.log").write_text("".join(lines))
    error = "or leave out wrong poses: in far, the pose jumps 2 times, first by 499.6 m, before scan 3"
    with pytest.raises(ScenarioError, match=f"use larger cells .--resolution., {error}"):
        recorded(tmp_path / "far.log")


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
