"""The packets of a handshake: an offer of a map, and the answer with the receiver's log length.

An answer leaves out the fields that it shares with the offer. It names the offset within a block of 4096 entries;
before that the block, if it differs from the offered one; and before that the round of 64 blocks, if it is not the
first. So no length is ambiguous.
"""

from __future__ import annotations

from functools import lru_cache

from protocol import packets
from protocol.errors import ProtocolError
from protocol.packets import BLOCKS, INDEX_WINDOW

ROUND = BLOCKS * INDEX_WINDOW
"""Entries of a log whose blocks have different numbers."""

LEAST_HANDSHAKE = packets.Offer.size + packets.Answer.size
"""Bytes of an offer and the shortest answer."""

DECLINE = packets.encode([packets.Decline()])


@lru_cache(maxsize=1024)
def offer(number: int, expected: int) -> bytes:
    """Encode an offer of map `number` to a peer that is expected to hold so many entries."""
    return packets.encode([packets.Offer(number, block_of(expected))])


@lru_cache(maxsize=1 << 12)
def read_offer(payload: bytes) -> packets.Offer:
    """Decode a frame that must be one offer; ProtocolError otherwise."""
    read = packets.handshake(payload)
    if len(read) != 1 or not isinstance(read[0], packets.Offer):
        raise ProtocolError("conn", 0, "expected one offer")
    return read[0]


@lru_cache(maxsize=1024)
def answer(length: int, offered_block: int) -> bytes:
    """Encode this robot's log length in as few packets as possible."""
    block = packets.Block(block_of(length))
    index = packets.Answer(length % INDEX_WINDOW)
    if length >= ROUND:
        return packets.encode([packets.Block(length // ROUND % BLOCKS), block, index])
    return packets.encode([index] if block.block == offered_block else [block, index])


@lru_cache(maxsize=1 << 14)
def read_answer(payload: bytes, offered_block: int) -> int | None:
    """Decode the peer's log length; None if it declines; ProtocolError if the frame is no answer."""
    match packets.handshake(payload):
        case (packets.Decline(),):
            return None
        case (packets.Answer(index),):
            rounds, block = 0, offered_block
        case (packets.Block(block), packets.Answer(index)):
            rounds = 0
        case (packets.Block(rounds), packets.Block(block), packets.Answer(index)):
            pass
        case _:
            raise ProtocolError("conn", 0, "expected an answer behind at most two blocks, or a decline")
    return rounds * ROUND + block * INDEX_WINDOW + index


def block_of(length: int) -> int:
    """Return the block in which a log of that length continues."""
    return length // INDEX_WINDOW % BLOCKS
