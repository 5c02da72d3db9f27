"""The packets of the radio, bit for bit (thesis, Table 6.1; docs/protocol.md draws them).

Every packet opens with a code that no other begins with; fields follow, most significant bit first; what is
left of the last byte is zero. The code alone tells a packet's length, so packets need no framing: a stream
of them may be cut anywhere and taken up again (`Decoder`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import ClassVar

from protocol.errors import ProtocolError

MAX_VERTICES = 4096
"""Vertices an object may have; `Insert`, `Replace` and `Delete` count them from 0."""

MAX_OBJECTS = 4096
"""Objects an approximation may have."""

GOSSIP_WINDOW = 1 << 24
"""Units of a log that `From` and `Held` can tell apart."""
EARLY = 1 << 8
"""The first units of a log, of which `FromEarly` and `HeldEarly` speak."""
MAX_GOSSIP_MAPS = 1 << 8
"""Maps that gossip can name."""

INDEX_WINDOW = 4096
"""Units of a log that one `Answer` can tell apart; the block says which window is meant."""

MAX_MAPS = 64
"""Robots whose maps an `Offer` can tell apart: the largest team that exchanges maps by packets."""

BLOCKS = 64
"""Blocks that an `Offer` can tell apart; in a longer log they begin again at block 0, in the next round."""


@dataclass(frozen=True, slots=True)
class Packet:
    """What all packets share: a code, and fields in the order in which they are sent."""

    name: ClassVar[str]
    size: ClassVar[int]
    """Bytes on the air (Table 6.1)."""
    code: ClassVar[int]
    code_bits: ClassVar[int]
    bits: ClassVar[tuple[int, ...]]
    """Width of each field, in bits, in the order of the dataclass."""


@dataclass(frozen=True, slots=True)
class Insert(Packet):
    """A vertex enters the current object before the one that has `index` now.

    The vertex is the contour point of cell (x, y) on its side `side` (`agent.outline.contour`); cells run from -1,
    the unknown rim around the grid. `occupied` speaks of the edge from this vertex to the next.
    """

    name, size, code, code_bits, bits = "ins", 6, 0b010, 3, (12, 12, 12, 2, 1)
    index: int
    x: int
    y: int
    side: int
    occupied: int


@dataclass(frozen=True, slots=True)
class Replace(Packet):
    """The vertex at `index` of the current object becomes another."""

    name, size, code, code_bits, bits = "rep", 6, 0b011, 3, (12, 12, 12, 2, 1)
    index: int
    x: int
    y: int
    side: int
    occupied: int


@dataclass(frozen=True, slots=True)
class Delete(Packet):
    """The vertex at `index` of the current object goes."""

    name, size, code, code_bits, bits = "del", 2, 0b100, 3, (12,)
    index: int


@dataclass(frozen=True, slots=True)
class Emerge(Packet):
    """A new object takes the free number `object`; `count` inserts follow.

    `inside`: it encloses the free space.
    """

    name, size, code, code_bits, bits = "em", 5, 0b1101, 4, (12, 13, 1)
    object: int
    count: int
    inside: int


@dataclass(frozen=True, slots=True)
class Change(Packet):
    """The vertex packets that follow speak of `object`, which will have `count` vertices after them."""

    name, size, code, code_bits, bits = "chg", 5, 0b1110, 4, (12, 13, 1)
    object: int
    count: int
    inside: int


@dataclass(frozen=True, slots=True)
class Remove(Packet):
    """`object` is gone; its number may be given again."""

    name, size, code, code_bits, bits = "rm", 2, 0b1010, 4, (12,)
    object: int


@dataclass(frozen=True, slots=True)
class Offer(Packet):
    """Handshake: the sender has news of robot `map`, from `block` of its log on."""

    name, size, code, code_bits, bits = "conn", 2, 0b1100, 4, (6, 6)
    map: int
    block: int


@dataclass(frozen=True, slots=True)
class Answer(Packet):
    """Handshake: the receiver holds the units before `index` (within the block) of the map offered."""

    name, size, code, code_bits, bits = "conn", 2, 0b1011, 4, (12,)
    index: int


@dataclass(frozen=True, slots=True)
class Block(Packet):
    """Handshake: the answer that follows counts from `block`, not from the one that the offer assumed.

    Before another block it counts rounds of `BLOCKS` blocks.
    """

    name, size, code, code_bits, bits = "conn", 2, 0b1111100000, 10, (6,)
    block: int


@dataclass(frozen=True, slots=True)
class Decline(Packet):
    """Handshake: nothing is wanted, for another robot is sending this map in the same exchange."""

    name, size, code, code_bits, bits = "conn", 2, 0b1111110000000000, 16, ()


@dataclass(frozen=True, slots=True)
class From(Packet):
    """Gossip: what follows are units of robot `map`'s log, the first of them number `index`, modulo `GOSSIP_WINDOW`."""

    name, size, code, code_bits, bits = "conn", 5, 0xF6, 8, (8, 24)
    map: int
    index: int


