"""When a goal is sent, and when a robot makes no progress toward it."""

from __future__ import annotations

from agent.bodies.goals import GoalTracker
from protocol.transforms import Pose

SECOND = 10**9
THERE = Pose(5.0, 0.0, 0.0)


def test_a_goal_is_sent_once_whatever_its_heading() -> None:
    tracker = GoalTracker(10 * SECOND)
    assert tracker.change(THERE)
    assert not tracker.change(Pose(5.0, 0.01, 2.0))
    assert tracker.goal == THERE
    assert tracker.change(Pose(5.0, 0.2, 0.0))
    assert tracker.change(None)
    assert not tracker.change(None)


def test_a_robot_is_stuck_after_a_time_without_progress_and_then_once_per_period() -> None:
    tracker = GoalTracker(10 * SECOND)
    tracker.change(THERE)
    stuck = [
        second
        for second in range(40)
        if tracker.is_stuck(Pose(min(second, 8) * 0.2, 0.0, 0.0), second * SECOND)
    ]
    assert stuck == [18, 29]


def test_a_change_of_the_goal_is_no_progress() -> None:
    tracker = GoalTracker(10 * SECOND)
    stuck = []
    for second in range(12):
        tracker.change(Pose(5.0, second % 2, 0.0))
        stuck.append(tracker.is_stuck(Pose(0.0, 0.0, 0.0), second * SECOND))
    assert stuck.index(True) == 10


def test_a_robot_without_a_goal_is_not_stuck() -> None:
    tracker = GoalTracker(10 * SECOND)
    tracker.change(THERE)
    assert not tracker.is_stuck(Pose(0.0, 0.0, 0.0), 0)
    tracker.change(None)
    assert not tracker.is_stuck(Pose(0.0, 0.0, 0.0), 60 * SECOND)
    tracker.change(THERE)
    assert not tracker.is_stuck(Pose(0.0, 0.0, 0.0), 61 * SECOND)


def test_a_robot_that_gives_up_is_stuck_at_once() -> None:
    tracker = GoalTracker(10 * SECOND)
    tracker.change(THERE)
    tracker.fail()
    assert tracker.is_stuck(Pose(0.0, 0.0, 0.0), 0)
    assert not tracker.is_stuck(Pose(0.0, 0.0, 0.0), 1)
