"""Exports: a run's bag, read back by a library that had no part in writing it."""

from __future__ import annotations

import math
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[mcap]'")
pytest.importorskip(
    "mcap_ros2", reason="mcap-ros2-support is not installed: pip install 'murmur-robots[dev]'"
)

from agent.bodies.team_map import occupancy
from deploy.after import archive
from deploy.after.bag_messages import ranges_of
from deploy.after.export import export_mcap
from deploy.after.recast_scans import Lasers
from deploy.record.colors import GROUPS
from deploy.run.in_memory import MemoryRun
from protocol.grid import ray_table
from protocol.message_codec import unpack
from protocol.messages import Sense
from protocol.packages import MissingPackageError
from protocol.scans import HIT, NONE
from protocol.transforms import Pose
from tests.deploy.small_run import small_directory, small_plan
from worldsim.maps import to_cell, to_world
from worldsim.recorded import reading


@cache
def bag() -> dict[str, list[tuple[int, Any]]]:
    """All messages by topic, as (second, message)."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    topics: dict[str, list[tuple[int, Any]]] = {}
    with export_mcap(small_directory()).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, logged, message in reader.iter_decoded_messages():
            second, rest = divmod(logged.log_time, 10**9)
            assert rest == 0
            topics.setdefault(channel.topic, []).append((second, message))
    return topics


def steps() -> dict[str, np.ndarray[Any, Any]]:
    return archive.read(small_directory()).steps


def test_every_robot_has_its_topics_every_step() -> None:
    names = {
        "/truth",
        "/tf",
        "/tf_static",
        "/radio/frames",
        "/radio/steps",
        *(
            f"/r{r}/{what}"
            for r in range(3)
            for what in ("pose", "odom", "goal_pose", "scan", "map", "polygons")
        ),
    }
    assert set(bag()) == names
    for robot in range(3):
        assert [second for second, _ in bag()[f"/r{robot}/scan"]] == list(range(1, 41))


def test_poses_are_those_of_the_run_in_the_maps_frame() -> None:
    table = steps()
    for row in range(len(table["step"])):
        second, message = bag()[f"/r{table['robot'][row]}/pose"][table["step"][row] - 1]
        assert second == message.header.stamp.sec == table["step"][row]
        assert message.header.frame_id == "map"
        assert message.pose.position.x == table["x"][row]
        assert message.pose.position.y == table["y"][row]
        yaw = 2 * math.atan2(message.pose.orientation.z, message.pose.orientation.w)
        assert math.cos(yaw + math.radians(table["heading"][row])) == pytest.approx(1.0)


def placed(transform: Any) -> Pose:
    """The pose of a transform's frame in its parent."""
    place, turn = transform.transform.translation, transform.transform.rotation
    assert (place.z, turn.x, turn.y) == (0, 0, 0)
    return Pose(place.x, place.y, 2 * math.atan2(turn.z, turn.w))


def frames(step: int) -> dict[str, tuple[str, Pose]]:
    """Each frame's parent and its pose in it, at a step."""
    (_, static), (_, moving) = bag()["/tf_static"][0], bag()["/tf"][step - 1]
    both = [*static.transforms, *moving.transforms]
    assert all(each.header.stamp.sec == 0 for each in static.transforms)
    assert all(each.header.stamp.sec == step for each in moving.transforms)
    edges = {each.child_frame_id: (each.header.frame_id, placed(each)) for each in both}
    assert len(edges) == len(both), "each frame has one parent"
    return edges


def in_map(frame: str, step: int) -> Pose:
    """The pose of a frame in the frame of the map."""
    edges, pose = frames(step), Pose(0, 0, 0)
    while frame != "map":
        frame, outer = edges[frame]
        pose = outer.then(pose)
    return pose


