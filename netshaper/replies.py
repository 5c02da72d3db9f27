"""Speculative replies: the relay answers for a robot that has sent its replies together with its offers.

A round of handshakes has three phases, and asking each robot in each phase costs a message to it and one from it. But
a robot knows in advance how it answers nearly all offers, and what it sends after nearly all answers to its own. It
sends these replies in advance (`protocol.messages.Replies`), and the relay asks it only in other cases. The frames on
the air and their order are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from netshaper.admission import declines
from protocol.budget import Budget
from protocol.messages import Delivery, OutgoingFrame, Replies
from protocol.packet_index import fitting


class Speculation(NamedTuple):
    """A robot's replies in advance, and the position of each of its offers by receiver and map."""

    replies: Replies
    offered: dict[tuple[int, int], int]


def answers(speculation: Speculation, offers: Sequence[Delivery]) -> list[OutgoingFrame] | None:
    """Answer offers for a robot; None if it has to be asked."""
    known = {reply.offer: reply.answer for reply in speculation.replies.offers}
    taken: set[int] = set()
    frames: list[OutgoingFrame] = []
    for offer in offers:
        answer = known.get(offer.payload)
        if answer is None:
            return None
        payload = speculation.replies.decline if offer.map_id in taken else answer
        taken.add(offer.map_id)
        frames.append(OutgoingFrame(offer.sender, payload, offer.connection))
    return frames


def data(speculation: Speculation, answered: Sequence[Delivery], room: Budget) -> list[OutgoingFrame] | None:
    """Send data for a robot, in all no more than `room`, after answers to its offers; None if it has to be asked."""
    replies, loads = speculation.replies.answers, speculation.replies.loads
    frames: list[OutgoingFrame] = []
    for answer in answered:
        position = speculation.offered[answer.sender, answer.map_id]
        if position >= len(replies):
            return None
        reply = replies[position]
        if answer.payload == reply.up_to_date or declines(answer.payload):
            continue
        if answer.payload != reply.behind or reply.load < 0:
            return None
        payload = loads[reply.load]
        if room.limit is not None:
            payload = payload if room.fits(len(payload)) else payload[: fitting(payload, room.limit)]
            room = room.minus(len(payload))
        if payload:
            frames.append(OutgoingFrame(answer.sender, payload, answer.connection))
    return frames
