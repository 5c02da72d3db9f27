"""The pose guard: what a body can have driven is accepted, and a jump silences the robot for a while."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from agent.pose_guard import PoseGuard
from protocol.nanoseconds import SECOND


@given(st.lists(st.tuples(st.floats(0, 1), st.integers(0, 3 * SECOND)), max_size=40))
def test_no_motion_within_the_speed_is_a_jump(parts: list[tuple[float, int]]) -> None:
    guard, x, now = PoseGuard(5.0, 0.5, SECOND), 0.0, 0
    assert guard.accept(x, 0.0, now)
    for part, duration in parts:
        now += duration
        x += part * 5.0 * duration / SECOND
        assert guard.accept(x, 0.0, now)
    assert not guard.has_jumped


def test_after_a_jump_poses_are_accepted_once_they_have_settled() -> None:
    guard = PoseGuard(5.0, 0.5, 2 * SECOND)
    assert guard.accept(0.0, 0.0, 0)
    assert not guard.accept(4.0, 4.0, SECOND)  # 5.66 cells in a second
    assert not guard.accept(4.0, 4.0, 2 * SECOND)
    assert not guard.accept(0.0, 0.0, 2 * SECOND + 1)  # the time begins anew
    assert not guard.accept(0.0, 0.0, 4 * SECOND)
    assert guard.has_jumped
    assert guard.accept(0.0, 0.0, 4 * SECOND + 1)
    assert not guard.has_jumped


def test_a_clock_that_stands_still_allows_the_slack_only() -> None:
    guard = PoseGuard(5.0, 0.5, SECOND)
    assert guard.accept(0.0, 0.0, SECOND)
    assert guard.accept(0.4, 0.0, SECOND)
    assert not guard.accept(1.0, 0.0, SECOND)
