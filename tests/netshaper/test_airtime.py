"""Airtime: packets stay whole, transmissions respect the budget, and no robot starves the others."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from netshaper.airtime import HOUR_S, RECENT, WHOLE_STEP, Airtime, Shares, cut_into_frames
from netshaper.radio_options import RadioOptions
from netshaper.settings import RadioSettings
from protocol import packet_index
from protocol.budget import UNLIMITED, Budget
from protocol.nanoseconds import SECOND
from protocol.packet_codec import encode
from protocol.packets import Fragment

BUDGET = Budget(100)


def test_the_higher_priority_is_sent_first() -> None:
    shares = Shares()
    assert shares.rank(0, 7, BUDGET) < shares.rank(1, 3, BUDGET)


def test_a_robot_that_uses_most_airtime_is_deferred_and_recovers_later() -> None:
    shares = Shares()
    steps = 0
    while shares.rank(0, 255, BUDGET) < shares.rank(1, 0, BUDGET):
        shares.next_step()
        shares.book(0, 100)
        steps += 1
    assert steps <= RECENT
    for _ in range(RECENT):
        shares.next_step()
    assert shares.rank(0, 255, BUDGET) < shares.rank(1, 0, BUDGET)


def test_without_a_limit_no_robot_is_deferred() -> None:
    shares = Shares()
    shares.book(0, 10**9)
    assert shares.rank(0, 1, UNLIMITED) < shares.rank(1, 0, UNLIMITED)


def airtime(budget: Budget, robots: int, **settings: Any) -> Airtime:
    """Return the airtime of a radio."""
    return Airtime(RadioSettings(robots, 0, 1.0, budget, **settings))


LINE = {0: [1], 1: [0, 2], 2: [1, 3], 3: [2]}


def test_one_budget_is_spent_by_all() -> None:
    air = airtime(Budget(100), 4)
    air.next_step(LINE)
    air.book(0, 60)
    assert [air.room(robot).limit for robot in range(4)] == [40] * 4


def test_with_spatial_reuse_robots_out_of_range_share_no_airtime() -> None:
    air = airtime(Budget(100), 4, options=RadioOptions(reuse=True))
    air.next_step(LINE)
    air.book(0, 60)
    assert [air.room(robot).limit for robot in range(4)] == [40, 40, 40, 100]
    air.book(3, 100)
    assert [air.room(robot).limit for robot in range(4)] == [40, 0, 0, 0]


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 50)), max_size=30))
def test_no_neighborhood_exceeds_the_budget(transmissions: list[tuple[int, int]]) -> None:
    air = airtime(Budget(100), 4, options=RadioOptions(reuse=True))
    air.next_step(LINE)
    around = dict.fromkeys(LINE, 0)
    for robot, size in transmissions:
        if air.room(robot).fits(size):
            air.book(robot, size)
            for each in (robot, *LINE[robot]):
                around[each] += size
    assert max(around.values()) <= 100
    assert all(air.room(robot).limit == 100 - max(around[r] for r in (robot, *LINE[robot])) for robot in LINE)


@given(
    st.floats(0.0003, 0.5),
    st.lists(
        st.tuples(st.sampled_from((0, 1, 1799, 3599)), st.integers(1, 4000), st.integers(0, 1500)), max_size=8
    ),
)
def test_no_hour_has_more_airtime_than_the_duty_cycle_and_the_rest_may_be_used_at_once(
    share: float, transmissions: list[tuple[int, int, int]]
) -> None:
    """A plain reference adds up the airtime of the last hour at each step, at a bandwidth that changes."""
    air = airtime(Budget(1000), 2, options=RadioOptions(duty_cycle=share))
    sent: list[tuple[int, Fraction]] = []
    now, allowed = 0, Fraction(round(share * HOUR_S * WHOLE_STEP), WHOLE_STEP)
    for wait, bandwidth, wanted in transmissions:
        air.set_budget(Budget(bandwidth))
        for _ in range(wait + 1):
            now += 1
            air.next_step({0: [1], 1: [0]})
        used = sum((airtime for step, airtime in sent if step > now - HOUR_S), Fraction())
        left = int((allowed - used) * bandwidth)
        assert (air.own(0).limit, air.own(1).limit) == (left, int(allowed * bandwidth))
        size = min(wanted, left, bandwidth)
        if size:
            air.book(0, size)
            sent.append((now, Fraction(-(-size * WHOLE_STEP // bandwidth), WHOLE_STEP)))


def test_an_unlimited_bandwidth_has_no_duty_cycle() -> None:
    air = airtime(Budget(100), 1, options=RadioOptions(duty_cycle=0.01))
    air.set_budget(UNLIMITED)
    air.next_step({0: []})
    assert air.room(0) == UNLIMITED


def test_a_small_budget_per_step_is_saved_for_a_frame() -> None:
    air = airtime(Budget(6), 2, send=(0, 4), step_ns=SECOND)
    room = []
    for step in range(5):
        air.next_step({0: [1], 1: [0]})
        if step == 1:
            air.book(0, 16)
        room.append((air.room(0).limit, air.room(1).limit))
    assert room == [(16, 16), (0, 0), (6, 6), (12, 12), (16, 16)]


def test_saved_budgets_of_neighborhoods_and_robots_are_separate() -> None:
    air = airtime(Budget(10), 4, options=RadioOptions(reuse=True), step_ns=SECOND // 5)
    air.next_step(LINE)
    air.book(0, 45)
    assert [air.room(robot).limit for robot in range(4)] == [5, 5, 5, 50]
    air.next_step(LINE)
    assert [air.room(robot).limit for robot in range(4)] == [15, 15, 15, 50]


def test_a_robot_sends_and_receives_no_more_than_its_limits() -> None:
    air = airtime(UNLIMITED, 2, send=(50, 0), receive=(0, 30))
    air.next_step({0: [1], 1: [0]})
    assert (air.room(0), air.room(1)) == (Budget(50), UNLIMITED)
    air.book(0, 20)
    assert air.room(0) == Budget(30)
    assert air.receives(1, 20)
    assert not air.receives(1, 11)
    assert air.receives(1, 10)
    air.next_step({0: [1], 1: [0]})
    assert air.room(0) == Budget(50)
    assert air.receives(1, 30)


@given(
    st.lists(st.integers(1, 12), max_size=12),
    st.none() | st.integers(0, 60),
    st.none() | st.sampled_from((16, 20)),
    st.sampled_from((0, 3)),
)
def test_frames_hold_whole_packets_within_budget_and_frame_limit(
    sizes: list[int], room: int | None, most: int | None, tail: int
) -> None:
    payload = b"".join(encode([Fragment(bytes(size))]) for size in sizes)
    index = packet_index.index_of(payload)
    stops = cut_into_frames(index, Budget(room), Budget(most), tail)
    ends = [index.ends[stop - 1] for stop in stops]
    frame_sizes = [end - begin + tail for begin, end in pairwise([0, *ends])]
    assert all(Budget(most).fits(size) for size in frame_sizes)
    assert Budget(room).fits(sum(frame_sizes))
    if room is None and most is None:
        assert ends == ([len(payload)] if payload else [])
    if stops and stops[-1] < len(sizes):
        size = index.sizes[stops[-1]] + tail
        assert not Budget(room).minus(sum(frame_sizes)).fits(size) or not Budget(most).fits(size)
