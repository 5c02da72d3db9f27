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
    assert "poses are those of odometry, in frame 'odom': their errors grow" in log.notes[0]


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
    with Bag(tmp_path / "no_static", "mcap") as bag:
        write_scans(bag)
        bag.transform(0.0, "odom", "base_link", MOUNT)
    with Bag(tmp_path / "rare", "mcap") as bag:
        write_scans(bag)
        for second in (0, 10):
            bag.transform(second, "map", "laser", (second, 0.0, 0.0))
    with Bag(tmp_path / "set_back", "mcap") as bag:
        for number, second in enumerate((10, 11, 12, 4, 5)):
            bag.recorded = 100.0 + number
            bag.scan(second, np.ones(10))
            bag.transform(second, "map", "laser", (0.0, 0.0, 0.0))
    with Bag(tmp_path / "two_maps", "mcap") as bag:
        for frame in ("left", "right"):
            bag.scan(1.0, np.ones(10), frame=frame)
            bag.transform(1.0, f"{frame}/map", frame, (0.0, 0.0, 0.0))
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
        ("no_static", "no poses: .*; only between base_link, odom: was /tf_static recorded"),
        (
            "other_time",
            "no poses: the transforms from map to laser are not of the time of any scan: they are of 100.0 to 100.0 s, "
            "and scans of 1.0 to 6.0 s",
        ),
        ("rare", "no poses: all scans lie between transforms from map to laser that are more than 2 s apart"),
        ("set_back", "the time jumps back by 8 s at scan 4, .*; cut it there .*, and replay one part"),
        ("two_maps", "scans of frame 'left' have poses in 'left/map', and those of 'right' in 'right/map'"),
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


def test_scans_of_a_laser_whose_number_of_beams_varies_are_read_at_the_angles_of_most(tmp_path: Path) -> None:
    counts = [40, 455, 454, 455, 457, 455]
    with Bag(place(tmp_path), "mcap") as bag:
        for second, (pose, beams) in enumerate(zip(drive(6), counts, strict=True), 1):
            increment = math.tau / (beams - 1)
            angles = -math.pi + increment * np.arange(beams)
            bag.scan(second, distances(pose, angles), increment=increment)
            bag.transform(second, "map", "laser", pose)
    log = read(place(tmp_path))
    assert log.ranges.shape == (6, 455)
    assert "3 of 6 scans do not have 455 beams from -180.0 to 180.0 degrees" in log.notes[0]
    angles = np.linspace(-math.pi, math.pi, 455)
    for at in (2, 4):
        wanted = distances(drive(6)[at], angles)[::-1]
        assert np.median(np.abs(log.ranges[at] / 1000 - wanted)) < 0.01


def test_lasers_with_frames_of_their_own_may_share_a_topic(tmp_path: Path) -> None:
    mounts = {"front": (0.2, 0.0, 0.0), "rear": (-0.2, 0.0, math.pi)}
    with Bag(place(tmp_path), "mcap") as bag:
        for frame, mount in mounts.items():
            bag.transform(0.0, "base_link", frame, mount, static=True, roll=math.pi if frame == "rear" else 0)
        for second in range(4):
            bag.transform(second, "map", "base_link", (second, 0.0, 0.0))
            bag.scan(
                second,
                [1.0, 2.0, 3.0, 4.0],
                frame="rear" if second % 2 else "front",
                first=-0.3,
                increment=0.2,
            )
    log = read(place(tmp_path))
    assert np.allclose(log.poses[:, 0], [0.2, 0.8, 2.2, 2.8])
    assert np.allclose(np.cos(log.poses[:, 2]), [1, -1, 1, -1])
    assert log.ranges.tolist() == [[4000, 3000, 2000, 1000], [1000, 2000, 3000, 4000]] * 2


def test_messages_without_a_time_were_sent_when_they_were_recorded(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        for second in range(5, 9):
            bag.recorded = second
            bag.odometry(0.0, (0.5 * second, 0.0, 0.0))
            bag.scan(0.0, [1.0, 2.0])
    log = read(place(tmp_path))
    assert log.stamps.tolist() == [5, 6, 7, 8]
    assert np.allclose(log.poses[:, 0], [2.5, 3.0, 3.5, 4.0])


def test_scans_in_a_gap_of_the_transforms_are_left_out_if_the_robot_has_moved(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        for second in range(20):
            bag.scan(second, [1.0, 2.0])
            if second not in (*range(4, 8), *range(12, 16)):
                bag.transform(second, "map", "laser", (min(second, 9), 0.0, 0.0))
    log = read(place(tmp_path))
    assert log.stamps.tolist() == [0, 1, 2, 3, *range(8, 20)]
    assert log.notes == (
        f"{place(tmp_path)}: 4 of 20 scans lie between transforms that are more than 2 s apart, and are left out",
    )


def test_poses_may_be_in_a_frame_of_any_name(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        bag.transform(0.0, "base", "laser", MOUNT, static=True)
        write_scans(bag)
        for second in range(8):
            bag.transform(second, "world", "base", (second, 0.0, 0.0))
    log = read(place(tmp_path))
    assert np.allclose(log.poses[:, 0], np.arange(1, 7) + 0.2)
    assert log.notes == (
        f"{place(tmp_path)}: poses are those in frame 'world', as there is neither map nor odom",
    )


def test_robots_with_namespaces_may_have_frames_of_equal_names(tmp_path: Path) -> None:
    with Bag(tmp_path / "tf", "mcap") as bag, Bag(tmp_path / "odometry", "mcap") as other:
        for robot in (1, 2):
            space = f"/robot{robot}"
            bag.transform(0.0, "base_link", "laser", (0.1 * robot, 0, 0), static=True, namespace=space)
            for second in range(3):
                bag.transform(second, "odom", "base_link", (10.0 * robot + second, 0, 0), namespace=space)
                other.odometry(second, (10.0 * robot + second, 0.0, 0.0), topic=f"{space}/odom")
                for each in (bag, other):
                    each.scan(second, [1.0, 2.0], topic=f"{space}/scan")
    for robot in (1, 2):
        x = read(tmp_path / "tf", topic=f"/robot{robot}/scan").poses[:, 0]
        assert np.allclose(x, 10.1 * robot + np.arange(3))
        x = read(tmp_path / "odometry", topic=f"/robot{robot}/scan").poses[:, 0]
        assert np.allclose(x, 10.0 * robot + np.arange(3))


def test_an_error_of_a_file_names_the_bag_that_it_belongs_to(tmp_path: Path) -> None:
    with Bag(place(tmp_path), "mcap") as bag:
        write_scans(bag)
    file = place(tmp_path) / "run.mcap"
    file.write_bytes(file.read_bytes()[:500])
    with pytest.raises(LogError, match=f"not a readable bag: .*; it is a file of the bag {place(tmp_path)}"):
        read(file)
