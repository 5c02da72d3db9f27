from __future__ import annotations

import cmath
import math
from itertools import pairwise

import numpy as np
import pytest

from protocol.transforms import Pose, TransformBuffer, pose_of


def plain(first: Pose, second: Pose) -> tuple[complex, complex]:
    """Position and direction of a frame at `second` in a frame at `first`, by complex numbers."""
    turn = cmath.rect(1, first.yaw)
    return complex(first.x, first.y) + turn * complex(second.x, second.y), turn * cmath.rect(1, second.yaw)


def test_poses_are_composed_along_the_chain_of_frames() -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        buffer = TransformBuffer()
        outer, inner = (Pose(*random.uniform(-3, 3, 3).tolist()) for _ in range(2))
        buffer.add("map", "odom", 0.0, outer, is_static=True)
        buffer.add("odom", "laser", 0.0, inner, is_static=True)
        found = buffer.pose("laser", "map", 7.0)
        assert found is not None
        place, direction = plain(outer, inner)
        assert complex(found.x, found.y) == pytest.approx(place)
        assert cmath.rect(1, found.yaw) == pytest.approx(direction)


def test_poses_are_interpolated_also_if_they_come_out_of_order() -> None:
    random = np.random.default_rng(1)
    stamps = sorted(random.uniform(0, 10, 20).tolist())
    poses = {stamp: Pose(*random.uniform(-3, 3, 3).tolist()) for stamp in stamps}
    buffer = TransformBuffer()
    for stamp in random.permutation(stamps).tolist():
        buffer.add("map", "laser", stamp, poses[stamp], is_static=False)
    for before, after in pairwise(stamps):
        found = buffer.pose("laser", "map", (before + after) / 2)
        assert found is not None
        assert found.x == pytest.approx((poses[before].x + poses[after].x) / 2)
        middle = cmath.rect(1, poses[before].yaw) + cmath.rect(1, poses[after].yaw)
        assert cmath.rect(1, found.yaw) == pytest.approx(middle / abs(middle))
        assert buffer.pose("laser", "map", before) == poses[before]
    assert buffer.pose("laser", "map", stamps[0] - 0.1) is None
    assert buffer.pose("laser", "map", stamps[-1] + 0.1) is None


def test_a_circle_of_frames_ends() -> None:
    buffer = TransformBuffer()
    buffer.add("a", "b", 0.0, Pose(0, 0, 0), is_static=True)
    buffer.add("b", "a", 0.0, Pose(0, 0, 0), is_static=True)
    assert buffer.ancestors("a") == ["a", "b"]


@pytest.mark.parametrize(
    ("quaternion", "error"),
    [
        ((0.0, 0.0, 0.0, 0.0), "no unit quaternion"),
        ((1.0, 0.0, 0.0, 0.0), "upside down"),
        ((math.sin(0.3), 0.0, 0.0, math.cos(0.3)), "tilted; it must be level"),
        ((math.nan, 0.0, 0.0, 1.0), "no unit quaternion"),
    ],
)
def test_frames_that_are_not_level_have_no_pose(
    quaternion: tuple[float, float, float, float], error: str
) -> None:
    with pytest.raises(ValueError, match=error):
        pose_of(0.0, 0.0, *quaternion)


@pytest.mark.parametrize("x", [math.nan, math.inf, -1e300])
def test_a_position_that_no_robot_can_have_is_refused(x: float) -> None:
    with pytest.raises(ValueError, match="not a number, or beyond"):
        pose_of(x, 0.0, 0.0, 0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="not a number, or beyond"):
        pose_of(0.0, x, 0.0, 0.0, 0.0, 1.0)


def test_a_small_tilt_is_projected_into_the_plane() -> None:
    tilt = math.radians(5) / 2
    assert pose_of(1.0, 2.0, math.sin(tilt), 0.0, 0.0, math.cos(tilt)) == Pose(1.0, 2.0, 0.0)


def test_a_pose_and_its_inverse_cancel() -> None:
    random = np.random.default_rng(1)
    for x, y, yaw in random.uniform(-3, 3, (20, 3)).tolist():
        pose = Pose(x, y, yaw)
        assert pose.then(pose.inverse()) == pytest.approx((0, 0, 0))
        assert pose.inverse().then(pose) == pytest.approx((0, 0, 0))


def test_forgotten_poses_are_gone_and_later_ones_can_still_be_interpolated() -> None:
    transforms = TransformBuffer()
    transforms.add("base", "laser", 0, Pose(0, 1, 0), is_static=True)
    for stamp in (2, 0, 1, 3):  # not in the order of time
        transforms.add("map", "base", stamp, Pose(stamp, 0, 0), is_static=False)
    transforms.forget(1.5)
    assert transforms.pose("laser", "map", 0.5) is None
    assert transforms.pose("laser", "map", 1.5) == pytest.approx((1.5, 1, 0))
    assert transforms.pose("laser", "map", 3) == pytest.approx((3, 1, 0))
