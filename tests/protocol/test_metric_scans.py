"""Angles of lasers as logs and ROS describe them."""

from __future__ import annotations

import math

import pytest

from protocol.metric_scans import BeamAngles
from protocol.range_scans import TURN


def test_the_angles_of_a_laser_run_clockwise() -> None:
    angles = BeamAngles.of(5, -math.pi / 2, math.pi / 4)
    assert (angles.beams, angles.first, angles.span) == (5, -TURN // 4, TURN // 2)


@pytest.mark.parametrize(
    ("first", "increment"),
    [
        (math.nan, 0.01), (math.inf, 0.01), (1e308, 0.01), (7.0, 0.01),
        (0.0, math.nan), (0.0, math.inf), (0.0, -math.inf), (0.0, 0.0), (0.0, 1.0),
    ],
)  # fmt: skip
def test_angles_that_no_laser_has_are_refused(first: float, increment: float) -> None:
    with pytest.raises(ValueError, match="not those of a laser"):
        BeamAngles.of(100, first, increment)
