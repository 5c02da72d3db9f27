from __future__ import annotations

import numpy as np
import pytest

from protocol.body import Body
from protocol.grid import FREE
from protocol.messages import Move, Sense
from protocol.range_scans import Laser, RangeScan, decode_range_scan
from worldsim.recorded.world import RecordedWorld, Stretch
from worldsim.world import WorldSettings

LASER = Laser(3, -100, 200, 5000)
BODY = Body(50.0, 180.0, 1.0)


def stretch(steps: list[int], *cells: tuple[int, int]) -> Stretch:
    """A robot in the middle of one cell after the other; it finds its cell, and all before it."""
    places = np.array([(256 * x + 128, 256 * y + 128) for x, y in cells], np.int32)
    ranges = np.array([[100 + at, 200, 300] for at in range(len(steps))], np.uint16)
    found = [np.array([10 * y + x], np.int32) for x, y in cells]
    return Stretch(np.array(steps), places, np.full(len(steps), 16384), ranges, found)


def world(*stretches: Stretch) -> RecordedWorld:
    starts = tuple((scan.x, scan.y) for scan in (each.scan(0) for each in stretches))
    settings = WorldSettings((BODY,) * len(stretches), starts, ends_with_all=True)
    return RecordedWorld(np.full((4, 10), FREE, np.uint8), settings, stretches)


def scan_of(sense: Sense) -> RangeScan:
    return decode_range_scan(sense.range_scan, LASER)


def test_robots_sense_their_scans_in_the_recorded_steps_and_stay_in_between() -> None:
    replay = world(stretch([1, 3], (1, 1), (2, 1)), stretch([1, 2], (5, 1), (5, 1)))
    seen = [replay.advance({}) for _ in range(4)]
    assert [(senses[0].x, senses[0].y) for senses in seen] == [(1, 1), (1, 1), (2, 1), (2, 1)]
    assert [scan_of(senses[0]).ranges.tolist() for senses in seen] == [
        [100, 200, 300], [0, 0, 0], [101, 200, 300], [0, 0, 0],
    ]  # fmt: skip
    assert [senses[0].step for senses in seen] == [1, 2, 3, 4]
    assert {senses[0].heading for senses in seen} == {2}
    assert scan_of(seen[3][0]).place == (2 * 256 + 128, 256 + 128)


def test_moves_are_ignored() -> None:
    replay = world(stretch([1, 2], (1, 1), (2, 1)))
    replay.advance({})
    sense = replay.advance({0: Move(1, np.array([[1, 2], [1, 3]], "<i2").tobytes(), 6, False)})[0]
    assert (sense.x, sense.y, sense.heading, sense.blocked) == (2, 1, 2, "")
    assert replay.driven == [1.0]


def test_coverage_counts_each_cell_once() -> None:
    replay = world(stretch([1, 2], (1, 1), (2, 1)), stretch([1, 3], (2, 1), (3, 1)))
    counts = []
    for _ in range(3):
        replay.advance({})
        counts.append(replay.seen_cells)
    assert counts == [2, 2, 3]
    assert replay.reachable_cells == 40
    assert replay.share_seen(0) == 3 / 40


def test_the_run_may_end_after_the_last_scan_of_all_robots_that_are_left() -> None:
    replay = world(stretch([1, 2], (1, 1), (2, 1)), stretch([1, 9], (5, 1), (5, 1)))
    may_end = []
    for _ in range(3):
        replay.advance({})
        may_end.append(replay.may_end())
    assert may_end == [False, False, False]
    replay.remove(1)
    assert replay.may_end()
    replay.restore(1)
    assert not replay.may_end()
    assert replay.cells[1] == (5, 1)


@pytest.mark.parametrize(
    ("reports", "stalled"), [(["stalled", "explored"], True), (["stalled", ""], False), ([], False)]
)
def test_a_team_is_stalled_when_all_have_finished_or_make_no_progress(
    reports: list[str], stalled: bool
) -> None:
    replay = world(stretch([1], (1, 1)), stretch([1], (5, 1)))
    moves = {
        robot: Move(1, b"", 0, report == "explored", stalled=report == "stalled")
        for robot, report in enumerate(reports)
    }
    assert replay.is_stalled(moves) == stalled
