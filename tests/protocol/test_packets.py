"""Packets: the sizes of Table 6.1, every bit in its place, and rejection of all malformed bytes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from protocol import packets
from protocol.errors import ProtocolError
from protocol.packet_codec import decode, decode_kind, encode, handshake, length, packet_at
from protocol.packets import (
    ALL_KINDS,
    DECLINED,
    FRAGMENT_DATA,
    KINDS,
    LAYOUTS,
    UPDATE_DATA,
    UPDATE_NUMBERS,
    UPDATE_PART,
    Answer,
    AnyPacket,
    Block,
    Change,
    Check,
    Delete,
    Emerge,
    Fragment,
    From,
    FromEarly,
    FromFirst,
    Gone,
    Held,
    HeldEarly,
    HeldFirst,
    Insert,
    LogDigest,
    Near,
    Offer,
    Packet,
    Passed,
    Pose,
    Remove,
    Replace,
    Save,
    Target,
    Update,
)

GOLDEN = Path(__file__).parent / "golden" / "packets.txt"

SIZES = {"ins": 6, "rep": 6, "del": 2, "em": 5, "chg": 5, "rm": 2, "conn": 2, "targ": 3, "save": 1}
"""Table 6.1."""

VERTEX = {"index": (0, 4095), "x": (-1, 4094), "y": (-1, 4094), "side": (0, 3), "occupied": (0, 1)}
OBJECT = {"object": (0, 4095), "count": (0, 8191), "inside": (0, 1)}
LIMITS: dict[type[Packet], dict[str, tuple[int, int]]] = {
    Insert: VERTEX,
    Replace: VERTEX,
    Delete: {"index": (0, 4095)},
    Emerge: OBJECT,
    Change: OBJECT,
    Remove: {"object": (0, 4095)},
    Offer: {"map": (0, 63), "block": (0, 63)},
    Answer: {"index": (0, 4095)},
    Block: {"block": (0, 127)},
    Target: {"x": (0, 2047), "y": (0, 2047)},
    Pose: {"x": (0, 2047), "y": (0, 2047), "leads": (0, 1)},
    Passed: {"robot": (0, 255), "age": (0, 63), "x": (0, 2047), "y": (0, 2047)},
    Save: {},
    From: {"map": (0, 255), "index": (0, 2**24 - 1)},
    FromEarly: {"map": (0, 255), "index": (0, 4095)},
    FromFirst: {"map": (0, 15), "index": (0, 255)},
    Held: {"map": (0, 255), "index": (0, 2**24 - 1)},
    HeldEarly: {"map": (0, 255), "index": (0, 4095)},
    HeldFirst: {"map": (0, 15), "index": (0, 255)},
    Near: {"robot": (0, 255)},
    Gone: {"robot": (0, 255)},
    Check: {"sum": (0, 2**16 - 1)},
    LogDigest: {"entries": (0, 2**16 - 1), "complete": (0, 1), "salt": (0, 127), "hash": (0, 2**16 - 1)},
}
"""First and last value of each field of each packet."""

EXAMPLES: list[AnyPacket] = [
    Insert(3, 17, 42, 2, 1),
    Replace(4095, -1, 2048, 3, 0),
    Delete(258),
    Emerge(7, 4096, 0),
    Change(4095, 2, 1),
    Remove(100),
    Offer(5, 63),
    Answer(4094),
    Block(33),
    Block(DECLINED),
    Target(2047, 1000),
    Pose(1000, 2047, 1),
    Passed(17, 2, 1000, 2047),
    Save(),
    Fragment(b"murmur"),
    Fragment(bytes(range(63))),
    From(5, 70000),
    FromEarly(255, 12),
    FromFirst(15, 255),
    Held(63, 512),
    HeldEarly(5, 4095),
    HeldFirst(9, 17),
    Near(7),
    Gone(130),
    Check(0x29B1),
    LogDigest(513, 1, 100, 0xBEEF),
    Update(None, bytes(range(8))),
    Update(0, b"residual"),
    Update(1, b""),
    Update(0, bytes(range(15))),
    Update(1, bytes(range(16))),
    Update(1, bytes(range(63))),
    Update(None, bytes(range(15))),
    Update(None, bytes(range(16))),
    Update(None, bytes(range(63))),
]


BROKEN = 6 * b"\xff"
"""As long as a packet, with a code that no packet has."""


def packets_of(kind: type[Packet]) -> st.SearchStrategy[Any]:
    return st.builds(kind, **{name: st.integers(*limits) for name, limits in LIMITS[kind].items()})


fragments = st.builds(Fragment, st.binary(min_size=1, max_size=FRAGMENT_DATA))
updates = st.one_of(
    st.builds(Update, st.none(), st.binary(min_size=UPDATE_PART, max_size=UPDATE_DATA)),
    st.builds(Update, st.integers(0, UPDATE_NUMBERS - 1), st.binary(max_size=UPDATE_DATA)),
)
streams = st.lists(st.one_of(*map(packets_of, LIMITS), fragments, updates), max_size=12)


def bits(buffer: bytes) -> str:
    return "".join(f"{byte:08b}" for byte in buffer)


def documented_bits(packet: AnyPacket) -> str:
    """The layout that docs/protocol.md draws, as a string of zeros and ones."""
    match packet:
        case Insert() | Replace():
            code = "10100000" if isinstance(packet, Insert) else "10100001"
            expected = f"{packet.index:012b}{packet.x + 1:012b}{packet.y + 1:012b}"
            expected = f"{code}{expected}{packet.side:02b}{packet.occupied:b}0"
        case Delete():
            expected = f"1101{packet.index:012b}"
        case Emerge() | Change():
            code = "10100010" if isinstance(packet, Emerge) else "10100011"
            expected = f"{code}{packet.object:012b}{packet.count:013b}{packet.inside:b}" + 6 * "0"
        case Remove():
            expected = f"1110{packet.object:012b}"
        case Offer():
            expected = f"1100{packet.map:06b}{packet.block:06b}"
        case Answer():
            expected = f"1011{packet.index:012b}"
        case Block():
            expected = f"111110000{packet.block:07b}"
        case Target():
            expected = f"00{packet.x:011b}{packet.y:011b}"
        case Pose():
            expected = f"11110011{packet.x:011b}{packet.y:011b}{packet.leads:b}0"
        case Passed():
            expected = f"111111110000{packet.robot:08b}{packet.age:06b}{packet.x:011b}{packet.y:011b}"
        case Save():
            expected = "11110000"
        case Fragment():
            size = len(packet.data)
            expected = ("11110001" if size == 63 else f"11110010{size:08b}") + bits(packet.data)
        case Update():
            size, number = len(packet.data), packet.number
            if number is None:
                head = f"10101{size - 8:03b}" if size < 16 else f"11110100{size:08b}"
            else:
                head = f"100{size:04b}{number:b}" if size < 16 else f"11110101{size:07b}{number:b}"
            expected = head + bits(packet.data)
        case FromFirst() | HeldFirst():
            code = "0110" if isinstance(packet, FromFirst) else "0111"
            expected = f"{code}{packet.map:04b}{packet.index:08b}"
        case FromEarly() | HeldEarly():
            code = "0100" if isinstance(packet, FromEarly) else "0101"
            expected = f"{code}{packet.map:08b}{packet.index:012b}"
        case From() | Held():
            expected = f"1111011{packet.code[-1]}{packet.map:08b}{packet.index:024b}"
        case Near() | Gone():
            expected = f"{'11111001' if isinstance(packet, Near) else '11111110'}{packet.robot:08b}"
        case Check():
            expected = f"11111010{packet.sum:016b}"
        case LogDigest():
            expected = f"11111100{packet.entries:016b}{packet.complete:b}{packet.salt:07b}{packet.hash:016b}"
    return expected


@pytest.mark.parametrize("kind", LIMITS, ids=lambda kind: kind.__name__)
def test_packet_sizes_are_those_of_table_6_1(kind: type[Packet]) -> None:
    packet = kind(*(low for low, _ in LIMITS[kind].values()))
    longer = {
        Pose: 4,
        Passed: 6,
        From: 5,
        FromEarly: 3,
        FromFirst: 2,
        Held: 5,
        HeldEarly: 3,
        HeldFirst: 2,
        Check: 3,
        LogDigest: 6,
    }
    assert len(encode([packet])) == kind.size == (longer[kind] if kind in longer else SIZES[kind.name])


def test_kinds_are_the_nine_of_table_6_1_and_scans_poses_updates_and_checksums() -> None:
    assert set(KINDS) == set(SIZES)
    assert (*KINDS, "scan", "pose", "update", "sum") == ALL_KINDS


@pytest.mark.parametrize(("size", "on_air"), [(1, 3), (62, 64), (63, 64)])
def test_a_fragment_is_at_most_64_bytes(size: int, on_air: int) -> None:
    assert len(encode([Fragment(bytes(size))])) == on_air <= 64


@pytest.mark.parametrize("kind", LIMITS, ids=lambda kind: kind.__name__)
def test_each_field_is_read_back_at_its_limits(kind: type[Packet]) -> None:
    for name, limits in LIMITS[kind].items():
        for value in limits:
            packet = kind(**({other: low for other, (low, _) in LIMITS[kind].items()} | {name: value}))
            assert decode(encode([packet])) == [packet]


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        pytest.param(kind, name, value, id=f"{kind.__name__}.{name}={value}")
        for kind, ranges in LIMITS.items()
        for name, (low, high) in ranges.items()
        for value in (low - 1, high + 1)
    ],
)
def test_a_field_out_of_range_is_rejected_with_its_name_and_offset(
    kind: type[Packet], field: str, value: int
) -> None:
    packet = kind(**({name: low for name, (low, _) in LIMITS[kind].items()} | {field: value}))
    low, high = LIMITS[kind][field]
    with pytest.raises(ProtocolError) as caught:
        encode([Save(), Target(1, 2), packet])
    assert caught.value.packet == kind.name
    assert caught.value.offset == 4
    assert caught.value.reason == f"{field} {value} is outside {low} to {high}"
    assert kind.name in str(caught.value)
    assert "byte 4" in str(caught.value)


@pytest.mark.parametrize("size", [0, 64])
def test_an_empty_or_too_long_fragment_is_rejected(size: int) -> None:
    with pytest.raises(ProtocolError, match=r"scan at byte 1: .*1 to 63"):
        encode([Save(), Fragment(bytes(size))])


def test_vertices_reach_the_border_of_the_largest_grid() -> None:
    packet = Insert(4095, -1, 2048, 3, 1)
    assert decode(encode([packet])) == [packet]


@given(streams)
def test_decoding_inverts_encoding(stream: list[AnyPacket]) -> None:
    assert decode(encode(stream)) == stream


@given(streams)
def test_every_bit_is_where_the_documented_layout_has_it(stream: list[AnyPacket]) -> None:
    assert bits(encode(stream)) == "".join(map(documented_bits, stream))


def test_packets_have_the_bytes_of_the_golden_file() -> None:
    lines = [line for line in GOLDEN.read_text().splitlines() if not line.startswith("#")]
    assert lines == [f"{encode([packet]).hex(' ')}  {packet!r}" for packet in EXAMPLES]
    assert {type(packet) for packet in EXAMPLES} == {*LIMITS, Fragment, Update}


@given(streams, st.integers(0, 100))
def test_packets_are_read_one_by_one_up_to_an_incomplete_one(stream: list[AnyPacket], end: int) -> None:
    buffer = encode(stream)[:end]
    received: list[AnyPacket] = []
    while (packet := packet_at(buffer, len(encode(received)))) is not None:
        received.append(packet)
    assert received == stream[: len(received)]
    rest = stream[len(received) :]
    assert (not rest) or len(encode([*received, rest[0]])) > end


@given(st.binary(max_size=200))
@example(b"\xf2")
@example(b"\xf2\x00")
@example(b"\xf2\x3f" + bytes(63))
@example(b"\xfc\x01")
@example(b"\xf8\x40")
def test_random_bytes_are_packets_or_a_protocol_error(noise: bytes) -> None:
    try:
        received = decode(noise)
    except ProtocolError as error:
        assert 0 <= error.offset <= len(noise)
        assert error.reason
    else:
        assert encode(received) == noise


@pytest.mark.parametrize("packet", EXAMPLES, ids=repr)
def test_a_packet_with_a_spare_bit_set_is_rejected(packet: AnyPacket) -> None:
    buffer = encode([packet])
    layouts = [layout for layout in LAYOUTS if layout.packet == type(packet).__name__]
    (spare,) = {layout.spare for layout in layouts}
    for bit in range(spare):
        broken = int.from_bytes(buffer, "big") | 1 << bit
        with pytest.raises(ProtocolError, match=rf"^{packet.name} at byte 1: .*must be zero"):
            decode(encode([Save()]) + broken.to_bytes(packet.size, "big"))


@pytest.mark.parametrize("packet", EXAMPLES, ids=repr)
def test_the_error_of_a_cut_packet_has_the_missing_bytes(packet: AnyPacket) -> None:
    buffer = encode([packet])
    for have in range(1, len(buffer)):
        with pytest.raises(ProtocolError) as caught:
            decode(encode([Save()]) + buffer[:have])
        assert caught.value.packet == packet.name
        assert caught.value.offset == 1
        assert f"cut off after {have} of" in caught.value.reason


@pytest.mark.parametrize("size", [0, 63, 255])
def test_a_short_fragment_with_an_invalid_length_is_rejected_at_once(size: int) -> None:
    with pytest.raises(ProtocolError, match=r"scan at byte 0: .*1 to 62"):
        length(bytes([0xF2, size]))
    with pytest.raises(ProtocolError, match=r"scan at byte 0: .*1 to 62"):
        packet_at(bytes([0xF2, size]), 0)


def test_the_error_of_an_unknown_code_names_it() -> None:
    with pytest.raises(ProtocolError, match="packet at byte 3: no packet begins with 0xffff"):
        decode(encode([Target(1, 1)]) + BROKEN)


def test_no_code_is_a_prefix_of_another() -> None:
    codes = [layout.code for layout in LAYOUTS]
    assert not [(a, b) for a in codes for b in codes if a != b and b.startswith(a)]
    assert len(set(codes)) == len(codes)


def test_every_field_has_the_range_of_its_bits() -> None:
    for kind, limits in LIMITS.items():
        assert list(kind.__struct_fields__) == list(limits)
        (layout,) = [layout for layout in LAYOUTS if layout.packet == kind.__name__]
        for name, shift, mask, bias in layout.places:
            assert shift >= 0
            assert (-bias, mask - bias) == limits[name]


@given(streams)
def test_packets_before_a_malformed_one_are_read(stream: list[AnyPacket]) -> None:
    buffer, offset = encode(stream) + BROKEN, 0
    for packet in stream:
        assert packet_at(buffer, offset) == packet
        offset += length(buffer, offset)
    with pytest.raises(ProtocolError, match=f"at byte {len(encode(stream))}:"):
        packet_at(buffer, offset)
    with pytest.raises(ProtocolError, match=f"at byte {len(encode(stream))}:"):
        decode(buffer)


@given(streams.filter(bool), st.integers(1, 70))
def test_a_packet_that_is_cut_off_is_not_read(stream: list[AnyPacket], missing: int) -> None:
    last = encode(stream[-1:])
    assert packet_at(last, 0) == stream[-1]
    assert packet_at(last, len(last)) is None
    assert len(last) <= missing or packet_at(last[: len(last) - missing], 0) is None


def test_a_long_stream_is_read_in_linear_time() -> None:
    stream = 300_000 * encode([Save()])
    began = time.process_time()
    assert len(decode(stream)) == len(stream)
    assert time.process_time() - began < 5, "a copy of the rest for each packet would take minutes"


def test_limits_of_grids_and_teams_fit_the_layouts() -> None:
    assert packets.MAX_VERTICES >= 4096
    assert packets.MAX_OBJECTS >= 4096
    assert LIMITS[Target]["x"][1] + 1 >= 2048
    assert LIMITS[Offer]["map"][1] + 1 >= 64


def test_a_handshake_is_decoded_unless_it_is_too_long() -> None:
    for stream in ([Answer(7)], [Block(3), Answer(4095)], [Block(1), Block(2), Answer(3)], [Block(DECLINED)]):
        assert list(handshake(encode(stream))) == stream
    with pytest.raises(ProtocolError, match="conn at byte 0: 8 bytes instead of 6"):
        handshake(encode([Block(1), Block(2), Block(2), Answer(3)]))
    with pytest.raises(ProtocolError, match="cut off"):
        handshake(encode([Answer(7)])[:1])


@given(st.lists(updates))
def test_a_frame_of_one_kind_is_decoded(frame: list[Update]) -> None:
    assert decode_kind(encode(frame), Update) == frame


@pytest.mark.parametrize(
    "packet", [encode([Save()]), encode([Near(3)]), b"\xff", b"\xf4\x10short", b"\x88abc", b"\xa8short"]
)
def test_bytes_that_are_no_whole_packets_of_this_kind_are_rejected(packet: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_kind(encode([Update(None, bytes(UPDATE_PART))]) + packet, Update)


@pytest.mark.parametrize(
    "packet",
    [
        Update(None, bytes(UPDATE_PART - 1)),
        Update(None, bytes(UPDATE_DATA + 1)),
        Update(0, bytes(UPDATE_DATA + 1)),
        Update(UPDATE_NUMBERS, b""),
        Update(-1, b""),
        Update(UPDATE_NUMBERS, bytes(20)),
    ],
    ids=repr,
)
def test_an_update_with_an_unknown_layout_is_rejected(packet: Update) -> None:
    with pytest.raises(ProtocolError, match=r"update at byte 1: "):
        encode([Save(), packet])
