"""The packets of the radio and their layouts (thesis, Table 6.1; docs/protocol.md).

The layout of a packet is declared once, by the annotations of its class; `LAYOUTS` lists all of them. The code alone
determines a packet's length, so packets need no framing: a stream of them can be cut anywhere and resumed.
`protocol.packet_codec` writes and reads them.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, get_args, get_type_hints

import msgspec

from protocol.packet_layout import LENGTH, Bits, Layout

MAX_VERTICES = 4096
"""The most vertices of an object; `Insert`, `Replace` and `Delete` index them from 0."""

MAX_OBJECTS = 4096
"""The most objects of an approximation."""

GOSSIP_WINDOW = 1 << 24
"""Log offsets in `From` and `Held` are modulo this number."""
EARLY = 1 << 12
"""`FromEarly` and `HeldEarly` give log offsets below this number."""
FIRST = 1 << 8
"""`FromFirst` and `HeldFirst` give log offsets below this number, of maps below `FIRST_MAPS`."""
FIRST_MAPS = 1 << 4
"""`FromFirst` and `HeldFirst` give maps below this number."""
MAX_GOSSIP_MAPS = 1 << 8
"""The most maps that gossip can name."""

INDEX_WINDOW = 4096
"""Entries of a log in a block; an `Answer` gives an offset within one."""

MAX_MAPS = 64
"""The most maps that an `Offer` can name: the largest team that exchanges maps by offers."""

BLOCKS = 64
"""Blocks in a round; in a longer log, `Offer` and `Block` count again from block 0."""
DECLINED = BLOCKS
"""The number in a `Block` that declines an offer."""

SALTS = 1 << 7
"""Number of different salts of a `LogDigest`."""
DIGEST_WINDOW = 1 << 16
"""Lengths of logs in `LogDigest` are modulo this number."""

VertexIndex = Annotated[int, Bits(12, "i", "position of the vertex in its object, from 0")]
VertexX = Annotated[
    int, Bits(12, "x", "column of the vertex' cell, from -1 (the unknown border); sent plus 1", 1)
]
VertexY = Annotated[int, Bits(12, "y", "row of the vertex' cell, from -1; sent plus 1", 1)]
Side = Annotated[
    int, Bits(2, "s", "side of its cell on which the vertex lies: 0 below, 1 right, 2 above, 3 left")
]
Occupied = Annotated[
    int,
    Bits(
        1, "o", "1: the edge from this vertex to the next is a wall; 0: it is unknown (inside object: free)"
    ),
]
Object = Annotated[int, Bits(12, "n", "number of the object")]
Count = Annotated[int, Bits(13, "c", "vertices of the object after the vertex packets that follow")]
Inside = Annotated[int, Bits(1, "e", "1: the object encloses the free space")]
OfferedMap = Annotated[
    int, Bits(6, "m", "number of the map's robot, plus the team size times the robot's incarnation")
]
GossipMap = Annotated[
    int, Bits(8, "m", "number of the map's robot, plus the team size times the robot's incarnation")
]
BlockNumber = Annotated[int, Bits(6, "b", "block of 4096 log entries, modulo 64")]
AnswerBlock = Annotated[int, Bits(7, "b", "block of 4096 log entries, modulo 64; 64: the offer is declined")]
BlockOffset = Annotated[int, Bits(12, "i", "number of log entries held, within the block")]
Offset = Annotated[int, Bits(24, "i", "offset of a log entry, modulo 16777216")]
EarlyOffset = Annotated[int, Bits(12, "i", "offset of a log entry, below 4096")]
FirstMap = Annotated[int, Bits(4, "m", "number of the map's robot, if the map is among the first 16")]
FirstOffset = Annotated[int, Bits(8, "i", "offset of a log entry, below 256")]
Robot = Annotated[int, Bits(8, "r", "number of the robot")]
CellX = Annotated[int, Bits(11, "x", "column of a cell")]
CellY = Annotated[int, Bits(11, "y", "row of a cell")]
Leads = Annotated[int, Bits(1, "l", "1: the sender leads a sub-team")]
Age = Annotated[int, Bits(6, "a", "steps since the robot was in that cell")]
Checksum = Annotated[int, Bits(16, "q", "checksum of all preceding bytes of the frame")]
DigestLength = Annotated[int, Bits(16, "i", "number of log entries, modulo 65536")]
Complete = Annotated[int, Bits(1, "c", "1: the sender has sent no further entries of its log")]
Salt = Annotated[int, Bits(7, "k", "number that no other robot can predict, hashed behind the entries")]
Hash = Annotated[int, Bits(16, "h", "hash of the entries and the salt")]


class Packet(msgspec.Struct, frozen=True):
    """Base class of all packets: its fields are sent in the order of their declaration."""

    name: ClassVar[str]
    """Kind: of the packets in Table 6.1, their name there."""
    size: ClassVar[int]
    """Bytes (Table 6.1); of packets with content, those of a full one."""
    code: ClassVar[str]
    """Binary digits with which the packet starts; of packets with content, with which a full one starts."""


class Insert(Packet, frozen=True):
    """Insert a vertex into the current object, before the vertex that now has `index`.

    The vertex is the contour point of cell (x, y) on its side `side` (`agent.outline.contour`).
    """

    name, size, code = "ins", 6, "10100000"
    index: VertexIndex
    x: VertexX
    y: VertexY
    side: Side
    occupied: Occupied


class Replace(Packet, frozen=True):
    """Replace the vertex at `index` of the current object."""

    name, size, code = "rep", 6, "10100001"
    index: VertexIndex
    x: VertexX
    y: VertexY
    side: Side
    occupied: Occupied


class Delete(Packet, frozen=True):
    """Delete the vertex at `index` of the current object."""

    name, size, code = "del", 2, "1101"
    index: VertexIndex


class Emerge(Packet, frozen=True):
    """Create an object under the unused number `object`, and make it the current one; `count` inserts follow."""

    name, size, code = "em", 5, "10100010"
    object: Object
    count: Count
    inside: Inside


class Change(Packet, frozen=True):
    """Make `object` the current one; it has `count` vertices after the vertex packets that follow."""

    name, size, code = "chg", 5, "10100011"
    object: Object
    count: Count
    inside: Inside


class Remove(Packet, frozen=True):
    """Remove `object`; its number may be used again."""

    name, size, code = "rm", 2, "1110"
    object: Object


class Offer(Packet, frozen=True):
    """Handshake: offer log entries of a map; the receiver is believed to hold its log up to `block`."""

    name, size, code = "conn", 2, "1100"
    map: OfferedMap
    block: BlockNumber


class Answer(Packet, frozen=True):
    """Handshake: answer an offer with the number of log entries held of that map, within the block."""

    name, size, code = "conn", 2, "1011"
    index: BlockOffset


class Block(Packet, frozen=True):
    """Handshake: the answer that follows refers to `block` instead of the block of the offer.

    Before another `Block` it gives the round, which counts `BLOCKS` blocks. Alone, `DECLINED` declines the offer:
    another robot sends this map in the same round, or this robot wants no entries of it from the sender.
    """

    name, size, code = "conn", 2, "111110000"
    block: AnswerBlock


class From(Packet, frozen=True):
    """Gossip: entries of a map's log follow, the first of them at offset `index`, modulo `GOSSIP_WINDOW`.

    Without entries, in front of a `Held` of the same map: the first entry that the sender holds behind a gap.
    """

    name, size, code = "conn", 5, "11110110"
    map: GossipMap
    index: Offset


class FromEarly(From, frozen=True):
    """Gossip: a shorter `From`, for offsets below `EARLY`."""

    name, size, code = "conn", 3, "0100"
    map: GossipMap
    index: EarlyOffset


class FromFirst(From, frozen=True):
    """Gossip: the shortest `From`, for offsets below `FIRST` and maps below `FIRST_MAPS`."""

    name, size, code = "conn", 2, "0110"
    map: FirstMap
    index: FirstOffset


class Held(Packet, frozen=True):
    """Gossip: the sender holds `index` entries of a map's log, modulo `GOSSIP_WINDOW`.

    If it is the sender's own map, it asks for reports of this map.
    """

    name, size, code = "conn", 5, "11110111"
    map: GossipMap
    index: Offset


class HeldEarly(Held, frozen=True):
    """Gossip: a shorter `Held`, for fewer entries than `EARLY`."""

    name, size, code = "conn", 3, "0101"
    map: GossipMap
    index: EarlyOffset


class HeldFirst(Held, frozen=True):
    """Gossip: the shortest `Held`, for fewer entries than `FIRST` and maps below `FIRST_MAPS`."""

    name, size, code = "conn", 2, "0111"
    map: FirstMap
    index: FirstOffset


class Near(Packet, frozen=True):
    """Gossip: `robot` has entered the sender's range."""

    name, size, code = "conn", 2, "11111001"
    robot: Robot