def test_frames_are_those_of_a_ros_robot_below_the_map() -> None:
    assert {frame: parent for frame, (parent, _) in frames(1).items()} == {
        **{f"r{robot}/odom": "map" for robot in range(3)},
        **{f"r{robot}/base_link": f"r{robot}/odom" for robot in range(3)},
        **{f"r{robot}/laser": f"r{robot}/base_link" for robot in range(3)},
    }
    for robot in range(3):
        assert frames(1)[f"r{robot}/base_link"][1] == pytest.approx((0, 0, 0))
        for step in (1, 17, 40):
            place = bag()[f"/r{robot}/pose"][step - 1][1].pose
            base = in_map(f"r{robot}/base_link", step)
            assert (base.x, base.y) == pytest.approx((place.position.x, place.position.y))
            turned = base.yaw - 2 * math.atan2(place.orientation.z, place.orientation.w)
            assert math.cos(turned) == pytest.approx(1.0)


def test_odometry_is_the_motion_since_the_start_and_its_velocity() -> None:
    resolution = small_plan().map.resolution
    for robot in range(3):
        messages = [message for _, message in bag()[f"/r{robot}/odom"]]
        assert len(messages) == 40
        driven = 0.0
        for step, message in enumerate(messages, 1):
            assert (message.header.frame_id, message.child_frame_id) == (
                f"r{robot}/odom",
                f"r{robot}/base_link",
            )
            _, moved = frames(step)[f"r{robot}/base_link"]
            place = message.pose.pose.position
            assert (place.x, place.y) == pytest.approx(moved[:2])
            driven += math.hypot(message.twist.twist.linear.x, message.twist.twist.linear.y)
        table = steps()
        length = table["driven"][(table["robot"] == robot) & (table["step"] == 40)]
        assert length * 0.8 <= driven <= length + resolution


def test_goals_are_published_when_they_change() -> None:
    table = steps()
    for robot in range(3):
        rows = table["robot"] == robot
        targets = list(
            zip(*(table[name][rows].tolist() for name in ("step", "target_x", "target_y")), strict=True)
        )
        changes, last = [], None
        for step, x, y in targets:
            if not math.isnan(x) and (x, y) != last:
                changes.append((step, x, y))
                last = x, y
        goals = [
            (second, message.pose.position.x, message.pose.position.y)
            for second, message in bag()[f"/r{robot}/goal_pose"]
        ]
        assert goals == changes
        assert len(goals) > 1
        assert {message.header.frame_id for _, message in bag()[f"/r{robot}/goal_pose"]} == {"map"}
        assert {message.pose.orientation.w for _, message in bag()[f"/r{robot}/goal_pose"]} == {1.0}


def test_viewers_that_join_late_get_maps_and_static_transforms() -> None:
    from rosbags.interfaces import QosDurability, QosHistory, QosReliability
    from rosbags.rosbag2 import Reader

    bag()
    with Reader(small_directory() / "rosbag") as reader:
        profiles = {each.topic: each.ext.offered_qos_profiles for each in reader.connections}  # type: ignore[union-attr]
    assert profiles.keys() == bag().keys()
    latched = set()
    for topic, (profile,) in profiles.items():
        assert profile.reliability == QosReliability.RELIABLE, "it suits subscriptions of both kinds"
        assert profile.history == QosHistory.KEEP_LAST
        assert (
            profile.deadline
            == profile.lifespan
            == profile.liveliness_lease_duration
            == (9223372036, 854775807)
        )
        if profile.durability == QosDurability.TRANSIENT_LOCAL:
            latched.add(topic)
    per_robot = {f"/r{robot}/{name}" for robot in range(3) for name in ("map", "polygons")}
    assert latched == {"/truth", "/tf_static", *per_robot}
    assert {profiles[topic][0].depth for topic in ("/truth", "/r0/map")} == {1}


