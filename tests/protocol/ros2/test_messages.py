"""Messages: CDR, type hashes, and values of fields."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import ProtocolError
from protocol.ros2 import messages as names
from protocol.ros2.interfaces import CANCEL_GOAL, NAVIGATE_TO_POSE, fields_of, service
from protocol.ros2.messages import DISTROS, Messages, nanoseconds

TYPES = (
    names.CLOCK,
    names.LASER_SCAN,
    names.MARKERS,
    names.OCCUPANCY_GRID,
    names.ODOMETRY,
    names.POSE_STAMPED,
    names.STRING,
    names.TRANSFORMS,
    names.TWIST,
    f"{CANCEL_GOAL}_Request",
    f"{CANCEL_GOAL}_Response",
    f"{NAVIGATE_TO_POSE}_SendGoal_Request",
    f"{NAVIGATE_TO_POSE}_SendGoal_Response",
    f"{NAVIGATE_TO_POSE}_GetResult_Request",
    f"{NAVIGATE_TO_POSE}_GetResult_Response",
    f"{NAVIGATE_TO_POSE}_FeedbackMessage",
)

floats = st.floats(width=32, allow_nan=False)
JAZZY = Messages("jazzy")


@pytest.fixture(scope="module")
def messages() -> Messages:
    return Messages("jazzy")


def test_a_string_has_these_bytes(messages: Messages) -> None:
    data = messages.encode(messages[names.STRING](data="hello"))
    assert data == bytes.fromhex("00010000 06000000") + b"hello\0"


def test_a_clock_has_these_bytes(messages: Messages) -> None:
    data = messages.encode(messages[names.CLOCK](clock=messages.time(2_000_000_003)))
    assert data.hex() == "000100000200000003000000"


def test_type_hashes_are_those_of_ros(messages: Messages) -> None:
    # From rmw_zenoh's description of its keys.
    assert messages.type_hash(names.STRING).endswith(
        "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )


def test_the_hash_of_a_service_is_that_of_ros(messages: Messages) -> None:
    name = "example_interfaces/srv/AddTwoInts"
    messages.register(service(name, fields_of("int64 a\nint64 b")[1], fields_of("int64 sum")[1]))
    assert messages.type_hash(name) == (
        "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    )


@pytest.mark.parametrize("distro", DISTROS)
def test_each_distribution_has_all_types_and_they_survive_cdr(distro: str) -> None:
    messages = Messages(distro)
    for name in TYPES:
        message = messages.new(name)
        data = messages.encode(message)
        assert messages.encode(messages.decode(data, name)) == data, name
    for name in (*TYPES[:9], CANCEL_GOAL, f"{NAVIGATE_TO_POSE}_SendGoal", f"{NAVIGATE_TO_POSE}_GetResult"):
        assert messages.type_hash(name).startswith("TypeHash" if distro == "humble" else "RIHS01_"), name


@given(
    st.lists(floats, max_size=40), st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1), st.text(max_size=8)
)
def test_scans_survive_cdr(ranges: list[float], seconds: int, rest: int, frame: str) -> None:
    messages = JAZZY
    frame = frame.replace("\0", "")
    now_ns = seconds * 10**9 + rest
    scan = messages.new(
        names.LASER_SCAN, header=messages.header(frame, now_ns), ranges=np.array(ranges, np.float32)
    )
    copy = messages.decode(messages.encode(scan), names.LASER_SCAN)
    assert nanoseconds(copy.header.stamp) == now_ns
    assert copy.header.frame_id == frame
    np.testing.assert_array_equal(copy.ranges, scan.ranges)


def test_a_pose_in_the_plane_is_a_turn_around_the_vertical(messages: Messages) -> None:
    pose = messages.pose(1.5, -2.0, np.pi / 2)
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.5, -2.0, 0.0)
    assert (pose.orientation.z, pose.orientation.w) == pytest.approx((np.sqrt(0.5), np.sqrt(0.5)))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("sensor_msgs/msg/LaserScam", "did you mean sensor_msgs/msg/LaserScan or"),
        ("my_msgs/msg/Thing", "and no package 'my_msgs'"),
    ],
)
def test_an_unknown_type_gets_an_error(messages: Messages, name: str, reason: str) -> None:
    with pytest.raises(ValueError, match="jazzy has no type") as caught:
        messages.type_hash(name)
    assert reason in str(caught.value)


def test_an_unknown_distribution_gets_an_error() -> None:
    with pytest.raises(ValueError, match="unknown distribution of ROS 2: 'foxi'; there are: humble, jazzy"):
        Messages("foxi")


def test_a_wrong_field_gets_an_error(messages: Messages) -> None:
    with pytest.raises(ValueError, match="not a message of type std_msgs/msg/String"):
        messages.encode(messages[names.STRING](data=3))


@given(st.sampled_from(TYPES), st.binary(max_size=64))
def test_any_bytes_are_decoded_or_refused(name: str, data: bytes) -> None:
    for payload in (data, b"\0\1\0\0" + data):
        try:
            JAZZY.decode(payload, name)
        except ProtocolError as error:
            assert name in str(error)


def test_without_rosbags_the_error_says_what_to_install() -> None:
    code = (
        "import importlib.util as util; find = util.find_spec\n"
        "util.find_spec = lambda name: None if name == 'rosbags' else find(name)\n"
        "import protocol.ros2"
    )
    result = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert "ROS 2 needs the package rosbags: pip install 'murmur-robots[ros2]'" in result.stderr


@pytest.mark.parametrize(
    "module", ["murmur", "protocol.zenoh_bus", "agent.process", "worldsim.recorded.ros_bag"]
)
def test_without_ros_rosbags_is_not_imported(module: str) -> None:
    code = f"import sys, {module}; sys.exit('rosbags' in sys.modules or 'xxhash' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
