"""What can have been seen: no honest robot is ever refused, however late its words come; a jump is."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from agent.encodings.reachability_check import ReachabilityCheck
from protocol.errors import ProtocolError
from tests.system.team import small_plan

RANGE, SPEED = 30, 5.0
SETTINGS = replace(small_plan(robots=3).robot_settings[0], fastest_cells=SPEED)


def seen_from(x: int, y: int) -> tuple[int, int, int, int]:
    return x - RANGE, y - RANGE, x + RANGE + 1, y + RANGE + 1


moves = st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), min_size=1, max_size=40)


@given(moves, st.lists(st.booleans(), min_size=40, max_size=40), st.integers(0, 100))
def test_whoever_drives_and_looks_is_believed_also_when_it_says_little_and_is_heard_late(
    ways: list[tuple[int, int]], speaks: list[bool], late: int
) -> None:
    reachability_check = ReachabilityCheck(SETTINGS)
    x = y = 1000
    box = seen_from(x, y)
    for step, ((dx, dy), said) in enumerate(zip(ways, speaks, strict=False), 1):
        x, y = x + dx, y + dy
        there = seen_from(x, y)
        box = min(box[0], there[0]), min(box[1], there[1]), max(box[2], there[2]), max(box[3], there[3])
        reachability_check.place(1, step, x, y)
        if said:
            reachability_check.listen(step + late, 1)
            reachability_check.claim(1, box)
            box = there


def test_what_grows_faster_than_a_sensor_can_see_is_refused_and_changes_nothing() -> None:
    reachability_check = ReachabilityCheck(SETTINGS)
    for step in range(1, 41):
        reachability_check.listen(step, 1)
        reachability_check.claim(1, seen_from(100 + 5 * step, 100))
    reachability_check.listen(41, 1)
    for _ in range(2):
        with pytest.raises(ProtocolError, match="map 1 grows by 600 cells, where 73 can have been seen"):
            reachability_check.claim(1, (105 - RANGE, 100 - RANGE, 300 + RANGE + 601, 130))
    reachability_check.claim(1, seen_from(305, 100))


def test_a_first_word_is_no_larger_than_what_a_robot_can_have_seen_from_the_beginning() -> None:
    reachability_check = ReachabilityCheck(SETTINGS)
    reachability_check.listen(10, 0)
    with pytest.raises(ProtocolError, match="grows by 119 cells, where 118"):
        reachability_check.claim(2, (0, 0, 119, 5))
    reachability_check.claim(2, (0, 0, 118, 5))


def test_a_map_that_does_not_hold_the_place_where_its_maker_was_heard_from_is_refused_of_it_alone() -> None:
    reachability_check = ReachabilityCheck(SETTINGS)
    reachability_check.place(1, 10, 700, 100)
    reachability_check.listen(10, 1)
    far = seen_from(100, 100)
    with pytest.raises(
        ProtocolError, match=r"lies 570 cells from \(700, 100\), where its maker was heard from"
    ):
        reachability_check.claim(1, far)
    reachability_check.listen(10, 2)
    reachability_check.claim(1, far)
