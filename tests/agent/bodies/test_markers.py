"""Markers for RViz: frontiers, target, and teammates, in the robot's map frame."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from agent.bodies.markers import ADD, DELETE, MOST_POINTS, layers, marker_array
from agent.planning.small_frontiers import without_small_frontiers
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from deploy.scenario.scenario import parse
from protocol.grid import FREE, OCCUPIED, UNKNOWN
from protocol.map_frame import MapFrame
from protocol.ros2.messages import MARKERS, Messages
from protocol.transforms import Pose

WHERE = MapFrame(4, 3, 0.5, -1.0, 2.0)


def test_markers_lie_in_the_map_frame_of_the_robot_and_empty_ones_are_deleted() -> None:
    grid = np.array(
        [[FREE, FREE, UNKNOWN, UNKNOWN], [FREE, OCCUPIED, UNKNOWN, UNKNOWN], [FREE, FREE, OCCUPIED, FREE]],
        np.uint8,
    )
    messages = Messages("jazzy")
    map_pose = Pose(1.0, 2.0, math.pi / 2)
    shown = layers(grid, None, [(2, 2)])
    sent = marker_array(messages, shown, WHERE, map_pose, "map", 5 * 10**9)
    found = {each.ns: each for each in messages.decode(messages.encode(sent), MARKERS).markers}
    assert found["target"].action == DELETE
    assert found["frontiers"].action == found["teammates"].action == ADD
    # The center of cell (2, 2) is at (0.25, 2.25) m in the common frame.
    (point,) = found["teammates"].points
    assert (point.x, point.y) == pytest.approx((0.25, 0.75))
    assert len(found["frontiers"].points) == 2
    assert {each.header.frame_id for each in found.values()} == {"map"}


def test_large_frontiers_are_thinned_out() -> None:
    grid = np.full((200, 200), FREE, np.uint8)
    grid[::2] = UNKNOWN
    frontiers, _, _ = layers(grid, None, [])
    assert 0 < len(frontiers.cells) <= MOST_POINTS


@pytest.mark.parametrize(
    "sensors",
    [{}, {"laser": {"preset": "utm-30lx"}, "pose": {"preset": "graph-slam"}}],
    ids=["exact", "noisy"],
)
def test_frontiers_that_robots_ignore_have_no_markers(sensors: dict[str, dict[str, str]]) -> None:
    settings = {
        "map": "office",
        "robots": 1,
        "bus": "memory",
        "steps": 30,
        "min_frontier_size": 0.8,
        **sensors,
    }
    run = MemoryRun(plans.make(parse(settings)))
    (agent,), ignored = run.agents, 0
    for _ in run.steps():
        if agent.robot is None:
            continue
        grid = agent.robot.explorable
        shown = layers(grid, None, [])[0].cells
        assert without_small_frontiers(grid, 8) is grid, "no small frontier is left"
        ignored += len(layers(agent.robot.planning, None, [])[0].cells) - len(shown)
    assert ignored > 0