@dataclass(frozen=True, slots=True)
class FromEarly(Packet):
    """Gossip: as `From`, with one of the first `EARLY` units."""

    name, size, code, code_bits, bits = "conn", 3, 0xFB, 8, (8, 8)
    map: int
    index: int


@dataclass(frozen=True, slots=True)
class Held(Packet):
    """Gossip: the sender holds `index` units of robot `map`'s log, modulo `GOSSIP_WINDOW`."""

    name, size, code, code_bits, bits = "conn", 5, 0xF7, 8, (8, 24)
    map: int
    index: int


@dataclass(frozen=True, slots=True)
class HeldEarly(Packet):
    """Gossip: as `Held`, where they are fewer than `EARLY`."""

    name, size, code, code_bits, bits = "conn", 3, 0xFD, 8, (8, 8)
    map: int
    index: int


@dataclass(frozen=True, slots=True)
class Near(Packet):
    """Gossip: `robot` has come into the sender's range."""

    name, size, code, code_bits, bits = "conn", 2, 0xF9, 8, (8,)
    robot: int


@dataclass(frozen=True, slots=True)
class Gone(Packet):
    """Gossip: `robot` has left the sender's range."""

    name, size, code, code_bits, bits = "conn", 2, 0xFE, 8, (8,)
    robot: int


@dataclass(frozen=True, slots=True)
class Check(Packet):
    """The checksum at the end of a frame, over all before it; put there by radios whose frames can be damaged."""

    name, size, code, code_bits, bits = "sum", 3, 0xFA, 8, (16,)
    sum: int


@dataclass(frozen=True, slots=True)
class Target(Packet):
    """Broadcast: the sender moves to cell (x, y) next."""

    name, size, code, code_bits, bits = "targ", 3, 0b00, 2, (11, 11)
    x: int
    y: int


@dataclass(frozen=True, slots=True)
class Pose(Packet):
    """Broadcast: the sender is in cell (x, y), and leads if `leads` is 1.

    It is not in Table 6.1: strategies need it whose robots assign targets together, or follow leaders.
    """

    name, size, code, code_bits, bits = "pose", 4, 0xF3, 8, (11, 11, 1)
    x: int
    y: int
    leads: int


@dataclass(frozen=True, slots=True)
class Passed(Packet):
    """Broadcast: `robot` was in cell (x, y) `age` steps ago; a `Target` behind it is that robot's.

    Its own words, passed on to those who do not hear it (`agent.strategies.relayed_state`).
    """

    name, size, code, code_bits, bits = "pose", 6, 0xFF0, 12, (8, 6, 11, 11)
    robot: int
    age: int
    x: int
    y: int


@dataclass(frozen=True, slots=True)
class Save(Packet):
    """A step's edits are complete: what was said up to here may be drawn."""

    name, size, code, code_bits, bits = "save", 1, 0b11110000, 8, ()


@dataclass(frozen=True, slots=True)
class Fragment(Packet):
    """A piece of a raw scan (`protocol.scans`), at most `FRAGMENT_DATA` bytes; a full one needs no length."""

    name, size, code, code_bits, bits = "scan", 64, 0xF1, 8, ()
    data: bytes


@dataclass(frozen=True, slots=True)
class Update(Packet):
    """A piece of a unit of the predictive exchange (`agent.predictive`).

    Pieces of `UPDATE_DATA` bytes, which need no length, and then one that ends the unit: up to `LAST_UPDATE_DATA` bytes,
    and the number of the unit in its maker's stream, modulo `UPDATE_NUMBERS`. `number` is None where it is not the last.
    """

    name, size, code, code_bits, bits = "look", 9, 0xF4, 8, ()
    number: int | None
    data: bytes


