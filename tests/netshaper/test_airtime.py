"""Who speaks how long: packets stay whole, the budget is kept, and nobody shouts the others down."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from netshaper.airtime import LATE, MOST_URGENT, UNLIMITED, Shares, fill
from protocol import survey
from protocol.packets import Delete, Fragment, Look, Save, encode

frames = st.lists(
    st.sampled_from([Save(), Delete(7), Look(None, bytes(8)), Look(1, b"abc"), Fragment(bytes(63))]),
    min_size=1,
    max_size=6,
).map(encode)


@given(st.lists(frames, max_size=6), st.integers(0, 200))
def test_all_is_cut_between_packets_and_within_the_budget(said: list[bytes], left: int) -> None:
    sizes = fill(said, left)
    assert sum(sizes) <= left
    for frame, size in zip(said, sizes, strict=True):
        assert survey.fitting(frame, size) == size


@given(st.lists(frames, max_size=6), st.integers(0, 200))
def test_who_speaks_first_is_cut_only_where_the_budget_ends(said: list[bytes], left: int) -> None:
    sizes = fill(said, left)
    room = left
    for frame, size in zip(said, sizes, strict=True):
        assert size == survey.fitting(frame, room)
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