class Gone(Packet, frozen=True):
    """Gossip: `robot` has left the sender's range."""

    name, size, code = "conn", 2, "11111110"
    robot: Robot


class Check(Packet, frozen=True):
    """Checksum at the end of a frame; added and removed by radios that damage frames, never seen by robots."""

    name, size, code = "sum", 3, "11111010"
    sum: Checksum


class Target(Packet, frozen=True):
    """Broadcast: the sender moves to cell (x, y) next."""

    name, size, code = "targ", 3, "00"
    x: CellX
    y: CellY


class Pose(Packet, frozen=True):
    """Broadcast: the sender is in cell (x, y), and whether it leads a sub-team.

    It is not in Table 6.1. Strategies need it whose robots assign targets together, or follow leaders.
    """

    name, size, code = "pose", 4, "11110011"
    x: CellX
    y: CellY
    leads: Leads


class Passed(Packet, frozen=True):
    """Broadcast: relay the pose of another robot, which was in cell (x, y) `age` steps ago.

    A `Target` that follows is that robot's (`agent.team_state`).
    """

    name, size, code = "pose", 6, "111111110000"
    robot: Robot
    age: Age
    x: CellX
    y: CellY


class LogDigest(Packet, frozen=True):
    """Hash of the first `entries` entries of the sender's own log (`agent.replication.digests`)."""

    name, size, code = "conn", 6, "11111100"
    entries: DigestLength
    complete: Complete
    salt: Salt
    hash: Hash


