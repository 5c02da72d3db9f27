from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from protocol.packages import MissingPackageError
from protocol.range_scans import NO_MEASUREMENT, NOTHING
from tests.worldsim.recorded.made_logs import FULL_CIRCLE, Bag, distances, drive
from worldsim.recorded.log import LogError
from worldsim.recorded.reading import read

pytest.importorskip("rosbags", reason="rosbags is in the extra mcap")

KINDS = ("ros1", "sqlite3", "mcap")
MOUNT = (0.2, 0.1, math.pi / 2)
"""Pose of the laser on the robot."""


def place(folder: Path, kind: str = "mcap") -> Path:
    return folder / ("run.bag" if kind == "ros1" else "run")


def write_scans(bag: Bag, scans: int = 6) -> None:
    for second, pose in enumerate(drive(scans), 1):
        bag.scan(second, distances(pose, FULL_CIRCLE))


@pytest.mark.parametrize("kind", KINDS)
def test_poses_follow_the_transforms_from_the_map_to_the_laser(tmp_path: Path, kind: str) -> None:
    with Bag(place(tmp_path, kind), kind) as bag:
        bag.transform(0.0, "/base_link", "laser", MOUNT, static=True)
        write_scans(bag)
        for second in range(1, 8):
            bag.transform(second - 0.5, "map", "odom", (1.0, 0.0, math.pi / 2))
            bag.transform(second - 0.25, "odom", "base_link", (0.5 * second, 0.0, 0.0))
    log = read(place(tmp_path, kind))
    assert log.name == "run"
    assert log.stamps.tolist() == [1, 2, 3, 4, 5, 6]
    # base in odom at time t: x = 0.5 (t + 0.25); odom is turned by 90 degrees in map, and so is the laser on the base
    along = 0.5 * (log.stamps + 0.25) + 0.2
    assert np.allclose(log.poses[:, 0], 1.0 - 0.1)
    assert np.allclose(log.poses[:, 1], along)
    assert np.allclose(np.cos(log.poses[:, 2]), -1)
    wanted = distances(drive(6)[2], FULL_CIRCLE)[::-1]
    assert np.abs(log.ranges[2] / 1000 - wanted).max() < 0.001


@pytest.mark.parametrize("kind", KINDS)
def test_poses_follow_the_odometry_where_there_is_no_tf(tmp_path: Path, kind: str) -> None:
    with Bag(place(tmp_path, kind), kind) as bag:
        write_scans(bag)
        for second in range(8):
            bag.odometry(second, (0.25 * second, 1.0, 0.0))
    log = read(place(tmp_path, kind))
    assert np.allclose(log.poses, [(0.25 * second, 1.0, 0.0) for second in range(1, 7)])