def test_the_mcap_file_has_the_same_profiles_as_its_metadata() -> None:
    from mcap.reader import make_reader

    bag()
    folder = small_directory() / "rosbag"
    data = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    listed = {
        each["topic_metadata"]["name"]: yaml.safe_load(each["topic_metadata"]["offered_qos_profiles"])
        for each in data["topics_with_message_count"]
    }
    with (folder / "rosbag.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    channels = {
        each.topic: yaml.safe_load(each.metadata["offered_qos_profiles"])
        for each in summary.channels.values()
    }
    assert channels == listed
    assert listed["/r0/map"][0]["durability"] == 1
    assert listed["/r0/scan"][0]["durability"] == 2


def test_the_bag_can_be_replayed_as_a_robots_log() -> None:
    bag()
    log = reading.read(small_directory() / "rosbag", topic="/r1/scan")
    table = steps()
    rows = table["robot"] == 1
    poses = np.column_stack([table["x"][rows], table["y"][rows], -np.radians(table["heading"][rows])])
    assert log.poses[:, :2] == pytest.approx(poses[:, :2], abs=1e-3)
    assert np.cos(log.poses[:, 2] - poses[:, 2]) == pytest.approx(1.0)


def test_a_scan_drawn_in_the_maps_frame_hits_walls_of_the_truth() -> None:
    world = small_plan().map
    for robot in range(3):
        second, scan = bag()[f"/r{robot}/scan"][20 - 1]
        assert second == 20
        place = in_map(scan.header.frame_id, 20)
        assert scan.angle_min == pytest.approx(-math.pi)
        hits = 0
        for beam, meters in enumerate(scan.ranges):
            if math.isfinite(meters):
                angle = place.yaw + scan.angle_min + beam * scan.angle_increment
                x, y = to_cell(world, place.x + meters * math.cos(angle), place.y + meters * math.sin(angle))
                near = world.cells[round(y) - 1 : round(y) + 2, round(x) - 1 : round(x) + 2]
                assert (near == 2).any()
                assert scan.range_min <= meters <= scan.range_max
                hits += 1
        assert hits > 50


def test_maps_are_the_planning_maps_bottom_row_first() -> None:
    maps = archive.read(small_directory()).maps
    for robot in range(3):
        for second, message in bag()[f"/r{robot}/map"]:
            grid = maps.planning(robot, second)
            assert grid is not None
            data = np.array(message.data, np.int8).reshape(message.info.height, message.info.width)
            assert (data[::-1] == np.array([-1, 0, 100], np.int8)[grid]).all()
            assert message.info.resolution == pytest.approx(small_plan().map.resolution)
    truth = np.array(bag()["/truth"][0][1].data, np.int8)
    assert (truth == occupancy(small_plan().map.cells)).all()


def test_polygons_are_closed_and_lie_where_the_recorded_outlines_do() -> None:
    maps = archive.read(small_directory()).maps
    world = small_plan().map
    second, message = bag()["/r0/polygons"][-1]
    (marker,) = message.markers
    rows = np.frombuffer(maps.outlines(0, marker.id, second), "<i2").reshape(-1, 4)
    assert len(marker.points) == len(marker.colors) == 2 * len(rows)
    for row, (here, color) in zip(
        rows, zip(marker.points[::2], marker.colors[::2], strict=True), strict=True
    ):
        assert (here.x, here.y) == pytest.approx(to_world(world, row[1] / 4, row[2] / 4))
        assert color.a == pytest.approx(1.0 if row[3] & 1 else 0.4)
    begins = sorted((point.x, point.y) for point in marker.points[::2])
    ends = sorted((point.x, point.y) for point in marker.points[1::2])
    assert begins == ends


