"""A ROS 2 robot without laser scans: its own map, as the part of the team's map that it can have observed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from agent.bodies.map_body import MapBody
from agent.bodies.own_map import OwnMap
from agent.bodies.ros2 import BodySettings
from agent.mapping.mapper import GivenMapper
from agent.pose_guard import SETTLE_NS
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.map_frame import MapFrame
from protocol.messages import Sense
from protocol.own_map import OwnMapPart, decode_own_map, encode_own_map
from protocol.ros2 import messages as names
from protocol.transforms import Pose
from tests.agent.bodies.test_ros2 import AT_ORIGIN, GRID, MESSAGES, SECOND, stand

REACH_M = 1.0


def own_map(values: np.ndarray, corner: Pose, resolution: float = 0.1) -> Any:
    """Return a message of ``map``; the first row of `values` is the lowest one."""
    message = MESSAGES.new(names.OCCUPANCY_GRID, data=values.astype(np.int8).reshape(-1))
    message.info.height, message.info.width = values.shape
    message.info.resolution, message.info.origin = resolution, MESSAGES.pose(*corner)
    return message


def robot(map_pose: Pose = AT_ORIGIN, reach_m: float = REACH_M) -> MapBody:
    return MapBody(GRID, BodySettings(map_pose, reach_m))


def mapper() -> GivenMapper:
    """Return the mapper of a robot whose map has the cells of `GRID`."""
    return GivenMapper(
        Settings(
            robot=0, bodies=(Body(10.0, 360.0, 5.0),), width=GRID.width, height=GRID.height, beams=360, seed=0,
            strategy="meier", encoding=EncodingSettings("none"), replication=ReplicationSettings("gossip"),
            has_own_map=True,
        )
    )  # fmt: skip


def sensed(body: MapBody, step: int = 1, **options: Any) -> Sense:
    sense = body.sense(step, **options)
    assert sense is not None, body.problem
    return sense


@given(
    st.floats(-2, 2), st.floats(-2, 2), st.floats(-4, 4), st.sampled_from([0.05, 0.1, 0.23]), st.integers(0, 2**32)
)  # fmt: skip
def test_states_are_those_of_a_plain_reference(
    x: float, y: float, yaw: float, cell: float, seed: int
) -> None:
    values = np.random.default_rng(seed).choice([-1, 0, 20, 50, 70, 100], (9, 13))
    corner = Pose(x, y, yaw)
    grid, map_pose = MapFrame(30, 25, 0.1, -1.5, -1.0), Pose(0.3, -0.2, 1.0)
    found = OwnMap(own_map(values, corner, cell)).states(grid, map_pose)
    expected = np.full((25, 30), UNKNOWN, np.uint8)
    placed = map_pose.then(corner)
    for row in range(25):
        for column in range(30):
            inner = placed.inverse().then(Pose(*grid.position(column + 0.5, row + 0.5), 0.0))
            there = math.floor(inner.y / cell), math.floor(inner.x / cell)
            if 0 <= there[0] < 9 and 0 <= there[1] < 13:
                value = values[there]
                expected[row, column] = FREE if 0 <= value <= 25 else OCCUPIED if value >= 65 else UNKNOWN
    for row, column in np.argwhere(values >= 65):
        at = placed.then(Pose((column + 0.5) * cell, (row + 0.5) * cell, 0.0))
        left, top = math.floor((at.x + 1.5) / 0.1), math.floor(25 - (at.y + 1.0) / 0.1)
        if 0 <= left < 30 and 0 <= top < 25:
            expected[top, left] = OCCUPIED
    assert np.count_nonzero(found != expected) <= 2, (
        "rounding may put a cell's center on the other side of a border"
    )


def test_a_robot_without_scans_takes_over_what_its_map_shows_within_reach() -> None:
    body, given_mapper = robot(), mapper()
    values = np.zeros((40, 40), int)
    values[25] = 100  # from 0.5 to 0.6 m above the robot
    values[39] = 100  # out of reach
    assert body.laser is None
    stand(body, AT_ORIGIN)
    assert body.sense(1) is None
    assert body.problem == ""
    body.add_map(own_map(values, Pose(-2.0, -2.0, 0.0)))
    assert body.laser is not None
    given_mapper.add(sensed(body))
    rows, columns = np.nonzero(given_mapper.states == OCCUPIED)
    x, y = GRID.position(columns + 0.5, rows + 0.5)
    assert np.allclose(y, 0.55)
    assert 1.0 < np.ptp(x) < 2.1
    known = np.argwhere(given_mapper.states != UNKNOWN)[:, ::-1] + 0.5
    away = np.hypot(*(np.array(GRID.position(*known.T))))
    assert 0.9 < away.max() < 1.2
    assert given_mapper.known_cells == len(known)
    assert given_mapper.settled().sum() == len(known)


def test_a_clock_that_is_set_back_does_not_stop_the_robot() -> None:
    body = robot()
    body.add_map(own_map(np.zeros((60, 60), int), Pose(-3.0, -3.0, 0.0)))
    stand(body, AT_ORIGIN, 3600 * SECOND)
    assert sensed(body).x == 20
    stand(body, Pose(0.5, 0.0, 0.0), 0)
    assert sensed(body).x == 25


def test_what_was_within_reach_remains_so() -> None:
    body, given_mapper = robot(), mapper()
    for second in range(3):
        stand(body, Pose(float(second), 0.0, 0.0), second * SECOND)
        body.take_newest()
    body.add_map(own_map(np.zeros((60, 60), int), Pose(-3.0, -3.0, 0.0)))
    given_mapper.add(sensed(body))
    columns = np.flatnonzero((given_mapper.states != UNKNOWN).any(axis=0))
    assert (GRID.position(columns[0], 0)[0], GRID.position(columns[-1] + 1, 0)[0]) == pytest.approx(
        (-1, 3), abs=0.2
    )


def test_a_cell_changes_with_the_map_and_keeps_its_state_when_the_map_forgets_it() -> None:
    body, given_mapper = robot(), mapper()
    corner = Pose(-0.5, -0.5, 0.0)
    stand(body, AT_ORIGIN)
    cells = []
    for second, value in enumerate((0, 100, -1, 50, 0), 1):
        values = np.zeros((10, 10), int)
        values[7, 8] = value
        body.add_map(own_map(values, corner))
        stand(body, AT_ORIGIN, second * SECOND)
        _, change = given_mapper.add(sensed(body, second))
        cells.append((int(given_mapper.states[47, 23]), change.cells))
    # the first map also shows the other cells; then, only this one changes
    assert [state for state, _ in cells] == [FREE, OCCUPIED, OCCUPIED, OCCUPIED, FREE]
    assert [changed for _, changed in cells[1:]] == [1, 0, 0, 1]


def test_the_robots_own_cell_is_free_whatever_the_map_shows() -> None:
    body, given_mapper = robot(), mapper()
    stand(body, AT_ORIGIN)
    body.add_map(own_map(np.full((10, 10), 100), Pose(-0.5, -0.5, 0.0)))
    sense = sensed(body)
    given_mapper.add(sense)
    _, change = given_mapper.add(sense)
    assert given_mapper.states[sense.y, sense.x] == FREE
    assert change.cells == 0


def test_a_robot_that_does_not_measure_takes_nothing_over() -> None:
    body, given_mapper = robot(), mapper()
    stand(body, Pose(0.4, 0.0, 0.0))
    body.add_map(own_map(np.zeros((10, 10), int), Pose(-0.5, -0.5, 0.0)))
    given_mapper.add(sensed(body, measures=False))
    assert given_mapper.known_cells == 1


def test_a_pose_that_jumps_is_not_taken_until_it_settles() -> None:
    body = robot()
    body.add_map(own_map(np.zeros((10, 10), int), Pose(-0.5, -0.5, 0.0)))
    stand(body, AT_ORIGIN, 0)
    assert sensed(body).x == 20
    stand(body, Pose(5.0, 0.0, 0.0), SECOND)
    assert sensed(body).x == 20
    assert body.has_jumped
    stand(body, Pose(5.0, 0.0, 0.0), SECOND + SETTLE_NS)
    assert sensed(body).x == 70
    assert not body.has_jumped


def test_without_transforms_the_body_says_which_are_missing() -> None:
    body = robot()
    assert body.problem == "no map has arrived"
    body.add_map(own_map(np.zeros((10, 10), int), AT_ORIGIN))
    assert body.sense(1) is None
    assert body.problem == "no transforms (tf) from 'map' to the robot's base 'base_link'; only base_link"


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "0 bytes instead of 16 or more"),
        (encode_own_map(OwnMapPart((0, 0, 2, 1), np.zeros((1, 2), np.uint8)))[:-1], "17 bytes instead of 18"),
        (
            encode_own_map(OwnMapPart((3, 0, 6, 1), np.zeros((1, 3), np.uint8))),
            "does not lie in the 5 x 4 grid",
        ),
        (
            encode_own_map(OwnMapPart((1, 1, 1, 2), np.zeros((1, 0), np.uint8))),
            "does not lie in the 5 x 4 grid",
        ),
        (encode_own_map(OwnMapPart((0, 0, 1, 1), np.full((1, 1), 3, np.uint8))), "a cell has state 3"),
    ],
)
def test_a_malformed_part_of_a_map_is_refused(data: bytes, reason: str) -> None:
    with pytest.raises(ProtocolError, match=reason):
        decode_own_map(data, 4, 5)


def test_a_part_of_a_map_survives_its_binary_form() -> None:
    states: Grid = np.arange(6, dtype=np.uint8).reshape(2, 3) % 3
    part = decode_own_map(encode_own_map(OwnMapPart((1, 2, 4, 4), states)), 4, 5)
    assert part.box == (1, 2, 4, 4)
    assert np.array_equal(part.states, states)
