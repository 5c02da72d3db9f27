"""Fuzzing of ROS 2: any bytes, keys, and tokens are read or rejected; no message stops a body."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from protocol.errors import ProtocolError
from protocol.messages import Sense
from protocol.ros2 import messages as names
from protocol.ros2.attachments import Attachment, decode_attachment
from protocol.ros2.interfaces import NAVIGATE_TO_POSE
from protocol.ros2.qos import parse_qos
from protocol.ros2.tokens import parse_token
from tests.agent.bodies.test_ros2 import (
    AT_ORIGIN,
    MESSAGES,
    driving,
    laser_scan,
    robot,
    scan_at,
    stand,
    transforms,
)
from tests.fuzz.test_fuzz import CUTS, EXAMPLES, mutated

HASH = f"RIHS01_{'0a' * 32}"
NODE = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%r1/talker"
TYPE = "std_msgs::msg::dds_::String_"
ENDPOINT = f"@ros2_lv/2/8b20917502ee955ac4476e02/0/10/MP/%/%/talker/%chatter/{TYPE}/{HASH}/::,7:,:,:,,"
QOS = "1:1:1,10:9,9:9,9:1,9,9"

GRID_MESSAGE = MESSAGES.new(names.OCCUPANCY_GRID, data=np.zeros(16, np.int8))
GRID_MESSAGE.info.width = GRID_MESSAGE.info.height = 4
GRID_MESSAGE.info.resolution, GRID_MESSAGE.info.origin = 1.0, MESSAGES.pose(0.0, 0.0, 0.0)
VALID = {
    names.LASER_SCAN: laser_scan([1.0, 2.0, 3.0, math.inf]),
    names.TRANSFORMS: transforms(("map", "odom", AT_ORIGIN), ("odom", "base_link", AT_ORIGIN)),
    names.OCCUPANCY_GRID: GRID_MESSAGE,
    names.STRING: MESSAGES[names.STRING](data="hello"),
    f"{NAVIGATE_TO_POSE}_SendGoal_Request": MESSAGES.new(f"{NAVIGATE_TO_POSE}_SendGoal_Request"),
    f"{NAVIGATE_TO_POSE}_GetResult_Response": MESSAGES.new(f"{NAVIGATE_TO_POSE}_GetResult_Response"),
}
"""A valid message of each type."""


def use(name: str, payload: bytes) -> None:
    """Decode a message; let a body take it, sense, and choose a goal."""
    message = MESSAGES.decode(payload, name)
    body = robot()
    if name == names.TRANSFORMS:
        body.add_transforms(message, is_static=False)
    stand(body, AT_ORIGIN)
    if name == names.LASER_SCAN:
        body.add_scan(message)
    scan_at(body, AT_ORIGIN)
    if name == names.OCCUPANCY_GRID:
        body.add_map(message)
    sense = body.sense(1)
    assert isinstance(sense, Sense | None)
    body.goal(driving((21, 49), (22, 49)), (30, 40))


@pytest.mark.parametrize("name", list(VALID))
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=CUTS | st.binary(max_size=80))
def test_any_message_is_used_or_rejected(name: str, data: bytes | list[tuple[int, int, bytes]]) -> None:
    payload = data if isinstance(data, bytes) else mutated(MESSAGES.encode(VALID[name]), data)
    try:
        use(name, payload)
    except ProtocolError as error:
        assert str(error)


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.floats(width=32), st.floats(width=32), st.floats(), st.floats(), st.floats())
def test_a_body_uses_any_numbers_or_notes_why_not(
    first: float, increment: float, x: float, z: float, w: float
) -> None:
    body = robot()
    scan_at(body, AT_ORIGIN)
    body.add_scan(laser_scan([1.0] * 4, 1, angle_min=first, angle_increment=increment))
    message = transforms(("map", "odom", AT_ORIGIN), ("odom", "base_link", AT_ORIGIN), now_ns=1)
    message.transforms[0].transform.translation.x = x
    message.transforms[0].transform.rotation.z, message.transforms[0].transform.rotation.w = z, w
    body.add_transforms(message, is_static=False)
    assert body.sense(1) is not None or body.problem
    fresh = robot()
    fresh.add_scan(laser_scan([1.0] * 4, angle_min=first, angle_increment=increment))
    assert fresh.laser is not None or fresh.problem


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(cuts=CUTS)
def test_any_text_or_attachment_is_read_or_rejected_with_a_message(
    cuts: list[tuple[int, int, bytes]],
) -> None:
    for read, valid in (
        (parse_token, NODE),
        (parse_token, ENDPOINT),
        (parse_qos, QOS),
    ):
        try:
            read(mutated(valid.encode(), cuts).decode(errors="replace"))
        except ProtocolError as error:
            assert 0 < len(str(error)) < 1000
    try:
        decode_attachment(mutated(Attachment(1, 2, bytes(16)).encode(), cuts))
    except ProtocolError as error:
        assert str(error)
