"""The `slam-toolbox` encoding: messages as ROS 2 sends them, now and then; malformed ones change nothing."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from agent.encodings.catalog import make_encoding
from agent.encodings.slam_toolbox import CDR, LocalizedScans, SlamToolboxEncoding, message_layout
from agent.mapping.estimator import Estimator
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, Grid
from protocol.range_scans import NO_MEASUREMENT, NOTHING, TURN, UNIT, Laser, RangeScan, beam_ends, smoothed
from protocol.scans import GridChange, fragments
from tests.agent.encodings.arrival import LATE

CELL, WIDTH, HEIGHT = 0.05, 60, 50
LASER = Laser(72, -(TURN // 3), 2 * TURN // 3, 2000)
NO_CHANGE = GridChange(0, (WIDTH, HEIGHT, 0, 0))


def settings_of(robot: int, laser: Laser = LASER) -> Settings:
    return Settings(
        robot=robot, bodies=(Body(40.0, 360.0, 10.0, laser=laser),) * 3, width=WIDTH, height=HEIGHT, beams=36, seed=0,
        strategy="meier", encoding=EncodingSettings("slam-toolbox"), replication=ReplicationSettings("gossip"),
        resolution=CELL,
    )  # fmt: skip


def scan_at(x: float, y: float, heading: int = 0, seed: int = 0) -> RangeScan:
    """A scan with ranges of all kinds; `x` and `y` are in meters."""
    ranges = np.random.default_rng(seed).integers(1, 1500, LASER.beams).astype(np.uint16)
    ranges[:2], ranges[2:4] = NO_MEASUREMENT, NOTHING
    return RangeScan((round(x / CELL * UNIT), round(y / CELL * UNIT)), heading, ranges)


def empty() -> Grid:
    return np.zeros((HEIGHT, WIDTH), np.uint8)


def record(maker: SlamToolboxEncoding, scan: RangeScan) -> list[bytes]:
    return maker.encode_changes(empty(), scan, NO_CHANGE, delivered=False)


@given(
    st.floats(0, 2.9),
    st.floats(0, 2.4),
    st.integers(0, TURN - 1),
    st.lists(st.integers(0, 2**16 - 1), min_size=72, max_size=72),
)
def test_a_message_holds_the_scan_exactly(x: float, y: float, heading: int, ranges: list[int]) -> None:
    form = LocalizedScans(settings_of(0))
    place = scan_at(x, y).place
    scan = RangeScan(place, heading, np.array(ranges, np.uint16))
    data = form.encode(scan)
    if not any(ranges):
        assert not data
        return
    read = form.decode(0, data)
    assert (read.place, read.heading, read.ranges.tolist()) == (place, heading, ranges)


def test_the_message_has_the_layout_of_ros_2() -> None:
    """LaserScan, TransformStamped and PoseWithCovarianceStamped in CDR, read by hand."""
    scan = scan_at(1.5, 2.0, TURN // 4, seed=3)
    data = LocalizedScans(settings_of(1)).encode(scan)
    assert data.startswith(CDR)
    body = data[4:]
    assert struct.unpack_from("<IIi", body) == (1, 0, 11)
    assert body[12:23] == b"r001/laser\0"
    limits = struct.unpack_from("<7f", body, 24)
    assert limits[0] == pytest.approx(-2 * math.pi / 3, abs=1e-4)
    assert limits[2] * 71 == pytest.approx(4 * math.pi / 3, abs=1e-4)
    (beams,) = struct.unpack_from("<I", body, 52)
    ranges = np.frombuffer(body, "<f4", beams, 56)
    assert np.isnan(ranges[:2]).all()
    assert np.isposinf(ranges[2:4]).all()
    assert (np.rint(1000 * ranges[4:].astype(float)) == scan.ranges[4:]).all()
    at = 56 + 4 * beams
    assert struct.unpack_from("<IIII", body, at) == (0, 1, 0, 10), "no intensities; the header of the offset"
    at += 16
    assert body[at : at + 10] == b"r001/base\0"
    at += 12
    assert (struct.unpack_from("<I", body, at), body[at + 4 : at + 15]) == ((11,), b"r001/laser\0")
    at = -(-(at + 15) // 8) * 8
    assert struct.unpack_from("<7d", body, at) == (0, 0, 0, 0, 0, 0, 1)
    at += 56
    assert (struct.unpack_from("<III", body, at), body[at + 12 : at + 16]) == ((1, 0, 4), b"map\0")
    at = -(-(at + 16) // 8) * 8
    pose = struct.unpack_from("<7d", body, at)
    assert pose == pytest.approx((1.5, 2.0, 0, 0, 0, math.sin(math.pi / 4), math.cos(math.pi / 4)), abs=1e-3)
    assert len(body) == at + 8 * (7 + 36)


def test_a_scan_of_360_beams_takes_about_2_kb() -> None:
    assert LocalizedScans(settings_of(0, replace(LASER, beams=360))).size(0) == 1964


def test_a_robot_sends_a_scan_when_it_has_moved_or_turned() -> None:
    maker = SlamToolboxEncoding(settings_of(0))
    half_radian = TURN / (4 * math.pi)
    for scan, is_sent in (
        (scan_at(1, 1), True),
        (scan_at(1, 1, seed=1), False),
        (scan_at(1.3, 1.3), False),
        (scan_at(1.4, 1.4), True),
        (scan_at(1.4, 1.4, round(half_radian) - 5), False),
        (scan_at(1.4, 1.4, round(half_radian) + 5), True),
        (scan_at(1.4, 1.4, TURN - 10), True),
        (scan_at(1.4, 1.4, 10), False),
        (scan_at(1.4, 1.95), True),
    ):
        assert bool(record(maker, scan)) == is_sent


def test_a_scan_without_measurements_is_not_sent_and_the_next_one_is() -> None:
    maker = SlamToolboxEncoding(settings_of(0))
    blind = scan_at(1, 1)
    blind.ranges[:] = NO_MEASUREMENT
    assert record(maker, blind) == []
    assert record(maker, scan_at(1, 1))


def test_receivers_estimate_the_map_of_the_author_from_the_sent_scans() -> None:
    maker, receiver, late = (SlamToolboxEncoding(settings_of(robot)) for robot in (0, 1, 2))
    estimator, log = Estimator(HEIGHT, WIDTH), []
    for number in range(6):
        scan = scan_at(0.5 + 0.3 * number, 1.2, number * 500, seed=number)
        packets = record(maker, scan)
        log += packets
        if packets:
            receiver.apply(0, b"".join(packets), **LATE)
            estimator.add(*scan.place, *beam_ends(smoothed(scan, LASER), LASER, CELL))
    assert (estimator.states != UNKNOWN).any()
    assert receiver.merge(empty()).tolist() == estimator.states.tolist()
    for packet in log:
        late.apply(0, packet, **LATE)
    assert late.merge(empty()).tolist() == estimator.states.tolist()


def messages(**changes: object) -> bytes:
    form = LocalizedScans(settings_of(0))
    layout = message_layout(LASER.beams)
    message = np.frombuffer(form.encode(scan_at(1, 1))[len(CDR) :], layout).copy()
    for name, value in changes.items():
        message[name] = value
    return CDR + message.tobytes()


NO_POSE = (math.nan, 1, 0, 0, 0, 0, 1)
MALFORMED = {
    "a position that is no number": messages(pose=NO_POSE),
    "an infinite position": messages(pose=(1, -math.inf, 0, 0, 0, 0, 1)),
    "a heading that is no number": messages(pose=(1, 1, 0, 0, 0, math.nan, 1)),
    "a position outside the grid": messages(pose=(1, 60, 0, 0, 0, 0, 1)),
    "a position outside any grid": messages(pose=(1e300, 1, 0, 0, 0, 0, 1)),
    "another number of beams": messages(beams=71),
    "another byte order": b"\0\0" + messages()[2:],
    "bytes behind the message": messages() + b"\0" * 100 + messages(),
}


@pytest.mark.parametrize("data", MALFORMED.values(), ids=list(MALFORMED))
def test_malformed_messages_are_rejected_and_change_nothing(data: bytes) -> None:
    maker, receiver = SlamToolboxEncoding(settings_of(0)), SlamToolboxEncoding(settings_of(1))
    first, second = record(maker, scan_at(1, 1)), record(maker, scan_at(2, 1))
    receiver.apply(0, b"".join(first), **LATE)
    before = receiver.merge(empty()).tolist()
    with pytest.raises(ProtocolError):
        receiver.apply(0, b"".join(fragments(data)), **LATE)
    assert receiver.merge(empty()).tolist() == before
    receiver.apply(0, b"".join(second), **LATE)
    assert receiver.merge(empty()).tolist() != before


@given(st.lists(st.sampled_from([0.0, -1.0, 1e30, -math.inf, math.nan, 1e-30]), min_size=72, max_size=72))
def test_any_range_can_be_read(ranges: list[float]) -> None:
    scan = LocalizedScans(settings_of(1)).decode(0, messages(ranges=ranges))
    beam_ends(scan, LASER, CELL)


def test_exact_lasers_are_refused() -> None:
    with pytest.raises(ValueError, match=r"slam-toolbox.*lasers or poses with errors"):
        make_encoding(replace(settings_of(0), bodies=(Body(40.0, 360.0, 10.0),) * 3))
