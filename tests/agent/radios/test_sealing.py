"""Sealed frames: only new frames of the team open, whatever happens to them on the way."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.radios.replay_window import MAX_COUNTER, MAX_SESSION, WINDOW, ReplayWindow, frame_number
from agent.radios.sealing import KEY_BYTES, OVERHEAD, Opener, Sealer, SessionExhaustedError

KEY, OTHER = bytes(range(KEY_BYTES)), bytes(KEY_BYTES)
PAYLOADS = st.binary(max_size=80)


def opener(**more: object) -> Opener:
    return Opener(KEY, 0, 4, **more)  # type: ignore[arg-type]


@given(PAYLOADS)
def test_a_frame_opens_once_with_its_sender_and_numbers(payload: bytes) -> None:
    sealer, receiver = Sealer(KEY, 3, 7), opener()
    sealer.seal(b"an earlier frame")
    frame = sealer.seal(payload)
    assert len(frame) == len(payload) + OVERHEAD
    assert receiver.open(frame) == (3, 7, 1, payload)
    assert receiver.open(frame) is None
    assert receiver.dropped == {"replayed": 1}


@given(PAYLOADS, st.data())
def test_a_frame_with_a_flipped_bit_does_not_open(payload: bytes, data: st.DataObject) -> None:
    frame = bytearray(Sealer(KEY, 3, 1).seal(payload))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    receiver = opener()
    assert receiver.open(bytes(frame)) is None
    assert receiver.dropped.total() == 1


@given(PAYLOADS, st.data())
def test_a_truncated_or_extended_frame_does_not_open(payload: bytes, data: st.DataObject) -> None:
    frame = Sealer(KEY, 3, 1).seal(payload)
    other = data.draw(st.integers(0, len(frame) - 1).map(lambda end: frame[:end]) | st.just(frame + b"\0"))
    receiver = opener()
    assert receiver.open(other) is None
    assert receiver.dropped == {"truncated" if len(other) < OVERHEAD else "not authentic": 1}


@given(st.binary(max_size=60))
def test_arbitrary_bytes_do_not_open(frame: bytes) -> None:
    receiver = opener()
    assert receiver.open(frame) is None
    assert receiver.dropped.total() == 1


def test_frames_of_another_team_of_other_settings_and_of_impossible_senders_are_counted() -> None:
    receiver = opener(context=b"office")
    assert receiver.open(Sealer(OTHER, 3, 1, b"office").seal(b"")) is None
    assert receiver.open(Sealer(KEY, 3, 1, b"street").seal(b"")) is None
    assert receiver.open(Sealer(KEY, 4, 1, b"office").seal(b"")) is None
    assert receiver.open(Sealer(KEY, 0, 1, b"office").seal(b"")) is None
    assert receiver.dropped == {"not authentic": 2, "unknown sender": 1, "own number": 1}
    assert receiver.open(Sealer(KEY, 3, 1, b"office").seal(b"hello")) == (3, 1, 0, b"hello")


@given(st.permutations(range(WINDOW)), st.integers(0, WINDOW))
def test_frames_within_the_window_open_in_any_order_each_once(order: list[int], repeated: int) -> None:
    sealer, receiver = Sealer(KEY, 2, 1), opener()
    frames = [sealer.seal(bytes([number])) for number in range(WINDOW)]
    for number in order:
        assert receiver.open(frames[number]) == (2, 1, number, bytes([number]))
    for frame in frames[:repeated]:
        assert receiver.open(frame) is None


def test_a_frame_behind_the_window_does_not_open() -> None:
    sealer, receiver = Sealer(KEY, 2, 1), opener()
    frames = [sealer.seal(b"") for _ in range(WINDOW + 1)]
    assert receiver.open(frames[-1]) is not None
    assert receiver.open(frames[1]) is not None
    assert receiver.open(frames[0]) is None


def test_frames_of_an_earlier_session_do_not_open_after_one_of_a_later_session() -> None:
    before, after, receiver = Sealer(KEY, 2, 1), Sealer(KEY, 2, 2), opener()
    assert receiver.open(before.seal(b"")) is not None
    late = before.seal(b"")
    after.seal(b"lost")
    assert receiver.open(after.seal(b"")) is not None
    assert receiver.open(late) is None


def test_a_restarted_receiver_accepts_no_frame_that_it_had_accepted() -> None:
    sealer, receiver = Sealer(KEY, 2, 5), opener()
    frames = [sealer.seal(b"") for _ in range(5)]
    for frame in frames:
        assert receiver.open(frame) is not None
    restarted = opener(highest={2: receiver.highest(2)})
    assert [restarted.open(frame) for frame in frames] == [None] * 5
    assert restarted.open(sealer.seal(b"next")) is not None


@given(st.lists(st.tuples(st.integers(1, 3), st.integers(0, 200)), max_size=300))
def test_the_window_agrees_with_a_plain_reference(numbers: list[tuple[int, int]]) -> None:
    window, accepted = ReplayWindow(), list[tuple[int, int]]()
    for session, counter in numbers:
        newest = max(accepted, default=(0, 0))
        is_new = (session, counter) not in accepted
        recent = session > newest[0] or (session == newest[0] and counter > newest[1] - WINDOW)
        assert window.accept(frame_number(session, counter)) == (is_new and recent)
        if is_new and recent:
            accepted.append((session, counter))
        assert window.highest == (frame_number(*max(accepted)) if accepted else 0)


def test_no_frame_number_is_used_twice() -> None:
    sealer = Sealer(KEY, 2, MAX_SESSION)
    sealer.counter = MAX_COUNTER
    assert opener().open(sealer.seal(b"last")) == (2, MAX_SESSION, MAX_COUNTER, b"last")
    with pytest.raises(SessionExhaustedError, match="start it again"):
        sealer.seal(b"")
    with pytest.raises(ValueError, match="new team key"):
        Sealer(KEY, 2, MAX_SESSION + 1)


def test_equal_payloads_are_sealed_differently_and_are_not_readable() -> None:
    sealer, payload = Sealer(KEY, 2, 1), b"a map of the building"
    one, other = sealer.seal(payload), sealer.seal(payload)
    assert payload not in one
    assert one[6:] != other[6:]


def test_a_key_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="32 bytes, not 16"):
        Sealer(bytes(16), 0, 1)
