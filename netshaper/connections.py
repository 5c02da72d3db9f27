"""Connections of a round of handshakes: each is one offer, its answer and its data, from one robot to another.

A round of handshakes has three phases, and asking each robot in each phase costs a message to it and one from it. But
a robot knows in advance how it answers nearly all offers, and what it sends after nearly all answers to its own. It
sends these replies in advance (`protocol.messages.Replies`), and the relay asks it only in other cases. The frames on
the air and their order are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from netshaper.admission import DECLINE
from netshaper.frame_log import Content
from netshaper.ledger import ANSWER, OFFER
from protocol.budget import Budget
from protocol.messages import Replies
from protocol.packet_index import fitting


@dataclass(slots=True, eq=False)
class Connection:
    """One connection.

    Attributes
    ----------
    number : int
        Its number in the step, in the order in which connections go on the air.
    sender, receiver, map_id : int
        The robot that offers a map, the robot that receives the offer, and the map.
    position : int
        Position of the offer among the frames that its sender submitted.
    frames : list of Content
        The offer, the answer and the data, as far as they have been sent.
    lost : int
        The kind of the frame whose receiver could not receive it; -1 for none.
    """

    number: int
    sender: int
    receiver: int
    map_id: int
    position: int
    frames: list[Content]
    lost: int = -1

    def ends(self, kind: int) -> tuple[int, int]:
        """Return sender and receiver of its frame of a kind."""
        return (self.receiver, self.sender) if kind == ANSWER else (self.sender, self.receiver)

    def accepts(self, kind: int, sender: int, receiver: int) -> bool:
        """Return whether a frame of a kind is its next one, and between the right robots."""
        return self.ends(kind) == (sender, receiver) and len(self.frames) == kind and self.lost < 0


def answers(replies: Replies, offered: Sequence[Connection]) -> list[bytes] | None:
    """Answer offers for the robot that sent `replies`; None if the relay has to ask it."""
    known = {reply.offer: reply.answer for reply in replies.offers}
    taken: set[int] = set()
    payloads = []
    for connection in offered:
        answer = known.get(connection.frames[OFFER].payload)
        if answer is None:
            return None
        payloads.append(replies.decline if connection.map_id in taken else answer)
        taken.add(connection.map_id)
    return payloads


def data(replies: Replies, answered: Sequence[Connection], room: Budget) -> list[bytes] | None:
    """Return the data, at most `room` bytes, that a robot sends after answers; None if the relay has to ask it.

    Empty data are not sent.
    """
    payloads = []
    for connection in answered:
        if connection.position >= len(replies.answers):
            return None
        reply, answer = replies.answers[connection.position], connection.frames[ANSWER].payload
        if answer in (reply.up_to_date, DECLINE):
            payloads.append(b"")
            continue
        if answer != reply.behind or reply.load < 0:
            return None
        payload = replies.loads[reply.load]
        if room.limit is not None:
            payload = payload if room.fits(len(payload)) else payload[: fitting(payload, room.limit)]
            room = room.minus(len(payload))
        payloads.append(payload)
    return payloads
