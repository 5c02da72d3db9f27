"""Encode and decode the packets of the radio (`protocol.packets`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import TypeVar, cast, get_args

from protocol.errors import ProtocolError
from protocol.packet_layout import LENGTH, Layout
from protocol.packets import (
    ALL_KINDS,
    DECLINED,
    HANDSHAKE_SIZE,
    LAYOUT_OF,
    LAYOUTS,
    LENGTH_HEAD,
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

_PACKETS: dict[str, Callable[..., AnyPacket]] = {kind.__name__: kind for kind in get_args(AnyPacket)}

_BY_FIRST_BYTE = [
    next((layout for layout in LAYOUTS if layout.starts_with(byte)), None) for byte in range(256)
]
_WITH_CONTENT = {
    kind: [layout for layout in LAYOUTS if layout.packet == kind.__name__] for kind in (Fragment, Update)
}


def _index_row(first: int) -> tuple[int, ...]:
    layout = _BY_FIRST_BYTE[first]
    if layout is None:
        return (-1, 0, 0, 0, 0, 0, 0)
    kind = ALL_KINDS.index(layout.kind)
    if layout.content is None:
        return (kind, layout.size, *layout.fixed, 0, 0, 0)
    least, most = layout.content
    if not layout.has_length:
        return (kind, layout.size + most, 0, 0, 0, 0, 0)
    _, shift, mask, bias = layout.places[0]
    if layout.size == 1:
        return (kind, layout.size + (first >> shift & mask) - bias, 0, 0, 0, 0, 0)
    return (kind, 0, 0, 0, shift, least, most)


LAYOUT_BY_BYTE = [_index_row(first) for first in range(256)]
"""For each first byte: number of the kind in `ALL_KINDS` (-1: no packet); bytes of the packet (0: the second byte gives
its length); mask of the bits that are equal in all such packets, and their value; shift of the length within the second
byte, and the least and the most bytes of content (`protocol.packet_index`)."""
_SIZE = [row[1] for row in LAYOUT_BY_BYTE]
"""For each first byte the bytes of the packet; 0: the second byte has its length, or there is no such packet."""


def encode(packets: Iterable[Packet]) -> bytes:
    """Write packets one after the other; ProtocolError if the value of a field does not fit its bits."""
    out = bytearray()
    for packet in packets:
        content, layout = b"", LAYOUT_OF.get(type(packet))
        if layout is None:
            assert isinstance(packet, Fragment | Update)
            content, layout = packet.data, _layout_for(packet, len(out))
        number = layout.fixed[1]
        for name, shift, mask, bias in layout.places:
            value = (len(content) if name == LENGTH else getattr(packet, name)) + bias
            if not 0 <= value <= mask:
                reason = f"{name} {value - bias} is outside {-bias} to {mask - bias}"
                raise ProtocolError(packet.name, len(out), reason)
            number |= value << shift
        out += number.to_bytes(layout.size, "big")
        out += content
    return bytes(out)


def _layout_for(packet: Fragment | Update, offset: int) -> Layout:
    """Return the layout that has the packet's fields and length."""
    numbered = isinstance(packet, Update) and packet.number is not None
    sizes: list[int] = []
    for layout in _WITH_CONTENT[type(packet)]:
        if layout.content is None or ("number" in dict(layout.fields)) != numbered:
            continue
        least, most = layout.content
        if least <= len(packet.data) <= most:
            return layout
        sizes += layout.content
    reason = f"{len(packet.data)} bytes of content are outside {min(sizes)} to {max(sizes)}"
    raise ProtocolError(packet.name, offset, reason)


def length(buffer: bytes, offset: int = 0) -> int:
    """Return the bytes of the packet that starts at `offset`.

    Raises ProtocolError if no packet starts with that byte, or its length field is out of range.
    """
    layout = _layout(buffer, offset)
    if size := _SIZE[buffer[offset]]:
        return size
    if offset + 1 == len(buffer):
        return LENGTH_HEAD
    assert layout.content is not None
    least, most = layout.content
    size = buffer[offset + 1] >> layout.places[0][1]
    if not least <= size <= most:
        raise ProtocolError(layout.kind, offset, f"{size} bytes of content are outside {least} to {most}")
    return LENGTH_HEAD + size


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
    packet = buffer[offset : offset + size]
    layout = _layout(buffer, offset)
    if layout.content is not None:
        return _read_with_content(layout, packet)
    (mask, fixed), number = layout.fixed, int.from_bytes(packet, "big")
    if number & mask != fixed:
        raise _malformed(layout, number, offset)
    return _PACKETS[layout.packet](
        *[(number >> shift & mask) - bias for _, shift, mask, bias in layout.places]
    )


def _read_with_content(layout: Layout, packet: bytes) -> Fragment | Update:
    """Read a whole packet that has content."""
    head, data = int.from_bytes(packet[: layout.size], "big"), packet[layout.size :]
    if layout.packet == Fragment.__name__:
        return Fragment(data)
    numbers = [head >> shift & mask for name, shift, mask, _ in layout.places if name == "number"]
    return Update(numbers[0] if numbers else None, data)


def _malformed(layout: Layout, number: int, offset: int) -> ProtocolError:
    """Return the error of a packet, read as one number, whose code or spare bits are wrong."""
    mask, fixed = layout.fixed
    if (number & mask ^ fixed) >> layout.spare:
        begin = number >> 8 * layout.size - 16
        return ProtocolError("packet", offset, f"no packet begins with {begin:#06x}")
    return ProtocolError(layout.kind, offset, f"the last {layout.spare} bits must be zero")


DECLINE = encode([Block(DECLINED)])
"""The answer that declines an offer."""
