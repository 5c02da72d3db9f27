"""A ROS 2 robot as a body: its messages become `Sense`, a `Move` becomes a goal."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from agent.bodies.ros2 import BodySettings
from agent.bodies.scan_body import ScanBody
from agent.bodies.team_map import occupancy_grid
from agent.mapping.mapper import EstimatingMapper
from agent.pose_guard import SETTLE_NS
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.cell_bytes import cells_to_bytes, points_to_bytes
from protocol.grid import FREE, OCCUPIED, UNKNOWN
from protocol.map_frame import MapFrame
from protocol.messages import Move, Sense
from protocol.range_scans import NO_MEASUREMENT, NOTHING, TURN, UNIT, RangeScan, beam_ends, decode_range_scan
from protocol.ros2 import messages as names
from protocol.ros2.messages import Messages
from protocol.transforms import Pose

SECOND = 10**9
MESSAGES = Messages("jazzy")
GRID = MapFrame(100, 80, 0.1, -2.0, -3.0)
"""10 by 8 m; (0, 0) m is the lower left corner of cell (20, 49)."""
AT_ORIGIN = Pose(0.0, 0.0, 0.0)
TRANSFORM = "geometry_msgs/msg/TransformStamped"


def transforms(*edges: tuple[str, str, Pose], now_ns: int = 0) -> Any:
    """Return a message of tf: parent, child, and pose of each edge."""
    found = []
    for parent, child, pose in edges:
        each = MESSAGES.new(TRANSFORM, header=MESSAGES.header(parent, now_ns), child_frame_id=child)
        each.transform.translation.x, each.transform.translation.y = pose.x, pose.y
        each.transform.rotation = MESSAGES.pose(*pose).orientation
        found.append(each)
    return MESSAGES[names.TRANSFORMS](transforms=found)


def laser_scan(ranges: list[float], now_ns: int = 0, **fields: Any) -> Any:
    """Return a scan over 360 degrees, from -180 degrees."""
    usual = {
        "angle_min": -math.pi,
        "angle_increment": math.tau / len(ranges),
        "range_min": 0.05,
        "range_max": 12.0,
    }
    header, data = MESSAGES.header("laser", now_ns), np.array(ranges, np.float32)
    return MESSAGES.new(names.LASER_SCAN, header=header, ranges=data, **(usual | fields))


def robot(map_pose: Pose = AT_ORIGIN, laser: Pose = AT_ORIGIN) -> ScanBody:
    """Return a body whose laser is at a pose of its base."""
    body = ScanBody(GRID, BodySettings(map_pose))
    body.add_transforms(transforms(("base_link", "laser", laser)), is_static=True)
    return body


def stand(body: ScanBody, pose: Pose, now_ns: int = 0) -> None:
    """Let a body receive where its base is in the robot's map."""
    edges = ("map", "odom", AT_ORIGIN), ("odom", "base_link", pose)
    body.add_transforms(transforms(*edges, now_ns=now_ns), is_static=False)


def scan_at(
    body: ScanBody, pose: Pose, now_ns: int = 0, ranges: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0)
) -> None:
    """Let a body receive a scan that was taken with its base at a pose in the robot's map."""
    stand(body, pose, now_ns)
    body.add_scan(laser_scan(list(ranges), now_ns))


def scan_of(body: ScanBody, sense: Sense | None) -> RangeScan:
    assert sense is not None
    assert body.laser is not None
    return decode_range_scan(sense.range_scan, body.laser)


def driving(*cells: tuple[int, int]) -> Move:
    """Return a move along cells."""
    return Move(1, cells_to_bytes(np.array(cells, np.int32)), 0, explored=False)


def test_a_scan_becomes_a_sense_at_the_pose_of_the_laser() -> None:
    body = robot(laser=Pose(0.25, 0.0, 0.0))
    scan_at(body, Pose(1.0, 0.53, math.pi / 2))
    sense = body.sense(1)
    scan = scan_of(body, sense)
    # The laser is at (1.0, 0.78) m: 30 cells right of the corner, and 37.8 above it, in a grid of 80 rows.
    assert scan.place == pytest.approx((30 * UNIT, 42.2 * UNIT), abs=1)
    assert scan.heading == TURN * 3 // 4  # up, where angles grow clockwise
    assert sense is not None
    assert (sense.step, sense.y, sense.heading) == (1, 42, 6)
    assert sense.offset_y == pytest.approx(-300, abs=5)


