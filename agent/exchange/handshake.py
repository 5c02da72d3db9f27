"""What offers and answers of a session say, as bytes and back (docs/protocol.md).

An answer gives of its index what the offer has not said: the place within the block of 4096 units; before it
the block, where it is not the one that was offered; and before that the round of 64 blocks, where it is not
the first. So an index is never guessed at.
"""

from __future__ import annotations

from functools import lru_cache

from protocol import packets
from protocol.errors import ProtocolError
from protocol.packets import BLOCKS, INDEX_WINDOW

ROUND = BLOCKS * INDEX_WINDOW
"""Units of a log whose blocks have different numbers."""

LEAST_HANDSHAKE = packets.Offer.size + packets.Answer.size
"""Bytes of an offer and the shortest answer."""

DECLINE = packets.encode([packets.Decline()])


@lru_cache(maxsize=1024)
def offer(map_id: int, known: int) -> bytes:
    """Offer a map to who is thought to hold `known` units of it."""
    return packets.encode([packets.Offer(map_id, block_of(known))])


@lru_cache(maxsize=1 << 12)
def read_offer(payload: bytes) -> packets.Offer:
    """Read a frame that is to be one offer; ProtocolError: it is not."""
    said = packets.handshake(payload)
    if len(said) != 1 or not isinstance(said[0], packets.Offer):
        raise ProtocolError("conn", 0, "expected one offer")
    return said[0]


@lru_cache(maxsize=1024)
def answer(held: int, offered_block: int) -> bytes:
    """Say how many units one holds, in as few packets as that takes."""
    block = packets.Block(block_of(held))
    place = packets.Answer(held % INDEX_WINDOW)
    if held >= ROUND:
        return packets.encode([packets.Block(held // ROUND % BLOCKS), block, place])
    return packets.encode([place] if block.block == offered_block else [block, place])


@lru_cache(maxsize=1 << 14)
def read_answer(payload: bytes, offered_block: int) -> int | None:
    """Read how many units the peer holds; None if it declines; ProtocolError: it is no answer."""
    match packets.handshake(payload):
        case (packets.Decline(),):
            return None
        case (packets.Answer(index),):
            turn, block = 0, offered_block
        case (packets.Block(block), packets.Answer(index)):
            turn = 0
        case (packets.Block(turn), packets.Block(block), packets.Answer(index)):
            pass
        case _:
            raise ProtocolError("conn", 0, "expected an answer behind at most two blocks, or a decline")
    return turn * ROUND + block * INDEX_WINDOW + index


def block_of(units: int) -> int:
    """Return the number of the block in which a log of so many units goes on."""
    return units // INDEX_WINDOW % BLOCKS
