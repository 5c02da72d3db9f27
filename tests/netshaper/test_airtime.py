"""Who speaks how long: packets stay whole, the budget is kept, and nobody shouts the others down."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netshaper.airtime import HOUR, LATE, MOST_URGENT, UNLIMITED, Airtime, Shares, cut_into_frames, fill
from protocol import packet_index
from protocol.packets import Delete, Fragment, Save, Update, encode

frames = st.lists(
    st.sampled_from([Save(), Delete(7), Update(None, bytes(8)), Update(1, b"abc"), Fragment(bytes(63))]),
    min_size=1,
    max_size=6,
).map(encode)


@given(st.lists(frames, max_size=6), st.integers(0, 200))
def test_all_is_cut_between_packets_and_within_the_budget(said: list[bytes], left: int) -> None:
    sizes = fill(said, left)
    assert sum(sizes) <= left
    for frame, size in zip(said, sizes, strict=True):
        assert packet_index.fitting(frame, size) == size


@given(st.lists(frames, max_size=6), st.integers(0, 200))
def test_who_speaks_first_is_cut_only_where_the_budget_ends(said: list[bytes], left: int) -> None:
    sizes = fill(said, left)
    room = left
    for frame, size in zip(said, sizes, strict=True):
        assert size == packet_index.fitting(frame, room)
        room -= size


@given(st.lists(frames, max_size=6))
def test_without_a_limit_all_is_said(said: list[bytes]) -> None:
    assert fill(said, UNLIMITED) == [len(frame) for frame in said]


def test_the_more_urgent_goes_first_and_nobody_is_more_urgent_than_the_most() -> None:
    shares = Shares(100)
    assert shares.rank(0, 7) < shares.rank(1, 3)
    assert shares.rank(0, MOST_URGENT) == shares.rank(1, 10**9)
    assert shares.rank(0, 0) == shares.rank(1, -5)


def test_who_takes_all_the_air_waits_for_the_others_after_a_while_and_is_heard_again_later() -> None:
    shares = Shares(100)
    steps = 0
    while shares.rank(0, MOST_URGENT) < shares.rank(1, 0):
        shares.next_step()
        shares.book(0, 100)
        steps += 1
    assert steps <= LATE
    for _ in range(LATE):
        shares.next_step()
    assert shares.rank(0, MOST_URGENT) < shares.rank(1, 0)


def test_without_a_limit_nobody_takes_the_air_from_others() -> None:
    shares = Shares(UNLIMITED)
    shares.book(0, 10**9)
    assert shares.rank(0, 1) < shares.rank(1, 0)


LINE = {0: [1], 1: [0, 2], 2: [1, 3], 3: [2]}


def test_one_budget_is_spent_by_all() -> None:
    air = Airtime(100, 4)
    air.next_step(LINE)
    air.book(0, 60)
    assert [air.room(robot) for robot in range(4)] == [40] * 4


def test_who_cannot_hear_each_other_shares_no_air_where_neighbourhoods_have_budgets() -> None:
    air = Airtime(100, 4, reuse=True)
    air.next_step(LINE)
    air.book(0, 60)
    assert [air.room(robot) for robot in range(4)] == [40, 40, 40, 100]
    air.book(3, 100)
    assert [air.room(robot) for robot in range(4)] == [40, 0, 0, 0]


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 50)), max_size=30))
def test_nobody_has_more_than_a_budget_around_it(said: list[tuple[int, int]]) -> None:
    air = Airtime(100, 4, reuse=True)
    air.next_step(LINE)
    around = dict.fromkeys(LINE, 0)
    for robot, size in said:
        if size <= air.room(robot):
            air.book(robot, size)
            for each in (robot, *LINE[robot]):
                around[each] += size
    assert max(around.values()) <= 100
    assert all(air.room(robot) == 100 - max(around[r] for r in (robot, *LINE[robot])) for robot in LINE)


def test_a_duty_cycle_is_kept_over_an_hour_and_what_is_saved_is_bounded() -> None:
    air = Airtime(100, 1, duty_cycle=0.01)
    sent = []
    for _ in range(2 * HOUR):
        air.next_step({0: []})
        size = min(100, air.room(0))
        air.book(0, size)
        sent.append(size)
    # Saved up at first: an hour's bytes; and then what comes in.
    assert sum(sent) == pytest.approx(3 * HOUR, abs=2)
    assert sum(sent[HOUR:]) == pytest.approx(HOUR, abs=2)


def test_a_robot_sends_and_takes_no_more_than_it_can() -> None:
    air = Airtime(UNLIMITED, 2, send=[50, 0], receive=[0, 30])
    air.next_step({0: [1], 1: [0]})
    assert (air.room(0), air.room(1)) == (50, UNLIMITED)
    air.book(0, 20)
    assert air.room(0) == 30
    assert air.takes(1, 20)
    assert not air.takes(1, 11)
    assert air.takes(1, 10)
    air.next_step({0: [1], 1: [0]})
    assert air.room(0) == 50
    assert air.takes(1, 30)


@given(
    st.lists(st.integers(1, 12), max_size=12),
    st.integers(-1, 60),
    st.sampled_from((0, 16, 20)),
    st.sampled_from((0, 3)),
)
def test_frames_hold_whole_packets_and_no_more_than_there_is_room_for(
    sizes: list[int], room: int, most: int, tail: int
) -> None:
    said = [encode([Fragment(bytes(size))]) for size in sizes]
    frames, rest = cut_into_frames(b"".join(said), room, most, tail)
    assert b"".join(frames) + rest == b"".join(said)
    assert all(not most or len(frame) + tail <= most for frame in frames)
    assert room == UNLIMITED or sum(len(frame) + tail for frame in frames) <= room
    for frame in [*frames, rest]:
        assert packet_index.split(frame) or not frame
    if rest and room == UNLIMITED:
        assert most