def test_the_radios_frames_are_those_of_the_ledger() -> None:
    ledger = archive.read(small_directory()).ledger
    frames = [message for _, message in bag()["/radio/frames"]]
    whole = np.unique(
        np.column_stack(
            [ledger[name] for name in ("step", "round", "connection", "frame", "sender", "receiver", "map")]
        ),
        axis=0,
    )
    assert len(frames) == len(whole)
    assert {frame.frame for frame in frames} == {"offer", "answer", "data", "broadcast"}
    for kind in np.unique(ledger["kind"]):
        rows = ledger["kind"] == kind
        for name in ("packets", "bytes"):
            total = sum(
                amount
                for frame in frames
                for its, amount in zip(frame.kinds, getattr(frame, name), strict=True)
                if its == kind
            )
            assert total == ledger[name][rows].sum()
    assert sum(frame.carried for frame in frames) == ledger["bytes"][ledger["carried"]].sum()
    assert sum(frame.refused for frame in frames) == ledger["bytes"][~ledger["carried"]].sum()
    assert all(bool(frame.cause) == (frame.refused > 0) for frame in frames)
    broadcast = next(frame for frame in frames if frame.frame == "broadcast")
    assert (broadcast.receiver, broadcast.connection) == (-1, -1)


def test_each_step_has_its_bytes_by_traffic_type_and_its_budget() -> None:
    ledger = archive.read(small_directory()).ledger
    assert [second for second, _ in bag()["/radio/steps"]] == list(range(1, 41))
    for step, message in bag()["/radio/steps"]:
        here = ledger["step"] == step
        assert message.budget == 1000
        assert message.carried == ledger["bytes"][here & ledger["carried"]].sum()
        assert message.waiting == ledger["bytes"][here & (ledger["cause"] == "budget")].sum()
        purposes = {name: getattr(message, name) for name in GROUPS}
        assert sum(purposes.values()) == message.carried
        corners = np.isin(ledger["kind"], GROUPS["vertices"].kinds)
        assert purposes["vertices"] == ledger["bytes"][here & ledger["carried"] & corners].sum()


def test_the_bag_has_the_metadata_that_ros_asks_for() -> None:
    bag()
    data = yaml.safe_load((small_directory() / "rosbag" / "metadata.yaml").read_text())
    information = data["rosbag2_bagfile_information"]
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["rosbag.mcap"]
    assert information["message_count"] == sum(map(len, bag().values()))


def test_recomputed_scans_equal_those_of_the_run_bit_for_bit() -> None:
    sensed: dict[tuple[int, int], Sense] = {}

    def wrap(name: str, bus: Any) -> Any:
        receive = bus.receive

        def tapped(timeout_s: float | None = None) -> Any:
            message = receive(timeout_s)
            if message is not None and name[:1] == "r" and name != "relay" and "/body/" in message.key:
                content = unpack(message.payload)
                if isinstance(content, Sense):
                    sensed[int(name[1:]), content.step] = content
            return message

        bus.receive = tapped
        return bus

    MemoryRun(small_plan(), wrap=wrap).complete()
    compared = 0
    for step, scans in Lasers(archive.read(small_directory())).scans():
        for scan in scans:
            sense = sensed[scan.robot, step]
            assert (scan.x, scan.y, scan.heading) == (sense.x, sense.y, sense.heading)
            assert scan.readings.tobytes() == sense.readings
            compared += 1
    assert compared == 3 * 40


def test_ranges_turn_with_y_up_and_readings_out_of_range_are_infinite() -> None:
    beams = ray_table(10, 4)  # +x, down, -x, up on the picture
    readings = np.array([3 | HIT, 9, NONE, 0 | HIT], np.uint16)
    ranges = ranges_of(readings, beams, 0.5)
    assert ranges[0] == 2.0
    assert ranges[1] == 0.5  # up
    assert math.isnan(ranges[2])
    assert math.isinf(ranges[3])


def test_an_export_names_the_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(MissingPackageError, match=r"pip install 'murmur-robots\[mcap\]'"):
        export_mcap(Path())


def test_an_export_needs_only_the_packages_of_its_extra() -> None:
    program = "import sys; sys.modules['xxhash'] = None; import deploy.after.bag_messages"
    subprocess.run([sys.executable, "-c", program], check=True)