class Save(Packet, frozen=True):
    """Save point: a step's edits are complete, and receivers may draw them."""

    name, size, code = "save", 1, "11110000"


class Fragment(Packet, frozen=True):
    """Fragment of a raw scan (`protocol.scans`) or a patch: 1 to `FRAGMENT_DATA` bytes."""

    name, size, code = "scan", 64, "11110001"
    data: bytes


class Update(Packet, frozen=True):
    """Fragment of a map update of the predictive encoding (`agent.predictive`).

    The last fragment has the update's `number` in its map's log, modulo `UPDATE_NUMBERS`. Those before have none, and
    at least `UPDATE_PART` bytes. An update without content withdraws the last update that has not been withdrawn.
    """

    name, size, code = "update", 65, "11110101"
    number: int | None
    data: bytes


LENGTH_HEAD = 2
"""Bytes before the content of a packet whose second byte gives the bytes of content."""

FRAGMENT_DATA = Fragment.size - 1
"""Bytes of content of a full fragment."""

UPDATE_DATA = Update.size - LENGTH_HEAD
"""The most bytes of content of a fragment of an update."""
SHORT_UPDATE_DATA = 15
"""The most bytes of content behind a head of one byte."""
UPDATE_PART = 8
"""The fewest bytes of content of a fragment that another one follows."""
UPDATE_NUMBERS = 2
"""Numbers of updates are sent modulo this one."""

Edit = Insert | Replace | Delete | Emerge | Change | Remove | Save
Handshake = Offer | Answer | Block
Gossip = From | FromEarly | FromFirst | Held | HeldEarly | HeldFirst | Near | Gone | LogDigest
AnyPacket = Edit | Handshake | Gossip | Check | Target | Pose | Passed | Fragment | Update


def _declared(kind: type[Packet]) -> Layout:
    """Read the layout of a packet without content from the annotations of its class."""
    hints = get_type_hints(kind, include_extras=True)
    declared = tuple((name, hints[name].__metadata__[0]) for name in kind.__struct_fields__)
    return Layout(kind.__name__, kind.name, kind.size, kind.code, declared)


LAYOUT_OF: dict[type[Packet], Layout] = {
    kind: _declared(kind) for kind in get_args(AnyPacket) if kind not in (Fragment, Update)
}
"""The layouts of packets without content."""

_NUMBER = ("number", Bits(1, "u", "number of the update, modulo 2"))


def _length(width: int, least: int = 0) -> tuple[str, Bits]:
    """Return the field of `width` bits that gives the bytes of content, minus `least`."""
    meaning = f"bytes of content, minus {least}" if least else "bytes of content"
    return LENGTH, Bits(width, "n", meaning, -least)


def _with_content(
    kind: type[Packet], code: str, fields: tuple[tuple[str, Bits], ...], least: int, most: int
) -> Layout:
    """Return a layout with `least` to `most` bytes of content behind the fields."""
    head = (len(code) + sum(bits.width for _, bits in fields)) // 8
    return Layout(kind.__name__, kind.name, head, code, fields, (least, most))


_FRAGMENTS = (
    _with_content(Fragment, Fragment.code, (), FRAGMENT_DATA, FRAGMENT_DATA),
    _with_content(Fragment, "11110010", (_length(8),), 1, FRAGMENT_DATA - 1),
)
_UPDATES = (
    _with_content(Update, "100", (_length(4), _NUMBER), 0, SHORT_UPDATE_DATA),
    _with_content(Update, "10101", (_length(3, UPDATE_PART),), UPDATE_PART, SHORT_UPDATE_DATA),
    _with_content(Update, Update.code, (_length(7), _NUMBER), SHORT_UPDATE_DATA + 1, UPDATE_DATA),
    _with_content(Update, "11110100", (_length(8),), SHORT_UPDATE_DATA + 1, UPDATE_DATA),
)

LAYOUTS: tuple[Layout, ...] = (*LAYOUT_OF.values(), *_FRAGMENTS, *_UPDATES)
"""All layouts: one for each packet without content, several for each with."""

MAX_AGE = (1 << dict(LAYOUT_OF[Passed].fields)["age"].width) - 1
"""The greatest age that `Passed` can give, in steps."""

HANDSHAKE_SIZE = 3 * Answer.size
"""Bytes of the longest frame of a handshake: two blocks and an answer."""

KINDS = ("ins", "rep", "del", "em", "chg", "rm", "conn", "targ", "save")
"""The nine kinds of Table 6.1."""

ALL_KINDS = (*KINDS, Fragment.name, Pose.name, Update.name, Check.name)
"""All kinds of packets, in the order of reports."""

MAP_KINDS = frozenset(kind.name for kind in (*get_args(Edit), Fragment, Update))
"""The kinds of packets that logs of maps hold."""