SHORT_HEAD = 2
"""Bytes before the content of packets that say how long they are."""

FRAGMENT_DATA = Fragment.size - 1
"""Bytes of content in a full fragment."""
_FULL, _SHORT = 0xF1, 0xF2

UPDATE_DATA = Update.size - 1
"""Bytes of content in a piece of a unit behind which there are more."""
LAST_UPDATE_DATA = 63
"""Bytes of content in the last piece, at most."""
UPDATE_NUMBERS = 4
"""Units that the last piece can tell apart."""
_UPDATE, _LAST_UPDATE = 0xF4, 0xF5

Edit = Insert | Replace | Delete | Emerge | Change | Remove | Save
Handshake = Offer | Answer | Block | Decline
Gossip = From | FromEarly | Held | HeldEarly | Near | Gone
AnyPacket = Edit | Handshake | Gossip | Check | Target | Pose | Passed | Fragment | Update

_TYPES: tuple[type[Packet], ...] = (
    Insert, Replace, Delete, Emerge, Change, Remove, Offer, Answer, Block, Decline, Target, Save, Pose,
    From, FromEarly, Held, HeldEarly, Near, Gone, Check, Passed,
)  # fmt: skip

HANDSHAKE_SIZE = 3 * Answer.size
"""Bytes of the longest frame of a handshake: two blocks and an answer."""

KINDS = ("ins", "rep", "del", "em", "chg", "rm", "conn", "targ", "save")
"""The nine kinds of Table 6.1."""

ALL_KINDS = (*KINDS, Fragment.name, Pose.name, Update.name, Check.name)
"""All kinds that may be on the air, in the order of reports."""

_RIM = 1
"""Vertex cells are sent with this added, for the rim of the grid lies at -1."""


def _by_first_byte() -> list[type[Packet] | None]:
    """For each possible first byte, the packet that begins with it."""
    table: list[type[Packet] | None] = []
    for byte in range(256):
        fits = [kind for kind in _TYPES if byte >> max(8 - kind.code_bits, 0) == _first_bits(kind)]
        table.append(fits[0] if fits else None)
    table[_FULL] = table[_SHORT] = Fragment
    table[_UPDATE] = table[_LAST_UPDATE] = Update
    return table


def _first_bits(kind: type[Packet]) -> int:
    """Return as much of a packet's code as lies in its first byte."""
    return kind.code >> max(kind.code_bits - 8, 0)


def _fixed(kind: type[Packet]) -> tuple[int, int]:
    """Return what is the same in all packets of a kind, its code and the zeros at its end: (mask, bits)."""
    behind = 8 * kind.size - kind.code_bits
    code_mask = (1 << kind.code_bits) - 1 << behind
    return code_mask | (1 << behind - sum(kind.bits)) - 1, kind.code << behind


def _layout(kind: type[Packet]) -> tuple[tuple[str, int, int, int], ...]:
    """Return of each field its name, how far it is shifted up, its mask, and what is added before it is sent."""
    end = 8 * kind.size - kind.code_bits
    layout = []
    for field, width in zip(fields(kind), kind.bits, strict=True):
        end -= width
        rim = _RIM if field.name in "xy" and kind not in (Target, Pose, Passed) else 0
        layout.append((field.name, end, (1 << width) - 1, rim))
    return tuple(layout)


_FIRST_BYTE = _by_first_byte()
_SIZE = [
    0 if kind is None or byte in (_SHORT, _LAST_UPDATE) else kind.size
    for byte, kind in enumerate(_FIRST_BYTE)
]
"""For each possible first byte the size of the packet, 0 where it does not tell."""
_FIXED = {kind: _fixed(kind) for kind in _TYPES}
_LAYOUT = {kind: _layout(kind) for kind in _TYPES}

LAYOUT_BY_BYTE = [
    (ALL_KINDS.index(kind.name) if kind else -1, size, *(_FIXED.get(kind, (0, 0)) if kind else (0, 0)))
    for kind, size in zip(_FIRST_BYTE, _SIZE, strict=True)
]
"""For each possible first byte the number of the packet's kind (-1: none), its size (0: the next byte tells, for a
scan or a look as in `length`), which of its bits are the same in all such packets, and what they are
(`protocol.packet_index`)."""


