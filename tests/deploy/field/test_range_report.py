"""Lines about teammates in range: on each change, and if none has ever been received."""

from __future__ import annotations

from deploy.field.range_report import UNSENT, RangeReport
from protocol.nanoseconds import SECOND


def test_each_change_of_the_teammates_in_range_is_reported_once() -> None:
    report = RangeReport(2, timeout=32 * SECOND, began=5 * SECOND)
    assert list(report.new([], [], 0, 6 * SECOND)) == []
    assert list(report.new([2], [], 0, 7 * SECOND)) == ["teammates in range: robot 2"]
    assert list(report.new([2], [], 0, 8 * SECOND)) == []
    assert list(report.new([0, 2], [], 0, 9 * SECOND)) == ["teammates in range: robots 0, 2"]
    (lost,) = report.new([], [], 0, 60 * SECOND)
    assert lost == "teammates in range: none; this robot has accepted no frame for 32 s, and explores alone"
    assert list(report.new([], [], 0, 99 * SECOND)) == []
    assert list(report.new([0], [], 0, 100 * SECOND)) == ["teammates in range: robot 0"]


def test_a_robot_that_has_never_received_a_teammate_says_so_after_the_timeout() -> None:
    report = RangeReport(2, timeout=32 * SECOND, began=5 * SECOND)
    assert list(report.new([], [], 0, 37 * SECOND - 1)) == []
    (alone,) = report.new([], [], 0, 37 * SECOND)
    assert "accepted no frame for 32 s, and explores alone: compare [radio]" in alone
    assert list(report.new([], [], 0, 38 * SECOND)) == []


def test_a_robot_whose_teammates_have_all_ended_needs_no_advice() -> None:
    report = RangeReport(2, timeout=32 * SECOND, began=0)
    assert list(report.new([0], [2], 0, 50 * SECOND)) == ["teammates in range: robot 0; ended: robot 2"]
    assert list(report.new([], [0, 2], 0, 51 * SECOND)) == ["teammates in range: none; ended: robots 0, 2"]
    (lost,) = report.new([], [2], 0, 90 * SECOND)
    assert "ended: robot 2; this robot has accepted no frame" in lost


def test_frames_that_the_radio_does_not_take_are_reported_once() -> None:
    report = RangeReport(2, timeout=32 * SECOND, began=0)
    assert list(report.new([], [], UNSENT - 1, SECOND)) == []
    (failing,) = report.new([], [], UNSENT, 2 * SECOND)
    assert f"has not accepted {UNSENT} frames" in failing
    assert list(report.new([], [], 2 * UNSENT, 3 * SECOND)) == []
