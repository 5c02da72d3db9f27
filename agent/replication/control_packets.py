"""Control packets of replication: offers and answers of handshakes, and packets that name log offsets.

An offer names the block of 4096 entries in which the receiver's log is expected to end. An answer is the log's length
in one to three packets: the offset within a block; in front of it the block, unless it is the offered one; and in front
of both, in logs of 64 blocks or more, how many times 64 blocks precede.

Other packets (`From`, `Held`) come in three lengths. The shorter ones name small offsets whole. The longest one names
an offset modulo `GOSSIP_WINDOW`; the receiver takes the value nearest to its own log length, as TCP does with truncated
sequence numbers.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from protocol import packet_codec, packet_index, packets
from protocol.errors import ProtocolError

ROUND = packets.BLOCKS * packets.INDEX_WINDOW
"""Entries of a log whose blocks have different numbers."""

LEAST_HANDSHAKE = packets.Offer.size + packets.Answer.size
"""Bytes of an offer and the shortest answer."""

NamesOffset = type[packets.From] | type[packets.Held]


def block_of(length: int) -> int:
    """Return the block in which a log of that length continues."""
    return length // packets.INDEX_WINDOW % packets.BLOCKS


@lru_cache(maxsize=1024)
def offer(map_id: int, expected: int) -> bytes:
    """Encode an offer of map `map_id` to a peer that is expected to hold so many entries."""
    return packet_codec.encode([packets.Offer(map_id, block_of(expected))])


@lru_cache(maxsize=1 << 12)
def read_offer(payload: bytes) -> packets.Offer:
    """Decode a frame that must be one offer; ProtocolError otherwise."""
    match packet_codec.handshake(payload):
        case (packets.Offer() as offered,):
            return offered
    raise ProtocolError("conn", 0, "expected one offer")


@lru_cache(maxsize=1024)
def answer(length: int, offered_block: int) -> bytes:
    """Encode this robot's log length in as few packets as possible."""
    block = packets.Block(block_of(length))
    index = packets.Answer(length % packets.INDEX_WINDOW)
    if length >= ROUND:
        return packet_codec.encode([packets.Block(length // ROUND % packets.BLOCKS), block, index])
    return packet_codec.encode([index] if block.block == offered_block else [block, index])


@lru_cache(maxsize=1 << 14)
def read_answer(payload: bytes, offered_block: int) -> int | None:
    """Decode the peer's log length; None if it declines; ProtocolError if the frame is no answer."""
    match packet_codec.handshake(payload):
        case (packets.Block(packets.DECLINED),):
            return None
        case (packets.Answer(index),):
            return offered_block * packets.INDEX_WINDOW + index
        case (packets.Block(block), packets.Answer(index)) if block < packets.BLOCKS:
            return block * packets.INDEX_WINDOW + index
        case (packets.Block(rounds), packets.Block(block), packets.Answer(index)) if (
            max(rounds, block) < packets.BLOCKS
        ):
            return rounds * ROUND + block * packets.INDEX_WINDOW + index
        case _:
            raise ProtocolError("conn", 0, "expected an answer behind at most two blocks, or a decline")


def header(map_id: int, first: int) -> bytes:
    """Encode the shortest packet in front of entries of map `map_id`, from offset `first` on."""
    return _shortest(map_id, first, packets.FromFirst, packets.FromEarly, packets.From)


def length_report(map_id: int, length: int) -> bytes:
    """Encode the shortest report that this robot holds `length` entries of map `map_id`."""
    return _shortest(map_id, length, packets.HeldFirst, packets.HeldEarly, packets.Held)


def _shortest(map_id: int, value: int, first: NamesOffset, early: NamesOffset, whole: NamesOffset) -> bytes:
    """Encode map `map_id` and an offset in the shortest of three packets."""
    if map_id < packets.FIRST_MAPS and value < packets.FIRST:
        return packet_codec.encode([first(map_id, value)])
    if value < packets.EARLY:
        return packet_codec.encode([early(map_id, value)])
    return packet_codec.encode([whole(map_id, value % packets.GOSSIP_WINDOW)])


def offset(packet: packets.From | packets.Held, length: int) -> int:
    """Return the offset that a packet means, for a robot whose log has `length` entries."""
    if isinstance(packet, packets.FromFirst | packets.FromEarly | packets.HeldFirst | packets.HeldEarly):
        return packet.index
    return nearest(packet.index, length, packets.GOSSIP_WINDOW)


def nearest(number: int, length: int, window: int) -> int:
    """Return the offset nearest to `length` that equals `number` modulo `window`."""
    return max(0, length + (number - length + window // 2) % window - window // 2)


class ParsedFrame(NamedTuple):
    """A frame's control packets, headers among them, and its entries behind their headers.

    Entries without a header continue the sender's own log where its last frame ended. `named`: the headers without
    entries, by which the sender names an offset of a log.
    """

    controls: list[packets.AnyPacket]
    sections: list[tuple[packets.From | None, list[bytes]]]
    named: list[packets.From]


@lru_cache(maxsize=64)
def parse(frame: bytes) -> ParsedFrame:
    """Split a frame; ProtocolError if it does not consist of whole packets.

    Several robots of a process may receive the same frame, so callers must not change the result.
    """
    controls: list[packets.AnyPacket] = []
    entries: list[bytes] = []
    sections: list[tuple[packets.From | None, list[bytes]]] = [(None, entries)]
    for packet in packet_index.split(frame):
        if packet_codec.name(packet) != packets.From.name:
            entries.append(packet)
            continue
        controls += packet_codec.decode(packet)
        if isinstance(controls[-1], packets.From):
            entries = []
            sections.append((controls[-1], entries))
    filled = [section for section in sections if section[1]]
    return ParsedFrame(controls, filled, [head for head, those in sections if head and not those])
