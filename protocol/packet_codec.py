"""Write and read the packets of the radio (`protocol.packets`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, TypeVar, cast, get_args

from protocol.errors import ProtocolError
from protocol.packet_layout import Layout
from protocol.packets import (
    ALL_KINDS,
    DECLINED,
    FRAGMENT_DATA,
    HANDSHAKE_SIZE,
    LAYOUTS,
    LONG_UPDATE_DATA,
    SHORT_HEAD,
    UPDATE_DATA,
    UPDATE_NUMBERS,
    AnyPacket,
    Block,
    Fragment,
    Offer,
    Packet,
    Pose,
    Target,
    Update,
)

KindOfPacket = TypeVar("KindOfPacket", bound=Packet)

_PACKETS: dict[str, type[Packet]] = {kind.__name__: kind for kind in get_args(AnyPacket)}

_BY_FIRST_BYTE = [
    next((layout for layout in LAYOUTS if layout.starts_with(byte)), None) for byte in range(256)
]
_LAYOUT = {_PACKETS[layout.packet]: layout for layout in LAYOUTS if layout.content is None}
_FORM = {kind: (*layout.fixed, layout.places) for kind, layout in _LAYOUT.items()}
"""For each packet without content: mask and value of its fixed bits, and the places of its fields."""
_CLASS: list[Any] = [None if layout is None else _PACKETS[layout.packet] for layout in _BY_FIRST_BYTE]
"""For each first byte the class of the packet; None: no packet starts with it."""

_WITH_LENGTH = {layout.packet: int(layout.code, 2) for layout in LAYOUTS if layout.has_length}
"""First byte of the layout with a length field, by the name of the packet."""
_FULL, _SHORT = int(Fragment.code, 2), _WITH_LENGTH[Fragment.__name__]
_UPDATE, _LONG = int(Update.code, 2), _WITH_LENGTH[Update.__name__]


def _index_row(layout: Layout | None) -> tuple[int, ...]:
    if layout is None:
        return (-1, 0, 0, 0, 0, 0, 0)
    size, shift = (0, layout.places[0][1]) if layout.has_length else (layout.size, 0)
    fixed, content = (layout.fixed, (0, 0)) if layout.content is None else ((0, 0), layout.content)
    return (ALL_KINDS.index(layout.kind), size, *fixed, shift, *content)


LAYOUT_BY_BYTE = [_index_row(layout) for layout in _BY_FIRST_BYTE]
"""For each first byte: number of the kind in `ALL_KINDS` (-1: no packet); bytes of the packet (0: it has a length
field); mask of the bits that are equal in all such packets, and their value; shift of the length within the second
byte, and the least and the most bytes of content (`protocol.packet_index`)."""
_SIZE = [row[1] for row in LAYOUT_BY_BYTE]
"""For each first byte the bytes of the packet; 0: the second byte has its length, or there is no such packet."""


def encode(packets: Iterable[Packet]) -> bytes:
    """Write packets one after the other; ProtocolError if the value of a field does not fit its bits."""
    out = bytearray()
    for packet in packets:
        if isinstance(packet, Fragment):
            out += _write_fragment(packet, len(out))
            continue
        if isinstance(packet, Update):
            out += _write_update(packet, len(out))
            continue
        _, number, places = _FORM[type(packet)]
        for name, shift, mask, bias in places:
            value = getattr(packet, name) + bias
            if not 0 <= value <= mask:
                reason = f"{name} {value - bias} is outside {-bias} to {mask - bias}"
                raise ProtocolError(packet.name, len(out), reason)
            number |= value << shift
        out += number.to_bytes(packet.size, "big")
    return bytes(out)


def _write_fragment(packet: Fragment, offset: int) -> bytes:
    size = len(packet.data)
    if not 1 <= size <= FRAGMENT_DATA:
        raise ProtocolError(packet.name, offset, f"{size} bytes of content are outside 1 to {FRAGMENT_DATA}")
    head = bytes([_FULL]) if size == FRAGMENT_DATA else bytes([_SHORT, size])
    return head + packet.data


def _write_update(packet: Update, offset: int) -> bytes:
    size, number, more = len(packet.data), packet.number, packet.more
    if number is None:
        if size != UPDATE_DATA:
            reason = f"{size} bytes of content instead of {UPDATE_DATA}"
            raise ProtocolError(packet.name, offset, reason)
        return bytes([_UPDATE]) + packet.data
    if size > LONG_UPDATE_DATA or not (0 <= number < UPDATE_NUMBERS and 0 <= more <= 1):
        limits = f"0 to {UPDATE_NUMBERS - 1}, 0 to {LONG_UPDATE_DATA} or 0 to 1"
        reason = f"number {number}, size {size} or flag {more} is outside {limits}"
        raise ProtocolError(packet.name, offset, reason)
    return bytes([_LONG, size << 2 | number << 1 | more]) + packet.data


def length(buffer: bytes, offset: int = 0) -> int:
    """Return the bytes of the packet that starts at `offset`.

    Raises ProtocolError if no packet starts with that byte, or its length field is out of range.
    """
    layout = _layout(buffer, offset)
    if not layout.has_length or layout.content is None:
        return layout.size
    if offset + 1 == len(buffer):
        return SHORT_HEAD
    least, most = layout.content
    size = buffer[offset + 1] >> layout.places[0][1]
    if not least <= size <= most:
        raise ProtocolError(layout.kind, offset, f"{size} bytes of content are outside {least} to {most}")
    return SHORT_HEAD + size


def name(buffer: bytes, offset: int = 0) -> str:
    """Return the kind of the packet that starts at `offset`."""
    return _layout(buffer, offset).kind


def _layout(buffer: bytes, offset: int) -> Layout:
    layout = _BY_FIRST_BYTE[buffer[offset]]
    if layout is None:
        raise ProtocolError("packet", offset, f"no packet begins with {buffer[offset]:#04x}")
    return layout


def decode(buffer: bytes, offset: int = 0) -> list[AnyPacket]:
    """Read whole packets from `offset` on; ProtocolError if a packet is unknown or cut off, or has a spare bit set."""
    packets = []
    while offset < len(buffer):
        size = _SIZE[buffer[offset]] or length(buffer, offset)
        if offset + size > len(buffer):
            reason = f"cut off after {len(buffer) - offset} of {size} bytes"
            raise ProtocolError(name(buffer, offset), offset, reason)
        packets.append(_read(buffer, offset, size))
        offset += size
    return packets


def decode_kind(frame: bytes, kind: type[KindOfPacket]) -> list[KindOfPacket]:
    """Read a frame as `decode` does; ProtocolError also if it contains a packet of another class than `kind`."""
    packets = decode(frame)
    for packet in packets:
        if not isinstance(packet, kind):
            raise ProtocolError(packet.name, 0, f"expected a packet of kind {kind.name}")
    return cast("list[KindOfPacket]", packets)


def packet_at(buffer: bytes, offset: int) -> AnyPacket | None:
    """Read the packet that starts at `offset`; None if it is incomplete, ProtocolError if it is malformed."""
    if offset == len(buffer):
        return None
    size = length(buffer, offset)
    return _read(buffer, offset, size) if offset + size <= len(buffer) else None


def handshake(frame: bytes) -> list[AnyPacket]:
    """Read a frame of `conn` packets; ProtocolError as `decode`, or if it is longer than any handshake."""
    if len(frame) > HANDSHAKE_SIZE:
        raise ProtocolError(Offer.name, 0, f"{len(frame)} bytes instead of {HANDSHAKE_SIZE} at most")
    return decode(frame)


def broadcast(frame: bytes) -> Sequence[AnyPacket]:
    """Read a frame with many receivers, as `decode` does; cached, unless poses of other robots make it longer."""
    return _decode_cached(frame) if len(frame) <= Pose.size + Target.size else decode(frame)


@lru_cache(maxsize=1 << 14)
def _decode_cached(frame: bytes) -> tuple[AnyPacket, ...]:
    return tuple(decode(frame))


def _read(buffer: bytes, offset: int, size: int) -> AnyPacket:
    """Read the whole packet of `size` bytes that starts at `offset`."""
    first, packet = buffer[offset], buffer[offset : offset + size]
    kind = _CLASS[first]
    if kind is Fragment:
        return Fragment(packet[1 if first == _FULL else SHORT_HEAD :])
    if kind is Update and first == _UPDATE:
        return Update(None, packet[1:])
    if kind is Update:
        return Update(packet[1] >> 1 & 1, packet[SHORT_HEAD:], packet[1] & 1)
    fixed_mask, fixed, places = _FORM[kind]
    number = int.from_bytes(packet, "big")
    if number & fixed_mask != fixed:
        raise _malformed(_LAYOUT[kind], number, offset)
    read: AnyPacket = kind(*[(number >> shift & mask) - bias for _, shift, mask, bias in places])
    return read


def _malformed(layout: Layout, number: int, offset: int) -> ProtocolError:
    """Return the error of a packet, read as one number, whose code or spare bits are wrong."""
    mask, fixed = layout.fixed
    if (number & mask ^ fixed) >> layout.spare:
        begin = number >> 8 * layout.size - 16
        return ProtocolError("packet", offset, f"no packet begins with {begin:#06x}")
    return ProtocolError(layout.kind, offset, f"the last {layout.spare} bits must be zero")


DECLINE = encode([Block(DECLINED)])
"""The answer that declines an offer."""
