"""The instruments: streams are put together whatever the order, and Zenoh's bytes are read or refused."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.capture.sniffer import SYN, WINDOW, Segment, Stream
from tests.capture.zenoh_wire import Message, Session, WireError

FRAME = bytes.fromhex("2507")  # reliable, sequence number 7


def batch(*parts: bytes) -> bytes:
    whole = b"".join(parts)
    return len(whole).to_bytes(2, "little") + whole


def declare(number: int, key: str, scope: int = 0) -> bytes:
    return bytes([0x1E, 0x20, number, scope, len(key)]) + key.encode()


def push(number: int, suffix: str, payload: bytes, *, own: bool = True) -> bytes:
    named = bytes([len(suffix)]) + suffix.encode() if suffix else b""
    header = 0x1D | (0x20 if suffix else 0) | (0x40 if own else 0)
    return bytes([header, number]) + named + bytes([0x01, len(payload)]) + payload


@given(st.data(), st.binary(min_size=1, max_size=60), st.sampled_from((0, 5, WINDOW - 1, WINDOW - 20)))
def test_a_stream_is_reassembled_from_any_order_and_repeats(
    data: st.DataObject, sent: bytes, first: int
) -> None:
    cuts = sorted({0, len(sent), *data.draw(st.lists(st.integers(0, len(sent)), max_size=8))})
    pieces = [(at, sent[at:end]) for at, end in pairwise(cuts)]
    again = data.draw(st.lists(st.sampled_from(pieces), max_size=4))
    stream = Stream()
    assert stream.take(Segment(1, 2, first, SYN, b"")) == b""
    came = b""
    for at, piece in data.draw(st.permutations(pieces + again)):
        came += stream.take(Segment(1, 2, (first + 1 + at) % WINDOW, 0, piece))
    assert came == sent
    assert stream.complete
    assert not stream.missing
    assert stream.bytes == len(sent)


def test_a_gap_in_a_stream_is_detected() -> None:
    stream = Stream()
    stream.take(Segment(1, 2, 10, SYN, b""))
    assert stream.take(Segment(1, 2, 13, 0, b"later")) == b""
    assert stream.missing


def test_keys_are_resolved_from_the_declarations_of_both_ends() -> None:
    session = Session()
    up = batch(FRAME, declare(1, "run/radio"), declare(2, "/tx", scope=1), push(2, "/r0", b"hello"))
    assert list(session.feed(0, up)) == [Message("put", "run/radio/tx/r0", b"hello")]
    down = batch(FRAME, push(2, "", b"back", own=False))
    assert list(session.feed(1, down)) == [Message("put", "run/radio/tx", b"back")]


@given(st.lists(st.integers(0, 200), max_size=6))
def test_batches_may_come_in_any_pieces(cuts: list[int]) -> None:
    sent = batch(FRAME, push(0, "a", b"1"), push(0, "b", b"2")) + batch(FRAME, push(0, "c", b"3"))
    ends = sorted({0, len(sent), *(min(cut, len(sent)) for cut in cuts)})
    session = Session()
    came = [m for at, end in pairwise(ends) for m in session.feed(0, sent[at:end])]
    assert came == [Message("put", key, payload) for key, payload in (("a", b"1"), ("b", b"2"), ("c", b"3"))]
    assert session.pending == 0


def test_fragments_of_one_message_are_joined() -> None:
    whole = push(0, "long", bytes(range(100)))
    session = Session()
    assert not list(session.feed(0, batch(bytes.fromhex("6601"), whole[:40])))
    assert session.pending == 40
    assert list(session.feed(0, batch(bytes.fromhex("2602"), whole[40:]))) == [
        Message("put", "long", bytes(range(100)))
    ]
    assert session.fragmented == 1


@pytest.mark.parametrize("stray", ["07", "2507ff", "25071c", "25071d0001", "25071e0f00", "25071d000509"])
def test_unknown_bytes_are_an_error(stray: str) -> None:
    with pytest.raises(WireError):
        list(Session().feed(0, batch(bytes.fromhex(stray))))
