"""Admission: the relay parses each submitted frame once and refuses those that break the protocol.

The packet index found here travels with the frame: by it the medium cuts frames at the budget, and the ledger counts
packets. Nothing that a robot sends is believed:

    broadcast   a pose, a target, or both, then those of other robots, in the first round of a step
    offer       one offer of an existing map, for one robot, once per round
    answer      an answer behind at most two blocks, or a decline
    data        whole packets, no offers, broadcasts or checksums
    news        as data and reports, for all robots, once per round (gossip)
    other       reports and offers, then log entries, for one robot, once per round (imperfect radio, no gossip)
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

from netshaper.frame_log import Frame, index_or_none
from netshaper.ledger import ANSWER, BROADCAST, DATA, EVERYONE, KIND_NUMBER, NEWS, OFFER
from netshaper.settings import RadioSettings
from protocol import packet_index, packets
from protocol.errors import ProtocolError
from protocol.messages import OutgoingFrame
from protocol.packet_index import NO_PACKETS, PacketIndex
from protocol.packets import Check, From, FromEarly, Held, HeldEarly, Offer

Begins = Offer | From | FromEarly
"""Packets that say of which map the next ones are."""


class Content(NamedTuple):
    """What a payload holds: the index of its packets, the kind of frame, its map (-1: none), and a protocol error."""

    packets: PacketIndex
    kind: int
    map_id: int = -1
    problem: str = ""


class Admission:
    """Reads frames by the rules of one run."""

    def __init__(self, settings: RadioSettings) -> None:
        self._gossip = settings.gossip
        self._maps = settings.maps
        self._tail = settings.checksum_bytes
        self._frame_bytes = settings.options.frame_bytes

    def broadcast(self, sender: int, payload: bytes, round_number: int) -> tuple[Frame, str]:
        """Read a pose and target for all; return the frame and what is wrong with it, if anything."""
        problem = "" if not round_number and is_broadcast(payload) else NO_BROADCAST
        return Frame(BROADCAST, sender, EVERYONE, payload, index_or_none(payload)), problem

    def frame(self, sender: int, submitted: OutgoingFrame, kind: int, number: int) -> tuple[Frame, str]:
        """Read a frame of a phase; `kind` is `NEWS` if it may be any frame of a round without connections."""
        receiver, payload = submitted.receiver, submitted.payload
        if kind == OFFER:
            content = read_offer(payload, self._maps)
        elif kind == ANSWER:
            content = read_answer(payload)
        elif kind == DATA:
            content = read_data(payload)
        else:
            content = read_news(payload) if self._gossip else read_any(payload, self._maps)
            wanted = receiver == EVERYONE if self._gossip else receiver != EVERYONE
            if not wanted:
                content = content._replace(problem=NOT_FOR_ALL if receiver == EVERYONE else NOT_FOR_ONE)
        index, kind, map_id, problem = content
        frame = Frame(kind, sender, receiver, payload, index, map_id, number)
        return frame, problem or (self._too_long(index) if self._frame_bytes else "")

    def _too_long(self, index: PacketIndex) -> str:
        """Return the error text if a packet exceeds the frame limit, else nothing."""
        size = max(index.sizes, default=0) + self._tail
        if size <= self._frame_bytes:
            return ""
        tail = " with its checksum" if self._tail else ""
        return f"a packet of {size} bytes{tail}, where a frame holds {self._frame_bytes}"


NO_BROADCAST = "broadcast something other than a target or a pose, at the start of a step"
NOT_FOR_ALL = "sent to all, where maps are offered to one robot"
NOT_FOR_ONE = "news are a broadcast: sent to one robot"

_LETTERS = {packets.Pose: "p", packets.Target: "t", packets.Passed: "P"}
_BROADCAST = re.compile(r"(?=.)p?t?(Pt?)*")


def is_broadcast(payload: bytes) -> bool:
    """Return whether a frame is a pose, a target or both, and then those of other robots, each once and ascending."""
    try:
        content = packets.broadcast(payload)
    except ProtocolError:
        return False
    kinds = "".join(_LETTERS.get(type(packet), "?") for packet in content)
    robots = [packet.robot for packet in content if isinstance(packet, packets.Passed)]
    return _BROADCAST.fullmatch(kinds) is not None and all(one < other for one, other in pairwise(robots))


@lru_cache(maxsize=1 << 12)
def read_offer(payload: bytes, maps: int) -> Content:
    """Read the frame of an offer."""
    try:
        content = packets.handshake(payload)
    except ProtocolError as error:
        return Content(index_or_none(payload), OFFER, -1, str(error))
    offer = content[0] if len(content) == 1 else None
    if not isinstance(offer, Offer) or offer.map >= maps:
        return Content(index_or_none(payload), OFFER, -1, "an offer frame is one offer of a known map")
    return Content(packet_index.index_of(payload), OFFER, offer.map)


@lru_cache(maxsize=1 << 13)
def read_answer(payload: bytes) -> Content:
    """Read the frame of an answer."""
    try:
        kinds = [type(packet) for packet in packets.handshake(payload)]
    except ProtocolError as error:
        return Content(index_or_none(payload), ANSWER, -1, str(error))
    is_answer = kinds[-1:] == [packets.Answer] and kinds[:-1] in ([], [packets.Block], 2 * [packets.Block])
    problem = "an answer frame is an answer behind at most two blocks, or a decline"
    return Content(
        packet_index.index_of(payload), ANSWER, -1, "" if is_answer or kinds == [packets.Decline] else problem
    )


def declines(payload: bytes) -> bool:
    """Return whether an answer frame declines the offer."""
    return payload == _DECLINE


_DECLINE = packets.encode([packets.Decline()])


def read_data(payload: bytes) -> Content:
    """Read a frame of data."""
    try:
        index = packet_index.index_of(payload)
    except ProtocolError as error:
        return Content(NO_PACKETS, DATA, -1, str(error))
    odd = _first_of(index, _NO_DATA)
    problem = f"a data frame holds no {odd}" if odd else "" if payload else "an empty data frame"
    return Content(index, DATA, -1, problem)


def read_news(payload: bytes) -> Content:
    """Read a frame of gossip: log entries and reports."""
    try:
        index = packet_index.index_of(payload)
    except ProtocolError as error:
        return Content(NO_PACKETS, NEWS, -1, f"{_NEWS}: {error}")
    odd = _first_of(index, _NO_ENTRIES)
    for piece in _conn_packets(payload, index):
        if not odd and not isinstance(piece, packets.Gossip):
            odd = piece.name
    problem = f"no {odd} of this kind" if odd else "" if payload else "nothing in it"
    return Content(index, NEWS, -1, f"{_NEWS}: {problem}" if problem else "")


def read_any(payload: bytes, maps: int) -> Content:
    """Read a frame of a robot that requires acknowledgments: reports and offers, then log entries."""
    try:
        index = packet_index.index_of(payload)
    except ProtocolError as error:
        return Content(NO_PACKETS, DATA, -1, str(error))
    reports = _conn_packets(payload, index)
    if len(reports) < len(index.kinds):
        kind = DATA
    else:
        kind = OFFER if any(isinstance(each, Offer) for each in reports) else ANSWER
    begun = [each.map for each in reports if isinstance(each, Begins)]
    held = [each.map for each in reports if isinstance(each, Held | HeldEarly)]
    return Content(index, kind, (begun or held or [-1])[0], _wrong_in_any(index, reports, maps))


def _wrong_in_any(index: PacketIndex, reports: Sequence[packets.AnyPacket], maps: int) -> str:
    """Return what does not belong into a frame of reports and offers, then log entries, if anything."""
    if not index.kinds:
        return "nothing in it"
    of_a_map = [each for each in reports if isinstance(each, Begins | Held | HeldEarly)]
    odd = [type(each).__name__ for each in reports if not isinstance(each, Begins | Held | HeldEarly)]
    odd += filter(None, [_first_of(index, _NO_ENTRIES)])
    if odd:
        return f"no {odd[0]} of this kind"
    if any(each.map >= maps for each in of_a_map):
        return "the map of a robot that does not exist"
    first = next((at for at, kind in enumerate(index.kinds) if kind != _CONN), len(index.kinds))
    if first < len(index.kinds) and not any(isinstance(each, From | FromEarly) for each in reports[:first]):
        return "log entries without the position at which they begin"
    return ""


def _first_of(index: PacketIndex, unwanted: Sequence[str]) -> str:
    """Return the first of these names of packets that a frame holds, nothing if it holds none."""
    return next((name for name in unwanted if KIND_NUMBER[name] in index.kinds), "")


def _conn_packets(payload: bytes, index: PacketIndex) -> list[packets.AnyPacket]:
    """Decode the packets of a frame that are offers, answers and reports."""
    return [
        packets.decode(payload[end - size : end])[0]
        for kind, size, end in zip(index.kinds, index.sizes, index.ends, strict=True)
        if kind == _CONN
    ]


_CONN = KIND_NUMBER[Offer.name]
_NO_ENTRIES = (packets.Target.name, packets.Pose.name, Check.name)
_NO_DATA = (Offer.name, *_NO_ENTRIES)
_NEWS = "news are one broadcast of log entries"
