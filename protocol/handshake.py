"""The handshake of a connection: how an offer and its answer are said, and read (docs/protocol.md, Indices and blocks).

An answer gives of its index what the offer has not said: the place within the block of 4096 units; before it the
block, where it is not the one that was offered; and before that the round of 64 blocks, where it is not the first.
"""

from __future__ import annotations

from functools import lru_cache

from protocol import packets
from protocol.errors import ProtocolError
from protocol.packets import BLOCKS, INDEX_WINDOW

ROUND = BLOCKS * INDEX_WINDOW
"""Units of a log whose blocks have different numbers."""

BEHIND, LEVEL, DECLINED, FIRST_OFFER, UNWANTED_OFFER = range(5)
"""What the relay tells a robot that it has spoken for: what became of its offer, or of an offer to it."""

DECLINE = packets.encode([packets.Decline()])
"""The frame that declines an offer."""


def offer(about: int, known: int) -> bytes:
    """Offer a map, to who is known to hold so many of its units."""
    return _offer(about, known // INDEX_WINDOW % BLOCKS)


@lru_cache(maxsize=1024)
def _offer(about: int, block: int) -> bytes:
    return packets.encode([packets.Offer(about, block)])


@lru_cache(maxsize=1 << 12)
def read_offer(payload: bytes) -> packets.Offer:
    """Read an offer frame; ProtocolError if it is anything but one offer."""
    said = packets.handshake(payload)
    if len(said) != 1 or not isinstance(said[0], packets.Offer):
        raise ProtocolError("conn", 0, "expected one offer")
    return said[0]


@lru_cache(maxsize=1 << 12)
def answer(held: int, assumed_block: int) -> bytes:
    """Say how many units one holds, in as few packets as that takes, to an offer that assumes some block."""
    block = packets.Block(held // INDEX_WINDOW % BLOCKS)
    index = packets.Answer(held % INDEX_WINDOW)
    if held >= ROUND:
        return packets.encode([packets.Block(held // ROUND % BLOCKS), block, index])
    return packets.encode([index] if block.block == assumed_block else [block, index])


def held_by(payload: bytes, known: int) -> int | None:
    """Read an answer: how many units a peer holds that was known to hold so many; None if it declines.

    Raises
    ------
    ProtocolError
        It is no answer.
    """
    said = _read_answer(payload)
    if said is None:
        return None
    turn, block, index = said
    if block is None:
        block = known // INDEX_WINDOW % BLOCKS
    return turn * ROUND + block * INDEX_WINDOW + index


@lru_cache(maxsize=1 << 14)
def _read_answer(payload: bytes) -> tuple[int, int | None, int] | None:
    """Read an answer: round, block (None: the one that the offer assumed), index; None if it declines."""
    match packets.handshake(payload):
        case (packets.Decline(),):
            return None
        case (packets.Answer(index),):
            return 0, None, index
        case (packets.Block(block), packets.Answer(index)):
            return 0, block, index
        case (packets.Block(turn), packets.Block(block), packets.Answer(index)):
            return turn, block, index
        case _:
            raise ProtocolError("conn", 0, "expected an answer behind at most two blocks, or a decline")
