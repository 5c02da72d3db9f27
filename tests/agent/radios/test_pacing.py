"""Pacing compared with plain references: bytes per second, an hour's duty cycle, one frame at a time, back-off."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.radios.neighbors import Neighbors
from agent.radios.pacing import ALWAYS, HOUR, DutyCycle, Pacer
from protocol.nanoseconds import SECOND
from protocol.presets import PRESETS
from protocol.token_bucket import TokenBucket

GAPS = st.lists(st.tuples(st.integers(0, 20 * SECOND), st.integers(1, 300)), max_size=60)


@given(GAPS, st.integers(1, 500), st.integers(100, 400))
def test_a_token_bucket_agrees_with_exact_fractions(
    gaps: list[tuple[int, int]], rate: int, capacity: int
) -> None:
    bucket, now, level = TokenBucket(rate, capacity, 0), 0, Fraction(capacity)
    for gap, size in gaps:
        now += gap
        level = min(level + Fraction(rate * gap, SECOND), Fraction(capacity))
        assert bucket.room(now) == int(level)
        if size <= level:
            bucket.take(size)
            level -= size


def test_a_clock_that_goes_back_gives_no_tokens() -> None:
    bucket = TokenBucket(10, 100, 50 * SECOND)
    bucket.take(100)
    assert bucket.room(40 * SECOND) == 0
    assert bucket.room(50 * SECOND) == 0
    assert bucket.room(51 * SECOND) == 10


@given(
    st.lists(st.tuples(st.integers(0, HOUR // 5), st.integers(1, 60 * SECOND)), max_size=80),
    st.integers(50_000, 999_999),
    st.integers(0, 30 * SECOND),
)
def test_a_duty_cycle_agrees_with_exact_fractions_and_holds_in_every_hour(
    frames: list[tuple[int, int]], share: int, delay: int
) -> None:
    now, sent = 0, list[tuple[int, int]]()
    duty, most = DutyCycle(share, 60 * SECOND, delay + 60 * SECOND, now), HOUR * share // ALWAYS
    capacity = max(most // 10, 60 * SECOND)
    level = Fraction(0)
    for gap, airtime in frames:
        now += gap
        level += Fraction((most - capacity) * gap, HOUR + delay + 60 * SECOND)
        level = min(level, Fraction(capacity))
        assert duty.room(now) == int(level)
        if airtime <= level:
            duty.take(airtime)
            level -= airtime
            sent.append((now + len(sent) % 2 * delay + airtime, airtime))
    for end, _ in sent:
        assert sum(airtime for other, airtime in sent if end - HOUR <= other <= end) <= most


def test_a_duty_cycle_without_room_for_a_frame_is_refused() -> None:
    with pytest.raises(ValueError, match=r"3.6 s of airtime per hour has no room for a frame of 4 s"):
        DutyCycle(1000, 4 * SECOND, 0, 0)
    with pytest.raises(ValueError, match=r"3\.6 s of airtime per hour has no room for a frame of 3\.6 s"):
        DutyCycle(1000, HOUR // 1000, 0, 0)  # it would never send
    with pytest.raises(ValueError, match="must be 1 to 1000000"):
        DutyCycle(0, SECOND, 0, 0)


def pacer(rate: int, capacity: int, *, share: int = 1_000_000, backoff: int = 0, robot: int = 0) -> Pacer:
    """A radio of 1 ms per byte."""
    return Pacer(
        TokenBucket(rate, capacity, 0),
        DutyCycle(share, 100 * SECOND // 1000, backoff + 100 * SECOND // 1000, 0),
        lambda size: size * SECOND // 1000,
        100,
        backoff,
        seed=5,
        robot=robot,
    )


@given(GAPS, st.integers(1, SECOND))
def test_frames_do_not_overlap_and_wait_less_than_the_back_off(
    gaps: list[tuple[int, int]], backoff: int
) -> None:
    pace, now, free = pacer(80, 200, backoff=backoff), 0, 0
    for gap, wanted in gaps:
        now += gap
        room = pace.room(now)
        assert (room > 0 and now >= free) or room == 0
        size = min(wanted, room)
        if size:
            start = pace.schedule(size, now)
            assert now <= start < now + backoff
            free = start + size * SECOND // 1000
            assert pace.room(free - 1) == 0


def test_the_back_off_differs_between_robots_and_frames_but_not_between_runs() -> None:
    starts = [
        [pace.schedule(1, 10 * number * SECOND) % (10 * SECOND) for number in range(5)]
        for pace in (pacer(80, 200, backoff=SECOND, robot=robot) for robot in (0, 1, 0))
    ]
    assert starts[0] == starts[2] != starts[1]
    assert len(set(starts[0])) == 5


def test_where_the_duty_cycle_leaves_less_airtime_the_frame_is_shorter() -> None:
    pace = pacer(1000, 1000, share=700)  # 2.52 s of airtime per hour, 252 ms at once
    assert pace.room(0) == 0, "the robot may have used its share before it started"
    for second, expected in enumerate((100, 100, 53, 0)):
        now = HOUR + second * SECOND
        assert pace.room(now) == expected
        if expected:
            pace.schedule(expected, now)
    assert pace.room(2 * HOUR) == 100


@pytest.mark.parametrize("name", PRESETS)
def test_the_airtime_of_a_preset_grows_with_the_frame_up_to_that_of_a_full_one(name: str) -> None:
    preset = PRESETS[name]
    airtimes = [preset.airtime_s(size) for size in range(preset.frame_bytes + 1)]
    assert airtimes == sorted(airtimes)
    assert airtimes[0] > 0
    assert airtimes[-1] == pytest.approx(preset.frame_s)


def test_neighbors_are_those_received_within_the_timeout() -> None:
    neighbors = Neighbors(10 * SECOND)
    neighbors.received(3, 1, 0)
    neighbors.received(1, 1, 4 * SECOND)
    assert neighbors.current(10 * SECOND - 1) == [1, 3]
    assert neighbors.current(10 * SECOND) == [1]
    neighbors.received(3, 1, 12 * SECOND)
    assert neighbors.current(14 * SECOND) == [3]