def encode(packets: Iterable[Packet]) -> bytes:
    """Write packets behind each other.

    Raises
    ------
    ProtocolError
        A field does not fit its bits.
    """
    out = bytearray()
    for packet in packets:
        if isinstance(packet, Fragment):
            out += _write_fragment(packet, len(out))
            continue
        if isinstance(packet, Update):
            out += _write_update(packet, len(out))
            continue
        kind = type(packet)
        word = _FIXED[kind][1]
        for name, shift, mask, rim in _LAYOUT[kind]:
            value = getattr(packet, name) + rim
            if not 0 <= value <= mask:
                reason = f"{name} {value - rim} is outside {-rim} to {mask - rim}"
                raise ProtocolError(packet.name, len(out), reason)
            word |= value << shift
        out += word.to_bytes(packet.size, "big")
    return bytes(out)


def length(buffer: bytes, offset: int = 0) -> int:
    """Return the length of the packet that begins at `offset`, in bytes.

    Raises
    ------
    ProtocolError
        No packet begins like this.
    """
    kind = _kind(buffer, offset)
    if buffer[offset] not in (_SHORT, _LAST_UPDATE):
        return kind.size
    if offset + 1 == len(buffer):
        return 2
    if kind is Update:
        return 2 + (buffer[offset + 1] >> 2)
    size = buffer[offset + 1]
    if not 1 <= size < FRAGMENT_DATA:
        reason = f"a short fragment of {size} bytes is outside 1 to {FRAGMENT_DATA - 1}"
        raise ProtocolError(kind.name, offset, reason)
    return 2 + size


def name(buffer: bytes, offset: int = 0) -> str:
    """Return the kind, as Table 6.1 names it, of the packet that begins at `offset`."""
    return _kind(buffer, offset).name


def content(packet: bytes) -> bytes:
    """Return what one fragment of a scan carries.

    Raises
    ------
    ProtocolError
        It is another packet, or cut off.
    """
    if packet[0] == _FULL and len(packet) == Fragment.size:
        return packet[1:]
    if packet[0] == _SHORT and len(packet) == length(packet):
        return packet[2:]
    if _kind(packet, 0) is Fragment:
        raise _cut_off(packet, 0)
    raise ProtocolError(name(packet), 0, "only fragments of scans travel in this exchange")


def look(packet: bytes) -> tuple[int | None, bytes]:
    """Return the fields of one piece of a unit of the predictive exchange: `Update.number` and `Update.data`.

    Raises
    ------
    ProtocolError
        It is another packet, or cut off.
    """
    if packet[0] == _UPDATE and len(packet) == Update.size:
        return None, packet[1:]
    if packet[0] == _LAST_UPDATE and len(packet) == length(packet):
        return packet[1] & UPDATE_NUMBERS - 1, packet[2:]
    if _kind(packet, 0) is Update:
        raise _cut_off(packet, 0)
    raise ProtocolError(name(packet), 0, "only looks travel in this exchange")


def decode(buffer: bytes) -> list[AnyPacket]:
    """Read a buffer of whole packets.

    Raises
    ------
    ProtocolError
        A packet is unknown, cut off, or has bits set that must be zero.
    """
    decoder = Decoder()
    packets = list(decoder.feed(buffer))
    if decoder.pending:
        raise _cut_off(buffer, len(buffer) - len(decoder.pending))
    return packets


def handshake(frame: bytes) -> tuple[AnyPacket, ...]:
    """Read a frame of `conn` packets, of which the same few come again and again.

    Raises
    ------
    ProtocolError
        As `decode`, or the frame is longer than any handshake.
    """
    if len(frame) > HANDSHAKE_SIZE:
        raise ProtocolError(Offer.name, 0, f"{len(frame)} bytes instead of {HANDSHAKE_SIZE} at most")
    return _read_handshake(frame)


BROADCAST_SIZE = Pose.size + Target.size
"""Bytes of the longest broadcast in which nothing is passed on."""


def broadcast(frame: bytes) -> tuple[AnyPacket, ...]:
    """Read a frame that many hear, as `decode` does; what has the size of a broadcast is read only once."""
    return _read_broadcast(frame) if len(frame) <= BROADCAST_SIZE else tuple(decode(frame))


