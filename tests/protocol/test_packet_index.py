"""The packet index accepts and rejects the same frames as the decoder, packet by packet."""

from __future__ import annotations

from itertools import accumulate
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from protocol.errors import ProtocolError
from protocol.packet_codec import decode, encode
from protocol.packet_index import ends, fitting, index_of, split
from protocol.packets import ALL_KINDS, AnyPacket
from tests.protocol.test_packets import EXAMPLES, streams

noisy = st.binary(max_size=100) | st.builds(
    lambda stream, at, more: encode(stream)[:at] + more, streams, st.integers(0, 80), st.binary(max_size=3)
)


@given(noisy)
@example(b"\xf2\x00")
@example(b"\xf2\x3f" + bytes(63))
@example(b"\xf2\xff")
@example(b"\xfc\x01")
@example(b"\xf8\x40")
@example(b"\x80\x01")
def test_the_index_accepts_what_the_decoder_accepts_and_raises_its_errors(noise: bytes) -> None:
    readers: list[Any] = [split, index_of]
    try:
        decoded = decode(noise)
    except ProtocolError as error:
        for read in readers:
            with pytest.raises(ProtocolError) as caught:
                read(noise)
            assert str(caught.value) == str(error)
    else:
        assert split(noise) == [encode([packet]) for packet in decoded]
        index = index_of(noise)
        assert [ALL_KINDS[kind] for kind in index.kinds] == [packet.name for packet in decoded]
        assert list(index.sizes) == [len(encode([packet])) for packet in decoded]
        assert list(ends(noise)) == list(accumulate(index.sizes))


@pytest.mark.parametrize("packet", EXAMPLES, ids=repr)
def test_every_wrong_bit_is_found(packet: AnyPacket) -> None:
    whole = encode([packet])
    for bit in range(8 * len(whole)):
        broken = (int.from_bytes(whole, "big") ^ 1 << bit).to_bytes(len(whole), "big")
        try:
            decode(broken)
        except ProtocolError:
            with pytest.raises(ProtocolError):
                index_of(broken)
        else:
            assert split(broken)


@given(streams, st.integers(-1, 300))
def test_fitting_packets_are_the_longest_prefix_within_a_limit(stream: list[AnyPacket], limit: int) -> None:
    ends = [len(encode(stream[: count + 1])) for count in range(len(stream))]
    assert index_of(encode(stream)).count_fitting(limit) == sum(end <= limit for end in ends)
    assert (
        fitting(encode(stream), limit)
        == encode(stream)[: max([end for end in ends if end <= limit], default=0)]
    )


@given(streams, st.data())
def test_a_part_of_an_index_is_the_index_of_that_part(stream: list[AnyPacket], data: st.DataObject) -> None:
    frame = encode(stream)
    index = index_of(frame)
    first = data.draw(st.integers(0, len(stream)))
    last = data.draw(st.integers(first, len(stream)))
    assert index.part(first, last) == index_of(encode(stream[first:last]))
    assert frame[index.bytes_of(first, last)] == encode(stream[first:last])
