"""What the relay says for robots: replies that they have told it together with their offers.

An exchange has three phases, and to ask each robot in each costs a message to it and one from it. But a robot knows
beforehand how it would answer nearly all offers, and what it would send behind nearly all answers to its own; it says
so (`protocol.messages.Replies`), and is asked only where something else was said. What goes on the air, and in which
order, is the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from netshaper.frames import declines
from netshaper.medium import UNLIMITED
from protocol import packet_index
from protocol.messages import PhaseDelivery, Replies, Said

Offered = Mapping[tuple[int, int], int]
"""Of each offer of a robot, by its receiver and map, the place among them."""


class Beforehand(NamedTuple):
    """What a robot has said before an exchange of what it is going to say."""

    replies: Replies
    offered: Offered


def answers(
    said: Beforehand, turn: PhaseDelivery, peers: Sequence[int], offers: Sequence[bytes]
) -> Said | None:
    """Answer offers of `peers` for a robot; None if it has to be asked."""
    known = dict(zip(said.replies.offers, said.replies.answers, strict=True))
    taken: set[int] = set()
    frames: list[bytes] = []
    for map_id, offer in zip(turn.maps, offers, strict=True):
        answer = known.get(offer)
        if answer is None:
            return None
        frames.append(said.replies.decline if map_id in taken else answer)
        taken.add(map_id)
    return Said(turn.step, turn.round, "answers", turn.connections, 0, list(peers), frames)


def data(
    said: Beforehand, turn: PhaseDelivery, peers: Sequence[int], heard: Sequence[bytes], room: int
) -> Said | None:
    """Send for a robot, in all no more than `room`, what follows answers of `peers`; None if it has to be asked."""
    replies = said.replies
    numbers: list[int] = []
    receivers: list[int] = []
    frames: list[bytes] = []
    for number, peer, map_id, answer in zip(turn.connections, peers, turn.maps, heard, strict=True):
        place = said.offered[peer, map_id]
        if place >= len(replies.load):
            return None
        if answer == replies.level[place] or declines(answer):
            continue
        if answer != replies.behind[place] or replies.load[place] < 0:
            return None
        frame = replies.loads[replies.load[place]]
        if room != UNLIMITED:
            frame = frame if len(frame) <= room else frame[: packet_index.fitting(frame, room)]
            room -= len(frame)
        if frame:
            numbers.append(number)
            receivers.append(peer)
            frames.append(frame)
    return Said(turn.step, turn.round, "data", numbers, 0, receivers, frames)