def test_static_transforms_say_where_the_laser_is_on_the_robot_with_odometry(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        bag.transform(0.0, "base_link", "laser", MOUNT, static=True)
        write_scans(bag)
        for second in range(8):
            bag.odometry(second, (second, 0.0, 0.0))
    log = read(place(tmp_path))
    assert np.allclose(log.poses[0], (1.2, 0.1, math.pi / 2))


def test_the_odometry_is_used_if_the_map_frame_is_not_above_the_laser(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        write_scans(bag)
        for second in range(8):
            bag.transform(second, "odom", "laser", (second, 0.0, 0.0))
    assert np.allclose(read(place(tmp_path)).poses[:, 0], range(1, 7))


def test_headings_are_interpolated_the_short_way_around(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        bag.scan(0.5, np.ones(180))
        bag.transform(0.0, "map", "laser", (0.0, 0.0, math.radians(170)))
        bag.transform(1.0, "map", "laser", (0.0, 0.0, math.radians(-170)))
    assert math.cos(read(place(tmp_path)).poses[0, 2]) == pytest.approx(-1)


def test_scans_without_a_pose_at_their_time_are_left_out_and_noted(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        write_scans(bag)
        for second in (3, 4):
            bag.transform(second, "map", "laser", (second, 0.0, 0.0))
    log = read(place(tmp_path))
    assert log.stamps.tolist() == [3, 4]
    assert log.notes == (f"{place(tmp_path)}: 4 of 6 scans have no pose at their time, and are left out",)


def test_readings_out_of_limits_are_read_as_ros_defines_them(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        ranges = [1.0, np.inf, np.nan, 0.0, 0.05, 30.5, -np.inf, 29.0]
        bag.scan(1.0, ranges)
        bag.transform(1.0, "map", "laser", (0.0, 0.0, 0.0))
    wanted = [1000, NOTHING, NO_MEASUREMENT, NO_MEASUREMENT, NO_MEASUREMENT, NOTHING, NO_MEASUREMENT, 29000]
    assert read(place(tmp_path)).ranges[0].tolist() == wanted[::-1]


def test_limits_that_are_not_numbers_are_none(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        bag.scan(1.0, [1.0, 0.0, np.nan, 60.0], least=math.nan, most=math.nan)
        bag.transform(1.0, "map", "laser", (0.0, 0.0, 0.0))
    assert read(place(tmp_path)).ranges[0].tolist() == [60000, NO_MEASUREMENT, NO_MEASUREMENT, 1000]


def test_beams_of_a_laser_that_runs_clockwise_stay_in_their_order(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        bag.scan(1.0, [1.0, 2.0, 3.0], first=1.0, increment=-1.0)
        bag.transform(1.0, "map", "laser", (0.0, 0.0, 0.0))
    log = read(place(tmp_path))
    assert log.ranges[0].tolist() == [1000, 2000, 3000]
    assert (log.angles.first, log.angles.span) == (-round(65536 / 2 / math.pi), round(65536 / math.pi))


def test_every_takes_each_kth_scan(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        write_scans(bag)
        for second in range(8):
            bag.transform(second, "map", "laser", (second, 0.0, 0.0))
    assert read(place(tmp_path), every=4).stamps.tolist() == [1, 5]


def test_a_topic_selects_one_of_several_lasers(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        for topic in ("/front", "/rear"):
            bag.scan(1.0, [1.0 if topic == "/front" else 2.0] * 4, topic=topic)
        bag.transform(1.0, "map", "laser", (0.0, 0.0, 0.0))
    assert read(place(tmp_path), topic="/rear").ranges[0].tolist() == [2000] * 4
    with pytest.raises(LogError, match="several lasers; choose one with --topic: /front, /rear"):
        read(place(tmp_path))
    with pytest.raises(LogError, match="topic = '/read': no laser scans on it; did you mean /rear"):
        read(place(tmp_path), topic="/read")


def test_an_error_names_what_a_bag_lacks(tmp_path: Path) -> None:
    with Bag(tmp_path / "no_scans", "mcap") as bag:
        bag.odometry(1.0, (0.0, 0.0, 0.0))
    with Bag(tmp_path / "no_poses", "mcap") as bag:
        write_scans(bag)
        bag.transform(0.0, "base_link", "laser", MOUNT, static=True)
    with Bag(tmp_path / "other_time", "mcap") as bag:
        write_scans(bag)
        bag.transform(100.0, "map", "laser", (0.0, 0.0, 0.0))
    with Bag(tmp_path / "other_beams", "mcap") as bag:
        bag.scan(1.0, np.ones(10))
        bag.scan(2.0, np.ones(11))
        bag.transform(1.0, "map", "laser", (0.0, 0.0, 0.0))
        bag.transform(2.0, "map", "laser", (0.0, 0.0, 0.0))
    with Bag(tmp_path / "tilted", "mcap") as bag:
        write_scans(bag)
        bag.transform(1.0, "map", "laser", (0.0, 0.0, 1.0), roll=math.pi / 2)
    with Bag(tmp_path / "odometries", "mcap") as bag:
        write_scans(bag)
        for topic in ("/left", "/right"):
            bag.odometry(1.0, (0.0, 0.0, 0.0), topic=topic)
    with Bag(tmp_path / "no_angles", "mcap") as bag:
        bag.scan(1.0, np.ones(10), first=math.nan)
        bag.transform(1.0, "map", "laser", (0.0, 0.0, 0.0))
    with Bag(tmp_path / "blind", "mcap") as bag:
        bag.scan(1.0, np.full(10, 0.05))
        bag.transform(1.0, "map", "laser", (0.0, 0.0, 0.0))
    with Bag(tmp_path / "cut", "mcap") as bag:
        write_scans(bag)
    whole = (tmp_path / "cut" / "cut.mcap").read_bytes()
    (tmp_path / "cut" / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "no_yaml").mkdir()
    (tmp_path / "no_yaml" / "metadata.yaml").write_text("x: [")
    (tmp_path / "damaged.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    for name, error in (
        ("no_scans", "no laser scans .sensor_msgs/msg/LaserScan.; it has nav_msgs/msg/Odometry"),
        ("no_poses", "no poses: it has no odometry .*, and no transforms .*; only base_link -> laser"),
        ("other_time", "no poses: the transforms from map to laser are not of the time of any scan"),
        ("other_beams", "scan 2 has 11 beams from .*, after scans of 10 beams"),
        ("tilted", "frame 'laser': it is tilted"),
        ("odometries", "no transforms .*, and several odometries: /left, /right"),
        ("no_angles", "beams from nan rad, 0.0349066 rad apart, are not those of a laser"),
        ("blind", "no beam of its 1 scans measured anything"),
        ("cut", "not a readable bag: .*; mcap recover .* repairs files that were cut off"),
        ("no_yaml", "not a readable bag: [^\n]*$"),
        ("damaged.mcap", "not a readable bag"),
    ):
        with pytest.raises(LogError, match=f"{name}: {error}"):
            read(tmp_path / name)


def test_a_laser_that_hangs_upside_down_measures_the_same_walls(tmp_path: Path) -> None:
    logs = []
    for hangs in (False, True):
        with Bag(place(tmp_path / str(hangs)), "mcap") as bag:
            bag.transform(0.0, "base_link", "laser", MOUNT, static=True, roll=math.pi if hangs else 0.0)
            for second, pose in enumerate(drive(6), 1):
                ranges = distances(pose, FULL_CIRCLE)
                bag.scan(
                    second,
                    ranges,
                    first=math.pi if hangs else -math.pi,
                    increment=math.radians(-2 if hangs else 2),
                )
            for second in range(8):
                bag.transform(second, "map", "base_link", (second, 0.5, 0.3))
        logs.append(read(place(tmp_path / str(hangs))))
    level, upside_down = logs
    assert np.allclose(level.poses, upside_down.poses)
    assert level.angles == upside_down.angles
    assert np.array_equal(level.ranges, upside_down.ranges)


def test_frames_that_are_tilted_do_not_matter_unless_they_carry_the_laser(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        write_scans(bag)
        bag.transform(0.0, "laser", "camera_optical", MOUNT, static=True, roll=-math.pi / 2)
        for second in range(8):
            bag.transform(second, "map", "laser", (second, 0.0, 0.0))
    assert np.allclose(read(place(tmp_path)).poses[:, 0], range(1, 7))


def test_a_bag_needs_the_package_that_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        write_scans(bag)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(MissingPackageError, match=r"pip install 'murmur-robots\[mcap\]'"):
        read(place(tmp_path))


@pytest.mark.parametrize(("kind", "suffix"), [("sqlite3", ".db3"), ("mcap", ".mcap")])
def test_a_file_of_a_bag_is_a_log_of_its_own(tmp_path: Path, kind: str, suffix: str) -> None:
    with Bag(place(tmp_path), kind) as bag:
        write_scans(bag)
        for second in range(8):
            bag.odometry(second, (second, 0.0, 0.0))
    log = read(place(tmp_path) / f"run{suffix}")
    assert log.name == "run"
    assert log.stamps.tolist() == [1, 2, 3, 4, 5, 6]
