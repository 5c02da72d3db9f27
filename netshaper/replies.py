"""What the relay says for robots: replies that they have told it together with their offers.

An exchange has three phases, and to ask each robot in each costs a message to it and one from it. But a robot knows
beforehand how it is going to answer offers, and what it is going to send to nearly all who answer its own; it says so
(`protocol.messages.Replies`), and is asked only where that is not enough. What goes on the air, and in which order, is
the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from netshaper.medium import ANSWER, OFFER, UNLIMITED, Connections
from protocol import handshake, survey
from protocol.messages import Replies


class Beforehand(NamedTuple):
    """What a robot has said of what it is going to say; `offered`: the place of each offer, by receiver and map."""

    replies: Replies
    offered: Mapping[tuple[int, int], int]


class Reply(NamedTuple):
    """What a robot says in a connection (None: nothing), and what came of that (`protocol.handshake`)."""

    frame: bytes | None
    event: int


def answers(said: Beforehand, these: Connections, places: Sequence[int]) -> list[Reply] | None:
    """Answer for a robot the offers that it hears, in connections at `places`; None if it has to be asked."""
    held, asks = said.replies.held, said.replies.asks
    taken: set[int] = set()
    found: list[Reply] = []
    for at in places:
        about, offer = these.maps[at], these.frames[OFFER][at]
        if offer is None or about >= len(held) or about in asks:
            return None
        if about in taken:
            found.append(Reply(handshake.DECLINE, handshake.UNWANTED_OFFER))
            continue
        taken.add(about)
        block = handshake.read_offer(offer).block
        found.append(Reply(handshake.answer(held[about], block), handshake.FIRST_OFFER))
    return found


def data(said: Beforehand, these: Connections, places: Sequence[int], room: int) -> list[Reply] | None:
    """Send for a robot, in all no more than `room`, what follows answers at `places`; None if it has to be asked."""
    held, known, load, loads = said.replies.held, said.replies.known, said.replies.load, said.replies.loads
    found: list[Reply] = []
    for at in places:
        about, answer = these.maps[at], these.frames[ANSWER][at]
        place = said.offered[these.receivers[at], about]
        if answer is None or place >= len(known) or about >= len(held):
            return None
        index = handshake.held_by(answer, known[place])
        if index is None:
            found.append(Reply(None, handshake.DECLINED))
        elif not known[place] <= index < held[about]:
            found.append(Reply(None, handshake.LEVEL))
        elif index != known[place] or load[place] < 0:
            return None
        else:
            frame = loads[load[place]]
            if room != UNLIMITED:
                frame = frame if len(frame) <= room else frame[: survey.fitting(frame, room)]
                room -= len(frame)
            found.append(Reply(frame or None, handshake.BEHIND))
    return found
