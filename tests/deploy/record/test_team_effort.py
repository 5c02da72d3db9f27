"""Longest paths and overlaps of teams, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.record.team_effort import longest_path_m, overlaps, report_at
from protocol.grid import FREE, OCCUPIED, UNKNOWN
from protocol.messages import WorldReport

WORLD = [
    WorldReport(1, b"", [0, 0, 0], 10, 40),
    WorldReport(2, b"", [500, 900, 100], 37, 40),
    WorldReport(3, b"", [1000, 1400, 2600], 38, 40),
    WorldReport(4, b"", [1500, 1500, 3100], 40, 40),
]
"""Four steps of three robots that see 25, 92.5, 95 and 100 % of 40 cells."""


def test_a_share_is_reached_in_the_first_step_in_which_the_team_has_seen_it() -> None:
    steps = {
        share: report.step
        for share in (0.2, 0.9, 0.95, 0.96, 1.0)
        if (report := report_at(WORLD, share)) is not None
    }
    assert steps == {0.2: 1, 0.9: 2, 0.95: 3, 0.96: 4, 1.0: 4}
    assert report_at(WORLD[:3], 0.96) is None
    assert report_at([], 0.5) is None


def test_the_longest_path_is_that_of_the_robot_that_had_driven_farthest_by_then() -> None:
    assert longest_path_m(report_at(WORLD, 0.9)) == 0.9
    assert longest_path_m(report_at(WORLD, 0.95)) == 2.6
    assert longest_path_m(WORLD[-1]) == 3.1
    assert longest_path_m(None) is None


def test_overlaps_count_the_reachable_free_cells_that_each_robot_has_seen() -> None:
    reachable = np.array([[True, True, True, True, True, False]])
    own = [
        np.array([[FREE, FREE, FREE, FREE, UNKNOWN, FREE]], np.uint8),
        np.array([[UNKNOWN, FREE, FREE, OCCUPIED, UNKNOWN, FREE]], np.uint8),
        np.array([[UNKNOWN, FREE, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN]], np.uint8),
    ]
    found = overlaps(own, reachable)
    assert found["overlap"] == 2 / 4
    assert found["overlap_sum"] == (4 + 2 + 1) / 4 - 1
    shares = [4 / 5, 2 / 5, 1 / 5]
    mean = sum(shares) / 3
    assert found["seen_std"] == pytest.approx((sum((each - mean) ** 2 for each in shares) / 3) ** 0.5)


def test_a_robot_alone_overlaps_with_nobody() -> None:
    own = [np.array([[FREE, FREE, UNKNOWN]], np.uint8)]
    reachable = np.ones((1, 3), np.bool_)
    assert overlaps(own, reachable) == {"overlap": 0.0, "overlap_sum": 0.0, "seen_std": 0.0}
