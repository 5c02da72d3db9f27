"""Connections of a round of handshakes: each is one offer, its answer and its data, from one robot to another.

A round of handshakes has three phases, and asking each robot in each phase costs a message to it and one from it. But
a robot knows in advance how it answers nearly all offers, and what it sends after nearly all answers to its own. It
sends these replies in advance (`protocol.messages.Replies`), and the relay asks it only in other cases. The frames on
the air and their order are the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from netshaper.admission import DECLINE
from netshaper.frame_log import Content
from netshaper.ledger import ANSWER, OFFER
from protocol.budget import Budget
from protocol.messages import NO_LOAD
from protocol.packet_index import fitting


class Connection(msgspec.Struct, eq=False, gc=False):
    """One connection.

    Attributes
    ----------
    number : int
        Its number in the step, in the order in which connections go on the air.
    sender, receiver, map_id : int
        The robot that offers a map, the robot that receives the offer, and the map.
    frames : list of Content
        The offer, the answer and the data, as far as they have been sent.
    loads : mapping of bytes to int
        Which load the sender sends after each answer (`Replies.data`).
    lost : int
        The kind of the frame whose receiver could not receive it; -1 for none.
    """

    number: int
    sender: int
    receiver: int
    map_id: int
    frames: list[Content]
    loads: Mapping[bytes, int]
    lost: int = -1

    def ends(self, kind: int) -> tuple[int, int]:
        """Return sender and receiver of its frame of a kind."""
        return (self.receiver, self.sender) if kind == ANSWER else (self.sender, self.receiver)

    def accepts(self, kind: int, sender: int, receiver: int) -> bool:
        """Return whether a frame of a kind is its next one, and between the right robots."""
        return self.ends(kind) == (sender, receiver) and len(self.frames) == kind and self.lost < 0


def answers(replies: Mapping[bytes, bytes], offered: Sequence[Connection]) -> list[bytes] | None:
    """Answer offers by `Replies.answers` of their receiver; None if the relay has to ask it."""
    taken: set[int] = set()
    payloads = []
    for connection in offered:
        answer = replies.get(connection.frames[OFFER].payload)
        if answer is None:
            return None
        payloads.append(DECLINE if connection.map_id in taken else answer)
        taken.add(connection.map_id)
    return payloads


def data(loads: Sequence[bytes], answered: Sequence[Connection], room: Budget) -> list[bytes] | None:
    """Return the data, at most `room` bytes, that a robot with these `Replies.loads` sends after answers.

    Empty data are not sent. None if the relay has to ask the robot.
    """
    payloads = []
    for connection in answered:
        answer = connection.frames[ANSWER].payload
        load = NO_LOAD if answer == DECLINE else connection.loads.get(answer)
        if load is None or not connection.loads:
            return None
        payload = b"" if load == NO_LOAD else loads[load]
        if room.limit is not None and payload:
            payload = payload if room.fits(len(payload)) else payload[: fitting(payload, room.limit)]
            room = room.minus(len(payload))
        payloads.append(payload)
    return payloads
