"""What a frame may hold: nothing that robots say is believed, so each is looked at before it goes on the air."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

from netshaper.ledger import EVERYONE, KIND_NUMBER
from netshaper.medium import ANSWER, DATA, OFFER
from protocol import packet_index, packets
from protocol.errors import ProtocolError
from protocol.packets import Check, From, FromEarly, Held, HeldEarly, Offer

Begins = Offer | From | FromEarly
"""What says which map is spoken of from here on."""


_LETTERS = {packets.Pose: "p", packets.Target: "t", packets.Passed: "P"}
_BROADCAST = re.compile(r"(?=.)p?t?(Pt?)*")


def is_broadcast(payload: bytes) -> bool:
    """Whether a frame says a pose and a target, or one of them, and then the same of others, each once, ascending."""
    try:
        said = packets.broadcast(payload)
    except ProtocolError:
        return False
    kinds = "".join(_LETTERS.get(type(packet), "?") for packet in said)
    passed = [packet.robot for packet in said if isinstance(packet, packets.Passed)]
    return _BROADCAST.fullmatch(kinds) is not None and all(one < other for one, other in pairwise(passed))


def wrong_in_news(receiver: int, payload: bytes) -> str:
    """Say what is wrong with news; nothing if it is a broadcast of whole packets that may be units or reports."""
    if receiver != EVERYONE:
        return "said to one robot"
    try:
        pieces = packet_index.split(payload)
    except ProtocolError as error:
        return str(error)
    strange = [packets.name(piece) for piece in pieces if _is_strange(piece)]
    return f"no {strange[0]} of this kind" if strange else "" if pieces else "nothing in it"


def _is_strange(piece: bytes) -> bool:
    """Whether a packet does not belong into news."""
    if packets.name(piece) == packets.Offer.name:
        return not isinstance(packets.decode(piece)[0], packets.Gossip)
    return packets.name(piece) in (packets.Target.name, packets.Pose.name, packets.Check.name)


@lru_cache(maxsize=1 << 12)
def read_offer(payload: bytes, maps: int) -> tuple[int, str]:
    """Return whose map an offer frame offers; or what is wrong with it."""
    try:
        said = packets.handshake(payload)
    except ProtocolError as error:
        return -1, str(error)
    offer = said[0] if len(said) == 1 else None
    if not isinstance(offer, packets.Offer) or offer.map >= maps:
        return -1, "an offer frame is one offer of a known map"
    return offer.map, ""


@lru_cache(maxsize=1 << 13)
def wrong_in_answer(payload: bytes) -> str:
    """Say what is wrong with an answer frame; nothing if it is one."""
    try:
        said = packets.handshake(payload)
    except ProtocolError as error:
        return str(error)
    kinds = [type(packet) for packet in said]
    if kinds == [packets.Decline]:
        return ""
    if kinds[-1:] == [packets.Answer] and kinds[:-1] in ([], [packets.Block], 2 * [packets.Block]):
        return ""
    return "an answer frame is an answer behind at most two blocks, or a decline"


def declines(payload: bytes) -> bool:
    """Whether an answer frame declines the offer."""
    return payload == _DECLINE


_DECLINE = packets.encode([packets.Decline()])


@lru_cache(maxsize=16)
def wrong_in_data(payload: bytes) -> str:
    """Say what is wrong with a data frame; nothing if it is whole packets that may be data.

    What a robot sends to several teammates is looked at once.
    """
    try:
        kinds = packet_index.kinds(payload)
    except ProtocolError as error:
        return str(error)
    if kinds & _NO_DATA:
        return f"a data frame holds no {next(name for name, bit in _NO_DATA_BITS.items() if kinds & bit)}"
    return "" if kinds else "an empty data frame"


_NO_DATA_BITS = {
    kind.name: 1 << KIND_NUMBER[kind.name]
    for kind in (packets.Offer, packets.Target, packets.Pose, packets.Check)
}
_NO_DATA = sum(_NO_DATA_BITS.values())


def read_confirmed(receiver: int, payload: bytes, maps: int) -> tuple[int, int, str]:
    """Return what kind of frame one for a single robot is, which map it is about, and what is wrong with it.

    Of robots that go by what the other confirms (`agent.exchange.confirmed`).
    """
    try:
        pieces = packet_index.split(payload)
        handshakes = [packets.decode(piece)[0] for piece in pieces if packets.name(piece) == Offer.name]
    except ProtocolError as error:
        return DATA, -1, str(error)
    strange = _strange(receiver, pieces, handshakes, maps)
    if len(handshakes) < len(pieces):
        frame = DATA
    else:
        frame = OFFER if any(isinstance(each, Offer) for each in handshakes) else ANSWER
    begun = [each.map for each in handshakes if isinstance(each, Begins)]
    held = [each.map for each in handshakes if isinstance(each, Held | HeldEarly)]
    return frame, (begun or held or [-1])[0], strange


def _strange(
    receiver: int, pieces: Sequence[bytes], handshakes: Sequence[packets.AnyPacket], maps: int
) -> str:
    """Say what does not belong into a frame for one robot; nothing if it is reports and offers, then units of a map."""
    if receiver == EVERYONE:
        return "said to all, where maps are offered to one"
    odd = [type(each).__name__ for each in handshakes if not isinstance(each, Begins | Held | HeldEarly)]
    no_units = {packets.Target.name, packets.Pose.name, Check.name}
    odd += [packets.name(piece) for piece in pieces if packets.name(piece) in no_units]
    if odd:
        return f"no {odd[0]} of this kind"
    if any(each.map >= maps for each in handshakes if isinstance(each, Begins | Held | HeldEarly)):
        return "it speaks of a robot that there is not"
    first = next((at for at, piece in enumerate(pieces) if packets.name(piece) != Offer.name), len(pieces))
    if first < len(pieces) and not any(isinstance(each, From | FromEarly) for each in handshakes[:first]):
        return "units without a word of what they are units of"
    return "" if pieces else "nothing in it"