def test_beams_run_clockwise_in_a_sense() -> None:
    body = robot()
    scan_at(body, AT_ORIGIN, ranges=(1.0, 2.0, 3.0, 4.0))  # at -180, -90, 0, 90 degrees
    assert scan_of(body, body.sense(1)).ranges.tolist() == [4000, 3000, 2000, 1000]
    assert body.laser is not None
    assert body.laser.angles.tolist() == [-TURN // 4, 0, TURN // 4, TURN // 2]


def test_a_start_pose_places_the_map_in_the_frame_of_the_team() -> None:
    body = robot(map_pose=Pose(3.0, 1.0, math.pi / 2))
    scan_at(body, Pose(1.0, 0.0, 0.0))
    scan = scan_of(body, body.sense(1))
    assert scan.place == pytest.approx((50 * UNIT, 30 * UNIT), abs=1)  # (3, 2) m
    assert scan.heading == TURN * 3 // 4


def test_infinite_ranges_met_nothing_and_invalid_ones_are_no_measurements() -> None:
    body = robot()
    scan_at(body, AT_ORIGIN, ranges=(math.inf, 12.0, math.nan, 0.0, 0.01, 2.5))
    expected = [2500, NO_MEASUREMENT, NO_MEASUREMENT, NO_MEASUREMENT, NOTHING, NOTHING]
    assert scan_of(body, body.sense(1)).ranges.tolist() == expected


def test_without_a_new_scan_the_robot_stays_and_measures_nothing() -> None:
    body = robot()
    scan_at(body, Pose(1.0, 0.0, 0.0))
    first, second = scan_of(body, body.sense(1)), scan_of(body, body.sense(2))
    assert second.place == first.place
    assert set(second.ranges.tolist()) == {NO_MEASUREMENT}


def test_a_robot_that_does_not_measure_knows_only_its_pose() -> None:
    body = robot()
    scan_at(body, Pose(1.0, 0.0, 0.0))
    scan = scan_of(body, body.sense(1, measures=False))
    assert scan.x == 30
    assert set(scan.ranges.tolist()) == {NO_MEASUREMENT}


def test_the_newest_scan_with_a_known_pose_counts() -> None:
    body = robot()
    for second in range(4):
        scan_at(body, Pose(0.5 * second, 0.0, 0.0), second * SECOND)
    body.add_scan(laser_scan([9.0] * 4, 5 * SECOND))  # no transform at its time yet
    assert scan_of(body, body.sense(1)).place == pytest.approx((35 * UNIT, 50 * UNIT), abs=1)
    body.sense(2)
    assert "not of the time of the scans" in body.problem
    stand(body, Pose(2.0, 0.0, 0.0), 6 * SECOND)
    assert scan_of(body, body.sense(3)).ranges.tolist() == [9000] * 4


def test_a_pose_between_two_transforms_is_interpolated() -> None:
    body = robot()
    stand(body, Pose(1.0, 0.0, 0.0), 0)
    stand(body, Pose(2.0, 0.0, 0.0), SECOND)
    body.add_scan(laser_scan([1.0] * 4, SECOND // 2))
    assert scan_of(body, body.sense(1)).place == pytest.approx((35 * UNIT, 50 * UNIT), abs=1)


def test_a_scan_with_other_beams_is_read_at_the_angles_of_the_first() -> None:
    body = robot()
    scan_at(body, AT_ORIGIN)
    body.sense(1)
    stand(body, AT_ORIGIN, SECOND)
    body.add_scan(laser_scan([5.0, 6.0, 7.0], SECOND, angle_min=-math.pi / 2, angle_increment=math.pi / 4))
    assert scan_of(body, body.sense(2)).ranges.tolist() == [NO_MEASUREMENT, 7000, 5000, NO_MEASUREMENT]


@pytest.mark.parametrize(
    ("prepare", "problem"),
    [
        (lambda body: None, "no laser scan has arrived"),
        (lambda body: body.add_scan(laser_scan([1.0])), "laser scan: 1 beams; a scan must have 2 to"),
        (
            lambda body: body.add_scan(laser_scan([1.0] * 4)),
            "no transforms (tf) from 'map' to the laser's frame 'laser'; only base_link -> laser",
        ),
        (
            lambda body: scan_at(body, Pose(50.0, 0.0, 0.0)),
            "the laser is at (50.00, 0.00) m in the frame of the team, outside the grid",
        ),
    ],
)
def test_without_a_sense_the_body_says_why(prepare: Any, problem: str) -> None:
    body = robot()
    prepare(body)
    assert body.sense(1) is None
    assert problem in body.problem


def test_a_tilted_laser_is_refused() -> None:
    body = ScanBody(GRID, BodySettings(AT_ORIGIN))
    message = transforms(("base_link", "laser", AT_ORIGIN))
    message.transforms[0].transform.rotation.x = message.transforms[0].transform.rotation.w = 0.7
    body.add_transforms(message, is_static=True)
    body.add_scan(laser_scan([1.0] * 4))
    assert body.sense(1) is None
    assert body.problem == "frame 'laser': it is tilted; it must be level"


def test_a_laser_that_hangs_upside_down_measures_the_same_walls() -> None:
    mounts = [(Pose(0.25, 0.1, 0.5), False), (Pose(0.25, 0.1, 0.5), True)]
    walls = []
    for mount, hangs in mounts:
        body = ScanBody(GRID, BodySettings(AT_ORIGIN))
        message = transforms(("base_link", "plate", mount), ("plate", "laser", Pose(0.0, -0.2, 0.3)))
        if hangs:  # the plate is turned about its x axis, and what hangs from it is mirrored
            turn = message.transforms[0].transform.rotation
            turn.x, turn.y, turn.z, turn.w = turn.w, turn.z, 0.0, 0.0
            mirrored = transforms(("plate", "laser", Pose(0.0, 0.2, -0.3))).transforms[0]
            message.transforms[1] = mirrored
        body.add_transforms(message, is_static=True)
        stand(body, Pose(1.0, 0.53, math.pi / 2))
        angles = {"angle_min": -0.4, "angle_increment": 0.4}
        if hangs:
            angles = {"angle_min": 0.4, "angle_increment": -0.4}
        body.add_scan(laser_scan([1.0, 2.0, 3.0, 4.0], **angles))
        scan = scan_of(body, body.sense(1))
        assert body.laser is not None
        walls.append(beam_ends(scan, body.laser, GRID.resolution)[0])
    assert np.abs(walls[0] - walls[1]).max() <= 2


def test_a_robot_whose_pose_jumps_measures_nothing_until_it_settles() -> None:
    body = robot()
    scan_at(body, AT_ORIGIN, 0)
    body.sense(1)
    scan_at(body, Pose(3.0, 0.0, 0.0), SECOND // 2)
    jumped = scan_of(body, body.sense(2))
    assert set(jumped.ranges.tolist()) == {NO_MEASUREMENT}
    assert jumped.x == 20
    assert "has jumped" in body.problem
    scan_at(body, Pose(3.05, 0.0, 0.0), SECOND // 2 + SETTLE_NS)
    settled = scan_of(body, body.sense(3))
    assert (settled.x, body.problem) == (50, "")
    assert NO_MEASUREMENT not in settled.ranges.tolist()


def test_a_clock_that_is_set_back_does_not_stop_the_robot_or_move_its_scans() -> None:
    """Poses of the time before would be mixed with those of scans after, or a jump would settle an hour later."""
    hour = 3600 * SECOND
    body = robot()
    scan_at(body, AT_ORIGIN, hour)
    body.sense(1)
    scan_at(body, Pose(3.0, 0.0, 0.0), hour + SECOND // 2)
    body.sense(1)
    assert "has jumped" in body.problem
    for second in range(4):
        scan_at(body, Pose(3.0 - 0.1 * second, 0.0, 0.0), second * SECOND)
        body.sense(2)
    assert body.problem == ""
    body.add_scan(laser_scan([9.0] * 4, 3 * SECOND + SECOND // 2))
    assert set(scan_of(body, body.sense(3)).ranges.tolist()) == {NO_MEASUREMENT}, "no later pose is known yet"
    stand(body, Pose(2.6, 0.0, 0.0), 4 * SECOND)
    assert scan_of(body, body.sense(4)).place == pytest.approx((46.5 * UNIT, 50 * UNIT), abs=1)


def test_a_goal_is_the_end_of_the_path_in_the_robots_map_and_looks_along_it() -> None:
    body = robot(map_pose=Pose(3.0, 1.0, math.pi / 2))
    scan_at(body, AT_ORIGIN)  # at the corner of cell (50, 40)
    body.sense(1)
    goal = body.goal(driving((51, 40), (52, 40), (52, 39)))
    assert goal is not None
    # The center of cell (52, 39) is at (3.25, 1.05) m; the last step leads up, which is ahead in the robot's map.
    assert (goal.x, goal.y) == pytest.approx((0.05, -0.25))
    assert math.remainder(goal.yaw, math.tau) == pytest.approx(0.0)


def test_waypoints_lead_to_the_same_goal_as_cells() -> None:
    body = robot()
    scan_at(body, AT_ORIGIN)
    body.sense(1)
    points = points_to_bytes(np.array([[25_000, 50_000], [30_000, 50_000]], np.int32))
    by_points = body.goal(Move(1, b"", 0, explored=False, points=points))
    assert by_points is not None
    assert by_points == pytest.approx(body.goal(driving((25, 50), (30, 50))))


def test_a_robot_drives_to_its_target_although_the_move_ends_before_it() -> None:
    body = robot()
    scan_at(body, AT_ORIGIN)
    body.sense(1)
    goal = body.goal(driving((21, 49), (22, 49)), (22, 44))
    assert goal is not None
    assert (goal.x, goal.y, goal.yaw) == pytest.approx((0.25, 0.55, math.pi / 2))


def test_a_robot_that_stays_has_no_goal() -> None:
    body = robot()
    scan_at(body, AT_ORIGIN)
    body.sense(1)
    assert body.goal(Move(1, b"", 3, explored=False)) is None


def test_a_goal_stays_on_cells_that_the_robots_map_knows() -> None:
    body = robot()
    scan_at(body, AT_ORIGIN)
    body.sense(1)
    own = MESSAGES.new(names.OCCUPANCY_GRID, data=np.zeros(10 * 10, np.int8))
    own.info.width = own.info.height = 10
    own.info.resolution, own.info.origin = 0.1, MESSAGES.pose(-0.5, -0.5, 0.0)
    own.data[5 * 10 + 7] = -1  # from (0.2, 0.0) to (0.3, 0.1) m: cell (22, 49)
    body.add_map(own)
    path = [(column, 49) for column in range(21, 40)]
    goal = body.goal(driving(*path))
    assert goal is not None
    assert (goal.x, goal.y) == pytest.approx((0.45, 0.05))  # the map ends at 0.5 m
    goal = body.goal(driving((21, 49), (22, 49)))
    assert goal is not None
    assert (goal.x, goal.y) == pytest.approx((0.15, 0.05))
    assert body.goal(driving((22, 49))) is None
    assert body.goal(driving(*path), (60, 49)) == body.goal(driving(*path)), (
        "its map does not know the target"
    )


@pytest.mark.parametrize("start", [AT_ORIGIN, Pose(1.0, 0.5, 2.0)])
def test_a_robot_maps_the_walls_of_a_room_from_ros_messages(start: Pose) -> None:
    beams = 360
    angles = np.arange(beams) * math.tau / beams - math.pi + start.yaw
    cos, sin = np.cos(angles), np.sin(angles)
    to_walls = [
        (2 - np.sign(c) * at) / np.maximum(np.abs(c), 1e-9) for c, at in ((cos, start.x), (sin, start.y))
    ]
    body = robot(map_pose=start)
    scan_at(body, AT_ORIGIN, ranges=tuple(np.minimum(*to_walls).tolist()))
    sense = body.sense(1)
    assert sense is not None
    assert body.laser is not None
    settings = Settings(
        robot=0, bodies=(Body(100.0, 360.0, 5.0),), width=GRID.width, height=GRID.height, beams=beams, seed=0,
        strategy="meier", encoding=EncodingSettings("none"), replication=ReplicationSettings("gossip"),
    )  # fmt: skip
    mapper = EstimatingMapper(settings, body.laser)
    mapper.add(sense)
    rows, columns = np.nonzero(mapper.states == OCCUPIED)
    x, y = GRID.position(columns + 0.5, rows + 0.5)
    off = np.maximum(np.abs(x), np.abs(y)) - 2.0
    assert len(off) > 100
    assert np.abs(off).max() < 0.11
    assert mapper.states[49, 21] == FREE


def test_the_team_map_has_its_first_row_at_the_bottom() -> None:
    grid = np.full((GRID.height, GRID.width), UNKNOWN, np.uint8)
    grid[-1, 0], grid[0, 1] = FREE, OCCUPIED
    message = occupancy_grid(MESSAGES, grid, GRID, AT_ORIGIN, "map", 7)
    data = MESSAGES.decode(MESSAGES.encode(message), names.OCCUPANCY_GRID).data.reshape(80, 100)
    assert (data[0, 0], data[-1, 1], data[1, 0]) == (0, 100, -1)
    assert (message.info.origin.position.x, message.info.origin.position.y) == (-2.0, -3.0)


@given(st.floats(-1, 3), st.floats(-1, 3), st.floats(-3.2, 3.2), st.integers(0, 99), st.integers(0, 79))
def test_cells_of_the_team_map_lie_where_goals_lead(
    x: float, y: float, yaw: float, column: int, row: int
) -> None:
    map_pose = Pose(x, y, yaw)
    body = robot(map_pose=map_pose)
    scan_at(body, AT_ORIGIN)
    body.sense(1)
    goal = body.goal(driving((column, row)))
    info = occupancy_grid(MESSAGES, np.zeros((80, 100), np.uint8), GRID, map_pose, "map", 0).info
    position, turn = info.origin.position, info.origin.orientation
    corner = Pose(position.x, position.y, 2 * math.atan2(turn.z, turn.w))
    cell = corner.then(Pose((column + 0.5) * info.resolution, (79 - row + 0.5) * info.resolution, 0.0))
    assert goal is not None
    assert (goal.x, goal.y) == pytest.approx((cell.x, cell.y), abs=1e-6)


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("resolution", 0.0, "its resolution is 0 m"),
        ("resolution", math.nan, "its resolution is nan m"),
        ("width", 4_000_000_000, "100 cells instead of 4000000000 x 10"),
        ("origin", MESSAGES.pose(math.inf, 0.0, 0.0), "its origin is not a pose"),
        ("origin", MESSAGES.pose(1e300, 0.0, 0.0), "its origin is not a pose"),
        ("origin", MESSAGES.pose(0.0, 0.0, math.nan), "its origin is not a pose"),
    ],
)
def test_a_malformed_map_is_noted_and_has_no_effect(field: str, value: Any, problem: str) -> None:
    body = robot()
    scan_at(body, AT_ORIGIN)
    body.sense(1)
    own = MESSAGES.new(names.OCCUPANCY_GRID, data=np.full(100, -1, np.int8))
    own.info.width = own.info.height = 10
    own.info.resolution, own.info.origin = 0.1, MESSAGES.pose(0.0, 0.0, 0.0)
    setattr(own.info, field, value)
    body.add_map(own)
    assert body.problem == f"map: {problem}"
    assert body.goal(driving((21, 49), (22, 49))) is not None


def test_transforms_are_forgotten_after_a_minute_without_scans() -> None:
    body = robot()
    for second in range(200):
        stand(body, AT_ORIGIN, second * SECOND)
    body.add_scan(laser_scan([1.0] * 4, 100 * SECOND))
    assert body.sense(200) is None
    assert "not of the time of the scans" in body.problem
    body.add_scan(laser_scan([1.0] * 4, 150 * SECOND))
    assert body.sense(201) is not None


def test_poses_and_beams_beyond_all_bounds_are_noted() -> None:
    body = robot()
    scan_at(body, Pose(1e300, 0.0, 0.0))
    assert body.sense(1) is None
    assert "beyond 1e+09 m" in body.problem
    other = robot()
    other.add_scan(laser_scan([1.0] * 4, angle_increment=math.inf))
    assert "not those of a laser" in other.problem