@lru_cache(maxsize=1 << 12)
def _read_broadcast(frame: bytes) -> tuple[AnyPacket, ...]:
    return tuple(decode(frame))


@lru_cache(maxsize=1 << 14)
def _read_handshake(frame: bytes) -> tuple[AnyPacket, ...]:
    return tuple(decode(frame))


class Decoder:
    """Reads packets from a stream that arrives in pieces, cut anywhere."""

    def __init__(self) -> None:
        self.pending = b""
        """The beginning of a packet whose end has not come yet."""
        self._read = 0

    def feed(self, data: bytes) -> Iterator[AnyPacket]:
        """Yield the packets that `data` completes, as they are read.

        Raises
        ------
        ProtocolError
            The stream is broken here; packets before this one have been yielded.
        """
        buffer = self.pending + data
        offset = 0
        try:
            while offset < len(buffer):
                size = _SIZE[buffer[offset]] or length(buffer, offset)
                if offset + size > len(buffer):
                    break
                packet = _read(buffer, offset, size)
                offset += size
                yield packet
        except ProtocolError as error:
            raise ProtocolError(error.packet, self._read + offset, error.reason) from None
        finally:
            self._read += offset
            self.pending = buffer[offset:]


def _write_fragment(packet: Fragment, offset: int) -> bytes:
    size = len(packet.data)
    if not 1 <= size <= FRAGMENT_DATA:
        raise ProtocolError(packet.name, offset, f"{size} bytes of content are outside 1 to {FRAGMENT_DATA}")
    head = bytes([_FULL]) if size == FRAGMENT_DATA else bytes([_SHORT, size])
    return head + packet.data


def _write_update(packet: Update, offset: int) -> bytes:
    size, number = len(packet.data), packet.number
    if number is None:
        if size != UPDATE_DATA:
            reason = f"{size} bytes of content instead of {UPDATE_DATA}"
            raise ProtocolError(packet.name, offset, reason)
        return bytes([_UPDATE]) + packet.data
    if size > LAST_UPDATE_DATA or not 0 <= number < UPDATE_NUMBERS:
        reason = f"unit {number} of {size} bytes is outside 0 to {UPDATE_NUMBERS - 1} or {LAST_UPDATE_DATA}"
        raise ProtocolError(packet.name, offset, reason)
    return bytes([_LAST_UPDATE, size << 2 | number]) + packet.data


def _kind(buffer: bytes, offset: int) -> type[Packet]:
    kind = _FIRST_BYTE[buffer[offset]]
    if kind is None:
        raise ProtocolError("packet", offset, f"no packet begins with {buffer[offset]:#04x}")
    return kind


def _misfit(kind: type[Packet], word: int, offset: int) -> ProtocolError:
    """Say which is not as it must be in a packet, its code or its spare bits."""
    mask, bits = _FIXED[kind]
    spare = 8 * kind.size - kind.code_bits - sum(kind.bits)
    if (word & mask ^ bits) >> spare:
        begin = word >> 8 * kind.size - 16
        return ProtocolError("packet", offset, f"no packet begins with {begin:#06x}")
    return ProtocolError(kind.name, offset, f"the last {spare} bits must be zero")


def _read(buffer: bytes, offset: int, size: int) -> AnyPacket:
    if buffer[offset] in (_FULL, _SHORT):
        return Fragment(content(buffer[offset : offset + size]))
    if buffer[offset] in (_UPDATE, _LAST_UPDATE):
        return Update(*look(buffer[offset : offset + size]))
    kind = _kind(buffer, offset)
    word = int.from_bytes(buffer[offset : offset + size], "big")
    mask, bits = _FIXED[kind]
    if word & mask != bits:
        raise _misfit(kind, word, offset)
    values = [(word >> shift & mask) - rim for _, shift, mask, rim in _LAYOUT[kind]]
    return kind(*values)  # type: ignore[return-value]


def _cut_off(buffer: bytes, offset: int) -> ProtocolError:
    have, wanted = len(buffer) - offset, length(buffer, offset)
    return ProtocolError(name(buffer, offset), offset, f"cut off after {have} of {wanted} bytes")
