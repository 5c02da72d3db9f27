"""Admission: the relay parses each submitted frame once and refuses frames that break the protocol.

The packet index found here travels with the frame: the medium uses it to cut frames at the budget, and the ledger to
count packets. The relay trusts no robot, and accepts only these frames:

    broadcast   pose and target, those of other robots, a digest, lengths of logs, in the first round of a step
    offer       one offer of an existing map, for one robot, once per round
    answer      an answer after at most two blocks, or a decline
    data        whole packets, no offers, broadcasts or checksums
    news        reports, then log entries, once per round: for all robots (gossip), or with offers for one robot
                (imperfect radio, no gossip)
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

from msgspec.structs import replace

from netshaper.frame_log import Content
from netshaper.ledger import ANSWER, BROADCAST, DATA, KIND_NUMBER, NEWS, OFFER
from netshaper.settings import RadioSettings
from protocol import packet_codec, packets
from protocol.errors import ProtocolError
from protocol.packet_index import NO_PACKETS, PacketIndex, cache_short, index_of
from protocol.packets import Check, From, Held, HeldEarly, HeldFirst, LogDigest, Offer

MAX_REPORTS = 1 << 12
"""Maximum number of offers, answers and reports in a frame: some for each map."""

Begins = Offer | From
"""Packets that select the map of the packets after them."""
OfMap = Begins | Held
"""Packets of robots that require acknowledgments: each concerns one map."""

Reader = Callable[[bytes], Content]

_cache_handshakes = cache_short(1 << 12, packets.HANDSHAKE_SIZE)


def readers(settings: RadioSettings) -> dict[int, Reader]:
    """Return for each kind of frame a function that reads it; `NEWS` is any frame of a round without connections."""
    return {
        OFFER: _cache_handshakes(partial(read_offer, settings.maps)),
        ANSWER: read_answer,
        DATA: _limited(read_data, settings),
        NEWS: _limited(partial(read_news, settings), settings),
    }


def _limited(read: Reader, settings: RadioSettings) -> Reader:
    """Return a reader that refuses frames with a packet that exceeds the frame limit."""
    most = settings.packet_bytes
    if most is None:
        return read

    def read_limited(payload: bytes) -> Content:
        content = read(payload)
        size, tail = max(content.packets.sizes, default=0), settings.checksum_bytes
        if content.problem or size <= most:
            return content
        noted = " with its checksum" if tail else ""
        problem = f"a packet of {size + tail} bytes{noted}, where a frame holds {most + tail}"
        return replace(content, problem=problem)

    return read_limited


_LETTERS = {
    packets.Pose: "p", packets.Target: "t", packets.Passed: "P", LogDigest: "d", Held: "h", HeldEarly: "h",
    HeldFirst: "h",
}  # fmt: skip
_BROADCAST = re.compile(r"(?=.)p?t?(Pt?)*d?h*")


def is_broadcast(payload: bytes) -> bool:
    """Return whether a frame is a broadcast: all packets are optional, but robots come once and ascending."""
    try:
        content = packet_codec.broadcast(payload)
    except ProtocolError:
        return False
    kinds = "".join(_LETTERS.get(type(packet), "?") for packet in content)
    robots = [packet.robot for packet in content if isinstance(packet, packets.Passed)]
    return _BROADCAST.fullmatch(kinds) is not None and all(one < other for one, other in pairwise(robots))


def read_broadcast(payload: bytes, round_number: int) -> Content:
    """Read a broadcast of pose and target."""
    problem = (
        "broadcast something other than poses, targets, a digest and log lengths, at the start of a step"
    )
    return content_of(BROADCAST, payload, "" if not round_number and is_broadcast(payload) else problem)


def content_of(kind: int, payload: bytes, problem: str = "") -> Content:
    """Return the content of a frame whose bytes need not be packets."""
    try:
        index = index_of(payload)
    except ProtocolError:
        index = NO_PACKETS
    return Content(kind, payload, index, -1, problem)


def read_offer(maps: int, payload: bytes) -> Content:
    """Read the frame of an offer."""
    try:
        content = packet_codec.handshake(payload)
    except ProtocolError as error:
        return content_of(OFFER, payload, str(error))
    offer = content[0] if len(content) == 1 else None
    if isinstance(offer, Offer) and offer.map < maps:
        return Content(OFFER, payload, index_of(payload), offer.map)
    return content_of(OFFER, payload, "an offer frame is one offer of a known map")


@_cache_handshakes
def read_answer(payload: bytes) -> Content:
    """Read the frame of an answer."""
    try:
        kinds = [type(packet) for packet in packet_codec.handshake(payload)]
    except ProtocolError as error:
        return content_of(ANSWER, payload, str(error))
    is_answer = kinds[-1:] == [packets.Answer] and kinds[:-1] in ([], [packets.Block], 2 * [packets.Block])
    problem = "an answer frame is an answer behind at most two blocks, or a decline"
    return content_of(ANSWER, payload, "" if is_answer or payload == packet_codec.DECLINE else problem)


@cache_short(64)
def read_data(payload: bytes) -> Content:
    """Read a frame of data."""
    try:
        index = index_of(payload)
    except ProtocolError as error:
        return Content(DATA, payload, NO_PACKETS, -1, str(error))
    odd = _first_of(index, _NO_DATA)
    problem = f"a data frame holds no {odd}" if odd else "" if payload else "an empty data frame"
    return Content(DATA, payload, index, -1, problem)


def read_news(settings: RadioSettings, payload: bytes) -> Content:
    """Read a frame of a round without connections: reports and offers, then log entries."""
    try:
        index = index_of(payload)
        reports = _conn_packets(payload, index)
    except ProtocolError as error:
        return Content(NEWS if settings.gossip else DATA, payload, NO_PACKETS, -1, str(error))
    problem = _wrong_in_news(settings, index, reports)
    if settings.gossip:
        return Content(NEWS, payload, index, -1, problem)
    if len(reports) < len(index.kinds):
        kind = DATA
    else:
        kind = OFFER if any(isinstance(each, Offer) for each in reports) else ANSWER
    begun = [each.map for each in reports if isinstance(each, Begins)]
    held = [each.map for each in reports if isinstance(each, Held)]
    return Content(kind, payload, index, (begun or held or [-1])[0], problem)


def _wrong_in_news(settings: RadioSettings, index: PacketIndex, reports: Sequence[packets.AnyPacket]) -> str:
    """Return the error text of a frame of reports and offers, then log entries; empty if it is valid."""
    allowed = packets.Gossip if settings.gossip else OfMap
    odd = [type(each).__name__ for each in reports if not isinstance(each, allowed)]
    odd += filter(None, [_first_of(index, _NO_ENTRIES)])
    if odd:
        return f"no {odd[0]} of this kind"
    if not index.kinds:
        return "nothing in it"
    if settings.gossip:
        return ""
    if any(isinstance(each, OfMap) and each.map >= settings.maps for each in reports):
        return "the map of a robot that does not exist"
    first = next((at for at, kind in enumerate(index.kinds) if kind != _CONN), len(index.kinds))
    if first < len(index.kinds) and not any(isinstance(each, From) for each in reports[:first]):
        return "log entries without the position at which they begin"
    return ""


def _first_of(index: PacketIndex, unwanted: Sequence[str]) -> str:
    """Return the first of these packet names that a frame holds, empty if it holds none."""
    return next((name for name in unwanted if KIND_NUMBER[name] in index.kinds), "")


def _conn_packets(payload: bytes, index: PacketIndex) -> list[packets.AnyPacket]:
    """Decode the packets of a frame that are offers, answers and reports; ProtocolError if they are too many."""
    if index.kinds.count(_CONN) > MAX_REPORTS:
        raise ProtocolError(Offer.name, 0, f"{index.kinds.count(_CONN)} reports; at most {MAX_REPORTS}")
    return [
        packet_codec.decode(payload[end - size : end])[0]
        for kind, size, end in zip(index.kinds, index.sizes, index.ends, strict=True)
        if kind == _CONN
    ]


_CONN = KIND_NUMBER[Offer.name]
_NO_ENTRIES = (packets.Target.name, packets.Pose.name, Check.name)
_NO_DATA = (Offer.name, *_NO_ENTRIES)
