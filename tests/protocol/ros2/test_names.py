"""Names of ROS, and the keys of topics and services."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.ros2.names import (
    NO_HASH,
    DataKey,
    check_node,
    dds_type,
    demangled,
    mangled,
    qualified,
    ros_type,
)

HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"

parts = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
names = st.lists(parts, min_size=1, max_size=4).map(lambda each: "/" + "/".join(each))
types = st.tuples(parts, st.sampled_from(["msg", "srv", "action"]), parts).map("/".join)
hashes = st.just(NO_HASH) | st.from_regex(r"RIHS01_[0-9a-f]{64}", fullmatch=True)
data_keys = st.builds(DataKey, st.integers(0, 232), names, types, hashes)


def test_a_topic_has_the_key_of_rmw_zenoh() -> None:
    key = DataKey(0, "/robot1/chatter", "std_msgs/msg/String", HASH)
    assert str(key) == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{HASH}"


def test_a_service_has_the_key_of_rmw_zenoh() -> None:
    key = DataKey(2, "/add_two_ints", "example_interfaces/srv/AddTwoInts", HASH)
    assert str(key) == f"2/add_two_ints/example_interfaces::srv::dds_::AddTwoInts_/{HASH}"


def test_humble_has_a_literal_instead_of_a_hash() -> None:
    key = DataKey(0, "/scan", "sensor_msgs/msg/LaserScan", NO_HASH)
    assert str(key) == "0/scan/sensor_msgs::msg::dds_::LaserScan_/TypeHashNotSupported"


@given(types)
def test_types_survive_their_dds_name(name: str) -> None:
    assert ros_type(dds_type(name)) == name


@given(names)
def test_names_survive_mangling(name: str) -> None:
    assert demangled(mangled(name)) == name
    assert "/" not in mangled(name)


@pytest.mark.parametrize(
    ("name", "namespace", "full"),
    [
        ("scan", "/", "/scan"),
        ("scan", "r1", "/r1/scan"),
        ("scan", "/r1/", "/r1/scan"),
        ("/scan", "/r1", "/scan"),
        ("~/status", "/r1", "/r1/murmur/status"),
        ("~", "/", "/murmur"),
        ("navigate_to_pose/_action/status", "/a/b", "/a/b/navigate_to_pose/_action/status"),
    ],
)
def test_names_are_qualified_as_in_ros(name: str, namespace: str, full: str) -> None:
    assert qualified(name, namespace, "murmur") == full


@pytest.mark.parametrize("name", ["", "/", "a//b", "1scan", "/r-1/scan", "scan/", "a%b", "scan**", "ä"])
def test_a_name_that_ros_does_not_allow_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="is not a name of ROS"):
        qualified(name, "/r1")


def test_a_node_has_a_namespace_with_one_slash() -> None:
    assert check_node("murmur", "") == check_node("murmur", "/") == "/"
    assert check_node("murmur", "team/r1/") == "/team/r1"
    with pytest.raises(ValueError, match="is not the name of a node"):
        check_node("my node", "/")
