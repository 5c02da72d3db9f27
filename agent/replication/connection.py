"""One connection of a handshake round, as one of its two ends sees it (thesis, section 5.1.2, Algorithm 8).

`TRANSITIONS` is the table that the code runs by, as h11 does for HTTP; an answer to an offer that was not made is an
error:

    side      state      event                                   next state   action
    offerer   idle       round opens, peer lacks entries         offered      send offer(map, block)
    offerer   offered    answer, length below this robot's       sending      send the entries from there on
    offerer   offered    answer, length not below                refused      send nothing
    offerer   offered    decline                                 refused      send nothing
    receiver  idle       offer, first of its map                 taking       send answer(length)
    receiver  idle       offer, another of that map              declining    send decline
    receiver  idle       offer of the receiver's own map         declining    send decline
    receiver  idle       offer from a distrusted peer            declining    send decline

All connections end with the round: the offerer updates its peer table by the send report, the receiver appends the
entries that arrived.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from agent.replication.frame_builder import FrameBuilder


class State(StrEnum):
    """State of a connection."""

    __hash__ = str.__hash__  # that of enumerations is slow: it is not compiled

    IDLE = "idle"
    OFFERED = "offered"
    SENDING = "sending"
    REFUSED = "refused"
    TAKING = "taking"
    DECLINING = "declining"


class Event(StrEnum):
    """Event that a connection reacts to."""

    __hash__ = str.__hash__

    NEWS = "the round opens and the peer lacks entries"
    BEHIND = "the answer's length is below this robot's"
    LEVEL = "the answer's length is not below this robot's, or the peer does not want the entries"
    DECLINED = "the peer declines the offer"
    FIRST_OFFER = "the first offer of a map in this round"
    UNWANTED_OFFER = "another offer of that map, one of the receiver's own map, or one from a distrusted peer"


TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.IDLE, Event.NEWS): State.OFFERED,
    (State.OFFERED, Event.BEHIND): State.SENDING,
    (State.OFFERED, Event.LEVEL): State.REFUSED,
    (State.OFFERED, Event.DECLINED): State.REFUSED,
    (State.IDLE, Event.FIRST_OFFER): State.TAKING,
    (State.IDLE, Event.UNWANTED_OFFER): State.DECLINING,
}


@dataclass(slots=True)
class Connection:
    """One end of a connection.

    Attributes
    ----------
    peer, number : int
        The other end, and the map's number.
    state : State
    length : int
        As offerer: entries that the peer holds, by its answer; before the answer, as expected.
    frame : FrameBuilder, optional
        As offerer: the entries that are sent.
    """

    peer: int
    number: int
    state: State = State.IDLE
    length: int = 0
    frame: FrameBuilder | None = None

    def on(self, event: Event) -> State:
        """Follow the transition table."""
        self.state = TRANSITIONS[self.state, event]
        return self.state
