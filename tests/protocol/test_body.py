"""Hardware of robots: the openings that they explore."""

from __future__ import annotations

from protocol.body import narrowest_opening


def test_openings_are_as_wide_as_the_robot_and_at_least_30_cm() -> None:
    assert narrowest_opening(0.0, 0.1) == 3
    assert narrowest_opening(0.0, 0.2) == 2
    assert narrowest_opening(2.5, 0.1) == 5
