"""The reachability check accepts every honest robot, however late its entries arrive, and rejects impossible jumps."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from agent.encodings.reachability_check import ReachabilityCheck
from protocol.errors import ProtocolError
from tests.system.team import small_plan

RANGE, SPEED = 30, 5.0
PLANNED = small_plan(robots=3).robot_settings[0]
SETTINGS = replace(PLANNED, bodies=tuple(replace(body, speed=SPEED) for body in PLANNED.bodies))


def seen_from(x: int, y: int) -> tuple[int, int, int, int]:
    return x - RANGE, y - RANGE, x + RANGE + 1, y + RANGE + 1


moves = st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), min_size=1, max_size=40)


@given(moves, st.lists(st.booleans(), min_size=40, max_size=40), st.integers(0, 100))
def test_an_honest_robot_is_accepted_even_if_it_reports_rarely_and_late(
    ways: list[tuple[int, int]], reports: list[bool], delay: int
) -> None:
    reachability = ReachabilityCheck(SETTINGS)
    x = y = 1000
    box = seen_from(x, y)
    for step, ((dx, dy), sends) in enumerate(zip(ways, reports, strict=False), 1):
        x, y = x + dx, y + dy
        there = seen_from(x, y)
        box = min(box[0], there[0]), min(box[1], there[1]), max(box[2], there[2]), max(box[3], there[3])
        reachability.note_pose(1, step, x, y)
        if sends:
            reachability.check(1, box, step=step + delay, sender=1)
            box = there


def test_a_map_that_grows_faster_than_a_sensor_can_see_is_rejected_and_nothing_changes() -> None:
    reachability = ReachabilityCheck(SETTINGS)
    for step in range(1, 41):
        reachability.check(1, seen_from(100 + 5 * step, 100), step=step, sender=1)
    far = 105 - RANGE, 100 - RANGE, 300 + RANGE + 601, 130
    for _ in range(2):
        with pytest.raises(ProtocolError, match="map 1 grows by 600 cells; its author can have observed 73"):
            reachability.check(1, far, step=41, sender=1)
    reachability.check(1, seen_from(305, 100), step=41, sender=1)


def test_a_first_entry_covers_no_more_than_a_robot_can_have_seen_since_the_start() -> None:
    reachability = ReachabilityCheck(SETTINGS)
    with pytest.raises(ProtocolError, match="grows by 119 cells; its author can have observed 118"):
        reachability.check(2, (0, 0, 119, 5), step=10, sender=0)
    reachability.check(2, (0, 0, 118, 5), step=10, sender=0)


def test_a_map_far_from_its_authors_pose_is_rejected_from_the_author_but_not_from_a_forwarder() -> None:
    reachability = ReachabilityCheck(SETTINGS)
    reachability.note_pose(1, 10, 700, 100)
    far = seen_from(100, 100)
    with pytest.raises(
        ProtocolError, match=r"570 cells from \(700, 100\), the pose of its author in step 10"
    ):
        reachability.check(1, far, step=10, sender=1)
    reachability.check(1, far, step=10, sender=2)
